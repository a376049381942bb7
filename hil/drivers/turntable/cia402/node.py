"""Node of one axis on the CAN bus: commanded values, received values and their times."""

from __future__ import annotations

from typing import Final

from hil.config.rig import Cia402, GimbalAxis, RotaryAxes
from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import DriveState
from hil.drivers.turntable.cia402.setup import DriveSetup
from hil.errors import DriveFault, LinkTimeout, ProtocolError

BURST: Final = 4  # consecutive implausible frames that end the link
_STANDSTILL_RADPS: Final = 2e-3
_LOST_BEATS: Final = 3.0
_SLACK: Final = 2.0  # times the largest rate of the axis
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
        self._rate_max = self._counts_deg(axis.rate_max_degps)
        self._acceleration = self._counts_deg(axis.acceleration_max_degps2)
        self._margin = self._counts_deg(0.5 * config.following_error_max_deg)
        self._allowed_s = (config.timeout_s, config.timeout_s, max(config.timeout_s, _LOST_BEATS * wire.heartbeat_s))
        self.setup: DriveSetup | None = None
        self.homing = Homing.DONE if axis.encoder == "absolute" else Homing.NEEDED
        self.protocol_errors = 0
        self.surplus = 0
        self.reset()

    def reset(self, position: int | None = None) -> None:
        """Reset the reception state and its time-outs; position: counts, as reported by the drive."""
        now_s = self._clock.now_s()
        self.controlword = codec.ENABLE_OPERATION
        self.target = self.position = position or 0
        self.offset = self.velocity = 0
        self.limit = 0
        self.answered = True
        self.mode = codec.CYCLIC_SYNCHRONOUS_POSITION
        self._homing_result: Homing | None = None
        # time of the last accepted position, for the plausibility of the next; None while homing may move the zero
        self._position_s: float | None = now_s if position is not None and self.homing is Homing.DONE else None
        self._implausible_in_a_row = 0
        self._received_s = [now_s] * len(_MESSAGES)

    def set_up(self, setup: DriveSetup, timeout_s: float, watchdog_s: float) -> None:
        """Identify and configure the drive (node pre-operational)."""
        self.setup = setup
        setup.identify(self._wire)
        self._has_offset = setup.configure(timeout_s, watchdog_s, self._wire.heartbeat_s)
        if self._axis.encoder == "incremental":
            speed = self._counts_deg(self._axis.homing_rate_degps)
            homed = setup.prepare_homing(self._wire.homing_method, speed, self._acceleration)
            self.homing = Homing.DONE if homed else Homing.NEEDED

    def enable(self) -> int:
        """Enable the drive at its present position; return that, counts."""
        return self._sdo.enable(codec.counts_from_rad(_STANDSTILL_RADPS, self._wire.counts_per_turn))

    def begin_homing(self) -> None:
        """Start homing."""
        self._sdo.choose_mode(codec.HOMING)  # discards earlier statuswords, of other meaning
        self.mode = codec.HOMING
        self._homing_result = None
        self.controlword = codec.START_HOMING

    @property
    def homing_is_over(self) -> bool:
        """Whether the drive has reported the result of homing since ``begin_homing``."""
        return self.homing is Homing.UNDER_WAY and self._homing_result is not None

    def end_homing(self) -> None:
        """Accept the result of homing; a homed drive returns to setpoints, at its present position."""
        if not self.homing_is_over:
            return
        if self._homing_result is Homing.DONE:
            self.target = self._sdo.back_to_setpoints()
            self.mode = codec.CYCLIC_SYNCHRONOUS_POSITION
            self.controlword = codec.ENABLE_OPERATION
            self._position_s = None
        self.homing = self._homing_result or Homing.FAILED

    def begin_profile(self, target: int, speed: int) -> None:
        """Start a profiled move to ``target``, counts, at most at ``speed``, counts/s."""
        self._sdo.prepare_profile(target, max(1, speed), self._acceleration)
        self.mode = codec.PROFILE_POSITION
        self.controlword = codec.NEW_SETPOINT

    def setpoint(self) -> tuple[int, bytes]:
        """Return the frame of the setpoint."""
        plain = codec.encode_plain_setpoint(self.target)
        data = codec.encode_setpoint(self.target, self.offset) if self._has_offset else plain
        return codec.RPDO1_ID + self.node_id, data

    def control(self) -> tuple[int, bytes]:
        """Return the frame of the controlword."""
        return codec.RPDO2_ID + self.node_id, codec.encode_control(self.controlword)

    def check_silence(self, now_s: float) -> None:
        """Raise LinkTimeout if an expected message has not been received for too long."""
        for what, received_s, allowed_s in zip(_MESSAGES, self._received_s, self._allowed_s, strict=True):
            if now_s - received_s > allowed_s:
                raise LinkTimeout(self.name, f"no {what} for {now_s - received_s:.3f} s, allowed {allowed_s:g} s")

    def on_feedback(self, data: bytes) -> None:
        """Receive position and velocity."""
        now_s = self._clock.now_s()
        try:
            position, velocity = codec.decode_feedback(data)
        except ValueError as error:
            self._count_implausible(f"feedback has {error}")
            return
        if self.answered:  # not requested: a repeated or late frame
            self.surplus += 1
            return
        if self._is_implausible(position, velocity, now_s):
            self._count_implausible(f"jumps from {self.position} to {position} counts at {velocity} counts/s")
            return
        self._implausible_in_a_row = 0
        self.position, self.velocity = position, velocity
        self._position_s = now_s if self.homing is Homing.DONE else None
        self.answered = True
        self._received_s[0] = now_s

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
        if self.mode == codec.HOMING and self._homing_result is None:
            homing = codec.homing_of(statusword)
            self._homing_result = None if homing is Homing.UNDER_WAY else homing

    def on_emergency(self, data: bytes) -> None:
        """Raise DriveFault for an emergency message that an SDO upload confirms."""
        try:
            code = codec.decode_emergency(data)
        except ValueError as error:
            self._count_implausible(f"emergency message has {error}")
            return
        if code != 0:
            self._confirm_fault(code)

    def on_heartbeat(self, data: bytes) -> None:
        """Receive a heartbeat; raise DriveFault for a node that has restarted."""
        if data == bytes((codec.OPERATIONAL,)):
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

    def _counts_deg(self, angle_deg: float) -> int:
        return round(angle_deg * self._wire.counts_per_turn / 360.0)

    def _is_implausible(self, position: int, velocity: int, now_s: float) -> bool:
        if self._position_s is None:
            return False
        path = _SLACK * self._rate_max * (now_s - self._position_s) + self._margin
        return abs(position - self.position) > path or abs(velocity) > 2 * _SLACK * self._rate_max

    def _is_bad(self, state: DriveState | None) -> bool:
        stopping = self.controlword in (codec.QUICK_STOP, codec.DISABLE_VOLTAGE)
        return state in codec.FAULT_STATES or (not stopping and state is not DriveState.ENABLED)

    def _confirm_fault(self, code: int = 0) -> None:
        """Read the state by SDO, so that no damaged frame passes for a fault; raise DriveFault if it is one."""
        state = codec.state_of(self._sdo.statusword())
        reported = self._sdo.fault_code()
        if state in codec.FAULT_STATES or reported != 0:
            code = reported or code
            raise DriveFault(self.name, codec.fault_text(code), codec.fault_kind(code))
        if self._is_bad(state):
            title = state.title if state else "an undefined state"
            raise DriveFault(self.name, f"left operation enabled by itself, is in {title}")
        self._count_implausible("a reported fault or state is not confirmed by SDO")

    def _count_implausible(self, what: str) -> None:
        self.protocol_errors += 1
        self._implausible_in_a_row += 1
        if self._implausible_in_a_row >= BURST:
            raise ProtocolError(self.name, f"{BURST} implausible frames in a row: {what}")
