"""The switch at the bench: without it nothing is powered, armed or moved; without it an armed bench stops."""

from __future__ import annotations

import pytest

from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from hil.drivers.io.mock import MockIo
from hil.errors import LinkTimeout, SafetyTrip
from hil.loop.safety_io_stage import SafetyIoStage
from hil.session import build
from tests.support.operated_bench import Script, Session, operate
from tests.support.run_settings import make_job

LINES = ('rig.io={driver="mock", inputs={local_enable=2}}',)
TEXT = "io: local enabling input off, allowed on"


def switch(session: Session, on: bool) -> None:
    lines = session.runner.loop.safety_io
    assert isinstance(lines, SafetyIoStage)
    assert isinstance(lines.io, MockIo)
    lines.io.local_enable = on


def off(session: Session) -> None:
    switch(session, False)


def idle(_: Session) -> None:
    """Give no command."""


@pytest.mark.parametrize("attended", [True, False])
def test_no_drive_is_enabled_without_it(attended: bool) -> None:
    def script(session: Session) -> None:
        session.order_once(OperatorCommand.STOP, session.mode is Mode.SAFE_STOP and session.since_s("seen") > 0.1)
        session.once("seen", session.mode is Mode.SAFE_STOP)

    outcome, session = operate(script, *LINES, attended=attended, prepare=off)
    assert outcome.faults[0] == TEXT
    assert Mode.STANDBY not in session.seen_modes
    assert not session.rails.sent


@pytest.mark.parametrize("command", ["home", "arm", "park", "jog"])
def test_commands_to_move_are_refused_in_standby_with_one_line(command: str) -> None:
    def script(session: Session) -> None:
        if session.mode is not Mode.STANDBY:
            return
        switch(session, False)
        if session.once("command", True):
            if command == "jog":
                session.operator.jog("rails.x", 1)
            else:
                session.operator.submit(OperatorCommand(command))
        session.order_once(OperatorCommand.STOP, session.since_s("command") > 0.5)

    outcome, session = operate(script, *LINES, plan=())
    assert list(session.operator.rejections) == [TEXT]
    assert not session.rails.sent
    assert set(session.runner.safety.modes.history) == {Mode.OFF, Mode.STANDBY, Mode.SAFE_STOP}
    assert outcome.stop == "stopped by the operator"


def lost_in(mode: Mode, *orders: tuple[OperatorCommand, Mode]) -> Script:
    def script(session: Session) -> None:
        for order, when in orders:
            session.order_once(order, session.mode is when)
        if session.once("lost", session.mode is mode):
            switch(session, False)
        session.order_once(OperatorCommand.RESET, session.since_s("lost") > 1.0)
        session.order_once(OperatorCommand.STOP, session.since_s("lost") > 1.5)

    return script


HOMED = 'rig.rails.y.encoder="incremental"'


@pytest.mark.parametrize(
    ("mode", "settings", "orders"),
    [
        (Mode.HOMING, (HOMED,), ()),
        (Mode.PLACING, (HOMED,), ()),
        (Mode.RUNNING, (), ()),
        (Mode.HOLD, (), ((OperatorCommand.HOLD, Mode.RUNNING),)),
        (Mode.ARMED, (), ()),
    ],
)
def test_an_armed_bench_stops_when_it_is_lost_and_is_not_reset_without_it(
    mode: Mode, settings: tuple[str, ...], orders: tuple[tuple[OperatorCommand, Mode], ...]
) -> None:
    plan = (OperatorCommand.HOME, OperatorCommand.ARM)
    if mode is not Mode.ARMED:
        plan += (OperatorCommand.START,)
    outcome, session = operate(lost_in(mode, *orders), *LINES, *settings, plan=plan, duration_s=8.0)
    assert outcome.faults[0] == TEXT
    assert [alarm.text for alarm in outcome.alarms] == [TEXT]
    if not session.runner.loop.done:  # a session with a run has ended
        assert session.operator.rejections[-1] == TEXT
    assert session.runner.safety.modes.mode is Mode.SAFE_STOP


def test_after_it_is_back_a_reset_opens_the_bench_again() -> None:
    def script(session: Session) -> None:
        if session.once("lost", session.mode is Mode.ARMED):
            switch(session, False)
        if session.once("back", session.since_s("lost") > 1.0):
            switch(session, True)
        session.order_once(OperatorCommand.RESET, session.since_s("back") > 0.2)
        reopened = session.mode is Mode.STANDBY and session.since_s("back") > 0.3
        session.order_once(OperatorCommand.STOP, reopened)

    _, session = operate(script, *LINES, plan=(OperatorCommand.HOME, OperatorCommand.ARM))
    modes = list(session.runner.safety.modes.history)
    assert modes[modes.index(Mode.SAFE_STOP) :][:3] == [Mode.SAFE_STOP, Mode.OFF, Mode.STANDBY]


def test_a_bench_without_the_switch_is_unaffected() -> None:
    outcome, _ = operate(idle, 'rig.io={driver="mock"}', attended=False, prepare=off)
    assert outcome.stop != TEXT


def test_chain_that_opens_while_drives_are_enabled_is_named_instead_of_the_drive() -> None:
    with build.runner(make_job(2.0, LINES)) as runner:
        lines = runner.loop.safety_io
        assert isinstance(lines, SafetyIoStage)
        assert isinstance(lines.io, MockIo)
        io = lines.io

        def fail(_now_s: float) -> None:
            io.open_interlocks = ("door",)
            raise LinkTimeout("turntable.roll", "not enabled within 10 s")

        runner.loop.bench.turntable.open = fail  # type: ignore[method-assign,assignment]
        with pytest.raises(SafetyTrip, match="io: interlock door open, allowed closed"), runner.axes_only():
            pytest.fail("the drives are enabled")
