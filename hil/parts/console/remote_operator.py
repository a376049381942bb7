"""Operator behind the console: receives the commands of the console process in the loop's thread.

The loop polls the socket once per cycle and never waits: a slow or dead console does not delay it. A message is one
JSON object per packet of a socket pair.

to the loop    {"order": "hold", "by": "ann", "id": 7}
               {"order": "arm", "by": "ann", "confirmed": true, "mode": "standby", "second": KEY, "id": 7,
                "until_s": 812.5}: not executed after that time of the monotonic clock, except STOP and HOLD
               {"acknowledge": 3, "by": "ann", "id": 8}: an alarm, true: all
               {"shelve": [3, 600.0], "by": "ann", "id": 9}
               {"adjust": {"key": "gnc.control.deadband_m", "value": 0.0004, "records": "..."}, "by": "ann", "id": 9}
               {"search": [120, 80, 300, 240], "by": "ann", "id": 9}: of the docking monitor, null: the whole image
               {"jog": ["rails.x", 1], "until_s": 812.5}: the key counts as held until then   {"release": true}: of it
               {"present": true}   {"note": ["operator", "ann has the command"], "by": "ann"}
with "by" come "key" and "rights" of the operator, for the recording
to the console {"answer": 7, "text": ""}, with "ask" or "second" and "mode" if a confirmation is missing
               {"alarms": [...]}    {"events": [...]}   and further ``OutgoingMessages``
"""

from __future__ import annotations

import json
import math
import socket
import time
from collections import deque
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Final

from hil.config.tables.host import OnLoss
from hil.core import alarm_table as table
from hil.core.files import parse_json
from hil.core.messages import Event
from hil.core.modes import AT_REST, Mode
from hil.core.operator_commands import HALTS, TOO_LATE, JogRequest, Operator, OperatorCommand
from hil.frmn.mailbox import Mailbox
from hil.frmn.search_region import SearchRegion, box_text
from hil.gnc_backends.builtin import BuiltinGnc
from hil.loop.runner import Runner
from hil.parts.console.status import StatusWriter
from hil.recording.audit import Actor
from hil.recording.sinks import EventRecorder
from hil.session.live_tuning import unpacked

STATUS_PERIOD_WALL_S: Final = 0.05
_PACKETS_PER_CYCLE: Final = 8
_KEPT_MESSAGES: Final = 512
_PACKET: Final = 1 << 18  # the parameters of a changed setting take up to 70 kB
NO_MONITOR: Final = "bench: no docking monitor measures on images in this session"
_HOLDABLE: Final = frozenset({Mode.PLACING, Mode.RUNNING})
"""Modes with motion that a hold can interrupt; other motion ends by a safe stop."""


class OutgoingMessages:
    """Messages to the console, sent in order and without blocking.

    They are stored while the console does not read; beyond ``_KEPT_MESSAGES`` the oldest are dropped.
    """

    def __init__(self, channel: socket.socket) -> None:
        channel.setblocking(False)
        self.channel = channel
        self._waiting: deque[bytes] = deque(maxlen=_KEPT_MESSAGES)

    def send(self, **message: Any) -> None:
        """Send one packet, or store it until the socket accepts it."""
        self._waiting.append(json.dumps(message).encode())
        self.flush()

    def flush(self) -> None:
        """Send the stored packets, as far as the socket accepts them."""
        while self._waiting:
            try:
                self.channel.send(self._waiting[0])
            except BlockingIOError:
                return
            except OSError:  # the console is gone
                self._waiting.clear()
                return
            self._waiting.popleft()


