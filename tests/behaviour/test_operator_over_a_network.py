"""Hours of bench time with an operator who comes and goes, a bad network and faults: no motion without a fresh act.

The page, the network and the operator's hand are simulated; the console's service and the bench are the real ones.
Everything is in simulated time, so that hours take minutes and each seed repeats.
"""

from __future__ import annotations

import asyncio
import json
import math
import random
import socket
from collections import Counter, deque
from dataclasses import dataclass, field
from typing import Any, cast

import numpy as np
import pytest

from hil.core.clock import SimulatedClock
from hil.core.modes import AT_REST, Mode
from hil.frmn.mailbox import MailboxBlock
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.parts.console.freshness import ACT_S, JOG_HOLD_S
from hil.parts.console.live_view import Client
from hil.parts.console.remote_operator import OutgoingMessages, RemoteOperator
from hil.parts.console.service import ConsoleService
from hil.parts.console.session import Choice
from hil.parts.console.session_process import SessionProcess
from hil.parts.console.status import CELLS, empty_status
from hil.session import build
from tests.support.run_settings import make_job

AXES = ("rails.x", "rails.y", "rails.z", "turntable.roll", "turntable.pitch", "turntable.yaw")
BEAT_S = 0.1
STEP_S = 0.02
BRAKES_S = 0.3
STANDS_S = 1.5
"""Time in which all axes stand, from full speed."""
STILL = 2e-5
"""Motion of an axis in a cycle, m or rad, that is none: 1 mm/s, 0.06 deg/s."""
FAULTS = (
    ("vmu", "no_pose"),
    ("vmu", "frozen"),
    ("imu", "dropout"),
    ("thruster.3", "stuck_open"),
    ("rails.x", "stuck"),
    ("turntable.yaw", "stuck"),
)
USUAL = {
    "standby": ("home", "arm"),
    "placing": ("hold",),
    "armed": ("start", "disarm"),
    "running": ("hold", "go", "abort"),
    "hold": ("resume",),
    "safe-stop": ("reset",),
}
ORDERS = ("home", "arm", "start", "hold", "resume", "go", "abort", "disarm", "reset", "park", "stop")
HOMED = "rig.rails.y.encoder='incremental'"


class Way:
    """One direction of a connection: what is sent arrives in order, late, and not while it is stalled."""

    def __init__(self) -> None:
        self._held: deque[tuple[float, Any]] = deque()
        self.stalled_until_s = -math.inf

    def send(self, now_s: float, delay_s: float, message: Any) -> None:
        self._held.append((now_s + delay_s, message))

    def arrived(self, now_s: float) -> list[Any]:
        messages = []
        while self._held and now_s >= max(self._held[0][0], self.stalled_until_s):
            messages.append(self._held.popleft()[1])
        return messages


class Line:
    """The session as the console's service sees it: its packets go to the loop, which answers later."""

    ready = True

    def __init__(self, end: socket.socket) -> None:
        self._end = end

    def send(self, **message: Any) -> bool:
        try:
            self._end.send(json.dumps(message).encode())
        except BlockingIOError:
            return False
        return True

    async def request(self, **message: Any) -> dict[str, Any]:
        self.send(**message, id=1)
        return {"text": ""}

    async def ask(self, **message: Any) -> str:
        return str((await self.request(**message))["text"])


@dataclass
class Tally:
    """What was done, and what moved without an act of the hand."""

    sessions: int = 0
    bench_s: float = 0.0
    acts: Counter[str] = field(default_factory=Counter)
    modes: Counter[str] = field(default_factory=Counter)
    refused: int = 0
    moving_s: float = 0.0
    wrong: list[str] = field(default_factory=list)


