"""Whether the bench can follow the whole plan of a scenario: travel, speed, acceleration and view of the cameras.

Each axis and each kind of limit gets one problem at most, at the moment at which it is passed furthest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from hil.bench import manipulator, reachability
from hil.bench.kinematics import show
from hil.checks.planned_trajectory import PlanSample, control_bounds, moments
from hil.config.load import Loaded
from hil.config.rig import BENCH_AXES, GIMBAL_NAMES, RAIL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.core.messages import Array
from hil.errors import Problem
from hil.maths import elementary, linear, quat
from hil.params import bench as bench_params
from hil.sensors.vision_unit import parameters as vmu_params

_ROUNDING = 1e-9
_LEAST_SPAN_S = 1e-3
_DEGREES = math.degrees(1.0)


@dataclass(frozen=True, slots=True)
class Demands:
    """What a scenario asks of a bench: the n moments of its plan, and for each of them the bench and its axes."""

    plan: list[PlanSample]
    attitudes: list[reachability.Attitude]
    margin_m: Array
    axes: reachability.Envelope
    relative: list[PlanSample]
    """The plan relative to the target; if that is moved, ``plan`` is what is left for the chaser's rig."""
    target_at: Array
    """Positions of the axes that move the target, (n, 3), rad or m; zero without any."""


def axis_demands(scenario: Scenario, rig: Rig) -> Demands:
    """Return what the plan with its dispersion asks of the axes.

    Raises ValueError where the thruster layout cannot move an axis.
    """
    bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
    relative, free = moments(scenario), control_bounds(scenario)
    plan, target_at, swing = _divided(scenario, rig, relative)
    band = math.radians(scenario.reachability.attitude_margin_deg)
    cached = {turn: reachability.attitude(bench, np.array(turn), band) for turn in {tuple(m.rotation) for m in plan}}
    attitudes = [cached[tuple(m.rotation)] for m in plan]
    r, v = np.array([m.r_CT_H for m in plan]), np.array([m.v_CT_H for m in plan])
    margin = position_margin(scenario, np.array([m.far_m for m in plan])) + band * swing[:, None]
    r, v, margin = _shown(bench, r, v, margin)
    rate, slewing = linear.length(free.rate), linear.length(free.slewing)
    free = replace(free, swing_mps=swing * rate, swing_mps2=swing * (slewing + rate * rate))
    axes = reachability.envelope(bench, attitudes, r, v, margin, free)
    return Demands(plan, attitudes, margin, axes, relative, target_at)


def _shown(bench: np.record, r: Array, v: Array, margin: Array) -> tuple[Array, Array, Array]:
    """Return positions, velocities and margins (n, 3) as a bench shows them that is scaled at a distance."""
    if bench.scaled_beyond == 0.0:
        return r, v, margin
    places, rates, margins = r.copy(), v.copy(), margin.copy()
    for k in range(len(r)):
        show(bench, r[k], v[k], places[k], rates[k])
        distance = linear.length(r[k])
        if distance > 0.0:
            margins[k] *= linear.length(places[k]) / distance
    return places, rates, margins


def _divided(scenario: Scenario, rig: Rig, plan: list[PlanSample]) -> tuple[list[PlanSample], Array, Array]:
    """Return what is left of ``plan`` for the chaser's rig, positions (n, 3) of the target's axes, and arms (n,), m.

    An arm is the distance at which a rotation of the chaser moves the rails; all are zero without a rotary manipulator.
    The target's axes take their part of a sample as far as their travel allows, and that of the plan's motion as far as
    their rates allow. What control adds is left to the chaser's rig.
    """
    params = bench_params.manipulator(rig)
    if params is None:
        return plan, np.zeros((len(plan), 3)), np.zeros(len(plan))
    limits, at = bench_params.manipulator_limits(rig, scenario.step_s), manipulator.places(params)
    bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
    samples, target_at, arms = [], np.empty((len(plan), 3)), np.empty(len(plan))
    near = np.zeros(3)
    for k, (sample, rate) in enumerate(zip(plan, _rates(plan), strict=True)):
        q = quat.from_rotation_vector(sample.rotation)
        motion = manipulator.ChaserMotion(sample.r_CT_H, sample.v_CT_H, q, rate, sample.t_s)
        wanted, rates = manipulator.wanted_axes(params, bench, motion, near)
        within = np.clip(wanted, limits.low[at], limits.high[at])
        rates = np.where(within == wanted, np.clip(rates, -limits.rate_max[at], limits.rate_max[at]), 0.0)
        shown = manipulator.shown_motion(params, within, rates, motion)
        samples.append(replace(sample, r_CT_H=shown.r, v_CT_H=shown.v, rotation=quat.to_rotation_vector(shown.q)))
        target_at[k], arms[k] = within, 0.0 if params.rails else linear.length(sample.r_CT_H + params.arm)
        near = within if sample.abort_s is None else near
    return samples, target_at, arms


