"""Drift check: what moved after the measurement is found, chance is not, and the chart keeps earlier checks."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from hil.config.bench_geometry import load_bench_geometry
from hil.config.load import load_rig
from hil.config.rig import Rig
from hil.config.tables.machine import NAMES, PARAMETERS
from hil.core.messages import Array
from hil.errors import BadInput
from hil.params.bench import ideal_axes
from hil.parts.geometry.check import GeometryDrift, append_to_chart, check
from hil.parts.geometry.fit import fit, geometry_file
from hil.parts.geometry.model import MachineModel
from hil.parts.geometry.observations import PoseObservations
from hil.vmu.calibration.files import as_toml
from tests.support.machine import TRACKER_SIGMA, axes_within, observed, twelve_errors

VECTOR = twelve_errors(1)
PLAIN = load_rig("mock").value


@cache
def content() -> str:
    model = MachineModel(PLAIN)
    observations = observed(model, VECTOR, axes_within(PLAIN, 90, 1), TRACKER_SIGMA, "tracker", 1)
    return as_toml(
        geometry_file(model, fit(model, observations), observations, "2026-03-01").model_dump(mode="json"), ""
    )


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    """Return the mock rig with a measured geometry."""
    path = tmp_path / "geometry.toml"
    path.write_text(content(), encoding="utf-8")
    return load_rig("mock", [f"rig.bench.geometry_file={path}"]).value


def checked(rig: Rig, vector: Array = VECTOR, seed: int = 0, shift: Array | None = None) -> GeometryDrift:
    """Return the check of a dozen poses of a machine with ``vector``, whose axes stand ``shift`` (6,) off."""
    axes, model = axes_within(rig, 12, 50 + seed), MachineModel(rig)
    there = axes if shift is None else axes + shift
    taken = observed(model, vector, there, TRACKER_SIGMA, "tracker", seed)
    return check(model, PoseObservations(taken.pose, axes, taken.value, taken.sigma, taken.source))


def test_a_bench_that_has_not_changed_passes(rig: Rig) -> None:
    assert [checked(rig, seed=seed).passed for seed in range(20)] == [True] * 20


@pytest.mark.parametrize(
    ("parameter", "size", "cause"),
    [
        ("base_m[1]", 2e-3, "rails.y is off by 2.00 mm, or the base has moved along it"),
        ("base_deg[2]", np.radians(0.1), "base moved by"),
    ],
)
def test_a_base_that_moved_is_named(rig: Rig, parameter: str, size: float, cause: str) -> None:
    moved = VECTOR.copy()
    moved[NAMES.index(parameter)] += size
    result = checked(rig, moved)
    assert not result.passed
    assert result.verdict.startswith(cause)


@pytest.mark.parametrize(
    ("axis", "size", "name"), [(2, 2e-3, "rails.z is off by 2.0"), (4, np.radians(0.1), "turntable.pitch is off by")]
)
def test_an_axis_that_moved_is_named(rig: Rig, axis: int, size: float, name: str) -> None:
    shift = np.zeros(6)
    shift[axis] = size
    result = checked(rig, shift=shift)
    assert not result.passed
    assert name in result.verdict


def test_swapped_bodies_are_named(rig: Rig) -> None:
    model, axes = MachineModel(rig), axes_within(rig, 12, 60)
    taken = observed(model, VECTOR, axes, TRACKER_SIGMA, "tracker", 3)
    from hil.parts.geometry.check import _swapped

    result = check(model, _swapped(taken))
    assert not result.passed
    assert result.verdict == "bodies swapped"


def test_a_check_needs_a_geometry_file() -> None:
    with pytest.raises(BadInput, match="geometry_file"):
        checked(PLAIN)


def test_an_ideal_machine_shows_the_same_at_its_axes(rig: Rig) -> None:
    axes = axes_within(rig, 20, 3)
    ideal = ideal_axes(rig, axes)
    shown = MachineModel(PLAIN).observed(np.zeros(PARAMETERS), ideal, "tracker")
    measured = MachineModel(rig).observed(
        load_bench_geometry(str(rig.bench.geometry_file)).parameters.vector, axes, "tracker"
    )
    assert np.abs(shown - measured).max() < 1e-12
    assert np.abs(ideal - axes).max() > 1e-3
    assert ideal_axes(PLAIN, axes) is axes


def test_the_chart_warns_of_what_leaves_the_earlier_checks(rig: Rig, tmp_path: Path) -> None:
    chart = tmp_path / "chart.csv"
    texts = [append_to_chart(chart, f"2026-03-{day:02d}", checked(rig, seed=day)) for day in range(1, 8)]
    assert texts[:5] == [""] * 5
    assert texts[5].startswith("within 3 sigma of 5")
    moved = VECTOR.copy()
    moved[NAMES.index("base_m[0]")] += 5e-4
    assert "sigma off 7 earlier checks" in append_to_chart(chart, "2026-03-09", checked(rig, moved))
    assert len(chart.read_text(encoding="utf-8").splitlines()) == 9


def test_a_file_that_was_edited_and_one_of_another_bench_are_refused(rig: Rig, tmp_path: Path) -> None:
    path = Path(str(rig.bench.geometry_file))
    other = load_rig("mock", [f"rig.bench.geometry_file={path}", "rig.bench.camera_position_m=[0.615, 0.0, 0.0]"]).value
    with pytest.raises(BadInput, match="other arms, mountings or travel"):
        check(
            MachineModel(other),
            observed(MachineModel(PLAIN), VECTOR, axes_within(rig, 3, 0), TRACKER_SIGMA, "tracker", 0),
        )
    edited = tmp_path / "edited.toml"
    edited.write_text(content().replace("poses = 60", "poses = 61"), encoding="utf-8")
    broken = load_rig("mock", [f"rig.bench.geometry_file={edited}"]).value
    with pytest.raises(BadInput, match="it was edited"):
        MachineModel(broken).observed(VECTOR, axes_within(rig, 3, 0), "tracker")