class Hours:
    """Sessions one after another; ``look`` is called in each cycle of the loop."""

    def __init__(self, seed: int) -> None:
        self.dice = random.Random(seed)
        self.tally = Tally()
        self.base_s = 1000.0
        self.now_s = 0.0
        self.up, self.down = Way(), Way()
        self.client = Client("a" * 16, "ann", page="p")
        self.client.rights = "command"
        made = ConsoleService(Choice(scenario="scheme-1", rig="mock"), ["scheme-1"], ["mock"], self.wall_s)
        self.service = made
        self.number = 0
        self.seen_s = -math.inf  # newest update that the page has drawn
        self.seen_mode = "off"
        self.acted_s: dict[str, float] = {}
        self.held: tuple[str, int] | None = None
        self.held_until_s = self.next_s = -math.inf
        self.last_held_s: dict[str, float] = dict.fromkeys(AXES, -math.inf)
        self.away = self.button = False
        self.button_until_s = -math.inf

    def wall_s(self) -> float:
        return self.base_s + self.now_s

    def page_sends(self, **message: Any) -> None:
        """Send a request as the page does; one whose updates are old sends halts alone."""
        if self.wall_s() - self.seen_s > ACT_S and message.get("order") not in ("stop", "hold"):
            return
        self.number += 1
        self.up.send(self.now_s, self.delay_s(), {"seen_s": self.seen_s, "number": self.number, **message})

    def delay_s(self) -> float:
        return self.dice.choice((0.005, 0.03, 0.1)) * (1.0 + self.dice.random())

    def hand(self) -> None:
        """Do what the operator does now: hold a key, confirm an order, go away, press the emergency stop."""
        if self.held is not None and self.now_s >= self.held_until_s:
            self.page_sends(do="release_key")
            self.held = None
        if self.held is not None:
            self.last_held_s[self.held[0]] = self.now_s
        if self.now_s < self.next_s:
            return
        self.next_s = self.now_s + self.dice.expovariate(0.7)
        chance = self.dice.random()
        if chance < 0.03:
            self.away = not self.away
        elif chance < 0.16:
            for way in self.dice.choice(((self.up,), (self.down,), (self.up, self.down))):
                way.stalled_until_s = self.now_s + 0.1 * 300.0 ** self.dice.random()
        elif chance < 0.165:
            self.button_until_s = self.now_s + self.dice.uniform(0.1, 3.0)
        elif self.away:
            self.held = None
        elif self.seen_mode == "standby" and chance < 0.85:
            self.held = self.dice.choice(AXES), self.dice.choice((-1, 1))
            self.held_until_s = self.now_s + self.dice.uniform(0.05, 4.0)
            self.tally.acts["jog"] += 1
        else:
            self.confirm(self.dice.choice(ORDERS if chance > 0.95 else USUAL.get(self.seen_mode, ORDERS)))

    def confirm(self, word: str) -> None:
        """Confirm an order in the mode that the page shows."""
        self.acted_s[word] = self.now_s
        self.tally.acts[word] += 1
        self.page_sends(do="order", order=word, confirmed=True, mode=self.seen_mode)

    def look(self, runner: Runner) -> None:
        """Pass on what the network brings, act, and let the service execute it."""
        for seen_s, mode in self.down.arrived(self.now_s):
            self.seen_s, self.seen_mode = seen_s, mode
        for request in self.up.arrived(self.now_s):
            self.service.lease.renew(self.client, self.wall_s())
            if "beat" not in request:
                answer = asyncio.run(self.service.execute(self.client, request))
                self.tally.refused += not answer["ok"]
        self.hand()

    def beat(self, runner: Runner) -> None:
        """Send the page its update, and the session the page's presence; refresh a held key."""
        self.down.send(self.now_s, self.delay_s(), (self.wall_s(), runner.safety.modes.mode.value))
        if not self.away:
            self.up.send(self.now_s, self.delay_s(), {"beat": True})
            if self.held is not None:
                self.page_sends(do="jog", axis=self.held[0], direction=self.held[1])
        status = empty_status()
        self.service.state.set_status(self.status.read(status)[0], status, self.wall_s())
        present = self.service.lease.held and self.service.lease.silent_s(self.wall_s()) <= 2.0
        assert self.service.session is not None
        self.service.session.send(present=bool(present))
        if not self.service.lease.held_by(self.client):
            self.service.lease.acquire(self.client, self.wall_s())

    def fly(self, session_s: float) -> None:
        """Run one session that ends by itself after ``session_s``, or by the operator or a fault before."""
        device, kind = self.dice.choice(FAULTS)
        at_s = self.dice.uniform(1.0, 300.0)
        fault = f'{{device="{device}", kind="{kind}", at_s={at_s:.2f}, until_s={at_s + 20.0:.2f}}}'
        job = make_job(400.0, (f"faults=[{fault}]", HOMED), seed=self.dice.randrange(1 << 31))
        here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        here.setblocking(False)
        block = MailboxBlock.create(CELLS, "console")
        self.status = block["status"]
        rate = SimulatedRate(SimulatedClock(), job.scenario.value.step_s)
        operator = RemoteOperator(
            OutgoingMessages(there), block["status"], "hold", 2.0, lambda: self.base_s + rate.now_s()
        )
        runner = build.in_memory(job, rate, SessionParts(operator, operator.on_progress))
        operator.attach(runner)
        self.service.session = cast(SessionProcess, Line(here))
        self.service.state.bench = {**self.service.state.bench, "axes": list(AXES)}
        judge = Judge(self, runner)
        begun = {"next": 0.0}

        def emergency(now_s: float) -> tuple[bool | None, bool]:
            self.now_s = now_s
            while True:
                try:
                    here.recv(1 << 18)
                except BlockingIOError:
                    break
            self.look(runner)
            if now_s >= begun["next"]:
                begun["next"] = now_s + BEAT_S
                self.beat(runner)
            judge.cycle(now_s)
            if now_s > session_s:
                self.service.session.send(order="stop", id=1)  # type: ignore[union-attr]
            return now_s < self.button_until_s, runner.safety.modes.mode is Mode.SAFE_STOP

        runner.loop.bench.emergency_input = emergency
        try:
            runner.run()
        finally:
            here.close()
            there.close()
            block.close()
        self.tally.sessions += 1
        self.tally.bench_s += self.now_s
        self.base_s += self.now_s + 1.0
        self.up, self.down = Way(), Way()
        self.held, self.next_s, self.button_until_s = None, -math.inf, -math.inf
        self.acted_s.clear()
        self.last_held_s = dict.fromkeys(AXES, -math.inf)


