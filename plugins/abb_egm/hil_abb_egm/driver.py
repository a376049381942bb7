"""Link to an ABB controller: answers each of its cycles with the pose or the joints, and checks what it reports."""

from __future__ import annotations

from hil.config.tables.arm import Arm
from hil.core.clock import BenchClock
from hil.drivers.arm.device import END
from hil.drivers.arm.model import FlangePose
from hil.errors import DriveFault, FaultKind, LinkTimeout
from hil_abb_egm import codec
from hil_abb_egm.codec import Posture, RobotState
from hil_abb_egm.entry import PERIOD_S, EgmSettings
from hil_robot_arms.cycles import Cycle, RobotCycles

_OPEN_S = 5.0  # bench time until the controller is guided


def _decode(data: bytes) -> Cycle[RobotState]:
    state = codec.decode_state(data)
    return Cycle(state.number, 1e-3 * state.tm_ms, state)


class EgmLink:
    """PoseLink of EGM; the port of ``[arm.abb_egm]``."""

    def __init__(self, arm: Arm, clock: BenchClock, name: str = "arm") -> None:
        self._settings: EgmSettings = arm.settings
        self._clock, self._name = clock, name
        self._cycles = RobotCycles(clock, _decode, 1, PERIOD_S, arm.timeout_s)
        self._ended = False
        self._pending: RobotState | None = None
        self._number = 0

    def open(self) -> FlangePose:
        """Wait until the controller is guided; it stands meanwhile. Raises DeviceError."""
        assert self._settings.port is not None
        self._ended, self._pending = False, None
        self._cycles.open(self._settings.host, self._settings.port)
        until_s, seen = self._clock.now_s() + _OPEN_S, 0
        while self._clock.now_s() < until_s:
            cycle = self._cycles.next(may_be_silent=True)
            if cycle is None:
                continue
            state, seen = cycle.state, seen + 1
            if seen > 1 and state.mci == codec.MCI_RUNNING:
                self._pending = state
                return self._flange(state)
            held = state.planned if state.planned.position_m is not None else state.feedback
            self._send(state, held)
        what = "no cycle" if not seen else "its program is not guided (EGMRunPose or EGMRunJoint)"
        raise LinkTimeout(self._name, f"{what} within {_OPEN_S:g} s on udp port {self._settings.port}")

    def exchange(self, target: FlangePose) -> FlangePose | None:
        """Answer the last cycle with ``target``; return the next one. Raises DeviceError, also for a stopped robot."""
        if self._pending is not None and not self._ended:
            self._send(self._pending, Posture(target.position_m, target.axes, target.joints_rad))
        self._pending = None
        cycle = self._cycles.next(may_be_silent=self._ended)
        if cycle is None:
            return None
        self._pending = cycle.state
        if not self._ended:
            self._check(cycle.state)
        return self._flange(cycle.state)

    def due_s(self) -> float:
        """Return the bench time of the last cycle, by the controller's clock."""
        return self._cycles.t_s

    def stop(self, category: int) -> None:
        """With END answer no more: the controller stops after ``silence_max_s``."""
        self._ended = self._ended or category == END

    def close(self) -> None:
        """Close the port. Idempotent."""
        self._cycles.close()

    def counters(self) -> dict[str, int]:
        """Return the counts since ``open``."""
        return {**self._cycles.counts, "drift_ppm": round(1e6 * self._cycles.drift)}

    def _check(self, state: RobotState) -> None:
        if state.motors != codec.MOTORS_ON:
            raise DriveFault(self._name, "motors of the robot are off", FaultKind.TORQUE_OFF)
        if state.mci != codec.MCI_RUNNING or state.rapid != codec.RAPID_RUNNING:
            raise DriveFault(self._name, "the controller has ended the guidance")

    def _send(self, state: RobotState, posture: Posture) -> None:
        """Answer with the posture as the mode has it."""
        self._number += 1
        joint = self._settings.mode == "joint"
        sent = Posture(None, None, posture.joints_rad) if joint else Posture(posture.position_m, posture.axes, None)
        self._cycles.answer(codec.encode_answer(self._number, state.tm_ms, sent))

    def _flange(self, state: RobotState) -> FlangePose:
        feedback = state.feedback
        assert feedback.position_m is not None
        assert feedback.axes is not None
        return FlangePose(self._cycles.t_s, feedback.position_m, feedback.axes, feedback.joints_rad)
