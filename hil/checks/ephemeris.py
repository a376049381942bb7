"""How long the GNC's orbit of the target is good for: before a run, from it and from the truth's.

About a point mass a target in low orbit drifts out of its ephemeris within hours, because harmonics change eccentricity
and plane of its orbit. What breaks first is not the relative motion, but the attitude: the rate of H that the GNC has
is off, and the innovations of sound poses have a mean.
"""

from __future__ import annotations

import math
from statistics import median
from typing import Final, NamedTuple

import numpy as np

from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import BUILT_IN, Scenario
from hil.core.messages import new
from hil.errors import Problem
from hil.gnc.estimation.integrity import INTEGRITY_STATE
from hil.gnc.estimation.rate_error_alarm import alarm_by_rate_error
from hil.gnc.estimation.step_memory import DOUBTS
from hil.gnc.estimation.target_orbit import frame_rate
from hil.maths import linear
from hil.maths.random_streams import noise_source
from hil.params import dynamics as dynamics_params
from hil.params import gnc as gnc_params
from hil.params.ephemeris import longest_run_s, row_interval_s, true_frames
from hil.sensors.vision_unit import parameters as vmu_params
from hil.sensors.vision_unit.model import VISION_NOISE

_DRAWS: Final = 15  # of the noise of the poses
_NEES_MAX: Final = 7.5  # mean over a run, 6 expected: 1.25 times the variance that the attitude filter states


class EphemerisLimit(NamedTuple):
    """Time for which the GNC's orbit is good, shortest and longest by the noise of the poses, s.

    good_for_s: with the noise of the run's seed, otherwise the median; inf: for the whole run. error_radps: largest
    error of its rate of H, about ``axis``. nees: mean NEES of the attitude filter until then, median, 6 expected.
    """

    good_for_s: float
    shortest_s: float
    longest_s: float
    error_radps: float
    axis: int
    nees: float

    def text(self, scenario: Scenario, length_s: float) -> str:
        """Return the line for a run of ``length_s``, "" if the orbit is good for all of it."""
        off = f"its rate of H is off by up to {math.degrees(self.error_radps):.1e} deg/s about {'xyz'[self.axis]}"
        degrees = (
            f"gnc.ephemeris.gravity_degree is {scenario.gnc.ephemeris.gravity_degree}, truth.gravity_degree "
            f"{scenario.truth.gravity_degree}"
        )
        if math.isinf(self.good_for_s):
            if self.nees <= _NEES_MAX:
                return ""
            return (
                f"the GNC's orbit: {off}, beyond gnc.ephemeris.rate_sigma_degps, and the attitude has larger errors "
                f"than the filter states, mean NEES {self.nees:.2g}, 6 expected; {degrees}"
            )
        last = "the end" if math.isinf(self.longest_s) else f"{self.longest_s / 3600.0:.2g}"
        return (
            f"the GNC's orbit is good for {self.good_for_s / 3600.0:.2g} h of {length_s / 3600.0:.3g} h, by the noise "
            f"of the poses {self.shortest_s / 3600.0:.2g} to {last}: {off}, and the innovations become inconsistent; "
            f"{degrees}"
        )


def check_length(scenario: Loaded[Scenario], length_s: float) -> list[Problem]:
    """Return a problem if the GNC's ephemeris with harmonics is shorter than the run."""
    key, degree = "gnc.ephemeris.gravity_degree", scenario.value.gnc.ephemeris.gravity_degree
    if degree < 2 or length_s <= (allowed_s := longest_run_s(dynamics_params.known_orbit(scenario.value))):
        return []
    text = f"{degree}: the ephemeris reaches to {allowed_s:.0f} s, the run to {length_s:.0f} s, allowed 0"
    return [scenario.problem(key, text)]


def ephemeris_limit(scenario: Scenario, rig: Rig, length_s: float, seed: int | None) -> EphemerisLimit | None:
    """Return how long of a run of ``length_s`` the GNC's orbit is good for; None if the filters do not follow one.

    seed: of the run, if the poses are simulated with its noise.
    """
    gnc = scenario.gnc
    if not (
        length_s > 0.0
        and scenario.truth_orbits
        and rig.has_vmu
        and gnc.binary is None
        and gnc.navigation.backend in BUILT_IN["navigation"]
    ):
        return None
    params, row_s = gnc_params.navigation(scenario), row_interval_s(dynamics_params.known_orbit(scenario))
    rows, orbit = true_frames(scenario, row_s, math.ceil(length_s / row_s) + 2), params.fusion.orbit
    error, known = np.zeros((len(rows), 3)), np.empty(3)
    for k, row in enumerate(rows):
        frame_rate(orbit, k * row_s, known)
        error[k] = -known[0], -row[0] - known[1], row[1] - known[2]
    noise, alarms = np.empty((math.floor(length_s * rig.vmu.rate_hz), VISION_NOISE)), []
    nees: list[float] = []
    farther = linear.length(gnc.guidance.ready_point_m) / scenario.vmu.reference_range_m
    sigma, q_vc = math.radians(scenario.vmu.sigma_angle_deg) * max(1.0, farther), vmu_params.mounting(rig).q_vc.copy()
    own = seed is not None and scenario.vmu.source == "model" and rig.kind != "hardware"
    for draw in (*([seed] if own else []), *range(_DRAWS)):
        noise_source(draw, "vision").standard_normal(out=noise)
        alarm_s, mean_nees = alarm_by_rate_error(
            params.fusion.akf, params.integrity, new(INTEGRITY_STATE), new(DOUBTS), error, row_s,
            1.0 / rig.vmu.rate_hz, noise, sigma, q_vc,
        )  # fmt: skip
        alarms.append(math.inf if math.isnan(alarm_s) else alarm_s)
        nees.append(mean_nees)
    good_for_s, (worst, axis) = alarms[0], divmod(int(np.abs(error).argmax()), 3)
    alarms.sort()
    if not own:
        good_for_s = alarms[_DRAWS // 2]
    return EphemerisLimit(good_for_s, alarms[0], alarms[-1], float(abs(error[worst, axis])), axis, median(nees))


def ephemeris_warnings(scenario: Scenario, rig: Rig, length_s: float, seed: int | None = None) -> list[str]:
    """Return a line if the orbit is not as good as the filters state for the run; see ``ephemeris_limit``."""
    limit = ephemeris_limit(scenario, rig, length_s, seed)
    return list(filter(None, [limit and limit.text(scenario, length_s)]))
