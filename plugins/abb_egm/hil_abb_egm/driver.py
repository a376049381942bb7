"""Link to an ABB controller: answers each of its cycles with the pose or the joints, and checks what it reports."""

from __future__ import annotations

from hil.config.tables.arm import Arm
from hil.core.clock import BenchClock
from hil.drivers.arm.model import FlangePose
from hil.errors import DriveFault, FaultKind
from hil_abb_egm import codec
from hil_abb_egm.codec import Posture, RobotState
from hil_abb_egm.entry import PERIOD_S, EgmSettings
from hil_robot_arms.cycles import Cycle, RobotCycles
from hil_robot_arms.link import CycleLink


def _decode(data: bytes) -> Cycle[RobotState]:
    state = codec.decode_state(data)
    return Cycle(state.number, 1e-3 * state.tm_ms, state)


class EgmLink(CycleLink[RobotState]):
    """PoseLink of EGM; the port of ``[arm.abb_egm]``. Its controller stops after a silence of ``silence_max_s``."""

    not_followed = "its program is not guided (EGMRunPose or EGMRunJoint)"

    def __init__(self, arm: Arm, clock: BenchClock, name: str = "arm") -> None:
        self._settings: EgmSettings = arm.settings
        cycles = RobotCycles(clock, _decode, 1, PERIOD_S, arm.timeout_s, name)
        super().__init__(cycles, (self._settings.host, self._settings.port), clock, name)
        self._number = 0

    def follows(self, state: RobotState) -> bool:
        """Return whether the controller is guided."""
        return state.mci == codec.MCI_RUNNING

    def hold(self, state: RobotState) -> None:
        """Answer with what the controller plans, or where it is."""
        self._send(state, state.planned if state.planned.position_m is not None else state.feedback)

    def lead(self, state: RobotState, target: FlangePose) -> None:
        """Answer with ``target``."""
        self._send(state, Posture(target.position_m, target.axes, target.joints_rad))

    def check(self, state: RobotState) -> None:
        """Raise DriveFault for a robot without motors or guidance."""
        if state.motors != codec.MOTORS_ON:
            raise DriveFault(self._name, "motors of the robot are off", FaultKind.TORQUE_OFF)
        if state.mci != codec.MCI_RUNNING or state.rapid != codec.RAPID_RUNNING:
            raise DriveFault(self._name, "the controller has ended the guidance")

    def flange(self, state: RobotState) -> FlangePose:
        """Return where the robot is."""
        feedback = state.feedback
        assert feedback.position_m is not None
        assert feedback.axes is not None
        return FlangePose(self._cycles.t_s, feedback.position_m, feedback.axes, feedback.joints_rad)

    def _send(self, state: RobotState, posture: Posture) -> None:
        """Answer with the posture as the mode has it."""
        self._number += 1
        joint = self._settings.mode == "joint"
        sent = Posture(None, None, posture.joints_rad) if joint else Posture(posture.position_m, posture.axes, None)
        self._cycles.answer(codec.encode_answer(self._number, state.tm_ms, sent))
