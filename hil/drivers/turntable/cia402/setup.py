"""Set-up of one CiA 402 drive by SDO: identity, units, PDO mapping, watchdog, mode, enabling.

canopen's SDO client does the transfers, pumped from the bus in the calling thread: no notifier
thread, so an error of the bus is raised here. Blocks; each reply is waited for at most REPLY_WALL_S.
"""

from __future__ import annotations

import math
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
from hil.drivers.turntable.cia402.units import Units, units_of
from hil.errors import DriveFault, LinkTimeout, ProtocolError

REPLY_WALL_S = 0.3
LAG_WALL_S = 0.5
"""Time that a drive may take to display a new mode, and then to show its bits in the statusword."""
_RESET_WALL_S = 0.3
_POLL_WALL_S = 0.005
_STANDSTILL_WALL_S = 0.05
_SDO_BYTES = 8
_NOT_MAPPABLE = 0x06040041
_INVALID_VALUE = 0x06090030
_ABSENT = (0x06020000, 0x06090011)  # no such object, no such sub-index
_CYCLES_PER_S = 50.0


_OTHER_REMEDY = "check its state and data sheet with the tool of its maker"
_REMEDIES = {
    codec.INTERPOLATION_PERIOD: "run the scenario at a rate whose period the drive takes",
    codec.QUICK_STOP_OPTION: "set 6, or 5, with the tool of its maker: the axis must keep its torque after a stop",
    codec.ABORT_CONNECTION_OPTION: "set 3, quick stop, with the tool of its maker",
    codec.HEARTBEAT_CONSUMER: "without a watchdog of the drive only the safety chain stops it",
    codec.MODE: "the mode must be one of 0x6502",
}
"""What to do if the drive refuses a setting, by object."""

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
    Set by ``configure``: units, stream (mode of operation that follows setpoints), has_offset and has_velocity (whether
    the setpoint holds a velocity, the feedback one), watchdogs, beats (whether it sends heartbeats).
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
        self.units = Units(1.0, None)
        self.stream = codec.CYCLIC_SYNCHRONOUS_POSITION
        self.has_offset = self.has_velocity = False
        self.watchdogs: list[str] = []
        self.watchdog_s = 0.0
        self._enabled_since_s: float | None = None
        self.beats = False
        self.position = 0

    def identify(self, config: Cia402) -> None:
        """Check that this is a CiA 402 drive, the one that the rig file asks for, and that their units agree."""
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
        try:
            self.units = units_of(config, self.read)
        except ValueError as error:
            raise ProtocolError(self.axis, str(error)) from error

    def _identity(self, subindex: int) -> int:
        return self.get(codec.IDENTITY, 4, subindex) & 0xFFFF_FFFF

    def _text(self, index: int) -> str:
        data = self._transfer(index, 0, lambda: self._sdo.upload(index, 0)) or b""
        return data.rstrip(b"\0 ").decode("ascii", "replace")

    def configure(self, timeout_s: float, watchdog_s: float, heartbeat_s: float, period_s: float, master: int) -> None:
        """Write PDOs, watchdog, mode and reactions (node pre-operational).

        period_s: between two setpoints. master: node id of the bench.
        """
        for index, subindex in self._eds.other_pdos():
            identifier = self.read(index, subindex)
            if identifier is not None and not identifier & codec.PDO_INVALID:
                self.put(index, identifier | codec.PDO_INVALID, 4, subindex)
        self._choose_stream()
        self._map_setpoint()
        self._map(codec.CONTROL_PDO)
        self.has_velocity = self._map_either(codec.FEEDBACK_PDO, codec.FEEDBACK_PDO_PLAIN, not self.units.has_rates)
        self._map_either(codec.STATUS_PDO, codec.STATUS_PDO_PLAIN)
        self._time_status(timeout_s)
        self._guard(watchdog_s, heartbeat_s, master)
        self._set_reaction(codec.QUICK_STOP_OPTION, codec.QUICK_STOP_REACTIONS)
        self._set_period(period_s)
        self.request_mode(self.stream)

    def _set_reaction(self, index: int, wanted: tuple[int, ...]) -> None:
        if (code := self._eds.reaction(index, wanted)) is not None:
            self.set(index, code, 2)

    def _choose_stream(self) -> None:
        """Choose the mode that follows setpoints, of those that the connected drive supports."""
        supported = self.read(*codec.SUPPORTED_MODES)
        modes = [mode for mode in self._eds.streams if mode in self._eds.declared_streams(supported)]
        if not modes:
            raise ProtocolError(
                self.axis,
                f"0x6502 is 0x{(supported or 0) & 0xFFFF_FFFF:X}: the drive supports none of "
                f"{', '.join(codec.MODE_NAMES[mode] for mode in self._eds.streams)}: it cannot follow setpoints",
            )
        self.stream = modes[0]

    def _map_setpoint(self) -> None:
        if self.stream == codec.INTERPOLATED_POSITION:
            self._map(codec.INTERPOLATION_PDO)
            for index, subindex, value, size in (
                (codec.INTERPOLATION_SUBMODE, 0, 0, 2),
                (codec.BUFFER, 6, 1, 1),
            ):
                if self._eds.can_write(index, subindex):
                    self.put(index, value, size, subindex)
            return
        self.has_offset = self._map_either(
            codec.SETPOINT_PDO, codec.SETPOINT_PDO_PLAIN, skip_full=not self.units.has_rates
        )

    def _time_status(self, timeout_s: float) -> None:
        """Let the statusword be sent at least four times per time-out: by its timer, else with every so many SYNC."""
        pdo = codec.STATUS_PDO
        if self._eds.can_write(pdo.parameter, codec.PDO_EVENT_TIMER):
            self.set(pdo.parameter, round(250.0 * timeout_s), 2, codec.PDO_EVENT_TIMER)
            return
        cycles = min(240, max(1, int(_CYCLES_PER_S * timeout_s / 4.0)))
        identifier = self.get(pdo.parameter, 4, 1) & 0xFFFF_FFFF
        self.put(pdo.parameter, identifier | codec.PDO_INVALID, 4, 1)
        self.set(pdo.parameter, cycles, 1, 2)
        self.put(pdo.parameter, identifier, 4, 1)

    def _guard(self, watchdog_s: float, heartbeat_s: float, master: int) -> None:
        """Set up the drive's watchdog over the bench, and its heartbeat."""
        time_ms, self.watchdog_s = round(1000.0 * watchdog_s), watchdog_s
        self.watchdogs = self._set_watchdogs(time_ms, master)
        beat_ms = round(1000.0 * heartbeat_s) if codec.LIFE_GUARD not in self.watchdogs else 0
        produces = self.read(codec.HEARTBEAT_PRODUCER) is not None and self._eds.can_write(codec.HEARTBEAT_PRODUCER)
        self.beats = codec.LIFE_GUARD in self.watchdogs or produces
        if produces:
            self.set(codec.HEARTBEAT_PRODUCER, beat_ms, 2)
        self._set_reaction(codec.ABORT_CONNECTION_OPTION, codec.ABORT_REACTIONS)

    def _set_watchdogs(self, time_ms: int, master: int) -> list[str]:
        """Set all watchdogs that the drive accepts; return them. Raises ProtocolError if it refuses all it has.

        Some drives accept a setpoint time-out that they do not monitor: a heartbeat is consumed as well.
        """
        accepted, refused = [], None
        for means in self._eds.watchdogs():
            try:
                if means == codec.SETPOINT_TIME_OUT:
                    self.set(codec.SETPOINT_PDO.parameter, time_ms, 2, codec.PDO_EVENT_TIMER)
                elif means == codec.HEARTBEAT_GUARD:
                    self.set(codec.HEARTBEAT_CONSUMER, master << 16 | time_ms, 4, 1)
                else:
                    self.set(codec.GUARD_TIME, time_ms // codec.GUARDS_PER_LIFE, 2)
                    self.set(codec.LIFE_TIME_FACTOR, codec.GUARDS_PER_LIFE, 1)
            except ProtocolError as error:
                refused = error
            else:
                accepted.append(means)
        if refused is not None and not accepted:
            raise refused
        return accepted

    def _set_period(self, period_s: float) -> None:
        """Write the time over which the drive interpolates between two setpoints, which is that between them."""
        if self._eds.can_write(codec.INTERPOLATION_PERIOD, 1):
            exponent = -3 if period_s >= 1e-3 and abs(1e3 * period_s - round(1e3 * period_s)) < 0.05 else -4
            while period_s * codec.power_of_ten(-exponent) > 255.0:
                exponent += 1
            if self._eds.can_write(codec.INTERPOLATION_PERIOD, 2):
                self.set(codec.INTERPOLATION_PERIOD, exponent, 1, 2)
            elif (fixed := self.read(codec.INTERPOLATION_PERIOD, 2)) is not None:
                exponent = fixed
            self.set(codec.INTERPOLATION_PERIOD, round(period_s * codec.power_of_ten(-exponent)), 1, 1)
        elif self._eds.can_write(codec.CYCLE_PERIOD):
            self.set(codec.CYCLE_PERIOD, round(1e6 * period_s), 4)

    def set_sync(self, identifier: int) -> bool:
        """Let the drive take ``identifier`` as SYNC; return whether it does."""
        present = self.read(codec.SYNC_OBJECT)
        if (codec.SYNC_ID if present is None else present & 0x7FF) == identifier:
            return True
        if not self._eds.can_write(codec.SYNC_OBJECT):
            return False
        try:
            self.put(codec.SYNC_OBJECT, identifier, 4)
        except ProtocolError:
            return False
        return self.get(codec.SYNC_OBJECT, 4) & 0x7FF == identifier

    def request_mode(self, mode: int) -> None:
        """Write the mode of operation."""
        self.put(codec.MODE, mode, 1)

    def displays(self, mode: int) -> bool | None:
        """Return whether the drive displays ``mode``; None for a drive that displays none."""
        return self.get(codec.MODE_DISPLAY, 1) == mode if self._eds.has(codec.MODE_DISPLAY) else None

    def await_mode(self, mode: int) -> bool:
        """Return whether the drive displays ``mode`` within LAG_WALL_S; one that is not enabled may do so later."""
        end_s = self._clock.host_s() + LAG_WALL_S
        while (displayed := self.displays(mode)) is False and self._clock.host_s() < end_s:
            self._clock.sleep(_POLL_WALL_S)
        return displayed is True

    def stays_in_another(self, mode: int) -> ProtocolError:
        """Return the error of a drive that does not take ``mode``."""
        displayed = self.get(codec.MODE_DISPLAY, 1)
        return ProtocolError(self.axis, f"stays in mode {displayed}, requested {mode} ({codec.MODE_NAMES[mode]})")

    def prepare_homing(self, method: int, rate_radps: float, acceleration_radps2: float) -> None:
        """Write the homing parameters and request homing mode, in which the drive shows whether it is homed."""
        if self.units.velocity is None:
            raise ProtocolError(
                self.axis,
                "0x60A9 is missing: the homing speeds need the drive's unit of velocity: "
                "set cia402.velocity_units_per_degps",
            )
        speed = math.floor(rate_radps * self.units.velocity + 1e-6)
        if speed < 1:
            unit_degps = math.degrees(1.0 / self.units.velocity)
            raise ProtocolError(
                self.axis,
                f"homing_rate_degps = {math.degrees(rate_radps):g} is below the drive's unit of velocity, "
                f"{unit_degps:.4g} deg/s: raise it, or give 0x60A9 a finer unit",
            )
        self.set(codec.HOMING_METHOD, method, 1)
        self.set(codec.HOMING_SPEEDS, speed, 4, 1)
        self.set(codec.HOMING_SPEEDS, max(1, speed // 4), 4, 2)
        if self._eds.can_write(codec.HOMING_ACCELERATION):
            self.set(codec.HOMING_ACCELERATION, max(1, self.units.speed(acceleration_radps2)), 4)
        self.request_mode(codec.HOMING)

    def is_homed(self) -> bool:
        """Return whether the drive shows that it is homed, and leave homing mode.

        The bits mean homing only LAG_WALL_S after the mode is displayed; before, they may be those of another mode.
        """
        homed = self.displays(codec.HOMING) is True and codec.homing_of(self.statusword()) is Homing.DONE
        self.request_mode(self.stream)
        return homed

    def prepare_profile(self, rate_radps: float, acceleration_radps2: float) -> None:
        """Request profile position mode. The move begins with NEW_SETPOINT."""
        acceleration = max(1, self.units.speed(acceleration_radps2))
        self.put(codec.PROFILE_VELOCITY, max(1, self.units.speed(rate_radps)), 4)
        self.put(codec.PROFILE_ACCELERATION, acceleration, 4)
        if self._eds.can_write(codec.PROFILE_DECELERATION):
            self.put(codec.PROFILE_DECELERATION, acceleration, 4)
        self.request_mode(codec.PROFILE_POSITION)

    def hold(self) -> int:
        """Make the present position, at rest, the setpoint; return it, counts.

        A drive keeps the velocity offset of the last setpoint that it received, however old.
        """
        position = self.get(codec.POSITION_ACTUAL, 4)
        if self.stream == codec.INTERPOLATED_POSITION:
            self.put(codec.INTERPOLATION_DATA, position, 4, 1)
        elif self._eds.can_write(codec.TARGET_POSITION):
            self.put(codec.TARGET_POSITION, position, 4)
        if self.has_offset:
            self.put(codec.VELOCITY_OFFSET, 0, 4)
        return position

    def statusword(self) -> int:
        return self.get(codec.STATUSWORD, 2) & 0xFFFF

    def begin_enabling(self) -> None:
        """Make the present position the setpoint; a drive found enabled is stopped."""
        if self._state() is DriveState.ENABLED:
            self.put(codec.CONTROLWORD, codec.QUICK_STOP, 2)
        self.position = self.hold()
        self._enabled_since_s = None

    def continue_enabling(self, standstill_radps: float) -> bool:
        """Take the next step towards operation enabled, at the present position; return whether it is.

        A drive in quick stop is waited for: below ``standstill_radps``. It is enabled at ``position``, counts.
        """
        state = self._state()
        if state is DriveState.FAULT:  # from before, or the torque was restored only now
            self._reset_fault()
            return False
        if state is DriveState.SWITCHED_ON:
            self.position = self.hold()
        moving = state is DriveState.QUICK_STOP_ACTIVE and self._moves(standstill_radps)
        if state in codec.TOWARDS_ENABLED and not moving:
            self.put(codec.CONTROLWORD, codec.TOWARDS_ENABLED[state], 2)
        if state is not DriveState.ENABLED:
            return False
        now_s = self._clock.host_s()
        self._enabled_since_s = self._enabled_since_s or now_s
        if self.displays(self.stream) is not False:
            return True
        if now_s - self._enabled_since_s > LAG_WALL_S:
            raise self.stays_in_another(self.stream)
        return False

    def not_enabled(self, timeout_s: float) -> LinkTimeout:
        """Return the error of a drive that is not enabled in time."""
        state = self._state()
        title = state.title if state else "an undefined state"
        return LinkTimeout(self.axis, f"not enabled within {timeout_s:g} s (cia402.enable_timeout_s), is in {title}")

    def _moves(self, standstill_radps: float) -> bool:
        before = self.get(codec.POSITION_ACTUAL, 4)
        self._clock.sleep(_STANDSTILL_WALL_S)
        path = abs(self.get(codec.POSITION_ACTUAL, 4) - before)
        return path > 1 and path > standstill_radps * _STANDSTILL_WALL_S * self.units.position

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
        """Return the drive's newest error code, which may be one of the past; 0 if it has none."""
        code = self.read(codec.ERROR_CODE)
        return (self.read(codec.ERROR_FIELD, 1) or 0 if code is None else code) & 0xFFFF

    def has_error(self) -> bool:
        """Return whether the drive has an error now, by its error register."""
        return self.get(codec.ERROR_REGISTER, 1) & 0xFF != 0

    def read(self, index: int, subindex: int = 0) -> int | None:
        """Return a whole number of any size; None if the data sheet does not have it, or the drive does not."""
        if (index, subindex) not in self._eds.variables:
            return None
        try:
            data = self._transfer(index, subindex, lambda: self._sdo.upload(index, subindex)) or b""
        except ProtocolError as error:
            if _abort_code(error) is None:
                raise
            return None
        return int.from_bytes(data[:4], "little", signed=True)

    def get(self, index: int, size: int, subindex: int = 0) -> int:
        """Read one whole number of ``size`` bytes, signed."""
        data = self._transfer(index, subindex, lambda: self._sdo.upload(index, subindex))
        if data is None or len(data) < size:
            name = codec.object_name(index, subindex)
            raise ProtocolError(self.axis, f"object {name} is shorter than {size} bytes")
        return int.from_bytes(data[:size], "little", signed=True)

    def put(self, index: int, value: int, size: int, subindex: int = 0) -> None:
        """Write one whole number of ``size`` bytes."""
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        self._transfer(index, subindex, lambda: self._sdo.download(index, subindex, data), value)

    def set(self, index: int, value: int, size: int, subindex: int = 0) -> None:
        """Write a setting unless the drive has it already, and read it back. Raises ProtocolError if it differs."""
        mask = (1 << 8 * size) - 1
        present = self.read(index, subindex)
        if present is not None and present & mask == value & mask:
            return
        self.put(index, value, size, subindex)
        if (actual := self.get(index, size, subindex)) & mask != value & mask:
            name = codec.object_name(index, subindex)
            raise ProtocolError(self.axis, f"object {name} is {actual} after {value} was written")

    def _map_either(self, full: Pdo, plain: Pdo, skip_full: bool = False) -> bool:
        """Map ``full``, or ``plain`` if EDS or drive lack one of its objects; return whether it is full."""
        if self._eds.maps(full) and not skip_full:
            try:
                self._map(full)
            except ProtocolError as error:
                if _abort_code(error) not in (*_ABSENT, _NOT_MAPPABLE):
                    raise
            else:
                return True
        self._map(plain)
        return False

    def _map(self, pdo: Pdo) -> None:
        """Write one PDO in the order that CiA 301 asks for: invalid, no entries, entries, count, valid.

        The bit that forbids remote frames stays as the drive has it; a drive that has none of them insists on it.
        """
        identifier = pdo.identifier + self.node_id
        kept = (self.read(pdo.parameter, 1) or 0) & codec.PDO_NO_RTR
        try:
            self.put(pdo.parameter, identifier | kept | codec.PDO_INVALID, 4, subindex=1)
        except ProtocolError as error:
            if _abort_code(error) != _INVALID_VALUE or kept or pdo.identifier not in (codec.TPDO1_ID, codec.TPDO2_ID):
                raise
            kept = codec.PDO_NO_RTR
            self.put(pdo.parameter, identifier | kept | codec.PDO_INVALID, 4, subindex=1)
        if self._eds.can_write(pdo.parameter, 2) or pdo.parameter >= codec.FEEDBACK_PDO.parameter:
            self.set(pdo.parameter, pdo.transmission, 1, subindex=2)  # a fixed one of a setpoint: it acts at once
        mapping = [index << 16 | subindex << 8 | bits for index, subindex, bits in pdo.mapping]
        if not self._has_mapping(pdo.mapping_index, mapping):
            self.put(pdo.mapping_index, 0, 1)
            for each, entry in enumerate(mapping, start=1):
                self.put(pdo.mapping_index, entry, 4, subindex=each)
            self.put(pdo.mapping_index, len(mapping), 1)
        self.put(pdo.parameter, identifier | kept, 4, subindex=1)

    def _has_mapping(self, index: int, mapping: list[int]) -> bool:
        present = [self.read(index, each) for each in range(len(mapping) + 1)]
        return [each is not None and each & 0xFFFF_FFFF for each in present] == [len(mapping), *mapping]

    def _transfer(
        self, index: int, subindex: int, transfer: Callable[[], bytes | None], value: int | None = None
    ) -> bytes | None:
        name = codec.object_name(index, subindex)
        for tries_left in (1, 0):
            try:
                return transfer()
            except SdoAbortedError as error:
                what = name if value is None else f"{name} = {value}"
                text = f"refuses object {what}: {error}: {_REMEDIES.get(index, _OTHER_REMEDY)}"
                if error.code in _ABSENT:
                    text = (
                        f"object {name} of the data sheet does not exist in the drive: enter its own as cia402.eds_file"
                    )
                raise ProtocolError(self.axis, text) from error
            except SdoCommunicationError as error:
                if tries_left:
                    continue  # a frame was lost or damaged
                what = f"node {self.node_id} does not answer for object {name} within {REPLY_WALL_S:g} s"
                raise LinkTimeout(self.axis, what) from error
        raise AssertionError("unreachable")


def _abort_code(error: ProtocolError) -> int | None:
    """Return the code with which the drive has refused an object; None for another error."""
    return error.__cause__.code if isinstance(error.__cause__, SdoAbortedError) else None
