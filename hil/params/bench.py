"""Parameters of the bench's kinematics, limits, bodies and geometry, from the rig's units to SI."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from hil.bench.bench_guard import BENCH_GUARD_PARAMS
from hil.bench.guard import GUARD
from hil.bench.keep_out import KEEP_OUT_ZONE
from hil.bench.kinematics import BENCH_PARAMS, axes_of_pose, pose_on_bench
from hil.bench.manipulator import MANIPULATOR, places
from hil.config.bench_geometry import errors_as_built, measured_errors
from hil.config.rig import BenchAxis, Rig, TargetManipulator
from hil.config.scenario import Scenario
from hil.config.tables.guard import BenchBody, SpacecraftBody
from hil.config.tables.machine import FULL_SCALE, BenchScale, parts_of
from hil.core.messages import AXES, Array, new
from hil.maths import euler, linear, quat
from hil.models.bodies import BODIES


def bodies(
    given: Sequence[SpacecraftBody | BenchBody],
    on: str,
    offset_m: Sequence[float] = (0.0, 0.0, 0.0),
    at_rest: Array | None = None,
) -> np.record:
    """Return BODIES of those ``on`` one kind. offset_m: from the origin of the record's frame to the bodies' origin.

    at_rest: matrix (3, 3) to the frame from that in which ``low`` and ``high`` hold; None: they hold in the frame.
    """
    record = new(BODIES)
    chosen = [(number, body) for number, body in enumerate(given, 1) if body.on == on]
    record.n, record.low, record.high = len(chosen), math.inf, -math.inf
    for k, (number, body) in enumerate(chosen):
        points = np.array(body.vertices_m) + np.array(offset_m)
        centre = points.mean(axis=0)
        record.number[k], record.vertices[k], record.radius[k] = number, len(points), body.radius_m
        record.vertex[k, : len(points)] = points
        record.centre[k] = centre
        record.reach[k] = body.radius_m + linear.lengths(points - centre).max()
        record.arm[k] = body.radius_m + linear.lengths(points).max()
        box = points if at_rest is None else linear.product(points, at_rest)
        record.low = np.minimum(record.low, box.min(axis=0) - body.radius_m)
        record.high = np.maximum(record.high, box.max(axis=0) + body.radius_m)
        record.farthest = max(float(record.farthest), float(record.arm[k]))
    return record


_LEAST_M = 1e-9  # travel of both vehicles along an axis
_SETTLED_S = 0.2  # at the demand: longer than a drive overshoots that has caught up
_FREE = np.finfo(np.float32).max  # m, m/s, ...: no limit, and still a number
_KEPT_S = 0.039  # between two samples of the encoders: two cycles of 50 Hz


def earth_rate(rig: Rig) -> Array:
    """Return the rotation of the Earth against the stars in the axes of H as the bench has them, (3,), rad/s."""
    of_lab = [math.radians(rate) for rate in rig.imu.earth_rate_degps] if rig.imu is not None else [0.0] * 3
    return np.array([linear.total(rig.bench.lab_axes[i][k] * of_lab[i] for i in range(3)) for k in range(3)])


def bench(rig: Rig, step_s: float, shown: BenchScale = FULL_SCALE) -> np.record:
    """Return BENCH_PARAMS: geometry and limits of the six axes. step_s: period of the cycle. shown: of the scenario."""
    params = new(BENCH_PARAMS)
    params.scaled_beyond = shown.scaled_beyond_m or 0.0
    params.scale = shown.scale
    params.dt_s = step_s / rig.ticks(step_s)
    params.order = _order(rig.bench.gimbal_order)
    axes = (*rig.rails.axes, *rig.turntable.axes)
    _set_axes(params, slice(6), axes)
    params.reduced, params.fixed = rig.is_reduced, [axis.is_fixed for axis in axes]
    params.q_HL = quat.from_matrix(np.array(rig.bench.lab_axes).T)
    if rig.floating is not None:  # its axes are those of the measured pose
        params.low, params.high, params.rate_max, params.acceleration_max = -_FREE, _FREE, _FREE, _FREE
    set_geometry(params, rig, measured_errors(rig))
    return params


def bench_as_built(rig: Rig, step_s: float, shown: BenchScale = FULL_SCALE) -> np.record:
    """Return BENCH_PARAMS of the machine that a mock or emulated rig moves: ``bench`` unless it has errors."""
    params = bench(rig, step_s, shown)
    set_geometry(params, rig, errors_as_built(rig, shown.errors))
    return params


def ideal_axes(rig: Rig, axes: Array) -> Array:
    """Return the axes (n, 6), m and rad, of an ideal machine that shows what the measured one does at ``axes``.

    Without a file these themselves. Raises BadInput for a file that does not fit.
    """
    machine, ideal = bench(rig, 1.0), bench(rig, 1.0)
    if not machine.geometry.enabled:
        return axes
    set_geometry(ideal, rig, None)
    shown, rest, r, q, record = np.empty_like(axes), np.zeros(3), np.empty(3), np.empty(4), new(AXES)
    for k, position in enumerate(axes):
        pose_on_bench(machine, position[:3], position[3:], r, q)
        axes_of_pose(ideal, r, rest, q, rest, record)
        shown[k] = *record.rail_m, *record.gimbal_rad
    return shown


def manipulator(rig: Rig) -> np.record | None:
    """Return MANIPULATOR of the axes that move the rig's target in a run; None without any."""
    params = new(MANIPULATOR)
    if (rotated := rig.rotated_target) is not None:
        params.order, params.arm = _order(rotated.gimbal_order), rotated.lever_arm_m
        return params
    if (rails := rig.shared_rails) is None:
        return None
    params.rails, params.to_H = 1, np.array(rig.bench.lab_axes).T
    params.points = n = len(rails.path_s)
    params.path_s[:n], params.path_m[:n] = rails.path_s, np.reshape(rails.path_m, (n, 3))
    low, high = np.array([axis.si("travel") for axis in rails.axes]).T
    chaser_low, chaser_high = np.array([axis.si("travel") for axis in rig.rails.axes]).T
    travel = high - low
    fraction = travel / np.maximum(travel + chaser_high - chaser_low, _LEAST_M)
    params.fraction, params.offset = fraction, high - fraction * (high - chaser_low)
    return params