class Judge:
    """Compares the motion of all axes, cycle by cycle, with what the hand did."""

    def __init__(self, hours: Hours, runner: Runner) -> None:
        self._hours, self._runner = hours, runner
        self._mode = Mode.OFF
        self._since_s = 0.0
        bench = runner.loop.bench
        self._position, self._before = np.full((2, 6), np.nan)
        for at, group in ((0, bench.rails), (3, bench.turntable)):
            self._watch(group, at)

    def _watch(self, group: Any, at: int) -> None:
        read = group.read

        def watched(now_s: float) -> Any:
            feedback = read(now_s)
            self._position[at : at + 3] = feedback.position
            return feedback

        group.read = watched

    def cycle(self, now_s: float) -> None:
        hours, mode = self._hours, self._runner.safety.modes.mode
        if mode is not self._mode:
            hours.tally.modes[mode.value] += 1
            self._judge_change(mode, now_s)
            self._mode, self._since_s = mode, now_s
        steps = np.abs(self._position - self._before)
        moved = steps > STILL
        self._before = self._position.copy()
        if not moved.any():
            return
        hours.tally.moving_s += STEP_S
        if mode is Mode.JOGGING:
            late = [
                f"{axis} by {step:.2g} {now_s - hours.last_held_s[axis]:.2f} s after its key"
                for axis, step in zip(AXES, steps, strict=True)
                if step > STILL and now_s - hours.last_held_s[axis] > JOG_HOLD_S + BRAKES_S
            ]
            hours.tally.wrong += [f"session {hours.tally.sessions}, {now_s:.2f} s: {text}" for text in late]
        elif mode in AT_REST and now_s - self._since_s > STANDS_S:
            names = [axis for axis, moves in zip(AXES, moved, strict=True) if moves]
            hours.tally.wrong.append(f"session {hours.tally.sessions}, {now_s:.2f} s: {names} move in {mode.value}")

    def _judge_change(self, mode: Mode, now_s: float) -> None:
        """Judge the beginning of a motion by the age of the act that allows it."""
        words = {Mode.HOMING: ("home",), Mode.PLACING: ("arm", "resume"), Mode.RUNNING: ("start", "resume")}.get(mode)
        if words is None:
            return
        age_s = now_s - max(self._hours.acted_s.get(word, -math.inf) for word in words)
        if age_s > ACT_S + 2.0 * STEP_S:
            self._hours.tally.wrong.append(
                f"session {self._hours.tally.sessions}, {now_s:.2f} s: {mode.value} {age_s:.2f} s after {words}"
            )


def fly(seed: int, bench_s: float) -> Tally:
    hours = Hours(seed)
    while hours.tally.bench_s < bench_s:
        hours.fly(min(900.0, bench_s - hours.tally.bench_s))
    print(hours.tally)  # noqa: T201
    return hours.tally


def test_nothing_moves_without_a_fresh_act_in_minutes() -> None:
    tally = fly(1, 300.0)
    assert tally.wrong == []
    assert tally.moving_s > 10.0


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", [11, 12, 13, 14, 15])
def test_nothing_moves_without_a_fresh_act_in_two_hours(seed: int) -> None:
    tally = fly(seed, 7200.0)
    assert tally.wrong == []
    assert tally.modes["running"] > 10
    assert tally.modes["jogging"] > 100
