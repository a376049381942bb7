"""Set-up of one CiA 402 drive: identity, units, PDO mapping, watchdog, mode, enabling. Blocks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from hil.config.rig import Cia402
from hil.core.messages import Homing
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import DriveState, Pdo
from hil.drivers.turntable.cia402.sdo import DriveObjects
from hil.drivers.turntable.cia402.units import Units, units_of
from hil.errors import DriveFault, LinkTimeout, ProtocolError

LAG_WALL_S = 0.5
"""Time that a drive may take to display a new mode, and then to show its bits in the statusword."""
_RESET_WALL_S = 0.3
_POLL_WALL_S = 0.005
_STANDSTILL_WALL_S = 0.05
_CYCLES_PER_S = 50.0


class DriveSetup(DriveObjects):
    """Set-up of one drive. Errors name ``axis``: LinkTimeout, ProtocolError, DriveFault.

    Set by ``configure``: units, stream (mode of operation that follows setpoints), has_offset and has_velocity (whether
    the setpoint holds a velocity, the feedback one), command_pdo (of controlword and setpoint in one), watchdogs, beats
    (whether it sends heartbeats).
    """

    units = Units(1.0, None)
    stream = codec.CYCLIC_SYNCHRONOUS_POSITION
    has_offset = has_velocity = beats = False
    command_pdo: Pdo | None = None
    watchdogs: Sequence[str] = ()
    watchdog_s = 0.0
    position = 0
    _enabled_since_s: float | None = None

    def identify(self, config: Cia402) -> None:
        """Check that this is a CiA 402 drive, the one that the rig file asks for, and that their units agree."""
        device_type = self.get(codec.DEVICE_TYPE, 4) & 0xFFFF_FFFF
        if device_type & 0xFFFF != codec.DEVICE_PROFILE and device_type != self._eds.default(codec.DEVICE_TYPE):
            raise ProtocolError(self.axis, f"node {self.node_id} is of device profile {device_type & 0xFFFF}, not 402")
        for subindex, what, expected in ((1, "vendor id", config.vendor_id), (2, "product code", config.product_code)):
            if expected is not None and (actual := self._identity(subindex)) != expected:
                raise ProtocolError(self.axis, f"{what} is 0x{actual:08X}, expected 0x{expected:08X}")
        if config.revision_min is not None and (actual := self._identity(3)) < config.revision_min:
            text = f"revision is 0x{actual:08X}, expected 0x{config.revision_min:08X} or newer"
            raise ProtocolError(self.axis, text)
        if config.firmware is not None and (name := self.text(codec.FIRMWARE)) != config.firmware:
            raise ProtocolError(self.axis, f"firmware is {name!r}, expected {config.firmware!r}")
        try:
            self.units = units_of(config, self.read)
        except ValueError as error:
            raise ProtocolError(self.axis, str(error)) from error

    def _identity(self, subindex: int) -> int:
        return self.get(codec.IDENTITY, 4, subindex) & 0xFFFF_FFFF

    def configure(self, timeout_s: float, watchdog_s: float, heartbeat_s: float, period_s: float, master: int) -> None:
        """Write PDOs, watchdog, mode and reactions (node pre-operational).

        period_s: between two setpoints. master: node id of the bench.
        """
        for index, subindex in self._eds.other_pdos():
            identifier = self.read(index, subindex)
            if identifier is not None and not identifier & codec.PDO_INVALID:
                self.put(index, identifier | codec.PDO_INVALID, 4, subindex)
        self._choose_stream()
        self._map_commands()
        if len(self._eds.reports) == 1:
            self.map(self._eds.reports[0])
        else:
            self.has_velocity = self.map_either(codec.FEEDBACK_PDO, codec.FEEDBACK_PDO_PLAIN, not self.units.has_rates)
            self._map_status(timeout_s)
        self._guard(watchdog_s, heartbeat_s, master)
        self._set_reaction(codec.QUICK_STOP_OPTION, codec.QUICK_STOP_REACTIONS)
        self._set_period(period_s)
        self.request_mode(self.stream)

    def _set_reaction(self, index: int, allowed: tuple[int, ...]) -> None:
        """Set the first of ``allowed`` that the data sheet allows; a drive that refuses it may have another of them."""
        if (code := self._eds.reaction(index, allowed)) is None:
            return
        try:
            self.set(index, code, 2)
        except ProtocolError:
            if self.read(index) not in allowed:
                raise

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

    def _map_commands(self) -> None:
        interpolates = self.stream == codec.INTERPOLATED_POSITION
        plain = codec.INTERPOLATION_PDO if interpolates else codec.SETPOINT_PDO_PLAIN
        if len(self._eds.commands) == 1:
            self.command_pdo = replace(self._eds.commands[0], mapping=codec.CONTROL_PDO.mapping + plain.mapping)
            self.map(self.command_pdo)
        else:
            self.has_offset = self.map_either(codec.SETPOINT_PDO, plain, interpolates or not self.units.has_rates)
            self.map(codec.CONTROL_PDO)
        if interpolates:
            for index, subindex, value, size in (
                (codec.INTERPOLATION_SUBMODE, 0, 0, 2),
                (codec.BUFFER, 6, 1, 1),
            ):
                if self._eds.can_write(index, subindex):
                    self.put(index, value, size, subindex)

    def _map_status(self, timeout_s: float) -> None:
        """Let the statusword be sent at least four times per time-out: by its timer, else with every so many SYNC."""
        pdo, plain = codec.STATUS_PDO, codec.STATUS_PDO_PLAIN
        if self._eds.can_write(pdo.parameter, codec.PDO_EVENT_TIMER):
            self.map_either(pdo, plain)
            self.set(pdo.parameter, round(250.0 * timeout_s), 2, codec.PDO_EVENT_TIMER)
            return
        cycles = min(240, max(1, int(_CYCLES_PER_S * timeout_s / 4.0)))
        self.map_either(replace(pdo, transmission=cycles), replace(plain, transmission=cycles))

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
        displayed = self.read(codec.MODE_DISPLAY)
        return None if displayed is None else displayed == mode

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

    @property
    def shows_enabled(self) -> bool:
        """Whether the drive has shown that it is enabled, if not yet the mode of the setpoints."""
        return self._enabled_since_s is not None

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
        displayed, is_late = self.displays(self.stream), now_s - self._enabled_since_s > LAG_WALL_S
        if displayed is False and is_late:
            raise self.stays_in_another(self.stream)
        return is_late if displayed is None else displayed

    def not_enabled(self, timeout_s: float) -> LinkTimeout:
        """Return the error of a drive that is not enabled in time."""
        state = self._state()
        title = state.title if state else "an undefined state"
        if state is DriveState.FAULT:
            title += f" again after each reset, {codec.fault_text(self.fault_code())}"
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
