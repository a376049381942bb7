"""LED layout from pairs of the ring at different places, by a renderer that shares no mathematics with it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.cli.main import execute
from hil.config.load import load_geometry
from hil.config.rig import Rig
from hil.config.vmu_geometry import VmuGeometry
from hil.vmu.calibration import hand_held, led_layout
from hil.vmu.calibration.files import as_toml
from hil.vmu.calibration.model import Setup
from hil.vmu.calibration.refine import layout_basis
from hil.vmu.calibration.solve import CalibrationSolution
from hil.vmu.kernels.chain import COMMON
from hil.vmu.unit import VisionUnit
from tests.support.vmu_disturbances import CalibrationErrors, Pose, ring_m
from tests.support.vmu_pixels import Array, PixelCamera, PixelOptics, PixelScene, turned

ERRORS = CalibrationErrors(0.1, 5e-4, 0.1, 0.01, 1e-4, 1e-4, 0.01, focal_scale=5e-4)
FOCAL_PX, SIZE_PX, BASELINE_M = 560.0, 480, 0.2
WRONG_LED = 4


def known() -> VmuGeometry:
    """Return the geometry file of the lab: cameras with the tolerances ``ERRORS``, nominal LEDs."""
    camera = {"fx": FOCAL_PX, "fy": FOCAL_PX, "cx": 239.5, "cy": 239.5, "width": SIZE_PX, "height": SIZE_PX}
    camera["distortion"] = (-0.08, 0.02, 0.0, 0.0, 0.0)  # type: ignore[assignment]
    keys = {
        "leds_m": tuple(map(tuple, ring_m().tolist())),
        "left": camera,
        "right": camera,
        "baseline_m": (BASELINE_M, 0.0, 0.0),
    }
    return VmuGeometry.model_validate(keys | {"tolerances": dict(ERRORS.__dict__)})


def bench(rng: np.random.Generator) -> PixelScene:
    """Return real cameras, and a ring with LEDs that are 0.2 mm off and one that is 2 mm off."""
    cameras, both = [], 1.0 + ERRORS.focal_scale * rng.standard_normal()
    for side in range(2):
        focal = FOCAL_PX * both * (1.0 + ERRORS.focal_fraction * rng.standard_normal())
        centre = 239.5 + ERRORS.principal_point_px * rng.standard_normal(2)
        place = BASELINE_M * side + ERRORS.baseline_m * side * rng.standard_normal(), 0.0, 0.0
        lens = (-0.08, 0.02, 0.0, 0.0, 0.0)
        cameras.append(PixelCamera(focal, focal, *centre, SIZE_PX, SIZE_PX, lens, place=place))
    leds = ring_m() + 2e-4 * rng.standard_normal((6, 3))
    off = rng.standard_normal(3)
    leds[WRONG_LED] = ring_m()[WRONG_LED] + 2e-3 * off / np.linalg.norm(off)
    right = turned(cameras[1], np.radians(ERRORS.rotation_deg) * rng.standard_normal(3))
    return PixelScene(cameras[0], right, leds, PixelOptics())


def places(rng: np.random.Generator, count: int) -> list[Pose]:
    """Return places of the ring in the hand: 0.7 to 1.6 m, tilted by up to 35 deg."""
    found = []
    for _ in range(count):
        z = rng.uniform(0.7, 1.6)
        t = np.array([0.1 + rng.uniform(-0.18, 0.18) * (z - 0.4), rng.uniform(-0.25, 0.25) * (z - 0.4), z])
        turn = Rotation.from_euler("zyx", rng.uniform(-1.0, 1.0, 3) * [3.1, 0.6, 0.6])
        found.append(Pose(turn.as_rotvec(), t))
    return found


def write_views(folder: Path, scene: PixelScene, poses: list[Pose], rng: np.random.Generator) -> None:
    """Write a pair of images for each of ``poses``."""
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
    for k, pose in enumerate(poses):
        for side, image in zip(("left", "right"), scene.pair(pose.turn, pose.t_v, rng), strict=True):
            cv2.imwrite(str(folder / side / f"{k:04d}.png"), image)


def off_nominal(points: Array) -> Array:
    """Return differences (n, 3), m, from the nominal ring without rigid motion."""
    basis = layout_basis(ring_m())
    return np.asarray((basis @ (basis.T @ (points - ring_m()).ravel())).reshape(-1, 3))


def layout_of(folder: Path, rig: Rig) -> CalibrationSolution:
    """Return the layout by the views in ``folder``."""
    ring = hand_held.at_origin(Setup.of(known(), rig.bench), ring_m())
    return led_layout.solve(hand_held.read_pairs(folder), known(), ring, 1e-3, lambda *_: None)[0]


def test_layout_from_fifteen_pairs_is_within_its_sigmas_and_finds_a_wrong_led(mock_rig: Rig, tmp_path: Path) -> None:
    ratios, shares = [], []
    for seed in range(2):
        rng = np.random.default_rng([seed, 31])
        scene = bench(rng)
        write_views(tmp_path / str(seed), scene, places(rng, 15), rng)
        fit = layout_of(tmp_path / str(seed), mock_rig).fit
        off, sigma = fit.setup.points - ring_m(), fit.sigma[COMMON:].reshape(-1, 3)
        ratios.append((off - off_nominal(scene.leds_m)) / sigma)
        shares.append(np.linalg.norm(off, axis=1))
    assert np.abs(ratios).max() < 3.5
    assert np.mean(np.abs(ratios) < 2.0) > 0.85
    for lengths in shares:
        assert lengths.argmax() == WRONG_LED
        assert lengths[WRONG_LED] == pytest.approx(1.7e-3, abs=0.6e-3)  # a part of it is motion of the whole ring


def test_command_writes_a_ring_that_the_unit_loads(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(32)
    scene = bench(rng)
    poses = places(rng, 10)
    write_views(tmp_path / "views", scene, poses[:9], rng)
    nominal, out, found = tmp_path / "vmu.toml", tmp_path / "measured.toml", tmp_path / "found.json"
    nominal.write_text(as_toml(known().model_dump(exclude_none=True), "Nominal."))
    words = ["calibrate", str(tmp_path / "views"), "--hand-held", "--geometry", str(nominal), "--out", str(out)]
    assert execute([*words, "--json", str(found), "--figure", str(tmp_path / "ring.png")]) == 0
    assert "LEDs against the nominal layout, mm" in capsys.readouterr().out
    assert json.loads(found.read_text())["target"] == "hand-held leds"
    measured = load_geometry(str(out)).value
    assert measured.left == known().left
    truth = poses[9]
    solution = VisionUnit(measured).solve(*scene.pair(truth.turn, truth.t_v, rng), 0.0)
    assert solution.status == "ok"
    assert np.max(np.abs(truth.error(solution)) / np.sqrt(np.diag(solution.covariance))) < 4.0


def test_layout_takes_the_errors_of_the_cameras_into_its_sigmas(mock_rig: Rig, tmp_path: Path) -> None:
    """A baseline that is longer by 1 % makes the ring larger by 1 %, and both are correlated."""
    rng = np.random.default_rng(33)
    scene = replace(bench(rng), leds_m=ring_m())
    write_views(tmp_path, scene, places(rng, 9), rng)
    exact = known()
    loose = exact.model_copy(update={"tolerances": exact.tolerances.model_copy(update={"baseline_m": 2e-3})})
    ring = hand_held.at_origin(Setup.of(exact, mock_rig.bench), ring_m())
    spread = ring_m() - ring_m().mean(axis=0)
    size = spread.ravel() / (spread**2).sum()
    sigmas = []
    for geometry in (exact, loose):
        views = hand_held.read_pairs(tmp_path)
        covariance = led_layout.solve(views, geometry, ring, 1e-3, lambda *_: None)[0].fit.covariance
        sigmas.append(float(np.sqrt(size @ covariance[COMMON:, COMMON:] @ size)))
    assert sigmas[1] == pytest.approx(2e-3 / BASELINE_M, rel=0.15)
    assert sigmas[0] < 0.3 * sigmas[1]
    along = covariance[COMMON:, 21] @ size  # the right camera's position along the baseline
    assert along / (sigmas[1] * 2e-3) > 0.9
