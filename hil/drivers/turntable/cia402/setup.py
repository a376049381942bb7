"""Set-up of one CiA 402 drive by SDO: identity, PDO mapping, mode, enabling.

canopen's SDO client does the transfers, pumped from the bus in the calling thread: no notifier
thread, so an error of the bus is raised here. Blocks; each reply is waited for at most REPLY_WALL_S.
"""

from __future__ import annotations

from collections.abc import Callable

import canopen
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from hil.config.rig import Cia402
from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.can_port import CanPort
from hil.drivers.turntable.cia402.codec import DriveState, Pdo
from hil.drivers.turntable.cia402.eds import Eds
from hil.errors import DriveFault, LinkTimeout, ProtocolError

REPLY_WALL_S = 0.3
_ENABLE_WALL_S = 2.0
_RESET_WALL_S = 0.3
_POLL_WALL_S = 0.002
_SDO_BYTES = 8
_NO_SUCH_OBJECT = 0x06020000
_NOT_MAPPABLE = 0x06040041


Handler = Callable[[int, bytes], None]


class PortNetwork(canopen.Network):
    """Network of canopen's clients on a ``CanPort``."""

    def __init__(self, port: CanPort) -> None:
        super().__init__()
        self._port = port

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._port.send((can_id, bytes(data)))


class _PumpedClient(SdoClient):
    """canopen's SDO client that reads the bus itself while it waits."""

    RESPONSE_TIMEOUT = 0.0

    def __init__(
        self, port: CanPort, network: canopen.Network, node_id: int, others: Handler, clock: BenchClock
    ) -> None:
        super().__init__(codec.SDO_REQUEST_ID + node_id, codec.SDO_REPLY_ID + node_id, ObjectDictionary())
        self.network = network
        self._port = port
        self._others = others
        self._clock = clock
        network.subscribe(self.tx_cobid, self.on_response)

    def read_response(self) -> bytes:
        end_s = self._clock.host_s() + REPLY_WALL_S
        while self.responses.empty() and (left_s := end_s - self._clock.host_s()) > 0.0:
            frame = self._port.receive(left_s)
            if frame is not None and frame[0] == self.tx_cobid and len(frame[1]) == _SDO_BYTES:
                self.on_response(frame[0], bytearray(frame[1]), 0.0)
            elif frame is not None:
                self._others(*frame)
        return super().read_response()  # type: ignore[no-any-return]


