"""Vision unit on images of a real laboratory: steps of the background, ghosts, reflections, refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.parts.vision.cli.vmu import never_found
from hil.vmu.detect import SpotDetector
from hil.vmu.ghosts import LensGhosts
from hil.vmu.identify import LedIdentification
from hil.vmu.kernels.components import COMPONENT_WIDTH, U0, U1, V0, V1
from hil.vmu.kernels.records import FIT, SPOT, SPOT_RAY
from hil.vmu.kernels.structure import flatten
from hil.vmu.pose import SolverSettings
from hil.vmu.refusals import reason, reason_of_time
from hil.vmu.unit import Solution, VisionUnit
from tests.support.disturbance_verdicts import judge
from tests.support.vmu_crowded import CROWDED_ROWS
from tests.support.vmu_disturbances import VERY_GOOD, Row, known_geometry, real_bench, somewhere
from tests.support.vmu_lab import BACKDROPS, LAB_ROWS, Backdrop, backgrounds, beside, ghosts, twins
from tests.support.vmu_pixels import PixelOptics


@pytest.mark.slow
@pytest.mark.parametrize("row", [*LAB_ROWS, *CROWDED_ROWS], ids=lambda row: row.name)
def test_every_row_of_the_laboratory_is_as_expected(row: Row) -> None:
    """The table of ``python sims/disturbances.py vmu``."""
    verdict = judge(row.expected, [row.run(40, seed).result() for seed in range(3)])
    assert not verdict.why, verdict


@pytest.mark.parametrize("name", ["border", "horizon", "image circle", "squares"])
def test_ring_before_a_background_with_steps_is_measured(name: str) -> None:
    tally = Row(name, VERY_GOOD, backgrounds(BACKDROPS[name])).run(3, 5)
    assert (tally.solved, tally.gross) == (3, 0), tally.line()
    assert np.abs(tally.ratios).max() < 4.5


@pytest.mark.parametrize("name", ["cables", "window with bars"])
def test_light_on_what_continues_on_both_sides_is_where_it_is(name: str) -> None:
    """On a cable or next to a bar the background is that of both sides, not a plane."""
    tally = Row(name, VERY_GOOD, backgrounds(BACKDROPS[name])).run(4, 21)
    assert (tally.solved, tally.gross) == (4, 0), tally.line()
    assert np.abs(tally.ratios).max() < 4.5


def test_light_on_a_cable_is_flattened_to_the_level_around_it() -> None:
    """A bar of 5 px at 30 deg, 60 levels above its surroundings, with a light of 100 levels on it."""
    v, u = np.mgrid[0:80, 0:80] - 40.0
    cable = 60.0 * np.clip(3.0 - np.abs(v * np.cos(0.5) - u * np.sin(0.5)), 0.0, 1.0)
    light = 100.0 * np.exp(-0.5 * (u**2 + v**2) / 1.3**2)
    row, flat = np.zeros(COMPONENT_WIDTH, np.int64), np.zeros((80, 80), np.uint8)
    row[[U0, V0, U1, V1]] = 38, 38, 42, 42
    flatten(np.rint(20.0 + cable + light).astype(np.uint8), row, 20.0, flat)
    around = np.hypot(u, v) < 12.0
    assert np.abs(flat - 20.0 - light)[around].mean() < 3.0  # the edges of the cable are as sharp as a pixel
    assert np.abs(flat - 20.0 - light)[np.hypot(u, v) < 2.0].max() < 4.0


def test_background_with_a_step_has_no_lights() -> None:
    """A wall next to a curtain is no component as large as the image, and its edge is no light."""
    rng, detector = np.random.default_rng(0), SpotDetector((1024, 1024))
    for name in ("curtain", "border", "image circle", "doorway"):
        levels, seen = BACKDROPS[name](rng)
        noisy = levels * seen + rng.normal(0.0, 1.0, levels.shape)
        assert len(detector.spots(np.clip(np.rint(noisy), 0, 255).astype(np.uint8))) == 0, name


def test_tracked_ring_crosses_a_step_without_a_search_of_the_whole_image() -> None:
    rng, unit, searched = np.random.default_rng(2), VisionUnit(known_geometry(VERY_GOOD)), 0
    scene = real_bench(VERY_GOOD, rng, PixelOptics(background_levels=0.0, peak_levels=110.0))
    edge = np.clip((np.mgrid[0:1024, 0:1024][1] - 520.0) / 2.0, 0.0, 1.0)
    scene = replace(scene, backdrop=((10.0 + 100.0 * edge, np.ones_like(edge)),) * 2)
    for k in range(8):
        solution = unit.solve(*scene.pair(np.zeros(3), np.array([0.05 + 0.01 * k, 0.0, 3.0]), rng), 0.16 * k)
        assert solution.status == "ok"
        searched += solution.full_frame
    assert searched <= 3  # the first one, and until the rates are known


@pytest.mark.parametrize(("part", "magnification"), [(0.2, -1.0), (0.2, -0.5), (0.1, 0.6)])
def test_ghosts_of_the_lens_are_no_second_ring(part: float, magnification: float) -> None:
    unit, rng = VisionUnit(known_geometry(VERY_GOOD)), np.random.default_rng(4)
    for scene, truth in ghosts(part, magnification)(rng, 4):
        unit.track.drop()
        solution = unit.solve(*scene.pair(truth.turn, truth.t_v, rng), 0.0)
        assert solution.status == "ok", solution.doubt
    for side in unit.ghosts:
        assert side.known is not None
        assert side.known.magnification == pytest.approx(magnification, abs=0.03)
        assert side.known.fraction == pytest.approx(part, rel=0.2)


def test_second_ring_as_bright_as_the_first_is_no_ghost() -> None:
    """Two equal rings, the other one upside down on the other side of the principal point."""
    ring = np.zeros(6, SPOT_RAY)
    angles = np.radians(60.0 * np.arange(6))
    ring["u"], ring["v"], ring["flux"] = 620.0 + 40.0 * np.cos(angles), 560.0 + 40.0 * np.sin(angles), 1000.0
    other = ring.copy()
    other["u"], other["v"] = 1024.0 - ring["u"], 1024.0 - ring["v"]
    assert not LensGhosts(np.array([512.0, 512.0])).among(ring, other).any()
    other["flux"] = 200.0
    assert LensGhosts(np.array([512.0, 512.0])).among(ring, other).all()


@pytest.mark.parametrize("frames", [twins, beside])
def test_reflection_of_a_ring_with_hidden_leds_is_not_the_pose(frames: Backdrop) -> None:
    tally = Row("", VERY_GOOD, frames).run(6, 8)
    assert tally.gross == 0, tally.line()
    assert not tally.ratios or np.abs(tally.ratios).max() < 5.0, tally.line()


@pytest.mark.parametrize(
    ("lit", "levels", "status", "why"),
    [
        (0, 12.0, "rejected_dark", "brightest pixel 16 levels: LEDs off, lens covered, short exposure?"),
        (2, 12.0, "too_few", "2 and 2 lights, 6 LEDs: longer exposure, or are LEDs hidden?"),
        (6, 250.0, "rejected_bright", "98 % of an image at full scale: shorten the exposure"),
    ],
)
def test_refusal_has_cause_amount_and_remedy(lit: int, levels: float, status: str, why: str) -> None:
    rng, unit = np.random.default_rng(6), VisionUnit(known_geometry(VERY_GOOD))
    scene, truth = (
        real_bench(
            VERY_GOOD, rng, PixelOptics(background_levels=levels, texture_levels=max(levels - 200.0, 0.0) / 5.0)
        ),
        somewhere(rng, 2.0, 3.0),
    )
    solution = unit.solve(*replace(scene, leds_m=scene.leds_m[:lit]).pair(truth.turn, truth.t_v, rng), 0.0)
    assert (solution.status, str(solution.doubt)) == (status, why)


def test_blooming_is_named_and_a_shorter_exposure_cures_it() -> None:
    rng, short = np.random.default_rng([11, 8]), np.random.default_rng(1)
    row = next(row for row in CROWDED_ROWS if row.name == "blooming")
    unit, other, refused = VisionUnit(known_geometry(VERY_GOOD)), VisionUnit(known_geometry(VERY_GOOD)), 0
    for scene, truth in row.frames(rng, 4):
        unit.track.drop()
        solution = unit.solve(*scene.pair(truth.turn, truth.t_v, rng), 0.0)
        if solution.pose is not None:
            continue
        refused += 1
        assert str(solution.doubt).endswith(" pixels of a column at full scale, blooming: shorten the exposure")
        less = replace(scene, optics=replace(scene.optics, peak_levels=180.0))
        assert other.solve(*less.pair(truth.turn, truth.t_v, short), 0.0).status == "ok"
        other.track.drop()
    assert refused > 0


@pytest.mark.parametrize("status", ["too_few", "rejected_no_match", "rejected_geometry", "rejected_geometry_file",
                                    "rejected_sync", "ambiguous"])  # fmt: skip
def test_reason_of_a_refusal_fits_into_80_columns(status: str) -> None:
    spots = [np.zeros(64, SPOT)] * 2
    fits = np.zeros(12, FIT)
    for verdict in (LedIdentification(status, candidates=fits), LedIdentification(status, candidates=fits, open=True)):
        for swapped in (True, False):
            assert 20 < len(reason(verdict, spots, 32, SolverSettings(), lambda swapped=swapped: swapped)) <= 80
    assert len(reason_of_time([np.full((900, 900), 255, np.uint8)], spots)) <= 80


def test_led_that_no_pair_has_is_named() -> None:
    measured = [Solution(0.0, "ok", None, (np.zeros(0, SPOT),) * 2, ((-1, 0, 1, 2), (-1, 0, 2, -1)))] * 6
    assert never_found(measured) == [0]
    assert never_found(measured[:2]) == []


def test_opposite_sign_of_the_baseline_is_named() -> None:
    rng, geometry = np.random.default_rng(6), known_geometry(VERY_GOOD)
    unit = VisionUnit(geometry.model_copy(update={"baseline_m": (-0.2, 0.0, 0.0)}))
    scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng, 2.0, 3.0)
    solution = unit.solve(*scene.pair(truth.turn, truth.t_v, rng), 0.0)
    assert solution.pose is None
    assert str(solution.doubt).startswith("would fit with the opposite baseline")
