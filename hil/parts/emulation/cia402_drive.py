"""Emulated CiA 402 drive: NMT, PDOs and power state machine over its object dictionary.

Frames in, frames out; no wire, no clock. The axis is a ``DriveAxis``.
"""

from __future__ import annotations

import math
from typing import Final

from hil.drivers.can_port import Frame
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import DriveState
from hil.parts.emulation.cia402_modes import DriveAxis, DriveMotion
from hil.parts.emulation.cia402_objects import MappedPdo, ObjectDictionary

_REMOTE = 0x0200  # statusword: the controlword is executed
_VOLTAGE = 0x0010
_GENERIC_ERROR = 0x01  # error register
_COMMUNICATION_ERROR = 0x10
_SDO_ABORT = 0x80
_SYNCHRONOUS_MAX: Final = 240  # transmission types up to this are with every so many SYNC
_ABORT_IS_A_FAULT: Final = 1  # abort connection option
_WARNING: Final = 0x8210  # PDO not processed because of its length
_BURST: Final = 5
_TARGETS: Final = {codec.TARGET_POSITION, codec.INTERPOLATION_DATA}

_POWERED: Final = (DriveState.SWITCHED_ON, DriveState.ENABLED, DriveState.QUICK_STOP_ACTIVE)
_NMT_STATES: Final = {codec.NMT_START: codec.OPERATIONAL, codec.NMT_STOP: codec.STOPPED}

_S = DriveState
# (state, command in the controlword) -> next state; CiA 402-2, power drive system FSA
_MOVES: Final = {
    (_S.SWITCH_ON_DISABLED, "shutdown"): _S.READY,
    (_S.READY, "switch on"): _S.SWITCHED_ON,
    (_S.READY, "enable"): _S.SWITCHED_ON,
    (_S.SWITCHED_ON, "enable"): _S.ENABLED,
    (_S.SWITCHED_ON, "shutdown"): _S.READY,
    (_S.ENABLED, "switch on"): _S.SWITCHED_ON,
    (_S.ENABLED, "shutdown"): _S.READY,
    (_S.ENABLED, "quick stop"): _S.QUICK_STOP_ACTIVE,
    (_S.READY, "quick stop"): _S.SWITCH_ON_DISABLED,
    (_S.SWITCHED_ON, "quick stop"): _S.SWITCH_ON_DISABLED,
    (_S.READY, "disable voltage"): _S.SWITCH_ON_DISABLED,
    (_S.SWITCHED_ON, "disable voltage"): _S.SWITCH_ON_DISABLED,
    (_S.ENABLED, "disable voltage"): _S.SWITCH_ON_DISABLED,
    (_S.QUICK_STOP_ACTIVE, "disable voltage"): _S.SWITCH_ON_DISABLED,
}


def command_of(controlword: int) -> str:
    """Return the command in the low bits of a controlword."""
    if not controlword & 0x02:
        return "disable voltage"
    if not controlword & 0x04:
        return "quick stop"
    if not controlword & 0x01:
        return "shutdown"
    return "enable" if controlword & 0x08 else "switch on"


