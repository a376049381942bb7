"""Commands of the operator, and the thread-safe queue from which the loop executes them.

At a terminal a line acts only if it repeats two digits that were shown at most a few seconds before: the network of a
remote terminal, a suspended program or a stuck key may hold a line or repeat it, and what moves the bench must have
been typed by an operator who has just read the question.
"""

from __future__ import annotations

import math
import os
import secrets
import select
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from enum import Enum
from typing import Final, Self

from hil.core.modes import Mode

ANSWER_S: Final = 5.0
"""Wall-clock time after the digits were shown within which they count."""
_ATTEMPTS_MAX: Final = 20
_YES: Final = ("y", "yes")
_NO: Final = ("n", "no")


class FreshDigits:
    """Two digits that are drawn for each question, and count once and for ``ANSWER_S``; none come twice in 90.

    now_s: wall-clock time, s; draw: returns a random number below its argument.
    """

    def __init__(
        self, now_s: Callable[[], float] = time.monotonic, draw: Callable[[int], int] = secrets.randbelow
    ) -> None:
        self._now_s, self._draw = now_s, draw
        self._unused: list[str] = []
        self._digits, self._shown_s = "", 0.0

    def drawn(self) -> str:
        """Return new digits, to be shown now; those before no longer count."""
        if not self._unused:
            self._unused = [str(number) for number in range(10, 100)]
        self._digits, self._shown_s = self._unused.pop(self._draw(len(self._unused))), self._now_s()
        return self._digits

    def refusal(self, typed: str) -> str:
        """Return why ``typed`` does not count, "" if it does."""
        age_s = self._now_s() - self._shown_s
        if typed != self._digits:
            return "does not have the digits that are shown"
        if age_s > ANSWER_S:
            return f"came {age_s:.0f} s after the digits were shown, allowed {ANSWER_S:g} s"
        self._digits = ""
        return ""


def confirmed(
    question: str, ask: Callable[[str], str | None], show: Callable[[str], None], digits: FreshDigits
) -> bool:
    """Return whether ``question`` was answered with yes and the digits shown with it; no needs none.

    ask: shows a prompt and returns the line typed, None at the end of input, which is no; so is the twentieth answer
    that does not count. show: shows a line.
    """
    for _ in range(_ATTEMPTS_MAX):
        answer = ask(f"{question} [y {digits.drawn()} / n] ")
        if answer is None or answer.strip().lower() in _NO:
            return False
        word, _, typed = answer.strip().lower().partition(" ")
        if word not in _YES:
            continue
        if not (refusal := digits.refusal(typed.strip())):
            return True
        show(f"not taken: the answer {refusal}")
    return False


STOP_SIGNALS: Final = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT)
"""Signals of a user, a terminal that closes, or the system, each of which stops the bench."""


class OperatorCommand(Enum):
    """HOME: home the axes. ARM: place the bench, then wait for poses. START: close the loop.

    GO: continue the approach past a waiting point. HOLD: brake all axes, the run's time stops. RESUME: continue
    the run. ABORT: brake and retreat the chaser. DISARM: return to standby. PARK: move to the park position.
    JOG: see ``Operator.jog``. STOP: end the session. RESET: after a safe stop, reopen the devices.
    """

    modes: frozenset[Mode]
    """Modes in which it is executed; in every other mode it is rejected with a message to the operator."""
    button: str
    """Text of its button, "" without one among the commands of the console's page; ``key``: of the keyboard."""
    key: str
    question: str
    """Question that confirms it, "" if it requires no confirmation."""
    moves: bool
    """Whether it moves the axes, or lets them move."""

    def __new__(
        cls,
        name: str,
        modes: Collection[Mode] = (),
        button: str = "",
        key: str = "",
        ask: str = "",
        moves: bool = False,
    ) -> Self:
        command = object.__new__(cls)
        command._value_ = name
        vars(command).update(modes=frozenset(modes), button=button, key=key, question=ask, moves=moves)
        return command

    # fmt: off
    HOME = ("home", {Mode.STANDBY}, "Home", "o",
            "Home: axes that are not homed search for their switches. Is the bench clear of people?", True)
    ARM = ("arm", {Mode.STANDBY}, "Arm", "m",
           "Arm: all axes move to the start pose. Is the bench clear of people?", True)
    START = ("start", {Mode.ARMED}, "Start", "s",
             "Start: the loop is closed and the bench moves automatically. Is the bench clear of people?", True)
    RESUME = ("resume", {Mode.HOLD}, "Resume", "r",
              "Resume: the bench continues from its present position. Is the bench clear of people?")
    GO = ("go", {Mode.RUNNING}, "Go", "g",
          "Go: the chaser leaves its waiting point and approaches the target.")
    ABORT = ("abort", {Mode.RUNNING}, "Abort", "a",
             "Abort: the chaser brakes and retreats with the bench. The approach cannot be continued.")
    DISARM = ("disarm", {Mode.ARMED}, "Disarm", "d")
    PARK = ("park", {Mode.STANDBY}, "Park", "k",
            "Park: all axes move to the park position; the session ends. Is the bench clear of people?", True)
    RESET = ("reset", {Mode.SAFE_STOP}, "Reset", "e",
             "Reset: the devices open and the drives are powered. Is the cause gone, is the bench clear?")
    HOLD = ("hold", {Mode.PLACING, Mode.RUNNING, Mode.HOLD})
    JOG = ("jog", {Mode.STANDBY}, "", "", "", True)
    STOP = ("stop", set(Mode) - {Mode.OFF})
    # fmt: on


