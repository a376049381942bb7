"""A run with transfers: the chaser coasts between its burns, and arrives."""

from __future__ import annotations

import numpy as np
import pytest

import hil

pytestmark = pytest.mark.xdist_group("campaign")


def test_chaser_coasts_from_a_hundred_metres_to_thirty_and_arrives() -> None:
    run = hil.run("transfer", duration_s=600.0)
    t_s, r, v = np.asarray(run.t_s), np.asarray(run.truth.r_CT_H), np.asarray(run.truth.v_CT_H)
    arrived = (t_s > 575.0) & (t_s < 590.0)
    np.testing.assert_allclose(r[arrived].mean(axis=0), [30.0, 0.0, 0.0], atol=0.1)
    np.testing.assert_allclose(v[arrived], 0.0, atol=0.01)
    assert r[:, 2].min() < -5.0 or r[:, 2].max() > 5.0  # it does not fly along the line
    on = np.asarray(run.command.on).sum(axis=1)
    coasting = (t_s > 150.0) & (t_s < 450.0)
    assert on[coasting].mean() < 0.1 * on[(t_s > 60.0) & (t_s < 90.0)].mean()
    energy = run.summary["verdict"]["energy"]
    assert energy["propellant_kg"] < 1.7 * energy["impulsive_bound_kg"]
    assert run.stop == "completed"