class EmulatedCia402Drive:
    """A drive on node ``node_id`` that moves ``axis``, with its object dictionary and its habits.

    Every method that can cause traffic returns the frames to send.
    """

    def __init__(self, node_id: int, axis: DriveAxis, objects: ObjectDictionary) -> None:
        self.node_id = node_id
        self.state = DriveState.SWITCH_ON_DISABLED
        self.operational = False
        self.objects = objects
        self._habits = objects.habits
        self._axis = axis
        window = axis.window()
        objects.put(codec.FOLLOWING_ERROR_WINDOW, window[0])
        objects.put(codec.FOLLOWING_ERROR_TIME_OUT, window[1])
        self._motion = DriveMotion(axis, self.objects)
        self._nmt_state = codec.PRE_OPERATIONAL
        self._beat_due_s = 0.0
        self._controlword = 0
        self._fresh_target = False
        self._pdos: dict[int, MappedPdo] = {}
        self._status_due_s = 0.0
        self._status_sent: tuple[int, int] | None = None
        self._syncs = 0
        self._now_s = -math.inf
        self._guarded_until_s = math.inf  # the master's heartbeat or guarding is due until then
        self._toggle = 0
        self._enable_due_s = math.inf
        self._shown, self._entered_s = self.state, -math.inf  # of the statusword, which may be late
        self._warned_s = 0.0

    def boot(self) -> list[Frame]:
        """Return the boot-up message."""
        return [(codec.HEARTBEAT_ID + self.node_id, b"\x00")]

    def on_frame(self, identifier: int, data: bytes, now_s: float) -> list[Frame]:
        """Receive one frame of the bus; return the frames that the drive sends in response."""
        self._now_s = now_s
        if identifier == (self.objects.value(codec.SYNC_OBJECT) & 0x7FF or codec.SYNC_ID):
            return self._on_sync()
        if identifier == codec.NMT_ID:
            return self._on_nmt(data)
        if identifier & ~codec.REMOTE & 0x780 == codec.HEARTBEAT_ID:
            return self._on_guard(identifier, data)
        if identifier == codec.SDO_REQUEST_ID + self.node_id:
            return self._on_sdo(data, now_s) + self.status(now_s)
        pdo = self._pdos.get(identifier)
        if pdo is None or len(data) < pdo.layout.size:
            return []
        pdo.unpack(data)
        if codec.CONTROLWORD in pdo.indices:
            self._control(now_s)
        if pdo.indices & _TARGETS:
            self._fresh_target = pdo.transmission <= _SYNCHRONOUS_MAX
            if not self._fresh_target and self.state is DriveState.ENABLED:
                self._motion.on_sync(now_s)
        return self.status(now_s)

    def advance(self, now_s: float) -> list[Frame]:
        """Advance to ``now_s``; return heartbeat, status and other frames due."""
        self._now_s = now_s
        frames = self._warnings()
        if now_s > self._guarded_until_s:
            self._guarded_until_s = math.inf
            frames += self.overdue(codec.GUARD_LOST)
        if now_s >= self._enable_due_s:
            self._enable_due_s = math.inf
            self._enter(DriveState.ENABLED)
        if self._axis.torque_off() and self.state in _POWERED:
            frames += self.fail(codec.TORQUE_OFF)
        if self._axis.astray() and self.state is not DriveState.FAULT:
            frames += self.fail(codec.FOLLOWING_ERROR)
        self._motion.advance(now_s, self.state is DriveState.ENABLED)
        period_ms = self.objects.value(codec.HEARTBEAT_PRODUCER) & 0xFFFF
        if period_ms and now_s >= self._beat_due_s:
            self._beat_due_s = now_s + period_ms * 1e-3
            frames.append((codec.HEARTBEAT_ID + self.node_id, bytes((self._nmt_state,))))
        return frames + self.status(now_s)

    def status(self, now_s: float) -> list[Frame]:
        """Return the status PDO when the statusword has changed or its timer has run out."""
        pdo = self._pdos.get(codec.TPDO2_ID + self.node_id)
        current = (self._statusword(), self._axis.limit())
        if pdo is None or (current == self._status_sent and now_s < self._status_due_s):
            return []
        if pdo.transmission <= _SYNCHRONOUS_MAX:
            return []
        self._status_sent = current
        timer_ms = self.objects.value(codec.STATUS_PDO.parameter, codec.PDO_EVENT_TIMER)
        self._status_due_s = now_s + timer_ms * 1e-3 if timer_ms else math.inf
        self._refresh()
        return [(pdo.identifier, pdo.pack())]

    def fail(self, code: int) -> list[Frame]:
        """Brake, enter the fault state, send the emergency message."""
        self._axis.brake()
        self.state = DriveState.FAULT
        return self._emergency(code, _GENERIC_ERROR)

    def overdue(self, code: int = codec.RPDO_TIMEOUT) -> list[Frame]:
        """React to a bench that is silent (CiA 402 abort connection option), with emergency message.

        A drive without that option makes a quick stop, as with 3.
        """
        option = self.objects.value(codec.ABORT_CONNECTION_OPTION)
        if self.state is not DriveState.ENABLED:
            return []
        if (codec.ABORT_CONNECTION_OPTION, 0) not in self.objects.entries or option == codec.ABORT_QUICK_STOPS:
            self._enter(DriveState.QUICK_STOP_ACTIVE)
        elif option == _ABORT_IS_A_FAULT:
            return self.fail(code)
        return self._emergency(code, _COMMUNICATION_ERROR)

    def _warnings(self) -> list[Frame]:
        """Return a burst of emergency messages that report no error of the drive, when one is due."""
        if not self._habits.warnings_hz or not self.operational:
            return []
        if self._now_s < self._warned_s + 1.0 / self._habits.warnings_hz:
            return []
        self._warned_s = self._now_s
        return [(codec.EMCY_ID + self.node_id, codec.encode_emergency(_WARNING, 0))] * _BURST

    def _emergency(self, code: int, register: int) -> list[Frame]:
        self.objects.put(codec.ERROR_CODE, code)
        self.objects.put(codec.ERROR_FIELD, code, 1)
        self.objects.put(codec.ERROR_REGISTER, register)
        return [(codec.EMCY_ID + self.node_id, codec.encode_emergency(code, register))]

    def _control(self, now_s: float) -> None:
        word = self.objects.value(codec.CONTROLWORD) & 0xFFFF
        rising, falling = word & ~self._controlword, self._controlword & ~word
        self._controlword = word
        if self.state is not DriveState.FAULT:
            following = _MOVES.get((self.state, command_of(word)), self.state)
            if following is DriveState.ENABLED and self.state is not DriveState.ENABLED and self._habits.enable_s > 0.0:
                self._enable_due_s = min(self._enable_due_s, now_s + self._habits.enable_s)
                following = self.state
            elif following is not self.state:
                self._enable_due_s = math.inf
            self._enter(following)
            if self.state is DriveState.ENABLED:
                self._motion.control(word, rising, falling, now_s)
        elif rising & codec.FAULT_RESET:
            if not self._habits.keeps_error:
                self.objects.put(codec.ERROR_CODE, 0)
            self.objects.put(codec.ERROR_REGISTER, 0)
            self._axis.clear_astray()
            self._enter(DriveState.SWITCH_ON_DISABLED)

    def _enter(self, state: DriveState) -> None:
        if state is self.state:
            return
        if self._now_s >= self._entered_s + self._habits.state_lag_s:
            self._shown = self.state
        self.state, self._entered_s = state, self._now_s
        if state is DriveState.ENABLED:
            self._axis.enable()
            self._motion.begin()
        elif state is DriveState.QUICK_STOP_ACTIVE:
            self._axis.brake()
        else:
            self._axis.disable()

    def _statusword(self) -> int:
        is_shown = self._now_s >= self._entered_s + self._habits.state_lag_s
        word = (self.state if is_shown else self._shown).bits | _REMOTE | _VOLTAGE
        return word | self._motion.statusword(self._now_s)

    def _refresh(self) -> None:
        """Update the measured objects."""
        objects = self.objects
        position, velocity = self._axis.feedback()
        objects.put(codec.POSITION_ACTUAL, position)
        objects.put(codec.VELOCITY_ACTUAL, velocity)
        objects.put(codec.STATUSWORD, self._statusword())
        limit = self._axis.limit()
        objects.put(codec.DIGITAL_INPUTS, codec.LOW_LIMIT * (limit < 0) | codec.HIGH_LIMIT * (limit > 0))
        objects.put(codec.MODE_DISPLAY, self._motion.mode)

    def _on_sync(self) -> list[Frame]:
        if self._fresh_target and self.state is DriveState.ENABLED:
            self._motion.on_sync(self._now_s)
        self._fresh_target = False
        self._syncs += 1
        self._refresh()
        return [
            (pdo.identifier, pdo.pack())
            for pdo in self._pdos.values()
            if pdo.is_sent and 0 < pdo.transmission <= _SYNCHRONOUS_MAX and self._syncs % pdo.transmission == 0
        ]

    def _on_guard(self, identifier: int, data: bytes) -> list[Frame]:
        """Receive the heartbeat of the master, or its remote frame, which is answered."""
        if identifier & codec.REMOTE and identifier & 0x7F == self.node_id:
            life_ms = self.objects.value(codec.GUARD_TIME) * self.objects.value(codec.LIFE_TIME_FACTOR)
            self._guarded_until_s = self._now_s + 1e-3 * life_ms if life_ms else math.inf
            state, self._toggle = self._nmt_state | self._toggle, self._toggle ^ codec.TOGGLE
            return [(codec.HEARTBEAT_ID + self.node_id, bytes((state,)))]
        consumed = self.objects.value(codec.HEARTBEAT_CONSUMER, 1) & 0xFFFF_FFFF
        if consumed and consumed >> 16 & 0x7F == identifier & 0x7F and data:
            self._guarded_until_s = self._now_s + 1e-3 * (consumed & 0xFFFF)
        return []

    def _on_nmt(self, data: bytes) -> list[Frame]:
        if len(data) != 2 or data[1] not in (0, self.node_id):
            return []
        self.operational = data[0] == codec.NMT_START
        self._nmt_state = _NMT_STATES.get(data[0], codec.PRE_OPERATIONAL)
        self._pdos = self.objects.map_pdos() if self.operational else {}
        self._status_sent = None
        if not self.operational:
            self._guarded_until_s = math.inf
        if data[0] not in (codec.NMT_RESET_NODE, codec.NMT_RESET_COMMUNICATION):
            if not self.operational and self.state is DriveState.ENABLED:
                self._enter(DriveState.QUICK_STOP_ACTIVE)  # abort connection option 3
            return []
        self.objects.put(codec.HEARTBEAT_PRODUCER, 0)
        self._enter(DriveState.SWITCH_ON_DISABLED)
        return self.boot()

    def _on_sdo(self, data: bytes, now_s: float) -> list[Frame]:
        if len(data) != 8 or data[0] == _SDO_ABORT:
            return []
        self._refresh()
        reply, written = self.objects.serve(data, self.operational)
        if written == codec.CONTROLWORD:
            self._control(now_s)
        elif written == codec.MODE:
            self._motion.request(now_s)
            self._motion.advance(now_s, self.state is DriveState.ENABLED)
        elif written in (codec.FOLLOWING_ERROR_WINDOW, codec.FOLLOWING_ERROR_TIME_OUT):
            counts = self.objects.value(codec.FOLLOWING_ERROR_WINDOW) & codec.UNLIMITED_WINDOW
            time_out_ms = self.objects.value(codec.FOLLOWING_ERROR_TIME_OUT) & 0xFFFF
            self._axis.set_window(math.inf if counts == codec.UNLIMITED_WINDOW else counts, time_out_ms)
        return [(codec.SDO_REPLY_ID + self.node_id, reply)]