class StopCommanded(Exception):
    """The operator commanded the end of the run."""


HALTS: Final = (OperatorCommand.STOP, OperatorCommand.HOLD)
"""Commands that every client of a console may give, without the command of the bench, and that are never too late."""
TOO_LATE: Final = "came too late to be executed: command it again"
DEAD_MAN_S: Final = 0.2
"""Time for which a jog key counts as held after each refresh."""


@dataclass(frozen=True, slots=True)
class JogRequest:
    """Axis by its full name, ``rails.x``; direction 1 or -1. hold_s: bench time for which the key counts as held."""

    axis: str
    direction: int
    hold_s: float = field(default=DEAD_MAN_S, compare=False)


class Operator:
    """Queue of commands, submitted from any thread and executed by the loop in order.

    plan: commands issued automatically, each as soon as its mode is reached. attended: an operator can issue further
    commands; if not, the session ends with the plan, and a safe stop ends it at once. At most ``_CAPACITY`` commands
    are pending: further ones are dropped, STOP never. wall_s: clock of the times until which commands may be executed.
    """

    _CAPACITY: Final = 64

    def __init__(
        self,
        plan: tuple[OperatorCommand, ...] = (OperatorCommand.HOME, OperatorCommand.ARM, OperatorCommand.START),
        attended: bool = False,
        wall_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self.attended = attended
        self._wall_s = wall_s
        self._until_s: dict[OperatorCommand, float] = {}
        self._plan = deque(plan)
        self.pending: deque[OperatorCommand] = deque()
        """Checked by the loop in each cycle: not empty if a command is pending."""
        self.rejections: deque[str] = deque(maxlen=self._CAPACITY)
        """Reasons of rejected commands, newest last."""
        self._lock = threading.Lock()
        self._jog: JogRequest | None = None
        self._refreshed = False

    @property
    def can_resume(self) -> bool:
        """Whether a requested hold can be ended by a command; if not, it becomes a safe stop."""
        return self.attended

    def poll(self, now_s: float) -> None:
        """Fetch commands from another process; called by the loop once per cycle, at bench time ``now_s``.

        No operation here: callers in the loop's process use ``submit``. Raises BenchError if the bench must stop.
        """

    def submit(self, command: OperatorCommand, until_s: float = math.inf) -> None:
        """Append ``command`` to the queue, not to be executed after ``until_s``; STOP goes to the front."""
        with self._lock:
            self._until_s[command] = until_s
            if command is OperatorCommand.STOP:
                self.pending.appendleft(command)
            elif len(self.pending) < self._CAPACITY:
                self.pending.append(command)

    def jog(self, axis: str, direction: int) -> None:
        """Press or refresh the jog key: without a refresh within 0.2 s the axis stops."""
        with self._lock:
            begins = self._jog is None
            self._jog, self._refreshed = JogRequest(axis, direction), True
            if begins and OperatorCommand.JOG not in self.pending:
                self.pending.append(OperatorCommand.JOG)

    def jog_request(self) -> JogRequest | None:
        """Return the requested jog if the key was refreshed since the last call, else None."""
        with self._lock:
            request = self._jog if self._refreshed else None
            self._refreshed = False
            return request

    def end_jog(self) -> None:
        """Clear the jog: the next press starts a new one."""
        with self._lock:
            self._jog, self._refreshed = None, False

    def next_command(self, mode: Mode) -> OperatorCommand | None:
        """Return the next command while none is in execution: a submitted one, else the plan's for ``mode``."""
        command = self.pop(mode)
        if command is None and self._plan and mode in self._plan[0].modes:
            return self._plan.popleft()
        return command

    def is_late(self, command: OperatorCommand) -> bool:
        """Return whether ``command``, as it was submitted last, may no longer be executed."""
        return self._wall_s() > self._until_s.get(command, math.inf)

    def cancel_auto_sequence(self) -> None:
        """Drop the rest of the plan: after a safe stop only the operator issues commands."""
        self._plan.clear()

    def pop(self, mode: Mode) -> OperatorCommand | None:
        """Return the next submitted command that is allowed in ``mode``, or None; reject those before it."""
        with self._lock:
            while self.pending:
                command = self.pending.popleft()
                late = self.is_late(command)
                if mode in command.modes and not late:
                    return command
                reason = f"{command.value} {TOO_LATE}" if late else f"cannot {command.value} in {mode.value}"
                self.rejections.append(f"bench: {reason}")
                if command is OperatorCommand.JOG:
                    self._jog, self._refreshed = None, False
            return None


class TerminalOperator(Operator):
    """Operator at the terminal of a run that needs no other commands: ``resume`` ends a hold, ``stop`` the run.

    ``resume`` alone shows two digits: only with them, and soon after, is it an order; ``stop`` acts whenever it comes.
    descriptor: of the terminal, whose lines are read without waiting; after its end no hold can be resumed. show: shows
    a line at the terminal.
    """

    _LONGEST_LINE: Final = 256

    def __init__(self, descriptor: int, show: Callable[[str], None], digits: FreshDigits | None = None) -> None:
        super().__init__()
        self._descriptor, self._show = descriptor, show
        self._digits = FreshDigits() if digits is None else digits
        self._ended = False
        self._line = b""

    @property
    def can_resume(self) -> bool:
        """Whether the terminal can still send ``resume``."""
        return not self._ended

    def poll(self, now_s: float) -> None:
        """Read the lines that have been typed, and show why a command was not executed."""
        while self.rejections:
            self._show(self.rejections.popleft())
        if self._ended or not select.select([self._descriptor], [], [], 0.0)[0]:
            return
        try:
            typed = os.read(self._descriptor, self._LONGEST_LINE)
        except OSError:  # a job in the background may not read
            return
        self._ended = not typed
        *lines, rest = (self._line + typed).split(b"\n")
        self._line = rest[-self._LONGEST_LINE :]
        for line in lines:
            word, _, given = line.decode(errors="replace").strip().partition(" ")
            if word == "stop":
                self.submit(OperatorCommand.STOP)
            elif word == "resume" and (not given or (refusal := self._digits.refusal(given.strip()))):
                reason = f"not resumed: the line {refusal}; " if given else ""
                self._show(f'{reason}type "resume {self._digits.drawn()}" within {ANSWER_S:g} s')
            elif word == "resume":
                self.submit(OperatorCommand.RESUME, self._wall_s() + ANSWER_S)


class AutoResumeOperator(Operator):
    """Unattended operator that resumes from every hold; RESUME waits until the GNC is ready.

    mode: returns the bench's mode; set by the owner of the bench.
    """

    def __init__(self) -> None:
        super().__init__()
        self.mode: Callable[[], Mode] = lambda: Mode.OFF

    @property
    def can_resume(self) -> bool:
        """A hold is ended by RESUME."""
        return True

    def poll(self, now_s: float) -> None:
        """Submit RESUME in a hold."""
        if self.mode() is Mode.HOLD and not self.pending:
            self.submit(OperatorCommand.RESUME)