def manipulator_limits(rig: Rig, step_s: float) -> np.record:
    """Return BENCH_PARAMS with the limits of the target's axes, see ``places``; others stand."""
    target, params = rig.moving_target, manipulator(rig)
    assert target is not None
    assert params is not None
    return limits_of(target.axes, step_s, places(params).start)


def limits_of(axes: Sequence[BenchAxis], step_s: float, first: int = 0) -> np.record:
    """Return BENCH_PARAMS with the limits of ``axes`` in the places from ``first`` on; the others stand."""
    params = new(BENCH_PARAMS)
    params.dt_s = step_s
    params.low, params.high, params.rate_max, params.acceleration_max = -1.0, 1.0, 1.0, 1.0
    params.q_HL[3] = 1.0
    _set_axes(params, slice(first, first + len(axes)), axes)
    return params


def _set_braking_of_both(params: np.record, rails: TargetManipulator) -> None:
    """Let ``params`` (BENCH_GUARD_PARAMS) bound the approach of two vehicles that brake on their own.

    The chaser brakes from the relative speed v and that of the target u, the target at once at worst: with the lesser
    deceleration a the distance is at most ``(v + u)^2 / (2 a) = v^2 / (2 a) + v u / a + u^2 / (2 a)``. Vehicles that
    share by their travel move against each other: v is the sum of their speeds, and u is not needed.
    """
    own = [axis.limits[3] for axis in rails.axes if not axis.is_fixed]
    deceleration, speed_mps = min(float(params.deceleration), *own), rails.path_speed_mps
    params.deceleration = deceleration
    params.reaction_s += speed_mps / deceleration
    ahead_m = speed_mps * speed_mps / (2.0 * deceleration)
    params.distance += ahead_m
    params.zone.plane += ahead_m
    params.zone.radius += ahead_m if params.zone.radius > 0.0 else 0.0


def _decelerations(axes: np.record) -> tuple[float, float]:
    """Return what all driven rails and all driven gimbals brake with, m/s^2, rad/s^2. axes: BENCH_PARAMS."""
    most = np.where(axes.fixed != 0, np.inf, axes.acceleration_max).reshape(2, 3).min(axis=1)
    return float(most[0]), float(most[1])


def _order(letters: str) -> list[int]:
    return ["xyz".index(letter) for letter in letters]


