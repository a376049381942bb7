"""A mock rig with an operator who follows a script: called before each look at the encoders."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hil.core.modes import Mode
from hil.core.operator_commands import Operator, OperatorCommand
from hil.loop.outcome import Outcome
from hil.loop.runner import Runner
from hil.session import build
from tests.support.run_settings import make_job

STEP_S = 0.02


class Recorded:
    """An axis group that remembers what it was sent: (bench time, position (3,))."""

    def __init__(self, device: Any) -> None:
        self._device = device
        self.sent: list[tuple[float, np.ndarray]] = []
        self.stood_at: np.ndarray | None = None  # before the first setpoint

    def __getattr__(self, name: str) -> Any:
        return getattr(self._device, name)

    def send(self, position: np.ndarray, rate: np.ndarray, now_s: float) -> np.ndarray:
        if self.stood_at is None:
            self.stood_at = self._device.read(now_s).position
        accepted: np.ndarray = self._device.send(position, rate, now_s)
        self.sent.append((now_s, accepted.copy()))
        return accepted


@dataclass
class Session:
    """What a script sees: time, mode, bench, and which of its own steps it has done."""

    runner: Runner
    operator: Operator
    rails: Recorded
    turntable: Recorded
    now_s: float = 0.0
    button: bool | None = False
    reset: bool = False
    seen_modes: list[Mode] = field(default_factory=list)
    marks: dict[str, float] = field(default_factory=dict)
    """When each step of the script came."""

    @property
    def mode(self) -> Mode:
        return self.runner.safety.modes.mode

    def once(self, step: str, condition: bool = True) -> bool:
        """Return True the first time that ``condition`` holds."""
        if step in self.marks or not condition:
            return False
        self.marks[step] = self.now_s
        return True

    def since_s(self, step: str) -> float:
        """Return how long ago ``step`` came; before it, -inf."""
        return self.now_s - self.marks.get(step, float("inf"))

    def order_once(self, order: OperatorCommand, condition: bool = True) -> None:
        if self.once(order.value, condition):
            self.operator.submit(order)

    def rates(self) -> np.ndarray:
        """Encoder rates of the last look, (6,)."""
        feedback = self.runner.loop.now.feedback
        return np.concatenate([feedback.rail_mps, feedback.gimbal_radps])

    def setpoints(self) -> tuple[np.ndarray, np.ndarray]:
        """Bench times (n,) and setpoints (n, 6) of all that was sent; before them, at -inf, where the axes stood."""
        t = np.array([-np.inf, *(t_s for t_s, _ in self.rails.sent)])
        rows = [[*rail, *gimbal] for (_, rail), (_, gimbal) in zip(self.rails.sent, self.turntable.sent, strict=True)]
        assert self.rails.stood_at is not None
        assert self.turntable.stood_at is not None
        return t, np.array([[*self.rails.stood_at, *self.turntable.stood_at], *rows])


Script = Callable[[Session], None]


def operate(
    script: Script,
    *settings: str,
    duration_s: float = 2.0,
    plan: tuple[OperatorCommand, ...] = (OperatorCommand.HOME, OperatorCommand.ARM, OperatorCommand.START),
    attended: bool = True,
    prepare: Callable[[Session], None] = lambda _: None,
) -> tuple[Outcome, Session]:
    """Run scheme 1 on the mock rig under ``script``; it ends a session that would wait for ever by itself."""
    operator = Operator(plan, attended)
    job = make_job(duration_s, settings)
    with build.runner(job, operator=operator) as runner:
        bench = runner.loop.bench
        session = Session(runner, operator, Recorded(bench.rails), Recorded(bench.turntable))
        bench.rails, bench.turntable = session.rails, session.turntable

        def look(now_s: float) -> tuple[bool | None, bool]:
            session.now_s = now_s
            if not session.seen_modes or session.seen_modes[-1] is not session.mode:
                session.seen_modes.append(session.mode)
            script(session)
            return session.button, session.reset

        bench.emergency_input = look
        prepare(session)
        return runner.run(), session
