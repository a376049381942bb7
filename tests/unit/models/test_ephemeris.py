"""Ephemeris of the GNC with harmonics against the truth's own orbit."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import new
from hil.dynamics.truth import TRUTH_MEMORY, step
from hil.gnc.estimation.target_orbit import HILL_STEP, frame_attitude, frame_rate, move_hill_frame
from hil.maths import quat
from hil.params import dynamics
from hil.params.gnc import target_orbit

HARMONICS = ("gnc.ephemeris.gravity_degree=6", "truth.gravity_degree=6", "truth.drag=false", "truth.third_bodies=false")
ECCENTRIC = ("orbit.eccentricity=0.7", "orbit.altitude_m=17e6", "orbit.true_anomaly_deg=-60.0")
DT_S, LENGTH_S = 0.4, 4000.0


@pytest.mark.parametrize(("name", "more"), [("scheme-1", ()), ("leo-vbar", ()), ("leo-vbar", ECCENTRIC)])
def test_ephemeris_is_the_orbit_of_the_truth(name: str, more: tuple[str, ...]) -> None:
    scenario = load_scenario(name, (*HARMONICS[:2], *more, *(HARMONICS[2:] if name == "leo-vbar" else ()))).value
    params, field, memory = dynamics.dss(scenario), dynamics.field(scenario), new(TRUTH_MEMORY)
    params.dt_s, truth, orbit = DT_S, dynamics.initial_truth(scenario), target_orbit(scenario)
    q_start, rate, q, hill = truth.q_HI.copy(), np.empty(3), np.empty(4), new(HILL_STEP)
    closed = np.zeros(params.n_thrusters, dtype=np.int64)
    off, turned = np.zeros(3), np.zeros(3)
    for k in range(round(LENGTH_S / DT_S)):
        before = truth.r_T_I.copy()
        step(params, field, memory, truth, closed)
        move_hill_frame(orbit, k * DT_S, DT_S, hill)
        assert hill.swings == hill.is_elliptic == 1
        if k % 41 == 0:
            t_s = (k + 1) * DT_S
            frame_rate(orbit, t_s, rate)
            frame_attitude(orbit, q_start, t_s, q)
            off = np.maximum(off, np.abs(rate - truth.w_HI_H))
            turned = np.maximum(turned, np.abs(quat.to_rotation_vector(quat.multiply(q, quat.conjugate(truth.q_HI)))))
            assert hill.rate == pytest.approx(-truth.w_HI_H[1], abs=1e-9)
            middle = np.linalg.norm(before + truth.r_T_I) / 2.0
            pull = orbit.mean_motion**2 - hill.across
            assert pull == pytest.approx(params.gravity.gm / middle**3, rel=1e-7)
    assert np.degrees(off).max() < 2e-8
    assert np.degrees(turned).max() < 2e-5


def test_point_mass_has_no_ephemeris_and_harmonics_change_it() -> None:
    known = [target_orbit(load_scenario("leo-vbar", more).value) for more in ((), HARMONICS[:1])]
    assert [int(orbit.ephemeris.n) > 0 for orbit in known] == [False, True]
    rates = np.empty((2, 3))
    for orbit, rate in zip(known, rates, strict=True):
        frame_rate(orbit, 3600.0, rate)
    assert 1e-4 < np.degrees(np.abs(rates[1] - rates[0])).max() < 1e-3
