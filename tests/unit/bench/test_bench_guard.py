"""Bench guard: what each check finds, in which cycle, and what it leaves alone."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.bench import bench_guard, keep_out
from hil.bench.bench_guard import BENCH_GUARD_MEMORY, check_bench, compare_estimate, compare_pose
from hil.bench.keep_out import BREACH, NOTHING
from hil.bench.kinematics import axes_of_pose
from hil.config.load import load_rig, load_scenario
from hil.config.rig import BENCH_AXES
from hil.core.messages import AXES, NAVIGATION, POSE, TRUTH, new
from hil.maths import quat
from hil.params import bench as bench_params
from hil.safety.motion_guards import breach_alarm

STEP_S = 0.02


class Motion:
    """A chaser in uniform motion, shown by a bench; the encoders may be changed before each check.

    The attitude is fixed.
    """

    def __init__(self, r_m: tuple[float, float, float], v_mps: tuple[float, float, float], *settings: str) -> None:
        scenario, rig = load_scenario("scheme-1", settings).value, load_rig("mock", settings).value
        self.bench = bench_params.bench(rig, scenario.step_s)
        self.params = bench_params.bench_guard(rig, scenario)
        self.memory, self.breach = new(BENCH_GUARD_MEMORY), new(BREACH)
        self.truth, self.wanted, self.feedback = new(TRUTH), new(AXES), new(AXES)
        self.truth.r_CT_H, self.truth.v_CT_H = r_m, v_mps
        self.truth.q_CH = quat.from_rotation_vector(np.array([0.02, -0.03, 0.01]))
        self.limited = self.cycle = 0
        self._show()

    def _show(self) -> None:
        truth = self.truth
        axes_of_pose(self.bench, truth.r_CT_H, truth.v_CT_H, truth.q_CH, np.zeros(3), self.wanted)
        np.asarray(self.feedback)[...] = self.wanted

    def move(self) -> None:
        """Advance the truth by a cycle, and the bench with it."""
        self.cycle += 1
        self.truth.r_CT_H += STEP_S * self.truth.v_CT_H
        self._show()

    def check(self, age_s: float = 0.0) -> int:
        """Check the present cycle."""
        code = check_bench(
            self.params, self.bench, self.memory, self.cycle * STEP_S, self.truth, self.wanted, self.feedback,
            age_s, age_s, self.limited, self.breach,
        )  # fmt: skip
        return int(code)

    def run(self, cycles: int) -> None:
        """Move and check without a finding."""
        for _ in range(cycles):
            assert self.check() == NOTHING
            self.move()

    def cycles_until_found(self, disturb: Callable[[], None], most: int = 200) -> tuple[int, int]:
        """Return the code found and the cycles until then; ``disturb`` changes the motion after each move."""
        for k in range(most):
            disturb()
            if (code := self.check()) != NOTHING:
                return code, k
            self.move()
        return NOTHING, most

    def pose(self, displaced_m: float = 0.0, turned_rad: float = 0.0, age_s: float = 0.0) -> np.record:
        """Return the pose that the unit measures now, with an error of the chaser's x and of its roll."""
        pose = new(POSE)
        r = self.truth.r_CT_H - age_s * self.truth.v_CT_H + [displaced_m, 0.0, 0.0]
        pose.z_TC_C = -quat.transform(self.truth.q_CH, r)
        pose.q_CH = quat.multiply(quat.from_rotation_vector(np.array([turned_rad, 0.0, 0.0])), self.truth.q_CH)
        pose.covariance_position = np.eye(3) * 0.005**2
        pose.covariance_attitude = np.eye(3) * math.radians(0.033) ** 2
        pose.t_s = self.cycle * STEP_S - age_s
        return pose

    def compare(self, pose: np.record) -> None:
        compare_pose(self.params, self.bench, self.memory, pose)

    def estimate(self, off_m: float, sigma_m: float, level_m: float = math.nan, turned_rad: float = 0.0) -> np.record:
        """Return an estimate whose y and yaw are off, with a standard deviation of the position."""
        made = new(NAVIGATION)
        made.valid, made.sigma_r_m, made.protection_level_m = 1, sigma_m, level_m
        made.sigma_attitude_rad = made.protection_level_rad = math.nan
        made.r_CT_H = self.truth.r_CT_H + np.array([0.0, off_m, 0.0])
        made.q_CH = quat.multiply(quat.from_rotation_vector(np.array([0.0, 0.0, turned_rad])), self.truth.q_CH)
        return made

    def disagrees(
        self, cycles: int, off_m: float, sigma_m: float, level_m: float = math.nan, turned_rad: float = 0.0
    ) -> list[bool]:
        """Return for each of the next cycles whether the encoders disagree with an estimate that is off."""
        found: list[bool] = []
        for _ in range(cycles):
            assert self.check() == NOTHING
            before = found[-1] if found else False
            estimate = self.estimate(off_m, sigma_m, level_m, turned_rad)
            t_s = self.cycle * STEP_S
            found.append(bool(compare_estimate(self.params, self.bench, self.memory, t_s, estimate, before)))
            self.move()
        return found


