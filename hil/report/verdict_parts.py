"""Parts of the verdict besides control precision: security, energy and field of view.

Security: corridor and closing rate on the truth, the abort, and the drift without any further thrust. Field of view:
every LED of the ring in both images throughout, at the pose that the bench really had.

Energy: the propellant spent against the least that the reference as run and the slews cost. The least is impulsive:
the reference's changes of velocity at once, summed over its path (a line from rest to rest at speed v costs 2 v,
whatever its ramps), what rotating axes of H ask beyond them, and for each axis the slew of the initial attitude error
at a steady rate over ``slew_s``, ``J theta / slew_s`` of torque impulse to start and the same to stop. Forces and
torques are counted with the cleanest thruster set of their axis. The orbital motion that a straight line requires is
not in the least; of a transfer, whose motion is free, only its burns are.

The impulsive bound has the same slews, and what no impulses, however many, can fall below that lead the chaser through
the states that the reference has at the start of each phase, at their times, by Yamanaka and Ankersen's motion.

The numbers of navigation and thrusters have the keys of the JSON of a run, from what is counted of its rows.
"""

from __future__ import annotations

import math
from typing import Any, Final

import numpy as np

from hil.bench.field_of_view import view_margins
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.truth import Orbit
from hil.core.messages import Array, new
from hil.dynamics.thrusters import STANDARD_GRAVITY_MPS2
from hil.gnc.allocation import AXES_OF_A_BODY
from hil.gnc.impulses import TRANSFER_WORK, least_impulses
from hil.gnc.limits import CLOSING, CORRIDOR
from hil.gnc_backends.approach_events import ABORT_CAUSES
from hil.loop.compiled.run_stats import BEFORE, SETTLED
from hil.maths import elementary, linear
from hil.maths.kepler import mean_anomaly, true_anomaly
from hil.maths.limits import finite_or_none
from hil.models import elliptic_motion
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params
from hil.params.dynamics import mean_motion
from hil.params.held_back import HeldBack
from hil.report import results
from hil.sensors.vision_unit import parameters as vmu_params

_RMS_KEYS: Final = (
    "position_rmse_m",
    "velocity_rmse_mps",
    "attitude_rmse_deg",
    "position_sigma_m",
    "attitude_sigma_deg",
)
_DEGREES: Final = np.array([1.0, 1.0, np.degrees(1.0), 1.0, np.degrees(1.0)])


def navigation_numbers(sums: np.record) -> dict[str, Any]:
    """Return errors of the estimate, and the filters' own sigmas, once settled (over all, if the run ended before).

    sums: NAVIGATION_SUMS. Root mean squares, three values each, and mean NEES; None for those that are unknown.
    """
    return navigation_means(sums, SETTLED if sums.estimates[SETTLED] else BEFORE)


def navigation_means(sums: np.record, span: int) -> dict[str, Any]:
    """Return ``navigation_numbers`` of one ``span``, SETTLED or BEFORE."""
    n, updates = int(sums.estimates[span]), sums.updates[span]
    squares = np.concatenate([sums.square_error[span], sums.square_sigma[span]]).reshape(5, 3)
    rms = np.sqrt(squares / n) if n else np.full((5, 3), np.nan)
    means: dict[str, Any] = {
        name: (values * unit).tolist() if np.isfinite(values).all() else None
        for name, values, unit in zip(_RMS_KEYS, rms, _DEGREES, strict=True)
    }
    for k, name in enumerate(("nees_pkf", "nees_akf")):
        means[name] = float(sums.nees[span, k] / updates[k]) if updates[k] else None
    return means


def attitude_error(history: np.ndarray) -> Array:
    """Return the small-angle rotation from the estimated to the true attitude in each row, (n, 3), rad, in c."""
    q, p = history["truth"]["q_CH"], history["navigation"]["q_CH"]
    # twice the vector part of q_true * conj(q_estimate)
    vector = p[:, 3:] * q[:, :3] - q[:, 3:] * p[:, :3] + np.cross(q[:, :3], p[:, :3])
    rotation: Array = 2.0 * vector * np.sign(np.sum(p * q, axis=1))[:, None]
    return rotation


def thruster_numbers(stats: np.record, scenario: Scenario) -> results.ThrusterUse:
    """Return the use of the thrusters: demands, open times, firings, propellant. stats: RUN_STATS."""
    n, step_s = len(scenario.chaser.thrusters.position_m), scenario.step_s
    return results.ThrusterUse(
        force_on_time_s=(step_s * stats.force_cycles).tolist(),
        torque_on_time_s=(step_s * stats.torque_cycles).tolist(),
        torque_on_time_360_400_s=(step_s * stats.torque_cycles_360_400_s).tolist(),
        thruster_on_time_s=(step_s * stats.thruster_open[:n]).tolist(),
        thruster_firings=stats.thruster_firings[:n].tolist(),
        propellant_kg=propellant_kg(stats, scenario),
    )


