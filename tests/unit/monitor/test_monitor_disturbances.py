"""Docking monitor on images of another renderer: errors of lens, tone, time and scene file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import CameraTolerances
from tests.support.disturbance_verdicts import Expectation, SeedResult, judge
from tests.support.monitor_disturbances import EXACT, MONITOR_ROWS, MonitorRow, MonitorTally

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


@pytest.mark.parametrize("name", ["focal length 0.5 %, not stated", "1 px at the corner, not stated"])
def test_usual_errors_that_are_not_stated_are_within_the_default_tolerances(name: str) -> None:
    tally = BY_NAME[name].run(1, 4)
    assert (tally.measured, tally.gross) == (1, 0), tally.line()
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.5
    assert np.abs(np.concatenate(replace(BY_NAME[name], stated=None).run(1, 4).ratios)).max() > 4.5


def test_shipped_scenes_state_the_exact_camera_of_their_images() -> None:
    for name in ("atv", "bright-cross"):
        assert load_scene(name).value.camera.tolerances == EXACT
    assert CameraTolerances() != EXACT


def test_clipped_pixels_displace_no_edge() -> None:
    """A portion overexposed by 60 % is measured like any other."""
    tally = BY_NAME["overexposed x1.6"].run(1, 4)
    assert (tally.measured, tally.gross) == (1, 0), tally.line()
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.0


def test_fields_in_the_wrong_order_are_noticed_where_only_one_kind_shows_the_cross() -> None:
    """The fields without the cross belong to the same motion; without them all times are off alike."""
    tally = MonitorTally()
    BY_NAME["wrong field order"].add_portion(tally, 18, 0)  # at 10.4 m
    assert tally.measured == 1, tally.line()
    assert np.abs(np.concatenate(tally.ratios)).max() < 4.5


@pytest.mark.parametrize(
    ("expected", "results", "why"),
    [
        (Expectation(), {}, ""),
        (Expectation(), {"gross": 1}, "1 gross errors"),
        (Expectation(), {"solved": 30, "statuses": {"ok": 30, "ambiguous": 10}}, "less than 95 % solved"),
        (Expectation(), {"ratios": [0.5] * 100}, "more than 98 % within 2 sigma"),
        (Expectation(drawn=False), {"ratios": [0.5] * 100}, ""),
        (Expectation(), {"ratios": [0.5] * 80 + [2.5] * 20}, "less than 90 % within 2 sigma"),
        (
            Expectation(refused=("rejected_sync",)),
            {"solved": 10, "statuses": {"ok": 10, "rejected_sync": 20, "rejected_geometry": 10}},
            "less than 90 % of the refused images name the cause",
        ),
        (Expectation(refused=("rejected_sync",)), {"solved": 2, "statuses": {"ok": 2, "rejected_sync": 38}}, ""),
    ],
)
def test_verdict_names_what_is_not_as_expected(expected: Expectation, results: dict[str, object], why: str) -> None:
    good = {"frames": 40, "solved": 40, "statuses": {"ok": 40}, "ratios": [0.5] * 95 + [2.5] * 5}
    assert judge(expected, [SeedResult(**(good | results))]).why == why  # type: ignore[arg-type]


@pytest.mark.slow
@pytest.mark.parametrize("row", MONITOR_ROWS, ids=lambda row: row.name)
def test_every_row_is_as_expected(row: MonitorRow) -> None:
    """The table of ``python sims/disturbances.py monitor``."""
    verdict = judge(row.expected, [row.run(20, seed).result() for seed in range(3)])
    assert not verdict.why, verdict