def _rates(plan: list[PlanSample]) -> list[Array]:
    """Return the rate (3,), rad/s, in c, at which the plan rotates from each sample on; zero in aborts."""
    rates = [np.zeros(3) for _ in plan]
    own = [k for k, sample in enumerate(plan) if sample.abort_s is None]
    for before, after in pairwise(own):
        span_s = plan[after].t_s - plan[before].t_s
        if span_s > _LEAST_SPAN_S:
            turn = quat.multiply(
                quat.from_rotation_vector(plan[after].rotation),
                quat.conjugate(quat.from_rotation_vector(plan[before].rotation)),
            )
            rates[before] = quat.to_rotation_vector(turn) / span_s
    return rates


def check_reachability(scenario_file: Loaded[Scenario], rig_file: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each axis, and for the cameras, that the plan with its dispersion asks too much of.

    The cameras are looked at only where the axes can go. Raises ValueError where the thruster layout cannot
    move an axis.
    """
    asked = axis_demands(scenario_file.value, rig_file.value)
    findings = _Findings(scenario_file, rig_file.value, asked)
    findings.travel(asked.axes)
    findings.speed(asked.axes)
    findings.acceleration(asked.axes)
    findings.start_in_motion(asked.attitudes[0])
    if not findings.problems:
        findings.view()
    return findings.problems


def position_margin(scenario: Scenario, far_m: Array) -> Array:
    """Return half the band of positions (n, 3), m: Table III at the ready point, and a fraction of the cone beyond."""
    limits, guidance, corridor = scenario.requirements, scenario.gnc.guidance, scenario.gnc.corridor
    at_ready = np.array([limits.axial_tolerance_m, limits.radial_distance_m, limits.radial_distance_m])
    slope = scenario.reachability.corridor_fraction * elementary.tan(math.radians(corridor.half_angle_deg))
    beyond = np.maximum(0.0, far_m - linear.length(guidance.ready_point_m))
    margin: Array = at_ready + slope * beyond[:, None]
    return margin


class _Findings:
    """Collects the problems and puts them into words."""

    def __init__(self, scenario: Loaded[Scenario], rig: Rig, asked: Demands) -> None:
        self.problems: list[Problem] = []
        self._scenario = scenario
        self._rig = rig
        self._bench = bench_params.bench(rig, scenario.value.step_s, scenario.value.bench)
        self._asked = asked
        self._plan = asked.plan
        self._in_abort = np.array([m.abort_s is not None for m in asked.plan])
        self._named: set[int] = set()  # axes: what they cannot do after their first problem follows from it

    def travel(self, asked: reachability.Envelope) -> None:
        over = np.maximum(self._bench.low - asked.low, asked.high - self._bench.high)
        for axis, k in self._worst(over):
            unit, scale, digits = _unit(axis)
            too_high = asked.high[k, axis] - self._bench.high[axis] >= self._bench.low[axis] - asked.low[k, axis]
            value = (asked.high if too_high else asked.low)[k, axis] * scale
            planned = asked.planned[k, axis] * scale
            low, high = self._bench.low[axis] * scale, self._bench.high[axis] * scale
            self._say(
                self._point_key(k, axis),
                f"{BENCH_AXES[axis]} would go to {value:.{digits}f} {unit} "
                f"(planned {planned:.{digits}f} {unit}) {self._when(k)}, "
                f"allowed {low:g} to {high:g} {unit} by {_rig_key(axis, 'travel', unit)}",
            )

    def speed(self, asked: reachability.Envelope) -> None:
        for axis, k in self._worst(asked.rate - self._bench.rate_max):
            unit, scale, _ = _unit(axis)
            planned = f"planned {asked.planned_rate[k, axis]:.3g} {unit}/s, the rest is" if axis < 3 else "all of it is"
            self._say(
                self._rate_key(k, axis),
                f"{BENCH_AXES[axis]} would go at up to {asked.rate[k, axis] * scale:.3g} {unit}/s "
                f"({planned} control) {self._when(k)}, allowed "
                f"{self._bench.rate_max[axis] * scale:g} {unit}/s by {_rig_key(axis, 'rate_max', f'{unit}ps')}",
            )

    def acceleration(self, asked: reachability.Envelope) -> None:
        for axis, k in self._worst(asked.acceleration - self._bench.acceleration_max):
            unit, scale, _ = _unit(axis)
            self._say(
                "chaser.thrusters.force_n",
                f"{BENCH_AXES[axis]} would be asked for up to "
                f"{asked.acceleration[k, axis] * scale:.3g} {unit}/s2 {self._when(k)}, allowed "
                f"{self._bench.acceleration_max[axis] * scale:g} {unit}/s2 "
                f"by {_rig_key(axis, 'acceleration_max', f'{unit}ps2')}",
            )

    def start_in_motion(self, start: reachability.Attitude) -> None:
        """The bench stands still before the run: each axis has to catch up with a chaser that starts in motion."""
        initial = self._scenario.value.initial
        own = linear.product(start.turned, np.radians(initial.rate_degps))
        along = linear.product(reachability.rails_of(self._bench), np.array(initial.velocity_mps))
        rate = np.abs(own + np.array([*along, 0.0, 0.0, 0.0]))
        takes_s = rate / self._bench.acceleration_max
        allowed_s = self._scenario.value.reachability.startup_lag_s
        for axis in sorted({int(axis) for axis in np.flatnonzero(takes_s > allowed_s)} - self._named):
            unit, scale, _ = _unit(axis)
            moved = axis < 3 and abs(along[axis]) >= abs(own[axis])
            self._say(
                "initial.velocity_mps" if moved else "initial.rate_degps",
                f"{BENCH_AXES[axis]} would need {takes_s[axis]:.2g} s at 0.0 s to catch up with "
                f"{rate[axis] * scale:.3g} {unit}/s at {self._bench.acceleration_max[axis] * scale:g} {unit}/s2, "
                f"allowed {allowed_s:g} s by reachability.startup_lag_s",
            )

    def view(self) -> None:
        """Add one problem if an LED leaves an image."""
        if not (self._rig.has_vmu and self._scenario.value.vmu.errors.needs_view):
            return
        camera, leds = vmu_params.camera(self._rig)
        asked, mounting = self._asked, vmu_params.mounting(self._rig)
        # of the relative pose, whichever axes show it
        r, attitudes = np.array([m.r_CT_H for m in asked.relative]), asked.attitudes
        if asked.target_at.any():
            band = math.radians(self._scenario.value.reachability.attitude_margin_deg)
            attitudes = [reachability.attitude(self._bench, m.rotation, band) for m in asked.relative]
        planned, least = reachability.view(self._bench, mounting, camera, leds, attitudes, r, asked.margin_m)
        k = int(np.argmin(least))
        if least[k] < 0.0:
            self._say(
                self._view_key(k),
                f"vmu: an LED of the ring would be {_pixels(least[k])} (planned: {_pixels(planned[k])}) "
                f"{self._when(k)}, allowed 0 px or more inside both images of "
                f"{self._rig.vmu.camera.width_px} x {self._rig.vmu.camera.height_px} px",
            )

    def _worst(self, over: Array) -> list[tuple[int, int]]:
        """Return axis and moment of the largest excess for each axis that has one, the approach before aborts.

        Not a number is an excess. An axis is named once.
        """
        over = np.where(np.isfinite(over), over, np.inf)
        worst = []
        for axis in sorted(set(range(6)) - self._named):
            excess = over[:, axis] > _ROUNDING
            chosen = excess & ~self._in_abort
            if excess.any():
                among = chosen if chosen.any() else excess
                worst.append((axis, int(np.where(among, over[:, axis], -np.inf).argmax())))
        self._named.update(axis for axis, _ in worst)
        return worst

    def _point_key(self, k: int, axis: int) -> str:
        moment = self._plan[k]
        if axis < 3:
            return moment.point_key
        return moment.rotation_key if moment.rotation.any() else "reachability.attitude_margin_deg"

    def _view_key(self, k: int) -> str:
        """Return the key of what moves the ring out of view: the attitude, or the distance from the docking axis."""
        moment = self._plan[k]
        axial = float(linear.product(moment.r_CT_H, self._scenario.value.gnc.corridor.axis))
        beside = elementary.acos(min(1.0, abs(axial) / max(linear.length(moment.r_CT_H), 1e-9)))
        return moment.rotation_key if linear.length(moment.rotation) > beside else moment.point_key

    def _rate_key(self, k: int, axis: int) -> str:
        if axis < 3:
            return self._plan[k].speed_key
        initial, control = self._scenario.value.initial, self._scenario.value.gnc.control
        own = max(abs(rate) for rate in initial.rate_degps) > control.slew_rate_degps
        return "initial.rate_degps" if own else "gnc.control.slew_rate_degps"

    def _when(self, k: int) -> str:
        moment = self._plan[k]
        begun = "" if moment.abort_s is None else f", in an abort begun at {moment.abort_s:.1f} s"
        return f"at {moment.t_s:.1f} s{begun}{self._beside(k)}"

    def _beside(self, k: int) -> str:
        """Return where the target's axes are at moment ``k``, whose travel leaves the rest to the chaser's rig."""
        at = self._asked.target_at[k]
        if self._rig.rotated_target is not None:
            angles = zip(GIMBAL_NAMES, np.degrees(at), strict=True)
            return f" with rotary_manipulator at {', '.join(f'{name} {angle:.1f}' for name, angle in angles)} deg"
        if self._rig.shared_rails is not None:
            positions = zip(RAIL_NAMES, at, strict=True)
            return (
                f" with target_manipulator at {', '.join(f'{name} {position:.3f}' for name, position in positions)} m"
            )
        return ""

    def _say(self, key: str, text: str) -> None:
        self.problems.append(self._scenario.problem(key, text))


def _unit(axis: int) -> tuple[str, float, int]:
    """Return unit, factor from SI and decimals of an axis."""
    return ("m", 1.0, 3) if axis < 3 else ("deg", _DEGREES, 2)


def _rig_key(axis: int, name: str, unit: str) -> str:
    return f"rig.{BENCH_AXES[axis]}.{name}_{unit}"


def _pixels(margin_px: float) -> str:
    if not math.isfinite(margin_px):
        return "behind the camera"
    return f"{abs(margin_px):.0f} px {'inside' if margin_px >= 0.0 else 'outside'} an image"