def propellant_kg(stats: np.record, truth: Scenario) -> float:
    """Return the propellant used, kg; if the truth loses no mass, that of the valves for the time they were open."""
    if truth.truth.mass_loss:
        return float(stats.mass_start - stats.mass_end)
    thrusters, open_s = truth.chaser.thrusters, truth.step_s * float(np.sum(stats.thruster_open))
    return open_s * thrusters.force_n / (thrusters.specific_impulse_s * STANDARD_GRAVITY_MPS2)


_DRIFT_SAMPLES = 720  # over one orbit


def drift(r_CT_H: Array, v_CT_H: Array, orbit: Orbit, nu: float, t_s: Array) -> Array:
    """Return the uncontrolled positions in H, (n, 3), m, ``t_s`` (n,) after the given state.

    nu: true anomaly of the target in that state, rad.
    """
    state, rate, e = np.concatenate([r_CT_H, v_CT_H]), mean_motion(orbit), orbit.eccentricity
    moved = (elliptic_motion.transition(rate, e, nu, float(t)) for t in t_s)
    return np.array([linear.product(whole[:3], state) for whole in moved]).reshape(-1, 3)


def drift_over_an_orbit(row: np.void, orbit: Orbit) -> dict[str, Any]:
    """Return the drift of the chaser of ``row`` (CYCLE) over one orbit without thrust."""
    rate, e = mean_motion(orbit), orbit.eccentricity
    period_s = 2.0 * math.pi / rate
    t_s = np.linspace(0.0, period_s, _DRIFT_SAMPLES + 1)
    nu = true_anomaly(e, mean_anomaly(e, math.radians(orbit.true_anomaly_deg)) + rate * float(row["t_s"]))
    path = drift(row["truth"]["r_CT_H"], row["truth"]["v_CT_H"], orbit, nu, t_s)
    distance = linear.lengths(path)
    nearest = int(np.argmin(distance))
    return {
        "from_s": float(row["t_s"]),
        "orbit_s": period_s,
        "nearest_m": float(distance[nearest]),
        "nearest_after_s": float(t_s[nearest]),
        "farthest_m": float(distance.max()),
        "after_one_orbit_m": [float(value) for value in path[-1]],
    }


def security_part(stats: np.record) -> results.Security:
    """Return ``passed`` and the least margins on the truth up to an abort. stats: RUN_STATS.

    The corridor counts from the first cycle inside it; the line of an abort is that before it.
    """
    if not stats.cycles:
        return results.Security(passed=False)
    limits = stats.integrity.limits
    corridor, closing = float(limits.margin[CORRIDOR]), float(limits.margin[CLOSING])
    return results.Security(
        passed=corridor >= 0.0 and closing >= 0.0,
        corridor_margin_m=corridor,
        corridor_margin_at_s=float(limits.at_s[CORRIDOR]),
        closing_margin_mps=closing,
        closing_margin_at_s=float(limits.at_s[CLOSING]),
        nearest_m=float(stats.integrity.nearest),
    )