def test_uniform_motion_has_no_finding() -> None:
    motion = Motion((3.0, 0.1, -0.1), (-0.03, 0.01, 0.0))
    for _ in range(200):
        assert motion.check() == NOTHING
        motion.compare(motion.pose())
        motion.move()


@pytest.mark.parametrize("closing", [0.0, 0.04, 0.24])
def test_keep_out_leaves_way_to_brake_and_to_react(closing: float) -> None:
    motion = Motion((0.5, 0.0, 0.0), (-closing, 0.0, 0.0))
    least = 0.25 + closing * 0.1 + closing**2 / (2.0 * 0.6)
    motion.truth.r_CT_H = [least + 1e-6, 0.0, 0.0]
    assert motion.check() == NOTHING
    motion.truth.r_CT_H = [least - 1e-6, 0.0, 0.0]
    assert motion.check() == keep_out.KEEP_OUT
    assert (motion.breach.value, motion.breach.low) == pytest.approx((least, closing), abs=1e-5)


def test_chaser_that_leaves_may_be_as_near_as_the_radius() -> None:
    motion = Motion((0.251, 0.0, 0.0), (0.3, 0.0, 0.0))
    assert motion.check() == NOTHING


def test_scenario_that_docks_has_no_keep_out() -> None:
    for settings in (("keep_out.radius_m=0",), ("keep_out.docks=true",)):
        motion = Motion((0.01, 0.0, 0.0), (-0.02, 0.0, 0.0), "keep_out.bodies=[]", *settings)
        motion.run(100)


def test_scenario_that_docks_has_a_keep_out_outside_its_corridor() -> None:
    motion = Motion((0.2, 0.09, 0.0), (0.0, 0.0, 0.0), "keep_out.bodies=[]", "keep_out.docks=true")
    assert motion.check() == NOTHING
    motion.truth.v_CT_H = [0.0, 0.1, 0.0]  # which takes 18 mm until rest
    assert motion.check() == keep_out.KEEP_OUT
    motion.truth.r_CT_H, motion.truth.v_CT_H = [0.2, 0.46, 0.0], [0.0, 0.0, 0.0]
    assert motion.check() == keep_out.PLANE


