"""The operator as the loop knows him: his orders come from the console's process, word for word, without a thread.

The loop looks once a cycle, and never waits: a console that is slow or dead costs it nothing. A message is
a JSON object in one packet of a socket pair.

to the loop    {"order": "hold", "by": "ann", "id": 7}   {"acknowledge": true, "by": "ann", "id": 8}
               {"adjust": {"key": "gnc.control.deadband_m", "value": 0.0004, "records": "..."}, "by": "ann", "id": 9}
               {"jog": ["rails.x", 1]}   {"present": true}   {"note": ["operator", "ann", "has the command"]}
to the console {"answer": 7, "text": ""}    {"alarms": [...]}    {"events": [...]}   and what ``OutgoingMessages`` says
"""

from __future__ import annotations

import json
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Any, Final

from hil.config.console import OnLoss
from hil.console.status import StatusWriter
from hil.core.messages import Event
from hil.core.modes import Mode
from hil.core.operator_commands import ALLOWED_IN, Operator, OperatorCommand
from hil.errors import SafetyTrip
from hil.frmn.mailbox import Mailbox
from hil.gnc_backends.builtin import BuiltinGnc
from hil.loop.runner import Runner
from hil.recording.taps import EventRecorder
from hil.setup.live_tuning import unpacked

STATUS_EACH_WALL_S: Final = 0.05
_PACKETS_A_CYCLE: Final = 8
_KEPT_WORDS: Final = 512
_PACKET: Final = 65536
_HELD: Final = frozenset({Mode.PLACING, Mode.RUNNING})
"""Modes with motion that a hold can interrupt."""
_AT_REST: Final = frozenset({Mode.STANDBY, Mode.ARMED, Mode.HOLD, Mode.SAFE_STOP})


class OutgoingMessages:
    """The way to the console: packets leave in their order, none is ever waited for.

    While the console does not read they are kept; beyond ``_KEPT_WORDS`` the oldest are dropped.
    """

    def __init__(self, channel: socket.socket) -> None:
        channel.setblocking(False)
        self.channel = channel
        self._waiting: deque[bytes] = deque(maxlen=_KEPT_WORDS)

    def say(self, **words: Any) -> None:
        """Send one packet, or keep it until there is room."""
        self._waiting.append(json.dumps(words).encode())
        self.push()

    def push(self) -> None:
        """Send what waits, as far as there is room."""
        while self._waiting:
            try:
                self.channel.send(self._waiting[0])
            except BlockingIOError:
                return
            except OSError:  # nobody is there any more
                self._waiting.clear()
                return
            self._waiting.popleft()


