"""Scheme 3: dispersed approaches without an IMU, whose thrust is known to a few per cent."""

from __future__ import annotations

import numpy as np
import pytest

import hil

pytestmark = pytest.mark.xdist_group("campaign")


def test_dispersed_approaches_without_an_imu_pass_all_parts() -> None:
    found = hil.campaign("scheme-3", 12, seed=31, workers=1)
    assert found.column("accepted").all()
    assert np.median(found.column("propellant_kg")) < 0.08