class AbortCourse:
    """Course of an abort over the rows of a run, which are added in order, from its trigger on."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._hold = len(scenario.gnc.guidance.sequence) + 2  # number of its phase
        self._first: np.void | None = None
        self._last: np.void | None = None
        self._nearest_m = math.inf
        self._hold_since_s: float | None = None

    def add(self, rows: np.ndarray) -> None:
        """Add the next ``rows`` (n,) of CYCLE."""
        if self._first is None:
            rows = rows[int(np.argmax(rows["supervision"]["aborted"] != 0)) :]
            if not rows["supervision"]["aborted"][0]:
                return
            self._first = rows[0].copy()
        self._last = rows[-1].copy()
        self._nearest_m = min(self._nearest_m, float(linear.lengths(rows["truth"]["r_CT_H"]).min()))
        held = np.flatnonzero(rows["reference"]["phase"] == self._hold)
        if self._hold_since_s is None and len(held):
            self._hold_since_s = float(rows["t_s"][held[0]])

    def course(self) -> results.AbortResults | None:
        """Return the course, None without an abort."""
        first, last, scenario = self._first, self._last, self._scenario
        if first is None or last is None:
            return None
        is_free = scenario.truth.relative_motion == "free"
        drifts = (None if is_free else drift_over_an_orbit(row, scenario.orbit) for row in (first, last))
        return results.AbortResults(
            cause=ABORT_CAUSES[int(first["supervision"]["aborted"])],
            at_s=float(first["t_s"]),
            range_m=linear.length(first["truth"]["r_CT_H"]),
            nearest_m=self._nearest_m,
            hold_since_s=self._hold_since_s,
            range_at_end_m=linear.length(last["truth"]["r_CT_H"]),
            drift_from_trigger=next(drifts),
            drift_from_end=next(drifts),
        )


def slew_impulse(scenario: Scenario) -> float:
    """Return the least thrust impulse of the slews, N s: thrust of the set over its torque, times torque impulse."""
    sets, strength = gnc_params.allocation(scenario.chaser)
    inertia = np.diag(np.array(scenario.chaser.inertia_kg_m2))
    angles = np.abs(np.radians(scenario.initial.attitude_deg))
    torque_impulse = 2.0 * inertia * angles / scenario.gnc.guidance.slew_s
    thrust = scenario.chaser.thrusters.force_n * sets[3:AXES_OF_A_BODY].sum(axis=2).min(axis=1)
    return float((torque_impulse * thrust / strength[3:AXES_OF_A_BODY]).sum())


def impulsive_bound(stats: np.record, scenario: Scenario) -> float | None:
    """Return the least sum of impulses, m/s, between the states of the reference; None in axes that rotate otherwise.

    stats: RUN_STATS.
    """
    orbit, work = gnc_params.target_orbit(scenario), new(TRANSFER_WORK)
    if orbit.tumble.rotates:
        return None
    legs = [*stats.leg[: stats.n_legs], stats.last]
    times, states = [float(leg["t_s"]) for leg in legs], [np.array(leg["state"]) for leg in legs]
    return sum(
        float(least_impulses(orbit, times[k], times[k + 1] - times[k], states[k], states[k + 1], work))
        for k in range(len(legs) - 1)
    )


def energy_part(
    stats: np.record, scenario: Scenario, propellant_kg: float, held_back: HeldBack | None = None
) -> results.Energy:
    """Return ``passed`` and the numbers. stats: RUN_STATS. held_back: of the run of a planar chaser.

    delta_v_mps is the rocket equation's value for the propellant, as if all thrust had acted in one direction.
    """
    exhaust_speed = scenario.chaser.thrusters.specific_impulse_s * STANDARD_GRAVITY_MPS2
    mass_kg, factor = scenario.chaser.mass_kg, scenario.requirements.propellant_factor
    line, slews = float(stats.reference_delta_v), slew_impulse(scenario) / mass_kg
    least_kg = mass_kg * -elementary.expm1(-(line + slews) / exhaust_speed)
    bound = impulsive_bound(stats, scenario)
    return results.Energy(
        passed=bool(stats.cycles and propellant_kg <= factor * least_kg),
        propellant_kg=propellant_kg,
        delta_v_mps=-exhaust_speed * elementary.log1p(-propellant_kg / mass_kg),
        least_propellant_kg=least_kg,
        least_line_mps=line,
        least_slews_mps=slews,
        impulsive_bound_mps=bound,
        impulsive_bound_kg=None if bound is None else mass_kg * -elementary.expm1(-(bound + slews) / exhaust_speed),
        factor=factor,
        firings=int(np.sum(stats.thruster_firings)),
        held_back_mps2=None if held_back is None else held_back.largest_mps2,
        held_back_mps=None if held_back is None else held_back.impulse_mps,
    )


class FieldOfView:
    """Margin of the LEDs to the images' edges over the rows of a run, at the pose that the bench really had."""

    def __init__(self, scenario: Scenario, rig: Rig) -> None:
        self._step_s = scenario.step_s
        self._bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
        self._mounting = vmu_params.mounting(rig)
        self._camera, self._leds = vmu_params.camera(rig)
        self._is_needed = rig.has_vmu and scenario.vmu.errors.needs_view
        self._least_px, self._at_s, self._range_m = math.inf, math.nan, math.nan
        self._rows = self._lost = 0

    def add(self, rows: np.ndarray) -> None:
        """Add the next ``rows`` (n,) of CYCLE."""
        margins, feedback = np.empty(len(rows)), rows["feedback"]
        rail_m, gimbal_rad = (np.ascontiguousarray(feedback[name]) for name in ("rail_m", "gimbal_rad"))
        view_margins(self._bench, self._mounting, self._camera, self._leds, rail_m, gimbal_rad, margins)
        worst = int(np.argmin(margins))
        if not self._rows or not margins[worst] >= self._least_px:
            self._least_px, self._at_s = float(margins[worst]), float(rows["t_s"][worst])
            self._range_m = linear.length(rows["truth"]["r_CT_H"][worst])
        self._rows += len(rows)
        self._lost += int(np.count_nonzero(margins < 0.0))

    def part(self) -> results.FieldOfViewResults:
        """Return ``passed``, the least margin to an image's edge, px, its time and range, and the time outside."""
        if not (self._rows and self._is_needed):  # without a vision unit, or with a tracker, nothing has to be in view
            return results.FieldOfViewResults(passed=not self._is_needed)
        return results.FieldOfViewResults(
            passed=bool(self._least_px >= 0.0),
            margin_px=finite_or_none(self._least_px),
            at_s=self._at_s,
            range_m=self._range_m,
            lost_s=self._step_s * self._lost,
        )
