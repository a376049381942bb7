"""One axis on the CAN bus as the driver knows it: what it was told, what it said, and when."""

from __future__ import annotations

from typing import Final

from hil.config.rig import Cia402, GimbalAxis, Turntable
from hil.core.clock import Clock
from hil.core.messages import Homing
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import DriveState
from hil.drivers.turntable.cia402.setup import DriveSetup
from hil.errors import DriveFault, LinkTimeout, ProtocolError

BURST: Final = 4  # frames in a row that cannot be true
_STANDSTILL_RADPS: Final = 2e-3
_LOST_BEATS: Final = 3.0
_SLACK: Final = 2.0  # times the largest rate of the axis
_WHAT: Final = ("answer to SYNC", "statusword", "heartbeat")


class Node:
    """An axis ``name`` on node ``node_id``. Errors name the axis: DriveFault, LinkTimeout, ProtocolError.

    A frame that cannot be true, because of its length, a place where the axis cannot be yet, or a state
    that the drive denies when it is asked by SDO, is counted and left out; a burst of them is an error.
    """

    def __init__(
        self, name: str, node_id: int, config: Turntable, axis: GimbalAxis, wire: Cia402, clock: Clock
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
        """Begin to listen, as if all had been heard just now; position: counts, where the drive itself says it is."""
        now_s = self._clock.now_s()
        self.controlword = codec.ENABLE_OPERATION
        self.target = self.position = position or 0
        self.offset = self.velocity = 0
        self.limit = 0
        self.answered = True
        self.mode = codec.CYCLIC_SYNCHRONOUS_POSITION
        self._homing_found: Homing | None = None
        # when the position was accepted last, against which the next one is held; None while homing may move the zero
        self._placed_s: float | None = now_s if position is not None and self.homing is Homing.DONE else None
        self._wrong_in_a_row = 0
        self._heard_s = [now_s] * len(_WHAT)

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
        """Enable the drive where it stands; return that place, counts."""
        return self._asked.enable(codec.counts_from_rad(_STANDSTILL_RADPS, self._wire.counts_per_turn))

    def begin_homing(self) -> None:
        """Let the drive look for its home switch."""
        self._asked.choose_mode(codec.HOMING)  # statuswords from before, of other meaning, are gone with its replies
        self.mode = codec.HOMING
        self._homing_found = None
        self.controlword = codec.START_HOMING

    @property
    def homing_is_over(self) -> bool:
        """Whether the drive has said, since ``begin_homing``, that it found its place or did not."""
        return self.homing is Homing.UNDER_WAY and self._homing_found is not None

    def end_homing(self) -> None:
        """Take what the drive said; one that found its place goes back to setpoints, where it stands."""
        if not self.homing_is_over:
            return
        if self._homing_found is Homing.DONE:
            self.target = self._asked.back_to_setpoints()
            self.mode = codec.CYCLIC_SYNCHRONOUS_POSITION
            self.controlword = codec.ENABLE_OPERATION
            self._placed_s = None
        self.homing = self._homing_found or Homing.FAILED

    def begin_profile(self, target: int, speed: int) -> None:
        """Let the drive go to ``target``, counts, by a profile of its own, at most at ``speed``, counts/s."""
        self._asked.prepare_profile(target, max(1, speed), self._acceleration)
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
        """Raise LinkTimeout when something that must come has not come for too long."""
        for what, heard_s, allowed_s in zip(_WHAT, self._heard_s, self._allowed_s, strict=True):
            if now_s - heard_s > allowed_s:
                raise LinkTimeout(self.name, f"no {what} for {now_s - heard_s:.3f} s, allowed {allowed_s:g} s")

    def on_feedback(self, data: bytes) -> None:
        """Take position and velocity."""
        now_s = self._clock.now_s()
        try:
            position, velocity = codec.decode_feedback(data)
        except ValueError as error:
            self._wrong(f"feedback has {error}")
            return
        if self.answered:  # not asked for: a repeated frame, or one that comes after its time
            self.surplus += 1
            return
        if self._cannot_be_true(position, velocity, now_s):
            self._wrong(f"jumps from {self.position} to {position} counts at {velocity} counts/s")
            return
        self._wrong_in_a_row = 0
        self.position, self.velocity = position, velocity
        self._placed_s = now_s if self.homing is Homing.DONE else None
        self.answered = True
        self._heard_s[0] = now_s

    def on_status(self, data: bytes) -> None:
        """Take statusword and digital inputs; raise DriveFault for a state that the drive should not be in."""
        try:
            statusword, inputs = codec.decode_status(data)
        except ValueError as error:
            self._wrong(f"status has {error}")
            return
        if self._is_bad(codec.state_of(statusword)):
            self._confirm_fault()
            return
        self._heard_s[1] = self._clock.now_s()
        self.limit = codec.limit_of(inputs)
        if self.mode == codec.HOMING and self._homing_found is None:
            found = codec.homing_of(statusword)
            self._homing_found = None if found is Homing.UNDER_WAY else found

    def on_emergency(self, data: bytes) -> None:
        """Raise DriveFault for an emergency message, unless the drive denies it."""
        try:
            code = codec.decode_emergency(data)
        except ValueError as error:
            self._wrong(f"emergency message has {error}")
            return
        if code != 0:
            self._confirm_fault(code)

    def on_heartbeat(self, data: bytes) -> None:
        """Take a heartbeat; raise DriveFault for a node that has restarted or stopped to take part."""
        if data == bytes((codec.OPERATIONAL,)):
            self._heard_s[2] = self._clock.now_s()
        elif data == bytes((codec.BOOT_UP,)):
            raise DriveFault(self.name, "has restarted")
        else:
            self._wrong(f"heartbeat says {data.hex(' ') or 'nothing'}, 05 (operational) expected")

    @property
    def _asked(self) -> DriveSetup:
        if self.setup is None:
            raise LinkTimeout(self.name, "is not open")
        return self.setup

    def _counts_deg(self, angle_deg: float) -> int:
        return round(angle_deg * self._wire.counts_per_turn / 360.0)

    def _cannot_be_true(self, position: int, velocity: int, now_s: float) -> bool:
        if self._placed_s is None:
            return False
        way = _SLACK * self._rate_max * (now_s - self._placed_s) + self._margin
        return abs(position - self.position) > way or abs(velocity) > 2 * _SLACK * self._rate_max

    def _is_bad(self, state: DriveState | None) -> bool:
        stopping = self.controlword == codec.QUICK_STOP
        return state in codec.FAULT_STATES or (not stopping and state is not DriveState.ENABLED)

    def _confirm_fault(self, code: int = 0) -> None:
        """Ask the drive itself, so that no spoilt frame passes for a fault; raise DriveFault when it is one."""
        state = codec.state_of(self._asked.statusword())
        found = self._asked.fault_code()
        if state in codec.FAULT_STATES or found != 0:
            code = found or code
            raise DriveFault(self.name, codec.fault_text(code), codec.fault_kind(code))
        if self._is_bad(state):
            title = state.title if state else "an undefined state"
            raise DriveFault(self.name, f"left operation enabled by itself, is in {title}")
        self._wrong("a fault or state was told that the drive denies")

    def _wrong(self, what: str) -> None:
        self.protocol_errors += 1
        self._wrong_in_a_row += 1
        if self._wrong_in_a_row >= BURST:
            raise ProtocolError(self.name, f"{BURST} frames in a row that cannot be true: {what}")