def _set_axes(params: np.record, places: slice, axes: Sequence[BenchAxis]) -> None:
    limits = np.array([axis.limits for axis in axes]).T
    for name, column in zip(("low", "high", "rate_max", "acceleration_max"), limits, strict=False):
        params[name][places] = column
    params.lead[places] = [axis.lead_s for axis in axes]
    params.averaged[places] = [math.ceil(axis.averaging_s / params.dt_s - 1e-9) for axis in axes]


def keep_out_zone(scenario: Scenario) -> np.record:
    """Return KEEP_OUT_ZONE."""
    config, zone = scenario.keep_out, new(KEEP_OUT_ZONE)
    zone.axis, zone.radius = scenario.gnc.corridor.axis, config.radius_m
    zone.plane = -math.inf if config.inspects else config.radius_m
    zone.corridor = scenario.gnc.corridor.minimum_radius_m if config.has_corridor else 0.0
    return zone


def following_limits(rig: Rig) -> tuple[list[float], list[float]]:
    """Return the following error of each axis that is allowed at rest, m, rad, and in addition per speed, s."""
    rails, turntable = rig.rails, rig.turntable
    return (
        [rails.following_error_max_m] * 3 + [math.radians(turntable.following_error_max_deg)] * 3,
        [rails.following_error_per_speed_s] * 3 + [turntable.following_error_per_speed_s] * 3,
    )


def axis_guard(rig: Rig, scenario: Scenario) -> np.record:
    """Return GUARD: following errors, travel, bodies of the bench, and the scenario's keep-out.

    The keep-out by the encoders is off without the bench guard, without encoders, and with a target that moves in a
    run: the axes of the chaser's rig alone do not show where its reference point is. The bench guard has it.
    """
    axes, guard = bench(rig, scenario.step_s, scenario.bench), new(GUARD)
    geometry = rig.bench
    guard.following_max, guard.following_per_speed = following_limits(rig)
    guard.low, guard.high, guard.order = axes.low, axes.high, axes.order
    guard.homed, guard.zone = 1, keep_out_zone(scenario)
    guard.zone.axis = quat.transform_back(axes.q_HL, guard.zone.axis)  # the guard volume is in L
    if rig.moving_target is not None or rig.floating is not None or not rig.guard.enabled:
        guard.zone.radius, guard.zone.plane = 0.0, -math.inf
    guard.arm, guard.arm_length = axes.lever_arm, linear.length(axes.lever_arm)
    guard.carriage, guard.lab = bodies(geometry.bodies, "carriage"), bodies(geometry.bodies, "lab")
    guard.rest = np.where(axes.fixed[3:] != 0, axes.low[3:], 0.0)
    at_rest = quat.to_matrix(euler.to_quaternion(guard.rest, axes.order))
    guard.turntable = bodies(geometry.bodies, "turntable", geometry.lever_arm_m, at_rest)
    guard.distance, guard.reaction_s = geometry.bodies_distance_m, rig.guard.reaction_s
    guard.deceleration, guard.turning_deceleration = _decelerations(axes)
    return guard


def target_guards(rig: Rig, scenario: Scenario) -> tuple[np.record, np.record] | None:
    """Return GUARD of chaser's rig against the bodies that move with the target, and of these against the lab.

    The first one is for the axes relative to those of the target, at what both brake with at least. None without any.
    """
    carried = bodies(rig.bench.bodies, "target")
    if rig.shared_rails is None or not carried.n:
        return None
    of_chaser, of_target = axis_guard(rig, scenario), axis_guard(rig, scenario)
    of_chaser.lab, of_target.carriage, of_target.turntable.n = carried, carried, 0
    of_target.deceleration = _decelerations(manipulator_limits(rig, scenario.step_s))[0]
    of_chaser.deceleration = min(of_chaser.deceleration, of_target.deceleration)
    return of_chaser, of_target