class DriveSetup:
    """One drive on the bus, spoken to by SDO. Errors name ``axis``: LinkTimeout, ProtocolError, DriveFault.

    others: handler of received frames that are not SDO responses of this drive. clock: of the time-outs.
    """

    def __init__(
        self,
        port: CanPort,
        network: canopen.Network,
        node_id: int,
        axis: str,
        eds: Eds,
        others: Handler,
        clock: BenchClock,
    ) -> None:
        self.axis = axis
        self.node_id = node_id
        self._eds = eds
        self._clock = clock
        self._sdo = _PumpedClient(port, network, node_id, others, clock)
        self._has_offset = False

    def identify(self, config: Cia402) -> None:
        """Check that this is a CiA 402 drive, and the one that the rig file asks for."""
        profile = self.get(codec.DEVICE_TYPE, 4) & 0xFFFF
        if profile != codec.DEVICE_PROFILE:
            raise ProtocolError(self.axis, f"node {self.node_id} is of device profile {profile}, not 402")
        for subindex, what, expected in ((1, "vendor id", config.vendor_id), (2, "product code", config.product_code)):
            if expected is not None and (actual := self._identity(subindex)) != expected:
                raise ProtocolError(self.axis, f"{what} is 0x{actual:08X}, expected 0x{expected:08X}")
        if config.revision_min is not None and (actual := self._identity(3)) < config.revision_min:
            text = f"revision is 0x{actual:08X}, expected 0x{config.revision_min:08X} or newer"
            raise ProtocolError(self.axis, text)
        if config.firmware is not None and (name := self._text(codec.FIRMWARE)) != config.firmware:
            raise ProtocolError(self.axis, f"firmware is {name!r}, expected {config.firmware!r}")

    def _identity(self, subindex: int) -> int:
        return self.get(codec.IDENTITY, 4, subindex) & 0xFFFF_FFFF

    def _text(self, index: int) -> str:
        data = self._transfer(index, lambda: self._sdo.upload(index, 0)) or b""
        return data.rstrip(b"\0 ").decode("ascii", "replace")

    def configure(self, timeout_s: float, watchdog_s: float, heartbeat_s: float) -> bool:
        """Write PDOs, mode and reactions (node pre-operational); return whether velocity offset is mapped."""
        self._has_offset = self._map_either(codec.SETPOINT_PDO, codec.SETPOINT_PDO_PLAIN)
        self._map(codec.CONTROL_PDO)
        self._map(codec.FEEDBACK_PDO)
        self._map_either(codec.STATUS_PDO, codec.STATUS_PDO_PLAIN)
        self.put(codec.STATUS_PDO.parameter, round(250.0 * timeout_s), 2, subindex=codec.PDO_EVENT_TIMER)
        self.put(codec.SETPOINT_PDO.parameter, round(1000.0 * watchdog_s), 2, subindex=codec.PDO_EVENT_TIMER)
        self.put(codec.HEARTBEAT_PRODUCER, round(1000.0 * heartbeat_s), 2)
        self.put(codec.ABORT_CONNECTION_OPTION, codec.ABORT_QUICK_STOPS, 2)
        self.put(codec.QUICK_STOP_OPTION, codec.QUICK_STOP_STAYS, 2)
        self.choose_mode(codec.CYCLIC_SYNCHRONOUS_POSITION)
        return self._has_offset

    def choose_mode(self, mode: int) -> None:
        """Write the mode of operation and check that the drive is in it."""
        self.put(codec.MODE, mode, 1)
        if (displayed := self.get(codec.MODE_DISPLAY, 1)) != mode:
            raise ProtocolError(self.axis, f"stays in mode {displayed}, requested {mode} ({codec.MODE_NAMES[mode]})")

    def prepare_homing(self, method: int, speed: int, acceleration: int) -> bool:
        """Write the homing parameters, counts/s and counts/s^2; return whether the drive is homed already."""
        self.put(codec.HOMING_METHOD, method, 1)
        self.put(codec.HOMING_SPEEDS, speed, 4, subindex=1)
        self.put(codec.HOMING_SPEEDS, max(1, speed // 4), 4, subindex=2)
        self.put(codec.HOMING_ACCELERATION, acceleration, 4)
        self.choose_mode(codec.HOMING)
        homed = codec.homing_of(self.statusword()) is Homing.DONE
        self.choose_mode(codec.CYCLIC_SYNCHRONOUS_POSITION)
        return homed

    def prepare_profile(self, target: int, speed: int, acceleration: int) -> None:
        """Choose profile position mode; counts, counts/s, counts/s^2. The move begins with NEW_SETPOINT."""
        self.put(codec.PROFILE_VELOCITY, speed, 4)
        self.put(codec.PROFILE_ACCELERATION, acceleration, 4)
        self.put(codec.PROFILE_DECELERATION, acceleration, 4)
        self.choose_mode(codec.PROFILE_POSITION)
        self.put(codec.TARGET_POSITION, target, 4)

    def back_to_setpoints(self) -> int:
        """Select cyclic synchronous position mode at the present position; return that, counts."""
        position = self._hold()
        self.choose_mode(codec.CYCLIC_SYNCHRONOUS_POSITION)
        return position

    def _hold(self) -> int:
        """Make the present position, at rest, the setpoint; return it, counts.

        A drive keeps the velocity offset of the last setpoint that it received, however old.
        """
        position = self.get(codec.POSITION_ACTUAL, 4)
        self.put(codec.TARGET_POSITION, position, 4)
        if self._has_offset:
            self.put(codec.VELOCITY_OFFSET, 0, 4)
        return position

    def statusword(self) -> int:
        return self.get(codec.STATUSWORD, 2) & 0xFFFF

    def enable(self, standstill: int) -> int:
        """Enable operation at the present position; return that, counts.

        A drive found enabled or in quick stop is stopped first: below ``standstill``, counts/s.
        """
        end_s = self._clock.host_s() + _ENABLE_WALL_S
        state = self._state()
        if state is DriveState.ENABLED:
            self.put(codec.CONTROLWORD, codec.QUICK_STOP, 2)
        while (state := self._state()) is not DriveState.ENABLED:
            if self._clock.host_s() > end_s:
                title = state.title if state else "an undefined state"
                raise LinkTimeout(self.axis, f"not enabled within {_ENABLE_WALL_S:g} s, is in {title}")
            if state is DriveState.FAULT:  # from before, or the torque was restored only now
                self._reset_fault()
                continue
            moving = state is DriveState.QUICK_STOP_ACTIVE and abs(self.get(codec.VELOCITY_ACTUAL, 4)) > standstill
            if state is DriveState.SWITCHED_ON:
                self._hold()
            if state in codec.TOWARDS_ENABLED and not moving:
                self.put(codec.CONTROLWORD, codec.TOWARDS_ENABLED[state], 2)
            self._clock.sleep(_POLL_WALL_S)
        return self.get(codec.TARGET_POSITION, 4)

    def _state(self) -> DriveState | None:
        return codec.state_of(self.statusword())

    def _reset_fault(self) -> None:
        """Reset a fault; raise DriveFault when it stays."""
        code = self.fault_code()
        self.put(codec.CONTROLWORD, codec.DISABLE_VOLTAGE, 2)  # the reset acts on a rising bit
        self.put(codec.CONTROLWORD, codec.FAULT_RESET, 2)
        end_s = self._clock.host_s() + _RESET_WALL_S
        while self._state() is DriveState.FAULT:
            if self._clock.host_s() > end_s:
                raise DriveFault(self.axis, f"{codec.fault_text(code)} stays after a reset", codec.fault_kind(code))
            self._clock.sleep(_POLL_WALL_S)

    def fault_code(self) -> int:
        """Return the drive's newest error code (0x603F)."""
        return self.get(codec.ERROR_CODE, 2) & 0xFFFF

    def get(self, index: int, size: int, subindex: int = 0) -> int:
        """Read one whole number of ``size`` bytes, signed."""
        data = self._transfer(index, lambda: self._sdo.upload(index, subindex))
        if data is None or len(data) < size:
            raise ProtocolError(self.axis, f"object 0x{index:04X} is shorter than {size} bytes")
        return int.from_bytes(data[:size], "little", signed=True)

    def put(self, index: int, value: int, size: int, subindex: int = 0) -> None:
        """Write one whole number of ``size`` bytes."""
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        self._transfer(index, lambda: self._sdo.download(index, subindex, data))

    def _map_either(self, full: Pdo, plain: Pdo) -> bool:
        """Map ``full``, or ``plain`` if EDS or drive lack one of its objects; return whether it is full."""
        if self._eds.maps(full):
            try:
                self._map(full)
            except ProtocolError as error:
                refused = error.__cause__
                if not (isinstance(refused, SdoAbortedError) and refused.code in (_NO_SUCH_OBJECT, _NOT_MAPPABLE)):
                    raise
            else:
                return True
        self._map(plain)
        return False

    def _map(self, pdo: Pdo) -> None:
        """Write one PDO in the order that CiA 301 asks for: invalid, no entries, entries, count, valid."""
        identifier = pdo.identifier + self.node_id
        self.put(pdo.parameter, identifier | codec.PDO_INVALID, 4, subindex=1)
        self.put(pdo.parameter, pdo.transmission, 1, subindex=2)
        self.put(pdo.mapping_index, 0, 1)
        for subindex, (index, bits) in enumerate(pdo.mapping, start=1):
            self.put(pdo.mapping_index, index << 16 | bits, 4, subindex=subindex)
        self.put(pdo.mapping_index, len(pdo.mapping), 1)
        self.put(pdo.parameter, identifier, 4, subindex=1)

    def _transfer(self, index: int, transfer: Callable[[], bytes | None]) -> bytes | None:
        for tries_left in (1, 0):
            try:
                return transfer()
            except SdoAbortedError as error:
                raise ProtocolError(self.axis, f"refuses object 0x{index:04X}: {error}") from error
            except SdoCommunicationError as error:
                if tries_left:
                    continue  # a frame was lost or damaged
                what = f"node {self.node_id} does not answer for object 0x{index:04X} within {REPLY_WALL_S:g} s"
                raise LinkTimeout(self.axis, what) from error
        raise AssertionError("unreachable")
