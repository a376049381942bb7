"""Docking monitor on images of another renderer: errors of lens, tone, time and scene file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import CameraTolerances
from tests.support.monitor_disturbances import MONITOR_ROWS, MonitorRow

BY_NAME = {row.name: row for row in MONITOR_ROWS}


@pytest.mark.parametrize("name", ["clean", "focal length 3 %"])
def test_portion_of_another_renderer_is_measured_within_its_sigmas(name: str) -> None:
    tally = BY_NAME[name].run(1, 4)
    assert (tally.measured, tally.gross) == (1, 0), tally.line()
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.0


def test_error_of_the_focal_length_that_is_not_stated_is_beyond_the_sigmas() -> None:
    """The tolerance is what makes the row above pass."""
    tally = replace(BY_NAME["focal length 3 %"], stated=None).run(1, 4)
    assert np.abs(np.concatenate(tally.ratios)).max() > 8.0


def test_tolerances_of_a_camera_are_zero_unless_stated() -> None:
    assert load_scene("atv").value.camera.tolerances == CameraTolerances()


@pytest.mark.slow
@pytest.mark.parametrize("row", MONITOR_ROWS, ids=lambda row: row.name)
def test_no_disturbance_gives_a_gross_error(row: MonitorRow) -> None:
    """The table of ``python sims/disturbances.py monitor``."""
    for seed in range(3):
        tally = row.run(10, seed)
        assert tally.gross == 0, tally.line()