@pytest.mark.parametrize("beside_m", [0.46, 1.2])
@pytest.mark.parametrize("closing", [0.0, 0.3])
def test_chaser_does_not_pass_the_target(beside_m: float, closing: float) -> None:
    least = 0.25 + closing * 0.1 + closing**2 / (2.0 * 0.6)
    motion = Motion((least + 1e-6, beside_m, 0.0), (-closing, 0.0, 0.0), "keep_out.bodies=[]")
    assert motion.check() == NOTHING
    motion.truth.r_CT_H = [least - 1e-6, beside_m, 0.0]
    assert motion.check() == keep_out.PLANE
    assert (motion.breach.value, motion.breach.low, motion.breach.high) == pytest.approx(
        (least, closing, least), abs=1e-5
    )
    alarm = breach_alarm(0.0, BENCH_AXES, keep_out.PLANE, motion.breach)
    assert alarm.quantity == "distance from the target along the docking axis"
    motion.truth.v_CT_H = [0.3, 0.0, 0.0]
    motion.truth.r_CT_H = [0.24, beside_m, 0.0]  # within it, whatever the speed
    assert motion.check() == keep_out.PLANE


def test_scenario_that_inspects_has_no_half_space() -> None:
    motion = Motion((-1.0, 1.2, 0.0), (-0.1, 0.0, 0.0), "keep_out.bodies=[]", "keep_out.inspects=true")
    motion.run(20)
    motion.truth.r_CT_H = [0.1, 0.2, 0.0]
    assert motion.check() == keep_out.KEEP_OUT


CAMERA = '{on = "chaser", vertices_m = [[-0.5, -0.1, -0.1], [-0.5, 0.1, -0.1], [-0.5, 0.0, 0.1]]}'
MAST = '{on = "target", vertices_m = [[0.2, 0.0, -1.0], [0.2, 0.0, 1.0]], radius_m = 0.05}'
BODIES = (f"keep_out.bodies=[{CAMERA}, {MAST}]", "keep_out.distance_m=0.04")


@pytest.mark.parametrize("closing", [0.0, 0.04, 0.24])
def test_bodies_leave_way_to_brake_and_to_react(closing: float) -> None:
    motion = Motion((2.0, 0.0, 0.0), (-closing, 0.0, 0.0), *BODIES)
    motion.truth.q_CH, motion.truth.w_HI_H = [0.0, 0.0, 0.0, 1.0], 0.0
    least = 0.5 + 0.2 + 0.05 + 0.04 + closing * 0.1 + closing**2 / (2.0 * 0.6)
    motion.truth.r_CT_H = [least + 1e-6, 0.0, 0.0]
    assert motion.check() == NOTHING
    motion.truth.r_CT_H = [least - 1e-6, 0.0, 0.0]
    assert motion.check() == bench_guard.BODIES_MEET
    alarm = breach_alarm(0.0, BENCH_AXES, bench_guard.BODIES_MEET, motion.breach)
    assert alarm.quantity == "distance of chaser and target"
    assert alarm.value.endswith("m (keep_out.bodies 1 and 2)")
    assert alarm.limit.endswith(f"m and more at a closing rate of {closing:.4f} m/s")


def test_body_that_turns_aside_may_pass() -> None:
    motion = Motion((0.75, 0.0, 0.0), (0.0, 0.0, 0.0), *BODIES)
    motion.truth.q_CH = quat.from_rotation_vector(np.array([0.0, 0.0, 1.0]))
    assert motion.check() == NOTHING
    motion.truth.w_CI_C = [0.0, 0.0, 4.0]  # which no gimbal can brake in time
    assert motion.check() == bench_guard.BODIES_MEET