def bench_guard(rig: Rig, scenario: Scenario) -> np.record:
    """Return BENCH_GUARD_PARAMS."""
    config, step_s = rig.guard, scenario.step_s
    axes = bench(rig, step_s, scenario.bench)
    params = new(BENCH_GUARD_PARAMS)
    params.enabled = config.enabled
    params.zone = keep_out_zone(scenario)
    params.deceleration, params.turning_deceleration = _decelerations(axes)
    if rig.floating is not None:
        params.deceleration = scenario.gnc.abort.brake_mps2
    params.reaction_s, params.startup_s = config.reaction_s, config.startup_s
    params.distance = scenario.keep_out.distance_m
    if rig.shared_rails is not None:
        _set_braking_of_both(params, rig.shared_rails)
    params.chaser, params.target = (
        bodies(scenario.keep_out.bodies, "chaser"),
        bodies(scenario.keep_out.bodies, "target"),
    )
    params.arm = linear.length(axes.lever_arm)
    params.position_max, params.attitude_max = config.pose_error_max_m, math.radians(config.pose_error_max_deg)
    params.pose_per_speed_s, params.pose_cycles = config.pose_error_per_speed_s, config.pose_error_cycles
    params.limited_max = max(1, round(config.limited_max_s / axes.dt_s))
    params.axis_max = [config.axis_error_max_m] * 3 + [math.radians(config.axis_error_max_deg)] * 3
    if rig.floating is not None:  # which has no drives
        params.axis_max = _FREE
    params.axis_per_speed_s, params.axis_cycles = config.axis_error_per_speed_s, config.axis_error_cycles
    gains = [rig.rails.servo.gain_per_s] * 3 + [rig.turntable.servo.gain_per_s] * 3
    params.axis_decay = [1.0 / (1.0 + gain * step_s) for gain in gains]
    params.vision_sigmas, params.vision_frames = config.vision_sigmas, config.vision_frames_max
    params.vision_position, params.vision_attitude = (
        config.vision_error_max_m,
        math.radians(config.vision_error_max_deg),
    )
    params.estimate_position = config.estimate_error_max_m
    params.estimate_attitude = math.radians(config.estimate_error_max_deg)
    params.calibration_position = config.calibration_m
    params.calibration_attitude = math.radians(config.calibration_deg)
    params.step_s, params.spacing_s, params.settled_cycles = step_s, _KEPT_S, round(_SETTLED_S / step_s)
    return params


_RAILS = "xyz"
_POWERS = np.array([[0.0, 1.0, 0.0, 0.0], [-0.5, 0.0, 1.5, 0.0], [0.0, -1.5, 0.0, 2.5]])
"""Powers of t in the Legendre polynomials P1, P2, P3."""


def set_geometry(params: np.record, rig: Rig, vector: Array | None) -> None:
    """Write the lever arm and ``geometry`` of ``params`` (BENCH_PARAMS), whose other fields are set.

    vector: (PARAMETERS,), m and rad; None: of an ideal machine.
    """
    params.lever_arm = rig.bench.lever_arm_m
    g = params.geometry
    g.enabled = vector is not None
    if vector is None:
        return
    of = parts_of(vector)
    params.lever_arm = np.array(rig.bench.lever_arm_m) + of["reference_m"]
    g.arm = params.lever_arm
    places = [rig.bench.rails_order.index(letter) for letter in _RAILS]
    g.carries = [[place < other for other in places] for place in places]
    half = 0.5 * (params.high[:3] - params.low[:3])
    g.centre, g.inverse = params.low[:3] + half, [0.0 if each <= 0.0 else 1.0 / each for each in half]
    g.rail = 0.0
    for i, name in enumerate(_RAILS):
        if not g.inverse[i]:  # a fixed rail: its errors are those of its base
            continue
        legendre = np.zeros((3, 6))  # P1, P2, P3
        legendre[:, i] = of[f"{name}_position_m"]
        legendre[:, 3:] = of[f"{name}_rotation_deg"].reshape(3, 3).T
        across = [axis for axis in range(3) if axis != i]
        legendre[1:, across] = of[f"{name}_straightness_m"].reshape(2, 2).T
        terms = [np.multiply.outer(powers, row) for powers, row in zip(_POWERS, legendre, strict=True)]
        g.rail[i] = terms[0] + terms[1] + terms[2]
    moves = g.inverse > 0.0
    g.squareness = of["squareness_deg"] * [moves[1], moves[2], moves[2]]
    outer, middle, inner = params.order
    g.zero[[outer, middle, inner]] = of["turntable_deg"][outer], of["middle_deg"][1], of["reference_deg"][inner]
    g.turntable_tilt, reference = of["turntable_deg"], of["reference_deg"].copy()
    g.turntable_tilt[outer] = reference[inner] = 0.0
    g.q_reference = quat.from_rotation_vector(reference)
    g.middle_tilt, g.middle_offset = of["middle_deg"][0], of["middle_m"][0]
    g.inner_tilt, g.inner_offset = of["inner_deg"][0], of["inner_m"]
    g.base, g.q_base = of["base_m"], quat.from_rotation_vector(of["base_deg"])