class RemoteOperator(Operator):
    """Receives commands from ``messages.channel`` in the loop's thread, and reacts to the loss of the operator.

    on_loss: reaction after the operator's page, or the console, has been silent for ``lease_s`` of wall-clock time
    while the bench moves. wall_s: the clock for that. second_person: commands that another person confirms as well.
    """

    def __init__(
        self,
        messages: OutgoingMessages,
        status: Mailbox,
        on_loss: OnLoss,
        lease_s: float,
        wall_s: Callable[[], float] = time.monotonic,
        second_person: tuple[str, ...] = (),
    ) -> None:
        super().__init__((), attended=True, wall_s=wall_s)
        self._second_person = second_person
        self._messages = messages
        self._status = status
        self._on_loss = on_loss
        self._lease_s = lease_s
        self._last_rx_s = wall_s()
        self._present = True
        self._disconnected = False
        self._reacted = False
        self._published_s = -STATUS_PERIOD_WALL_S
        self._published: tuple[object, ...] = ()
        self._runner: Runner
        self._writer: StatusWriter
        self._recorder: EventRecorder | None = None
        self._adjustable: tuple[str, ...] = ()
        self._search: SearchRegion | None = None
        self._jog_until_s = -math.inf

    def attach(
        self,
        runner: Runner,
        recorder: EventRecorder | None = None,
        adjustable: tuple[str, ...] = (),
        search: SearchRegion | None = None,
    ) -> None:
        """Attach the runner, before the first cycle.

        recorder: records the operators' commands. adjustable: settings that may be changed. search: region of search
        of the docking monitor.
        """
        self._search = search
        self._runner = runner
        self._recorder = recorder
        self._adjustable = adjustable
        self._writer = StatusWriter(runner)
        self._last_rx_s = self._wall_s()

    def on_progress(self, _: Mode, fraction: float) -> None:
        """Store the completed fraction of the present sequence."""
        self._writer.fraction = fraction

    def poll(self, now_s: float) -> None:
        """Receive messages, publish the status, and react to the loss of the operator. Raises SafetyTrip."""
        self._receive()
        wall_s = self._wall_s()
        if wall_s - self._published_s >= STATUS_PERIOD_WALL_S:
            self._published_s = wall_s
            self.publish(now_s)
        self._check_presence(wall_s)

    def publish(self, now_s: float) -> None:
        """Write the status, and send new alarms, events and rejected commands."""
        self._status.write(self._writer.fill(now_s), now_s)
        while self.rejections:
            self._messages.send(word=self.rejections.popleft())
        self._runner.safety.alarms.poll(now_s)
        alarms = self._runner.safety.alarms.all()
        events = self._runner.all_events()
        state = (alarms, len(events), self._runner.safety.hold_reason)
        if state != self._published:
            self._published = state
            self._messages.send(
                alarms=[alarm.as_json() for alarm in alarms],
                events=[{"t_s": event.t_s, "source": event.source, "text": event.text} for event in events[-50:]],
                hold_reason=self._runner.safety.hold_reason,
            )
        self._messages.flush()

    def _receive(self) -> None:
        for _ in range(_PACKETS_PER_CYCLE):
            try:
                packet = self._messages.channel.recv(_PACKET)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if not packet:
                self._disconnected = True
                return
            self._last_rx_s = self._wall_s()
            try:
                self._handle(parse_json(packet))
            except (ValueError, LookupError, TypeError, AttributeError) as error:  # of the console: no end of the loop
                self._messages.send(word=f"bench: a message of the console cannot be read: {error!r}")

    def _handle(self, message: dict[str, Any]) -> None:
        who = Actor(*(str(message.get(name, "")) for name in ("by", "key", "rights")))
        if "present" in message:
            self._present = bool(message["present"])
        elif "jog" in message:
            self._jog_until_s = float(message["until_s"])
            if self._wall_s() <= self._jog_until_s:
                self.jog(*message["jog"])
        elif "release" in message:
            self._jog_until_s = -math.inf
        elif "note" in message:
            kind, text = message["note"]
            self._log_event(kind, who, text)
        elif "acknowledge" in message:
            number = None if message["acknowledge"] is True else int(message["acknowledge"])
            self._runner.safety.alarms.acknowledge(number, who.name)
            self._log_event("operator", who, f"acknowledged {'the alarms' if number is None else f'alarm {number}'}")
            self._messages.send(answer=message["id"], text="")
        elif "shelve" in message:
            number, lasting_s = int(message["shelve"][0]), float(message["shelve"][1])
            text = self._runner.safety.alarms.shelve(number, self._runner.now_s(), lasting_s, who.name)
            self._log_event(
                "operator", who, f"shelved alarm {number} for {lasting_s:g} s{text and f': rejected: {text}'}"
            )
            self._messages.send(answer=message["id"], text=text)
        elif "search" in message:
            self._messages.send(answer=message["id"], text=self._search_in(message["search"], who))
        elif "adjust" in message:
            late = "came too late to be applied: change it again"
            text = late if self._is_late(message) else self._adjust(message["adjust"], who)
            self._messages.send(answer=message["id"], text=text)
        elif "order" in message:
            self._messages.send(answer=message["id"], **self._order(message, who))

    def jog_request(self) -> JogRequest | None:
        """Return the requested jog in each cycle until its deadline, which no hold in bench time extends."""
        with self._lock:
            held = self._jog is not None and self._wall_s() <= self._jog_until_s
            return replace(self._jog, hold_s=0.0) if self._jog is not None and held else None

    def _order(self, message: dict[str, Any], operator: Actor) -> dict[str, Any]:
        """Submit a command that the present mode allows and that is confirmed for it; return the answer."""
        command, mode = OperatorCommand(message["order"]), self._runner.safety.modes.mode
        word, confirmed_in = command.value, message.get("mode") or mode.value
        refusal = ""
        if mode not in command.modes:
            refusal = f"bench: cannot {word} in {mode.value}"
            refusal += ": STOP ends it" if command is OperatorCommand.HOLD and mode not in AT_REST else ""
        elif command not in HALTS and self._is_late(message):  # ABORT moves the chaser: it is refused as any motion is
            refusal = f"bench: {word} {TOO_LATE}"
        elif command.question:
            if message.get("confirmed") is not True:
                return {"text": "", "ask": command.question, "mode": mode.value}
            if confirmed_in != mode.value:
                refusal = f"bench: {word} was confirmed in {confirmed_in}, not for {mode.value}: confirm it again"
            elif word in self._second_person and message.get("second", "") in ("", operator.key):
                return {"text": "", "second": word, "mode": mode.value}
        if not refusal:
            self.submit(command, math.inf if command in HALTS else float(message.get("until_s", math.inf)))
        self._log_event("operator", operator, f"{word}{refusal and f': rejected: {refusal}'}")
        return {"text": refusal}

    def _is_late(self, message: dict[str, Any]) -> bool:
        return bool(self._wall_s() > message.get("until_s", math.inf))

    def _search_in(self, box: list[int] | None, operator: Actor) -> str:
        """Set the docking monitor's region of search, u, v, width, height, px; return the reason of a rejection."""
        if self._search is None:
            return NO_MONITOR
        self._search.set(box)
        self._log_event("operator", operator, f"the docking monitor searches {box_text(box)}")
        return ""

    def _adjust(self, change: dict[str, Any], operator: Actor) -> str:
        """Apply a changed setting before the next cycle; return the reason of a rejection, "" if applied.

        The sender has checked the setting and built its records, so that no cycle waits for it.
        """
        key, value = change["key"], float(change["value"])
        if key not in self._adjustable:
            return f"{key}: not adjustable during a run of this scenario"
        try:
            records = unpacked(change["records"])
        except ValueError as error:
            return f"{key}: {error}"
        gnc = self._runner.loop.gnc
        if not isinstance(gnc, BuiltinGnc):
            return f"{key}: a setting of the built-in GNC, which is not active"
        cycle = gnc.adjust(records)
        text = f"{key}={value!r}"
        if self._recorder is not None:
            self._recorder.setting(cycle, operator, text)
        t_s = float(self._runner.loop.now.t_s[0])
        self._runner.events.append(Event(t_s, "bench", f"{operator.name} changed {text}, from cycle {cycle}"))
        return ""

    def _log_event(self, kind: str, operator: Actor, text: str) -> None:
        """Record an action of an operator if the session is recorded; a replay ignores it."""
        if self._recorder is not None:
            self._recorder.operator(kind, operator, text)

    def _check_presence(self, wall_s: float) -> None:
        silent_s = wall_s - self._last_rx_s
        if self._present and not self._disconnected and silent_s <= self._lease_s:
            self._reacted = False
        else:
            self._react_to_loss(silent_s)

    def _react_to_loss(self, silent_s: float) -> None:
        """Hold or stop a moving bench, once; end the session of a dead console when the bench is at rest."""
        safety = self._runner.safety
        mode = safety.modes.mode
        kind = table.CONSOLE_PROCESS if self._disconnected else table.OPERATORS_PAGE
        trip = kind.trip(
            "console", "disconnected" if self._disconnected else max(silent_s, self._lease_s), self._lease_s
        )
        if not self._reacted and mode not in AT_REST:
            as_set = mode is Mode.RUNNING or self._on_loss != "continue"
            reaction = self._on_loss if as_set else "hold"  # only a run continues without its operator
            if reaction == "stop" or (reaction == "hold" and mode not in _HOLDABLE):
                self._reacted = True
                raise trip
            if reaction == "hold":
                self._reacted = True
                safety.request_hold(f"console: {kind.quantity} {trip.alarm.value}, allowed {self._lease_s:g} s")
        if self._disconnected and mode in AT_REST and OperatorCommand.STOP not in self.pending:
            self.submit(OperatorCommand.STOP)
