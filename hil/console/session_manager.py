"""Keeps the one session of a console: who commands it, what it tells, what is written down of it."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from hil.config.load import load_rig
from hil.console.client import Client
from hil.console.columns import console_rows
from hil.console.fault_injection_panel import FaultInjectionPanel
from hil.console.lease import Lease, LeaseRefused
from hil.console.live_view import LiveView
from hil.console.recording_watch import RecordingWatch
from hil.console.session import Choice
from hil.console.session_process import SessionProcess
from hil.console.session_state import SessionState, described
from hil.console.tuner import Tuner
from hil.core.messages import CYCLE
from hil.core.modes import Mode
from hil.params import bench as bench_params

PRESENT_EACH_S: Final = 0.2
_KEPT_LOG: Final = 200


class SessionManager:
    """Holds session and lease. Every method that takes ``now_s`` wants wall time.

    first: what is offered to begin with. scenarios, rigs: what may be chosen. log: told each line of the console's
    own log.
    """

    def __init__(
        self,
        first: Choice,
        scenarios: Sequence[str],
        rigs: Sequence[str],
        wall_s: Callable[[], float],
        log: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.choice = first
        self.scenarios, self.rigs = tuple(scenarios), tuple(rigs)
        self.lease = Lease(load_rig(first.rig, first.settings).value.console.lease_s)
        self.session: SessionProcess | None = None
        self.faults = FaultInjectionPanel()
        self.shown = LiveView()
        self.page_version = 0
        self.clients: list[Client] = []
        self.log: deque[dict[str, Any]] = deque(maxlen=_KEPT_LOG)
        self._say = log
        self.wall_s = wall_s
        self.account = SessionState({}, "no session is open")
        self.tuner: Tuner | None = None
        self.tuning = asyncio.Lock()  # each change is built on the one before
        self._present_said: tuple[str, float] = ("", -math.inf)
        self._tasks: set[asyncio.Task[None]] = set()

    def begin(self, choice: Choice) -> None:
        """Start a session of ``choice``. Raises BadInput where its files do not suit."""
        job = choice.job()
        self.choice = choice
        self.tuner = Tuner(job)
        self.account = SessionState(described(job.rig.value, job.scenario.value), "starting")
        self.lease.lasts_s = job.rig.value.console.lease_s
        self.shown.begin(job)
        self.session = SessionProcess(choice, self._hear)
        self._present_said = ("", -math.inf)
        self.note(f"{choice.scenario} on {choice.rig}, seed {choice.seed}: session process {self.session.pid}")

    def heard(self, client: Client, got: object = None) -> None:
        """The page of ``client`` is alive, and has ``got`` so many messages, where it says so."""
        if isinstance(got, int):
            client.got = got
        self.lease.renew(client.key, self.wall_s())

    def tick(self) -> None:
        """Take what the session has written, tell it whether its operator is there; call some 20 times a second."""
        now_s = self.wall_s()
        if lost := self.lease.expire(now_s):
            self.note(f"{lost} is lost: nothing heard for {self.lease.lasts_s:g} s; nobody has the command")
        session = self.session
        if session is None:
            return
        if session.ready:
            status = session.read_status()
            self.account.take_status(*status, now_s)
            self.shown.take(session, status[1], now_s)
            self.say_who_is_there(session, now_s)
            self._look_at_recording(session)
        session.look()
        if session.ended:
            self.session = None
            self.faults.disconnect()
            self._in_background(session.close())
            self.changed()

    def say_who_is_there(self, session: SessionProcess, now_s: float) -> None:
        """Tell the session whether somebody has the command, and let its recording know who."""
        key, said_s = self._present_said
        if key == self.lease.key and now_s - said_s < PRESENT_EACH_S:
            return
        session.send(present=self.lease.held)
        if key != self.lease.key:
            name = self.lease.name if self.lease.held else "nobody"
            session.send(note=["operator", name, f"{name} has the command"])
        self._present_said = (self.lease.key, now_s)

    def _look_at_recording(self, session: SessionProcess) -> None:
        found = session.read_recording()
        if found is not None and not self.account.closing:
            state, said_s = found
            for line in self.account.recording.look(state, time.monotonic() - said_s):
                self.note(line)

    def put_down(self, kind: str, who: str, text: str) -> None:
        """Let the session's recording have what somebody did."""
        if self.session is not None and self.session.ready:
            self.session.send(note=[kind, who, text])

    def _hear(self, message: dict[str, Any]) -> None:
        """Take a message of the session."""
        if "hello" in message and self.session is not None:
            self.account.word = ""
            self.account.recording = RecordingWatch(self.session.file)
            self._in_background(self._connect_faults(message["hello"]["addresses"]))
        for line in self.account.hear(message):
            self.note(line)
        self.changed()

    async def _connect_faults(self, addresses: dict[str, str]) -> None:
        with suppress(LeaseRefused):  # a device that does not answer has no switches
            await self.faults.connect(addresses)
        self.changed()

    def _in_background(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def note(self, text: str) -> None:
        """Write a line into the console's log."""
        self.log.append({"wall_s": self.wall_s(), "text": text})
        self._say(text)
        self.changed()

    def changed(self) -> None:
        """Let the pages have the slow part of the state anew."""
        self.page_version += 1

    def warm_up(self) -> None:
        """Compile what is called while a bench moves: it must not keep the console from saying that it is there."""
        job = self.choice.job()
        console_rows(bench_params.bench(job.rig.value, job.scenario.value.step_s), np.zeros(2, CYCLE))

    async def close(self) -> None:
        """End the session, the bench first at a stand."""
        if self.session is not None:
            await self.session.close()
            self.session = None
        while self._tasks:
            await asyncio.gather(*self._tasks, return_exceptions=True)

    @property
    def mode(self) -> Mode:
        if self.session is None or not self.session.ready:
            return Mode.OFF
        return self.account.mode
