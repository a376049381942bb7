"""What an operator may order, and the box in which orders wait for the loop."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from typing import Final

from hil.core.modes import Mode


class OperatorCommand(Enum):
    """HOME: let the axes find their places. ARM: place the bench, then wait for poses. START: close the loop.

    GO: let the approach go on from its wait. HOLD: bring all axes to a stand, the run's time stands.
    RESUME: go on. ABORT: let the chaser brake and retreat. DISARM: back to standby. PARK: go to
    where the rig is left. JOG: see
    ``Operator.jog``. STOP: end. RESET: after a safe stop, open the devices anew.
    """

    HOME = "home"
    ARM = "arm"
    START = "start"
    GO = "go"
    HOLD = "hold"
    RESUME = "resume"
    ABORT = "abort"
    DISARM = "disarm"
    PARK = "park"
    JOG = "jog"
    STOP = "stop"
    RESET = "reset"


OBEYED_IN: Final[dict[OperatorCommand, frozenset[Mode]]] = {
    OperatorCommand.HOME: frozenset({Mode.STANDBY}),
    OperatorCommand.ARM: frozenset({Mode.STANDBY}),
    OperatorCommand.START: frozenset({Mode.ARMED}),
    OperatorCommand.GO: frozenset({Mode.RUNNING}),
    OperatorCommand.HOLD: frozenset({Mode.PLACING, Mode.RUNNING, Mode.HOLD}),
    OperatorCommand.RESUME: frozenset({Mode.HOLD}),
    OperatorCommand.ABORT: frozenset({Mode.RUNNING}),
    OperatorCommand.DISARM: frozenset({Mode.ARMED}),
    OperatorCommand.PARK: frozenset({Mode.STANDBY}),
    OperatorCommand.JOG: frozenset({Mode.STANDBY}),
    OperatorCommand.STOP: frozenset(set(Mode) - {Mode.OFF}),
    OperatorCommand.RESET: frozenset({Mode.SAFE_STOP}),
}
"""Modes in which an order is obeyed; in every other one it is refused, and the operator is told."""


class OrderedToStop(Exception):
    """The operator ordered the run to end."""


@dataclass(frozen=True, slots=True)
class JogRequest:
    """Axis by its full name, ``rails.x``; direction 1 or -1."""

    axis: str
    direction: int


class Operator:
    """Takes orders from any thread, gives them to the loop in their sequence.

    plan: orders that are given by themselves, each as soon as its mode is reached. attended: somebody
    is there to give further ones; if not, the session ends with its plan, and a safe stop ends it at
    once. No more than ``_KEPT`` orders wait: what comes beyond that is dropped, STOP never.
    """

    _KEPT: Final = 64

    def __init__(
        self,
        plan: tuple[OperatorCommand, ...] = (OperatorCommand.HOME, OperatorCommand.ARM, OperatorCommand.START),
        attended: bool = False,
    ) -> None:
        self.attended = attended
        self._plan = deque(plan)
        self.waiting: deque[OperatorCommand] = deque()
        """Read by the loop in each cycle: true while an order waits."""
        self.answers: deque[str] = deque(maxlen=self._KEPT)
        """What was refused, and why; newest last."""
        self._lock = threading.Lock()
        self._jog: JogRequest | None = None
        self._refreshed = False

    @property
    def grants_holds(self) -> bool:
        """Whether a hold that was asked for will be ended by an order; if not, it is a safe stop."""
        return self.attended

    def listen(self, now_s: float) -> None:
        """Fetch what has come from outside; called by the loop once a cycle, at bench time ``now_s``.

        Here nothing has: whoever shares the loop's process calls ``order``. Raises BenchError where the bench must
        stop.
        """

    def order(self, order: OperatorCommand) -> None:
        """Let ``order`` wait for the loop; STOP goes before all others."""
        with self._lock:
            if order is OperatorCommand.STOP:
                self.waiting.appendleft(order)
            elif len(self.waiting) < self._KEPT:
                self.waiting.append(order)

    def jog(self, axis: str, direction: int) -> None:
        """Press, or keep pressed, the jog key: to be called again well within 0.2 s, or the axis stops."""
        with self._lock:
            wish = JogRequest(axis, direction)
            begins = self._jog is None
            self._jog, self._refreshed = wish, True
            if begins and OperatorCommand.JOG not in self.waiting:
                self.waiting.append(OperatorCommand.JOG)

    def jog_request(self) -> JogRequest | None:
        """Return what the key asks for where it was refreshed since the last call, None otherwise."""
        with self._lock:
            wish = self._jog if self._refreshed else None
            self._refreshed = False
            return wish

    def jog_ended(self) -> None:
        """Forget the jog: the next press begins a new one."""
        with self._lock:
            self._jog, self._refreshed = None, False

    def next(self, mode: Mode) -> OperatorCommand | None:
        """Return what to do next while nothing is under way: an order, or else what the plan has for ``mode``."""
        order = self.take(mode)
        if order is None and self._plan and mode in OBEYED_IN[self._plan[0]]:
            return self._plan.popleft()
        return order

    def cancel_auto_sequence(self) -> None:
        """Give no further order by itself: after a safe stop somebody has to."""
        self._plan.clear()

    def take(self, mode: Mode) -> OperatorCommand | None:
        """Return the next order that may be obeyed in ``mode``, None if there is none; refuse what comes before it."""
        with self._lock:
            while self.waiting:
                order = self.waiting.popleft()
                if mode in OBEYED_IN[order]:
                    return order
                self.answers.append(f"bench: cannot {order.value} in {mode.value}")
                if order is OperatorCommand.JOG:
                    self._jog, self._refreshed = None, False
            return None


class Resuming(Operator):
    """Nobody is there, and a hold that was asked for ends as soon as everybody is ready to go on.

    mode: gives the bench's mode; it is told by whoever has the bench.
    """

    def __init__(self) -> None:
        super().__init__()
        self.mode: Callable[[], Mode] = lambda: Mode.OFF

    @property
    def grants_holds(self) -> bool:
        """A hold is ended by RESUME, which waits for the GNC to be ready."""
        return True

    def listen(self, now_s: float) -> None:
        """Order RESUME in a hold."""
        if self.mode() is Mode.HOLD and not self.waiting:
            self.order(OperatorCommand.RESUME)