class RemoteOperator(Operator):
    """Takes orders off ``words.channel`` in the loop's own thread, and reacts when nobody is there to give any.

    on_loss: what is done once the operator's page, or the console, has been silent for ``lease_s`` of wall
    time while the bench moves. wall_s: the clock for that.
    """

    def __init__(
        self,
        words: OutgoingMessages,
        status: Mailbox,
        on_loss: OnLoss,
        lease_s: float,
        wall_s: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__((), attended=True)
        self._words = words
        self._status = status
        self._on_loss = on_loss
        self._lease_s = lease_s
        self._wall_s = wall_s
        self._heard_s = wall_s()
        self._present = True
        self._gone = False
        self._reacted = False
        self._told_s = -STATUS_EACH_WALL_S
        self._told: tuple[object, ...] = ()
        self._runner: Runner
        self._writer: StatusWriter
        self._notes: EventRecorder | None = None
        self._adjustable: tuple[str, ...] = ()

    def attach(self, runner: Runner, notes: EventRecorder | None = None, adjustable: tuple[str, ...] = ()) -> None:
        """Say whose bench it is, before the first cycle.

        notes: where a recording puts down who ordered what. adjustable: settings that may be changed.
        """
        self._runner = runner
        self._notes = notes
        self._adjustable = adjustable
        self._writer = StatusWriter(runner)
        self._heard_s = self._wall_s()

    def watch(self, _: Mode, share: float) -> None:
        """Note how far along the bench is."""
        self._writer.share = share

    def poll(self, now_s: float) -> None:
        """Take what has come, tell how things are, and react where the operator is lost. Raises SafetyTrip."""
        self._take_packets()
        wall_s = self._wall_s()
        if wall_s - self._told_s >= STATUS_EACH_WALL_S:
            self._told_s = wall_s
            self.tell(now_s)
        self._mind_the_operator(wall_s)

    def tell(self, now_s: float) -> None:
        """Write the status, and say what is new of alarms, events and refused orders."""
        self._status.write(self._writer.fill(now_s), now_s)
        while self.rejections:
            self._words.say(word=self.rejections.popleft())
        alarms = self._runner.safety.alarms.all()
        events = self._runner.all_events()
        told = (alarms, len(events), self._runner.safety.hold_reason)
        if told != self._told:
            self._told = told
            self._words.say(
                alarms=[alarm.as_json() for alarm in alarms],
                events=[{"t_s": event.t_s, "source": event.source, "text": event.text} for event in events[-50:]],
                hold_reason=self._runner.safety.hold_reason,
            )
        self._words.push()

    def _take_packets(self) -> None:
        for _ in range(_PACKETS_A_CYCLE):
            try:
                packet = self._words.channel.recv(_PACKET)
            except BlockingIOError:
                return
            except OSError:
                packet = b""
            if not packet:
                self._gone = True
                return
            self._heard_s = self._wall_s()
            self._obey(json.loads(packet))

    def _obey(self, message: dict[str, Any]) -> None:
        if "present" in message:
            self._present = bool(message["present"])
        elif "jog" in message:
            axis, direction = message["jog"]
            self.jog(axis, direction)
        elif "note" in message:
            self._note(*message["note"])
        elif "acknowledge" in message:
            self._runner.safety.alarms.acknowledge()
            self._note("operator", message.get("by", ""), "acknowledged the alarms")
            self._words.say(answer=message["id"], text="")
        elif "adjust" in message:
            self._words.say(answer=message["id"], text=self._adjust(message["adjust"], message.get("by", "")))
        elif "order" in message:
            order, mode = OperatorCommand(message["order"]), self._runner.safety.modes.mode
            refusal = "" if mode in ALLOWED_IN[order] else f"bench: cannot {order.value} in {mode.value}"
            if not refusal:
                self.submit(order)
            self._note("operator", message.get("by", ""), f"{order.value}{refusal and f': refused: {refusal}'}")
            self._words.say(answer=message["id"], text=refusal)

    def _adjust(self, change: dict[str, Any], who: str) -> str:
        """Take over other parameters before the next cycle; return why not, "" where it was done.

        Checked they are, and their records built, where no cycle waits for it: by whoever sends them.
        """
        key, value = change["key"], float(change["value"])
        if key not in self._adjustable:
            return f"{key}: this scenario lets nobody change it in flight"
        try:
            records = unpacked(change["records"])
        except ValueError as error:
            return f"{key}: {error}"
        gnc = self._runner.loop.gnc
        if not isinstance(gnc, BuiltinGnc):
            return f"{key}: a setting of the built-in GNC, which is not the one that flies"
        cycle = gnc.adjust(records)
        text = f"{key}={value!r}"
        if self._notes is not None:
            self._notes.setting(cycle, who, text)
        t_s = float(self._runner.loop.now.t_s[0])
        self._runner.events.append(Event(t_s, "bench", f"{who} changed {text}, from cycle {cycle} on"))
        return ""

    def _note(self, kind: str, who: str, text: str) -> None:
        """Put down what somebody did, where the session is recorded; the replay does not look at it."""
        if self._notes is not None:
            self._notes.log_event(kind, who or "console", text)

    def _mind_the_operator(self, wall_s: float) -> None:
        silent_s = wall_s - self._heard_s
        if self._present and not self._gone and silent_s <= self._lease_s:
            self._reacted = False
            return
        self._react(self._why(silent_s))

    def _why(self, silent_s: float) -> str:
        if self._gone:
            return "gone"
        return f"silent for {silent_s:.1f} s" if silent_s > self._lease_s else f"silent for {self._lease_s:g} s"

    def _react(self, value: str) -> None:
        """Hold or stop a bench that moves, once; end a session to which nobody can come back, once nothing moves."""
        supervisor = self._runner.safety
        mode = supervisor.modes.mode
        who = "its process" if self._gone else "the operator's page"
        if not self._reacted and mode not in _AT_REST:
            if self._on_loss == "stop":
                self._reacted = True
                raise SafetyTrip("console", who, value, "an operator while the bench moves")
            if self._on_loss == "hold" and mode in _HELD:
                self._reacted = True
                supervisor.request_hold(f"console: {who} {value}, allowed {self._lease_s:g} s")
        if self._gone and mode in _AT_REST and OperatorCommand.STOP not in self.pending:
            self.submit(OperatorCommand.STOP)
