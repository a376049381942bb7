"""Warning before the first motion, and reduced speeds of parking and jogging, on a mock bench."""

from __future__ import annotations

import numpy as np
import pytest

from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from hil.drivers.io.mock import MockIo
from hil.loop.safety_io_stage import SafetyIoStage
from tests.support.operated_bench import STEP_S, Session, operate

WARNING_S = 0.5
LINES = (f'rig.io={{driver="mock", coils={{warning=30}}, warning_s={WARNING_S}}}',)


def warns(session: Session) -> bool:
    lines = session.runner.loop.safety_io
    assert isinstance(lines, SafetyIoStage)
    assert isinstance(lines.io, MockIo)
    return lines.io.outputs.warning


def test_the_first_motion_is_announced_and_later_ones_are_not() -> None:
    seen: list[tuple[float, bool, bool]] = []

    def script(session: Session) -> None:
        if session.mode in (Mode.STANDBY, Mode.ARMED, Mode.RUNNING):
            seen.append((session.now_s, warns(session), bool(session.rails.sent)))

    outcome, _ = operate(script, *LINES, attended=False, duration_s=1.0)
    assert outcome.stop == "completed"
    warned = [t_s for t_s, on, _ in seen if on]
    assert max(warned) - min(warned) == pytest.approx(WARNING_S, abs=2.5 * STEP_S)
    assert not any(moved for _, on, moved in seen if on)
    assert len(warned) == pytest.approx(WARNING_S / STEP_S, abs=2)


def test_a_stop_ends_the_warning_and_nothing_moves() -> None:
    def script(session: Session) -> None:
        session.order_once(OperatorCommand.STOP, session.mode is Mode.STANDBY and warns(session))

    outcome, session = operate(script, *LINES)
    assert outcome.stop == "stopped by the operator"
    assert not session.rails.sent


def test_parking_has_the_speed_of_the_rig_file() -> None:
    def script(session: Session) -> None:
        session.order_once(OperatorCommand.PARK, session.mode is Mode.STANDBY)

    outcome, session = operate(script, "rig.safety.parking_rate_fraction=0.2", plan=())
    assert outcome.mode is Mode.STANDBY
    t_s, setpoints = session.setpoints()
    speeds = np.diff(setpoints[1:], axis=0) / np.diff(t_s[1:])[:, None]
    assert np.abs(speeds[:, 0]).max() == pytest.approx(0.2 * 0.5, rel=1e-3)
