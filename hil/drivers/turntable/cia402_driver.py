"""Turntable of three CiA 402 drives on one CAN bus, cyclic synchronous position mode."""

from __future__ import annotations

import canopen
import numpy as np

from hil.clock import Clock
from hil.config.rig import Cia402, Turntable
from hil.drivers.base import GIMBAL_NAMES, full_names
from hil.drivers.turntable import cia402_codec as codec
from hil.drivers.turntable.can_port import CanPort
from hil.drivers.turntable.cia402_codec import DriveState
from hil.drivers.turntable.cia402_setup import DriveSetup
from hil.drivers.turntable.exchange import ExchangedTurntable
from hil.errors import BadInput, DeviceError, DriveFault, LinkTimeout, ProtocolError
from hil.messages import Array, AxisFeedback

_ANSWER_S = 0.04  # bench time within which the answers to one SYNC count
_WATCHDOG_S = 0.5  # drives quick-stop when setpoints cease for longer
_STANDSTILL_RADPS = 2e-3
_OLD_FRAMES = 64
_OLD_FRAME_WALL_S = 0.005
_CONTROL_EVERY = 5  # exchanges: the controlword is repeated, so that a lost frame heals


class Cia402Link:
    """The bus and its three nodes. A cycle is three setpoint PDOs and a SYNC; three feedback PDOs answer.

    Feedback is stamped with the bench time of the SYNC, when the drives sample.
    """

    def __init__(self, device: str, config: Cia402, timeout_s: float, clock: Clock) -> None:
        self.device = device
        self.axis_names = full_names(device, GIMBAL_NAMES)
        self._config = config
        self._timeout_s = timeout_s
        self._clock = clock
        self._port: CanPort | None = None
        self._drives: list[DriveSetup] = []
        self._has_offset = [True, True, True]
        self._scale = config.counts_per_turn
        self._handlers = {
            base + node: (handler, axis)
            for axis, node in enumerate(config.node_ids)
            for base, handler in (
                (codec.TPDO1_ID, self._on_feedback),
                (codec.TPDO2_ID, self._on_status),
                (codec.EMCY_ID, self._on_emergency),
                (codec.HEARTBEAT_ID, self._on_heartbeat),
            )
        }
        self._reset()

    def _reset(self) -> None:
        now_s = self._clock.now_s()
        self._controlword = codec.ENABLE_OPERATION
        self._target = [0, 0, 0]
        self._position = [0, 0, 0]
        self._velocity = [0, 0, 0]
        self._answered = [False, False, False]
        self._answered_s = [now_s] * 3
        self._status_s = [now_s] * 3
        self._exchanges = 0
        self._incomplete = 0

    def open(self) -> Array:
        """Set all drives up, enable them where they stand; return their position (3,), rad."""
        self._port = CanPort(self.device, self._config)
        try:
            return self._set_up(self._port)
        except DeviceError:
            self.quick_stop()
            self.close()
            raise

    def _set_up(self, port: CanPort) -> Array:
        network = canopen.Network(port.bus)
        nodes = zip(self._config.node_ids, self.axis_names, strict=True)
        self._drives = [DriveSetup(port, network, node_id, axis) for node_id, axis in nodes]
        port.send(codec.NMT_ID, bytes((codec.NMT_PRE_OPERATIONAL, 0)))
        for axis, drive in enumerate(self._drives):
            drive.identify()
            self._has_offset[axis] = drive.configure(self._timeout_s, _WATCHDOG_S)
        port.send(codec.NMT_ID, bytes((codec.NMT_START, 0)))
        self._reset()
        standstill = codec.counts_from_rad(_STANDSTILL_RADPS, self._scale)
        counts = [drive.enable(standstill) for drive in self._drives]
        for _ in range(_OLD_FRAMES):  # statuswords from before all were enabled
            if port.receive(_OLD_FRAME_WALL_S) is None:
                break
        self._reset()
        self._target = counts
        return np.array([codec.rad_from_counts(count, self._scale) for count in counts])

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Send one cycle's setpoints and SYNC, take the answers."""
        port = self._open_port()
        self._take_pending(port)
        if self._exchanges % _CONTROL_EVERY == 0:
            self._send_controlword(port)
        self._exchanges += 1
        offset = [0, 0, 0]
        if self._controlword == codec.ENABLE_OPERATION:
            self._target = [codec.counts_from_rad(angle, self._scale) for angle in position]
            offset = [codec.counts_from_rad(value, self._scale) for value in rate]
        for axis, node_id in enumerate(self._config.node_ids):
            port.send(codec.RPDO1_ID + node_id, self._setpoint(axis, offset[axis]))
        self._answered = [False, False, False]
        port.send(codec.SYNC_ID, b"")
        return self._collect(port, self._clock.now_s())

    def quick_stop(self) -> None:
        """Send the quick-stop controlword to all nodes and repeat it from now on."""
        self._controlword = codec.QUICK_STOP
        if self._port is not None:
            self._send_controlword(self._port)

    def close(self) -> None:
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def counters(self) -> dict[str, int]:
        """Return exchanges and how many of them were not answered by all drives in time."""
        return {"exchanges": self._exchanges, "incomplete": self._incomplete}

    def _open_port(self) -> CanPort:
        if self._port is None:
            raise LinkTimeout(self.device, "is not open")
        return self._port

    def _setpoint(self, axis: int, offset: int) -> bytes:
        if self._has_offset[axis]:
            return codec.encode_setpoint(self._target[axis], offset)
        return codec.encode_plain_setpoint(self._target[axis])

    def _send_controlword(self, port: CanPort) -> None:
        for node_id in self._config.node_ids:
            port.send(codec.RPDO2_ID + node_id, codec.encode_control(self._controlword))

    def _take_pending(self, port: CanPort) -> None:
        while (frame := port.receive(0.0)) is not None:
            self._handle(*frame)

    def _collect(self, port: CanPort, sync_s: float) -> AxisFeedback | None:
        end_s = sync_s + _ANSWER_S
        while not all(self._answered) and (left_s := end_s - self._clock.now_s()) > 0.0:
            frame = port.receive(left_s / self._clock.speed)
            if frame is not None:
                self._handle(*frame)
        if not all(self._answered):
            self._take_pending(port)  # this thread may have slept while the answers came
        self._check_silence(self._clock.now_s())
        if not all(self._answered):
            self._incomplete += 1
            return None
        turn = np.array((self._position, self._velocity)) * codec.rad_from_counts(1, self._scale)
        return AxisFeedback(sync_s, turn[0], turn[1])

    def _check_silence(self, now_s: float) -> None:
        for what, heard_s in (("answer to SYNC", self._answered_s), ("statusword", self._status_s)):
            for axis, last_s in zip(self.axis_names, heard_s, strict=True):
                if now_s - last_s > self._timeout_s:
                    raise LinkTimeout(axis, f"no {what} for {now_s - last_s:.3f} s, allowed {self._timeout_s:g} s")

    def _handle(self, identifier: int, data: bytes) -> None:
        handler, axis = self._handlers.get(identifier, (None, 0))
        if handler is None:
            return
        try:
            handler(axis, data)
        except ValueError as error:
            raise ProtocolError(self.axis_names[axis], f"frame 0x{identifier:03X} has {error}") from error

    def _on_feedback(self, axis: int, data: bytes) -> None:
        self._position[axis], self._velocity[axis] = codec.decode_feedback(data)
        self._answered[axis] = True
        self._answered_s[axis] = self._clock.now_s()

    def _on_status(self, axis: int, data: bytes) -> None:
        self._status_s[axis] = self._clock.now_s()
        state = codec.state_of(codec.decode_status(data))
        if state in codec.FAULT_STATES:
            raise DriveFault(self.axis_names[axis], codec.fault_text(self._drives[axis].fault_code()))
        if self._controlword == codec.ENABLE_OPERATION and state is not DriveState.ENABLED:
            title = state.title if state else "an undefined state"
            raise DriveFault(self.axis_names[axis], f"left operation enabled by itself, is in {title}")

    def _on_emergency(self, axis: int, data: bytes) -> None:
        code = codec.decode_emergency(data)
        if code != 0:
            raise DriveFault(self.axis_names[axis], codec.fault_text(code))

    def _on_heartbeat(self, axis: int, data: bytes) -> None:
        if data == b"\x00":
            raise DriveFault(self.axis_names[axis], "has restarted")


class Cia402Turntable(ExchangedTurntable):
    """Turntable on CAN; ``config.cia402`` names interface, channel, nodes and counts per turn."""

    def __init__(self, config: Turntable, clock: Clock) -> None:
        if config.cia402 is None or config.cia402.channel is None:
            raise BadInput.single("rig", "turntable.cia402.channel", "is missing: the wire to the device")
        super().__init__(config, clock, Cia402Link("turntable", config.cia402, config.timeout_s, clock))