@pytest.mark.parametrize("axis", range(6))
def test_stuck_axis_is_found_within_half_a_second_at_the_slowest_speed(axis: int) -> None:
    motion = Motion((3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    motion.run(20)
    still = motion.feedback.copy()
    speed = 0.002 if axis < 3 else math.radians(0.1)
    field, rates, i = ("rail_m", "rail_mps", axis) if axis < 3 else ("gimbal_rad", "gimbal_radps", axis - 3)
    begun = motion.cycle

    def stick() -> None:
        motion.wanted[field][i] += speed * STEP_S * (motion.cycle - begun)
        motion.wanted[rates][i] = speed
        np.asarray(motion.feedback)[...] = motion.wanted
        motion.feedback[field][i] = still[field][i]

    code, cycles = motion.cycles_until_found(stick)
    assert (code, int(motion.breach.axis)) == (bench_guard.AXIS, axis)
    assert cycles * STEP_S <= 0.5


def test_axis_that_lags_by_its_feedbacks_age_is_not_found() -> None:
    motion = Motion((3.0, 0.0, 0.0), (-0.2, 0.0, 0.0))
    motion.run(20)
    for _ in range(50):
        motion.feedback.rail_m[0] += 0.2 * 0.15
        assert motion.check(age_s=0.12) == NOTHING
        motion.move()
    for k in range(3):
        motion.feedback.rail_m[0] += 0.2 * 0.15
        assert (motion.check() == bench_guard.AXIS) == (k == 2)
        motion.move()


def test_bench_off_the_truth_is_detected_after_five_cycles() -> None:
    motion = Motion(
        (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), "rig.guard.axis_error_max_m=1.0", "rig.guard.axis_error_max_deg=9"
    )
    motion.run(20)

    def displace() -> None:
        motion.feedback.rail_m[1] += 0.0051

    assert motion.cycles_until_found(displace) == (bench_guard.POSITION, 4)
    assert motion.breach.value == pytest.approx(0.0051)

    turned = Motion(
        (3.0, 0.0, 0.0), (0.0, 0.0, 0.0), "rig.guard.axis_error_max_m=1.0", "rig.guard.axis_error_max_deg=9"
    )
    turned.run(20)

    def turn() -> None:
        turned.feedback.gimbal_rad[2] += math.radians(0.31)

    assert turned.cycles_until_found(turn) == (bench_guard.ATTITUDE, 4)


def test_short_deviation_from_the_truth_is_forgotten() -> None:
    motion = Motion((3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    motion.run(20)
    for _ in range(30):
        motion.feedback.rail_m[1] += 0.05
        for _ in range(2):
            assert motion.check() == NOTHING
            motion.move()


def test_setpoints_that_stay_limited_are_found() -> None:
    motion = Motion((3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    motion.run(20)

    def limit() -> None:
        motion.limited += 1

    assert motion.cycles_until_found(limit) == (bench_guard.LIMITED, 25)


def test_axes_may_catch_up_at_the_start_for_two_seconds() -> None:
    motion = Motion((3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    motion.check()
    motion.move()

    def lag() -> None:
        motion.feedback.rail_m[0] += 0.1

    code, cycles = motion.cycles_until_found(lag)
    assert code != NOTHING
    assert 2.0 <= cycles * STEP_S <= 2.2


@pytest.mark.parametrize(
    ("displaced_m", "turned_deg", "expected"),
    [(0.029, 0.0, bench_guard.VISION_POSITION), (0.0, 0.27, bench_guard.VISION_ATTITUDE)],
)
def test_five_poses_off_the_encoders_are_detected(displaced_m: float, turned_deg: float, expected: int) -> None:
    motion = Motion((3.0, 0.0, 0.0), (-0.03, 0.0, 0.0))
    motion.run(50)
    for k in range(9):
        wrong = k != 3
        motion.compare(motion.pose(wrong * displaced_m, math.radians(wrong * turned_deg), age_s=0.13))
        motion.move()
        code = motion.check()
        assert code == (expected if k == 8 else NOTHING)
    assert motion.breach.value > motion.breach.high


def test_poses_count_as_of_their_exposure() -> None:
    motion = Motion((3.0, 0.0, 0.0), (-0.2, 0.0, 0.0))
    motion.run(200)
    for age_s in (0.0, 0.011, 0.05, 0.97, 2.4):
        motion.compare(motion.pose(0.0, age_s=age_s))
        assert motion.memory.vision_frames == 0
        motion.compare(motion.pose(0.05, age_s=age_s))
        assert motion.memory.vision_frames == 1
        motion.compare(motion.pose(0.0, age_s=age_s))


def test_pose_older_than_the_samples_does_not_count() -> None:
    motion = Motion((3.0, 0.0, 0.0), (-0.2, 0.0, 0.0))
    motion.run(200)
    motion.compare(motion.pose(1.0, age_s=3.5))
    assert motion.memory.vision_frames == 0


def test_covariance_that_is_none_counts_as_wrong() -> None:
    motion = Motion((3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    motion.run(10)
    pose = motion.pose()
    pose.covariance_position[1, 1] = math.nan
    motion.compare(pose)
    assert motion.memory.vision_frames == 1


def test_cycle_that_is_checked_again_counts_once() -> None:
    motion = Motion((3.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    motion.run(20)
    motion.feedback.rail_m[0] += 0.01
    before = None
    for _ in range(10):
        assert motion.check() == NOTHING
        assert before is None or motion.memory.tobytes() == before
        before = motion.memory.tobytes()


def approach() -> Motion:
    """Return an approach whose estimate has been right for 20 s."""
    motion = Motion((3.0, 0.1, -0.1), (-0.03, 0.0, 0.0))
    assert not any(motion.disagrees(1000, 0.0, 0.002))
    return motion


def test_estimate_that_is_off_is_found_within_a_second() -> None:
    motion = approach()
    found = motion.disagrees(50, 0.035, math.nan)
    assert not found[0]
    assert found[-1]
    assert motion.memory.estimate.axis == 1
    assert motion.memory.estimate.value > motion.memory.estimate.high
    assert not motion.disagrees(100, 0.0, 0.002)[-1]  # until it is right again


def test_estimate_that_is_off_from_its_start_is_found_within_a_second() -> None:
    assert Motion((3.0, 0.1, -0.1), (0.0, 0.0, 0.0)).disagrees(50, 0.035, math.nan)[-1]


def test_attitude_that_is_off_is_found_within_a_second() -> None:
    motion = approach()
    assert motion.disagrees(50, 0.0, 0.002, turned_rad=math.radians(1.0))[-1]
    assert motion.memory.estimate.axis == 5


def test_estimate_that_is_off_by_less_than_it_may_be_is_not_found() -> None:
    motion = approach()
    allowed = motion.params.estimate_position + motion.params.calibration_position
    assert not any(motion.disagrees(500, 0.98 * allowed, math.nan))  # it reports no standard deviation
    assert motion.disagrees(100, 1.02 * allowed, math.nan)[-1]
    assert not any(approach().disagrees(500, 0.98 * (allowed + 3.0 * 0.005), 0.005))
    assert approach().disagrees(200, 1.02 * (allowed + 3.0 * 0.005), 0.005)[-1]


def test_estimate_that_is_off_by_its_own_level_is_found() -> None:
    motion = approach()
    assert not any(motion.disagrees(500, 0.010, 0.002, 0.012))
    assert motion.disagrees(100, 0.011, 0.002, 0.012)[-1]
    assert motion.memory.estimate.high == pytest.approx(0.9 * 0.012)


def test_estimate_that_is_not_finite_is_found() -> None:
    assert approach().disagrees(5, math.nan, 0.002)[-1]


def test_invalid_estimate_restarts_the_comparison() -> None:
    motion = approach()
    estimate = new(NAVIGATION)
    assert not compare_estimate(motion.params, motion.bench, motion.memory, motion.cycle * STEP_S, estimate, True)
    found = motion.disagrees(50, 0.035, math.nan)
    assert 0.3 <= found.index(True) * STEP_S <= 0.5


def test_mean_of_the_errors_is_that_of_the_estimate() -> None:
    motion = approach()
    motion.disagrees(3000, 0.005, 0.002, turned_rad=0.001)
    assert motion.memory.off == pytest.approx([0.0, 0.005, 0.0, 0.0, 0.0, 0.001], abs=2e-5)
