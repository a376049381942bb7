"""Node of one axis on the CAN bus: commanded values, received values and their times."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable
from typing import Final

from hil.config.rig import Cia402, GimbalAxis, RotaryAxes
from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import DriveState
from hil.drivers.turntable.cia402.eds import Eds
from hil.drivers.turntable.cia402.setup import LAG_WALL_S, DriveSetup
from hil.drivers.turntable.cia402.units import Units
from hil.errors import DeviceError, DriveFault, LinkTimeout, ProtocolError

BURST: Final = 4  # consecutive implausible frames that end the link
_STANDSTILL_RADPS: Final = 2e-3
_LOST_BEATS: Final = 3.0
_SLACK: Final = 2.0  # times the largest rate of the axis
_MODE_WALL_S: Final = 2.0
_EMERGENCY_S: Final = 0.05  # within this time after an emergency message, further ones of its code are the same burst
_RATE_SAMPLES: Final = 5  # feedback over which the rate of a drive without a unit of velocity is taken
_TORQUE_FRACTION: Final = 0.3  # of the limit that is set, for the first move of commissioning
_RATE_LAG_S: Final = 0.02  # of the velocity that a drive measures
_REPEATABILITY_RAD: Final = math.radians(0.05)
_WORD_BYTES: Final = 2  # of the statusword
_MESSAGES: Final = ("answer to SYNC", "statusword", "heartbeat")


class Node:
    """An axis ``name`` on node ``node_id``. Errors name the axis: DriveFault, LinkTimeout, ProtocolError.

    A frame that is implausible (its length, a position that the axis cannot have reached, a state that an SDO upload
    contradicts) is counted and discarded; a burst of them is an error.
    """

    def __init__(
        self, name: str, node_id: int, config: RotaryAxes, axis: GimbalAxis, wire: Cia402, clock: BenchClock
    ) -> None:
        self.name = name
        self.node_id = node_id
        self._axis = axis
        self._wire = wire
        self._clock = clock
        self._is_unprotected = wire.interface in ("serial", "slcan")
        self._enabled_word = codec.ENABLE_OPERATION
        self._rate_max = math.radians(axis.rate_max_degps)
        self._acceleration = math.radians(axis.acceleration_max_degps2)
        self._margin_deg = 0.5 * config.following_error_max_deg
        self._timeout_s = config.timeout_s
        self._allowed_s: tuple[float, ...] = ()
        self.setup: DriveSetup | None = None
        self.units = Units(wire.counts_per_turn / math.tau, None)
        self.homing = Homing.DONE if axis.encoder == "absolute" else Homing.NEEDED
        self.protocol_errors = self.surplus = self.warnings = 0
        self.torque = ""
        """Result of the last change of the torque limit; "" while it is under way."""
        self._torque: int | None = None  # the limit to restore
        self.reset()

    def reset(self, position: int | None = None) -> None:
        """Reset the reception state and its time-outs; position: counts, as reported by the drive."""
        now_s = self._clock.now_s()
        self.controlword = self._enabled_word
        self.target = self.position = position or 0
        self.offset = 0
        self.rate = 0.0
        """Rate of the newest feedback, rad/s."""
        self.limit = 0
        self.answered = True
        self.is_homing = False
        """Whether homing was started, and its result is awaited."""
        self._mode_since_s: float | None = None
        self._displayed_since_s: float | None = None
        self._homing_result: Homing | None = None
        self._homing_shown = (Homing.UNDER_WAY, now_s)
        self._was_under_way = False
        # time of the last accepted position, for the plausibility of the next; None while homing may move the zero
        self._position_s: float | None = now_s if position is not None and self.homing is Homing.DONE else None
        self._samples: deque[tuple[float, int]] = deque(maxlen=_RATE_SAMPLES)
        self._implausible_in_a_row = 0
        self._departed: tuple[float, int, float] | None = None
        self._emergency_code, self._emergency_s = 0, -math.inf
        self._received_s = [now_s] * len(_MESSAGES)

    @property
    def needs_homing(self) -> bool:
        """Whether the rig file gives the axis an encoder that homing refers."""
        return self._axis.encoder == "incremental"

    def set_up(self, setup: DriveSetup, watchdog_s: float, period_s: float) -> None:
        """Identify and configure the drive (node pre-operational); request homing mode if it needs homing."""
        self.setup = setup
        setup.identify(self._wire)
        setup.configure(self._timeout_s, watchdog_s, self._wire.heartbeat_s, period_s, self._wire.master_id)
        self.units = setup.units
        self._enabled_word = codec.ENABLE_OPERATION
        if setup.stream == codec.INTERPOLATED_POSITION:
            self._enabled_word = codec.INTERPOLATE
        beats_s = max(self._timeout_s, _LOST_BEATS * self._wire.heartbeat_s) if setup.beats else math.inf
        self._allowed_s = (self._timeout_s, self._timeout_s, beats_s)
        if self.needs_homing:
            rate = math.radians(self._axis.homing_rate_degps)
            setup.prepare_homing(self._wire.homing_method, rate, self._acceleration)
            setup.await_mode(codec.HOMING)

    def continue_enabling(self) -> bool:
        """Take the next step towards an enabled drive, at its present position; return whether it is enabled."""
        is_enabled = self._sdo.continue_enabling(_STANDSTILL_RADPS)
        self.target, self.offset = self._sdo.position, 0
        return is_enabled

    def limit_torque(self, reduced: bool) -> bool:
        """Reduce the torque limit to a fraction of what it is set to, or restore it; ``torque`` is the result."""
        sdo, name = self._sdo, codec.object_name(codec.MAX_TORQUE)
        present = self._torque if self._torque is not None else sdo.read(codec.MAX_TORQUE)
        if present is None:
            self.torque = f"{name} is missing: full torque"
            return True
        present &= 0xFFFF
        limit = round(_TORQUE_FRACTION * present) if reduced else present
        try:
            sdo.set(codec.MAX_TORQUE, limit, 2)
        except ProtocolError as error:
            if not reduced:
                raise
            self.torque = f"{error.what}: full torque"
            return True
        self._torque = present if reduced else None
        self.torque = f"torque at most {limit} per mille of the rated one ({name}" + (", reduced)" if reduced else ")")
        return True

    def restore_torque(self) -> None:
        """Restore the torque limit if it is reduced; a bus that is gone leaves it."""
        if self._torque is not None:
            with contextlib.suppress(DeviceError):
                self.limit_torque(reduced=False)

    def begin_homing(self) -> bool:
        """Request homing mode, and start homing once the bits of the statusword are those of that mode.

        Returns whether homing was started; call again until then.
        """
        if not self._has_mode(codec.HOMING, LAG_WALL_S):
            return False
        self.is_homing = True
        self._homing_result, self._was_under_way = None, False
        self._homing_shown = (Homing.UNDER_WAY, self._clock.host_s())
        self.controlword = codec.START_HOMING
        return True

    def end_homing(self) -> bool:
        """Accept the result of homing; a homed drive returns to setpoints, at its present position.

        Returns whether it has; call again until then.
        """
        if self._homing_result is Homing.DONE:
            if self._mode_since_s is None:
                self.target = self._sdo.hold()
            if not self._has_mode(self._sdo.stream):
                return False
            self.target = self._sdo.hold()
            self.controlword = self._enabled_word
            self._position_s = None
        self.homing = self._homing_result or Homing.FAILED
        return True

    def take_homing_result(self) -> bool:
        """Return whether the drive has reported the result of homing since the last call."""
        if not self.is_homing or self._homing_result is None:
            return False
        self.is_homing = False
        return True

    def begin_profile(self, goal_rad: float, rate_radps: float) -> bool:
        """Start a profiled move to ``goal_rad``, at most at ``rate_radps``; return whether it was started."""
        if self._mode_since_s is None:
            self._sdo.prepare_profile(rate_radps, self._acceleration)
        if not self._has_mode(codec.PROFILE_POSITION):
            return False
        self._sdo.put(codec.TARGET_POSITION, self.units.counts(goal_rad), 4)
        self.controlword = codec.NEW_SETPOINT
        return True

    def _has_mode(self, mode: int, settling_s: float = 0.0) -> bool:
        """Request ``mode``; return whether it has been displayed for ``settling_s``. Raises ProtocolError."""
        now_s = self._clock.host_s()
        if self._mode_since_s is None:
            self._sdo.request_mode(mode)
            self._mode_since_s, self._displayed_since_s = now_s, None
            self.controlword = codec.ENABLE_OPERATION  # bit 4 starts in each mode by its rising edge
        displayed = self._sdo.displays(mode)
        if displayed is None:  # the drive displays no mode
            displayed, settling_s = True, max(settling_s, LAG_WALL_S)
        if not displayed:
            self._displayed_since_s = None
            if now_s - self._mode_since_s > _MODE_WALL_S:
                raise self._sdo.stays_in_another(mode)
            return False
        if self._displayed_since_s is None:
            self._displayed_since_s = now_s
        if now_s - self._displayed_since_s < settling_s:
            return False
        self._mode_since_s = None
        return True

    def command(self, position_rad: float, rate_radps: float) -> None:
        """Make position and rate the setpoint."""
        self.target, self.offset = self.units.counts(position_rad), self.units.speed(rate_radps)

    def setpoint(self) -> tuple[int, bytes]:
        """Return the frame of the setpoint."""
        plain = codec.encode_plain_setpoint(self.target)
        if (pdo := self._sdo.command_pdo) is not None:
            return pdo.identifier + self.node_id, codec.encode_control(self.controlword) + plain
        data = codec.encode_setpoint(self.target, self.offset) if self._sdo.has_offset else plain
        return codec.RPDO1_ID + self.node_id, data

    def control(self) -> tuple[int, bytes]:
        """Return the frame of the controlword."""
        if self._sdo.command_pdo is not None:
            return self.setpoint()
        return codec.RPDO2_ID + self.node_id, codec.encode_control(self.controlword)

    def facts(self) -> str:
        """Return mode, units and watchdog of the opened drive."""
        setup = self._sdo
        guards = " and ".join(setup.watchdogs)
        guard = f"watchdog {guards}, {setup.watchdog_s:g} s" if guards else "no watchdog"
        return f"{self.name}: {codec.MODE_NAMES[setup.stream]}, {setup.units}, {guard}"

    def report_handlers(self, eds: Eds) -> tuple[Callable[[bytes], None], ...]:
        """Return the methods that receive the PDOs of ``eds.reports``."""
        return (self.on_report,) if len(eds.reports) == 1 else (self.on_feedback, self.on_status)

    def check_silence(self, now_s: float) -> None:
        """Raise LinkTimeout if an expected message has not been received for too long."""
        for what, received_s, allowed_s in zip(_MESSAGES, self._received_s, self._allowed_s, strict=True):
            if now_s - received_s > allowed_s:
                raise LinkTimeout(self.name, f"no {what} for {now_s - received_s:.3f} s, allowed {allowed_s:g} s")

    def on_feedback(self, data: bytes) -> None:
        """Receive position and velocity."""
        now_s = self._clock.now_s()
        try:
            position, velocity = codec.decode_feedback(data, self._sdo.has_velocity)
        except ValueError as error:
            self._count_implausible(f"feedback has {error}")
            return
        if self.answered:  # not requested: a repeated or late frame
            self.surplus += 1
            return
        rate = self._rate(position, now_s) if velocity is None else velocity / (self.units.velocity or math.inf)
        if self._is_implausible(position, rate, now_s):
            shown = math.degrees(rate)
            self._count_implausible(f"jumps from {self.position} to {position} counts at {shown:.4g} deg/s")
            return
        if self._is_unconfirmed(position, rate, now_s):
            self._count_implausible(f"moves from {self.position} to {position} counts, against its acceleration")
            return
        self._implausible_in_a_row = 0
        self._samples.append((now_s, position))
        self.position, self.rate = position, rate
        self._position_s = now_s if self.homing is Homing.DONE else None
        self.answered = True
        self._received_s[0] = now_s

    def on_report(self, data: bytes) -> None:
        """Receive statusword and position in one message."""
        self.on_status(data[:_WORD_BYTES])
        self.on_feedback(data[_WORD_BYTES:])

    def on_status(self, data: bytes) -> None:
        """Receive statusword and digital inputs; raise DriveFault for an unexpected state."""
        try:
            statusword, inputs = codec.decode_status(data)
        except ValueError as error:
            self._count_implausible(f"status has {error}")
            return
        if self._is_bad(codec.state_of(statusword)):
            self._confirm_fault()
            return
        self._received_s[1] = self._clock.now_s()
        self.limit = codec.limit_of(inputs)
        if self.is_homing and self._homing_result is None:
            self._follow_homing(codec.homing_of(statusword))

    def _follow_homing(self, shown: Homing) -> None:
        """Take a result that homing has led to: shown after it was under way, or for longer than old bits linger."""
        now_s = self._clock.host_s()
        if shown is not self._homing_shown[0]:
            self._homing_shown = (shown, now_s)
        self._was_under_way |= shown is Homing.UNDER_WAY
        if shown is not Homing.UNDER_WAY and (self._was_under_way or now_s - self._homing_shown[1] > LAG_WALL_S):
            self._homing_result = shown

    def on_emergency(self, data: bytes) -> None:
        """Raise DriveFault for an emergency message that an SDO upload confirms; warnings are counted."""
        now_s = self._clock.now_s()
        try:
            code = codec.decode_emergency(data)
        except ValueError as error:
            self._count_implausible(f"emergency message has {error}")
            return
        if code != 0 and (code != self._emergency_code or now_s - self._emergency_s > _EMERGENCY_S):
            self._emergency_code, self._emergency_s = code, now_s
            self._confirm_fault(code)

    def on_heartbeat(self, data: bytes) -> None:
        """Receive a heartbeat; raise DriveFault for a node that has restarted."""
        if len(data) == 1 and data[0] & ~codec.TOGGLE == codec.OPERATIONAL:
            self._received_s[2] = self._clock.now_s()
        elif data == bytes((codec.BOOT_UP,)):
            raise DriveFault(self.name, "has restarted")
        else:
            self._count_implausible(f"heartbeat is {data.hex(' ') or 'empty'}, expected 05 (operational)")

    @property
    def _sdo(self) -> DriveSetup:
        if self.setup is None:
            raise LinkTimeout(self.name, "is not open")
        return self.setup

    def _rate(self, position: int, now_s: float) -> float:
        """Return the rate, rad/s, over the last positions."""
        if not self._samples or now_s <= self._samples[0][0] or self.homing is not Homing.DONE:
            return 0.0
        then_s, then = self._samples[0]
        return (position - then) / self.units.position / (now_s - then_s)

    def _is_implausible(self, position: int, rate: float, now_s: float) -> bool:
        if self._position_s is None:
            return False
        path = _SLACK * self._rate_max * (now_s - self._position_s) + math.radians(self._margin_deg)
        step = abs(position - self.position) / self.units.position
        return step > path or abs(rate) > 2 * _SLACK * self._rate_max

    def _is_unconfirmed(self, position: int, rate: float, now_s: float) -> bool:
        """Return whether a position departs from the motion so far, on a wire without a checksum.

        It is accepted when the next one continues it: a true departure costs one exchange, a damaged frame is left out.
        """
        sample, departed = (now_s, position, rate), self._departed
        self._departed = None
        if not self._is_unprotected or self._position_s is None:
            return False
        if self._continues((self._position_s, self.position, self.rate), sample):
            return False
        if departed is not None and self._continues(departed, sample):
            return False
        self._departed = sample
        return True

    def _continues(self, before: tuple[float, int, float], sample: tuple[float, int, float]) -> bool:
        """Return whether a sample (time, position, rate) continues the one before within the acceleration."""
        dt_s = sample[0] - before[0]
        path = (sample[1] - before[1]) / self.units.position - 0.5 * (before[2] + sample[2]) * dt_s
        lag_s = _RATE_LAG_S if self._sdo.has_velocity else _RATE_SAMPLES * dt_s
        return abs(path) <= self._acceleration * dt_s * (dt_s + lag_s) + _REPEATABILITY_RAD

    def _is_bad(self, state: DriveState | None) -> bool:
        stopping = self.controlword in (codec.QUICK_STOP, codec.DISABLE_VOLTAGE)
        return state in codec.FAULT_STATES or (not stopping and state is not DriveState.ENABLED)

    def _confirm_fault(self, code: int = 0) -> None:
        """Read the state by SDO, so that no damaged frame passes for a fault; raise DriveFault if it is one.

        The error code may be one of the past: state and error register alone show whether there is an error now.
        """
        state = codec.state_of(self._sdo.statusword())
        if not self._is_bad(state) and not (code and self._sdo.has_error()):
            self.warnings += bool(code)
            self.protocol_errors += not code  # the statusword was damaged
            return
        code = code or (self._sdo.fault_code() if state in codec.FAULT_STATES or self._sdo.has_error() else 0)
        if code or state in codec.FAULT_STATES:
            raise DriveFault(self.name, codec.fault_text(code), codec.fault_kind(code))
        title = state.title if state else "an undefined state"
        raise DriveFault(self.name, f"left operation enabled by itself, is in {title}")

    def _count_implausible(self, what: str) -> None:
        self.protocol_errors += 1
        self._implausible_in_a_row += 1
        if self._implausible_in_a_row >= BURST:
            raise ProtocolError(self.name, f"{BURST} implausible frames in a row: {what}")
