"""Session manager of the console: the session, its operator, its state and the console's log."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from hil.config.load import load_rig, load_scene
from hil.config.scene import SceneCamera
from hil.core.modes import Mode
from hil.errors import one_line
from hil.loop.runner import COMPLETED
from hil.parts.console.lease import Lease, RequestRejected
from hil.parts.console.live_view import Client, LiveView
from hil.parts.console.session import Choice
from hil.parts.console.session_process import SessionProcess
from hil.parts.console.session_state import RecordingStatus, SessionState, bench_description
from hil.parts.console.tuner import FaultInjectionPanel, Tuner

PRESENCE_PERIOD_S: Final = 0.2
CLIENTS_MAX: Final = 32
_SILENT_S: Final = 5.0  # a page sends a message every 0.2 s
_KEPT_LOG: Final = 200
_LONGEST_LOG_LINE: Final = 1000


class SessionManager:
    """Owns session and lease; ``now_s`` is wall-clock time.

    first: initial choice. scenarios, rigs: allowed choices. log: called with each line of the console's log.
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
        self.view = LiveView()
        self.page_version = 0
        self.clients: list[Client] = []
        self.log_lines: deque[dict[str, Any]] = deque(maxlen=_KEPT_LOG)
        self._print = log
        self.wall_s = wall_s
        self.state = SessionState({}, "no session is open")
        self.stop_reason = ""
        """Why the last session ended before its run was complete; shown until it is acknowledged."""
        self.tuner: Tuner | None = None
        self.television: SceneCamera | None = None
        """Camera of the docking monitor that measures on images, None without one."""
        self.tuning = asyncio.Lock()  # each change is based on the previous one
        self._reported: tuple[int, float] = (0, -math.inf)
        self._opened_by: Client | None = None
        self._tasks: set[asyncio.Task[None]] = set()

    def start_session(self, choice: Choice, opened_by: Client | None = None) -> None:
        """Start a session of ``choice``. opened_by: of whose operator. Raises BadInput for unsuitable files."""
        job = choice.job()
        self.choice = choice
        self.tuner = Tuner(job)
        monitor = job.scenario.value.monitor
        self.television = load_scene(monitor.scene).value.camera if monitor.has_images else None
        self.state = SessionState(bench_description(job.rig.value, job.scenario.value), "starting")
        self.lease.timeout_s = job.rig.value.console.lease_s
        self.view.begin(job)
        self.session = SessionProcess(choice, self._on_message)
        self._reported = (0, -math.inf)
        self._opened_by = opened_by
        work = (
            f"{choice.scenario} on {choice.rig}, seed {choice.seed}"
            if choice.signed_by is None
            else f"commissioning of {choice.rig}"
        )
        self.log(f"{work}: session process {self.session.pid}")

    def admit(self, client: Client) -> None:
        """Add a client. Beyond ``CLIENTS_MAX`` it displaces another one: a silent one if there is one, then the one
        whose last request is the oldest, and the operator who has the command only if no other is left."""
        now_s = client.last_rx_s = self.wall_s()
        for each in self.clients:
            if client.page and (each.page, each.key) == (client.page, client.key):  # its connection was lost
                self.lease.close(each)
                each.displaced.set()
        present = [each for each in self.clients if not each.displaced.is_set()]
        if len(present) >= CLIENTS_MAX:

            def importance(each: Client) -> tuple[bool, bool, float]:
                return self.lease.held_by(each), now_s - each.last_rx_s < _SILENT_S, each.acted_s

            min(present, key=importance).displaced.set()
        self.clients.append(client)
        self.lease.reclaim(client, now_s)
        self.changed()

    def dismiss(self, client: Client) -> None:
        """Remove a client that has disconnected."""
        self.clients.remove(client)
        self.lease.close(client)
        self.changed()

    def refresh(self, client: Client, got: object = None) -> None:
        """Renew the client's lease; got: number of updates that the page has received, if it reports it."""
        if isinstance(got, int):
            client.got = got
        client.last_rx_s = self.wall_s()
        self.lease.renew(client, self.wall_s())

    def tick(self) -> None:
        """Read the session's output and report the operator's presence to it; called about 20 times per second."""
        now_s = self.wall_s()
        if lost := self.lease.expire(now_s):
            self.log(f"{lost} is lost: no message for {self.lease.timeout_s:g} s; no operator has the command")
        session = self.session
        if session is None:
            return
        if session.ready:
            status = session.read_status()
            self.state.set_status(*status, now_s)
            self.view.update(session, status[1], now_s)
            self.report_operator(session, now_s)
            self._poll_recording(session)
        session.poll_exit()
        if session.ended:
            self.session = None
            self.faults.disconnect()
            self._in_background(session.close())
            self.changed()

    def report_operator(self, session: SessionProcess, now_s: float) -> None:
        """Report to the session whether an operator has the command, and record the operator's name."""
        holder, reported_s = self._reported
        if holder == self.lease.number and now_s - reported_s < PRESENCE_PERIOD_S:
            return
        session.send(present=self.lease.held)
        if holder != self.lease.number:
            self._report_holder(session)
        self._reported = (self.lease.number, now_s)

    def _report_holder(self, session: SessionProcess) -> None:
        """Record who has the command, and from where."""
        holder = next((each for each in self.clients if self.lease.held_by(each)), None)
        if holder is not None:
            at = f" at {holder.origin[0]}" if holder.origin[0] else ""
            session.send(note=["operator", f"{holder.name} has the command{at}"], **holder.actor)
        elif not self.lease.held:
            session.send(note=["operator", "no operator has the command"], by="no operator")
        else:
            state = "" if self.lease.number else ", its page is closed"
            session.send(note=["operator", f"{self.lease.name} has the command{state}"], by=self.lease.name)

    def _poll_recording(self, session: SessionProcess) -> None:
        status = session.read_recording()
        if status is not None and not self.state.closing:
            state, updated_s = status
            for line in self.state.recording.update(state, time.monotonic() - updated_s):
                self.log(line)

    def record_event(self, kind: str, client: Client, text: str) -> None:
        """Record an action of the operator of ``client`` in the session's recording."""
        if self.session is not None and self.session.ready:
            self.session.send(note=[kind, text], **client.actor)

    def _on_message(self, message: dict[str, Any]) -> None:
        """Handle a message of the session."""
        if "hello" in message and self.session is not None:
            self.state.status_text = ""
            self.state.recording = RecordingStatus(self.session.file)
            self._in_background(self._connect_faults(message["hello"]["addresses"]))
            if self._opened_by is not None:
                self.record_event("operator", self._opened_by, "opened the bench")
        for line in self.state.apply(message):
            self.log(line)
        if "refused" in message or ("ended" in message and message["ended"]["stop"] != COMPLETED):
            self.stop_reason = self.state.status_text
        if "ended" in message and "signed" in message["ended"]:
            self.rigs = (*self.rigs, message["ended"]["signed"])
            self.choice = self.choice.model_copy(update={"rig": message["ended"]["signed"]})
        self.changed()

    async def _connect_faults(self, addresses: dict[str, str]) -> None:
        with suppress(RequestRejected):  # a device that does not respond has no fault switches
            await self.faults.connect(addresses)
        self.changed()

    def _in_background(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def log(self, text: str) -> None:
        """Append a line to the console's log."""
        text = one_line(text, _LONGEST_LOG_LINE)
        self.log_lines.append({"wall_s": self.wall_s(), "text": text})
        self._print(text)
        self.changed()

    def changed(self) -> None:
        """Send the slow part of the state to all pages again."""
        self.page_version += 1

    def warm_up(self) -> None:
        """Compile the kernels used while a bench moves."""
        self.view.warm_up(self.choice.job())

    async def close(self) -> None:
        """End the session, with the bench stopped first."""
        if self.session is not None:
            await self.session.close()
            self.session = None
        while self._tasks:
            await asyncio.gather(*self._tasks, return_exceptions=True)

    @property
    def mode(self) -> Mode:
        if self.session is None or not self.session.ready:
            return Mode.OFF
        return self.state.mode
