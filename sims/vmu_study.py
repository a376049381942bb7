"""LED identification and pose accuracy of the vision unit, over random poses.

python sims/vmu_study.py identity     subsets of LEDs, with decoys, one camera black: statuses and errors
python sims/vmu_study.py track        the same with a prediction, ring with a raised LED and flat ring
python sims/vmu_study.py coverage     2-sigma coverage and error over bound, on spots
python sims/vmu_study.py flat         the flat ring: statuses and coverage over range
python sims/vmu_study.py images       error over the bound from the pixels' noise, over range, on rendered images
python sims/vmu_study.py drops        an approach of rendered images with 30 % of the frames lost, decoys, dark LEDs
python sims/vmu_study.py folder TRUTH CSV   hil vmu's CSV compared with its truth

All but the last take --poses N, --seed N.
"""

from __future__ import annotations

import argparse
import csv
from collections import Counter
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.vmu.geometry import EXACT, camera_pair, led_positions
from hil.vmu.kernels.budget import weigh
from hil.vmu.kernels.hypotheses import difference
from hil.vmu.kernels.lens import in_image, project
from hil.vmu.kernels.records import FIT, MAX_LEDS, SPOT
from hil.vmu.pose import Prediction, matrix_of
from hil.vmu.render import Extras, Light, Reflection, RingAppearance, RingRenderer
from hil.vmu.unit import Solution, VisionUnit

SIGMA_PX = 0.05
WRONG = 60.0  # chi-square of six components beyond that of any right pose
NAMES = ("x", "y", "z", "rx", "ry", "rz")
RANGES_M = (0.6, 0.9, 1.3, 2.0, 3.0, 4.5, 6.0, 9.0, 12.0)
LENS = {"fx": 1200.0, "fy": 1200.0, "width": 1024, "height": 1024, "distortion": (-0.08, 0.02, 3e-4, -2e-4, 0.0)}


def geometry(raised_m: float) -> VmuGeometry:
    """Return a ring of six LEDs, one of them raised, in front of two cameras 0.2 m apart."""
    angles = np.radians(60.0 * np.arange(6))
    leds = np.column_stack([0.12 * np.cos(angles), 0.12 * np.sin(angles), np.zeros(6)])
    leds[0, 2] = -raised_m
    return VmuGeometry.model_validate(
        {
            "leds_m": tuple(tuple(float(v) for v in led) for led in leds),
            "left": LENS | {"cx": 511.5, "cy": 511.5},
            "right": LENS | {"cx": 509.0, "cy": 512.5},
            "baseline_m": (0.2, 0.0, 0.0),
            "tolerances": EXACT,
        }
    )


@dataclass(frozen=True)
class Truth:
    r: Array
    t: Array

    @property
    def q(self) -> Array:
        return np.asarray(Rotation.from_matrix(self.r.T).as_quat())

    def error(self, solution: Solution) -> Array:
        out = np.empty(6)
        assert solution.pose is not None
        difference(matrix_of(solution.pose.q_vt), solution.pose.t_v, self.r, self.t, out)
        return out


class Stage:
    """Cameras and LEDs, and random poses that are complete in both images."""

    def __init__(self, chosen: VmuGeometry) -> None:
        self.geometry, self.pair, self.leds = chosen, camera_pair(chosen), led_positions(chosen)
        self.unit = VisionUnit(chosen)

    def pixel(self, camera: int, point: Array) -> tuple[float, float]:
        u, v = project(self.pair.lens[camera], *(self.pair.rotation[camera] @ point + self.pair.translation[camera]))
        return u, v

    def sees_all(self, truth: Truth) -> bool:
        points = self.leds @ truth.r.T + truth.t
        return all(in_image(self.pair.lens[c], *self.pixel(c, p), 8.0) for c in range(2) for p in points)

    def place(self, rng: np.random.Generator, range_m: float | None = None, tilt_deg: float = 25.0) -> Truth:
        z = np.exp(rng.uniform(np.log(0.65), np.log(12.0))) if range_m is None else range_m
        reach = 0.35
        while True:
            t = np.array([rng.uniform(-reach, reach) * z + 0.1, rng.uniform(-reach, reach) * z, z])
            axis, tilt = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(0.0, tilt_deg))
            lean = Rotation.from_rotvec(tilt * np.array([np.cos(axis), np.sin(axis), 0.0]))
            truth = Truth((lean * Rotation.from_rotvec([0, 0, rng.uniform(-np.pi, np.pi)])).as_matrix(), t)
            if self.sees_all(truth) or reach < 0.02:
                return truth
            reach *= 0.9

    def spots(
        self, truth: Truth, lit: Array, decoys: int, black: int | None, rng: np.random.Generator
    ) -> list[np.ndarray]:
        """Return both images' spots in random order: LEDs, lights in space, and half as many in one image only."""
        near = [truth.t * rng.uniform(0.8, 1.2) + rng.uniform(-0.3, 0.3, 3) * truth.t[2] for _ in range(decoys)]
        points = [*(self.leds[lit] @ truth.r.T + truth.t), *near]
        found = []
        for c in range(2):
            pixels = [self.pixel(c, p) for p in points]
            pixels = [uv for uv in pixels if in_image(self.pair.lens[c], *uv, 1.0)]
            spots = np.zeros(0 if c == black else len(pixels), SPOT)
            for spot, (u, v) in zip(spots, pixels, strict=False):
                spot["u"], spot["v"] = u + SIGMA_PX * rng.standard_normal(), v + SIGMA_PX * rng.standard_normal()
                spot["var_u"] = spot["var_v"] = SIGMA_PX**2
                spot["flux"] = 500.0
            rng.shuffle(spots)
            found.append(spots)
        return found

    def bound(self, truth: Truth, covariances: list[list[Array | None]]) -> Array:
        """Return the Cramer-Rao bound (6, 6) of the pose for spots of given covariances (2, 2) per camera and LED."""
        found, used = [], np.full((2, MAX_LEDS), -1, np.int64)
        for c in range(2):
            seen = [n for n, value in enumerate(covariances[c]) if value is not None]
            spots = np.zeros(len(seen), SPOT)
            for k, n in enumerate(seen):
                spots[k]["u"], spots[k]["v"] = self.pixel(c, truth.r @ self.leds[n] + truth.t)
                value = covariances[c][n]
                spots[k]["var_u"], spots[k]["var_v"], spots[k]["cov_uv"] = value[0, 0], value[1, 1], value[0, 1]
                used[c, n] = k
            found.append(spots)
        fit = np.zeros(1, FIT)[0]
        fit["r"], fit["t"], fit["spot"] = truth.r, truth.t, used
        view = self.unit.solver.view(*found)
        weigh(self.unit.solver.scene, view, self.unit.solver.stray_density(view), 0, fit)
        return np.asarray(fit["covariance"])


def outcome(solution: Solution, truth: Truth) -> str:
    if solution.status != "ok" or solution.pose is None:
        return solution.status
    e = truth.error(solution)
    return "WRONG" if e @ np.linalg.solve(solution.pose.covariance, e) > WRONG else "ok"


def prediction_of(truth: Truth, rng: np.random.Generator, sigma_deg: float = 1.5) -> Prediction:
    """Return a prediction with errors according to its covariance: 1 % of the range, a few degrees."""
    sigmas = np.repeat([0.005 + 0.01 * truth.t[2], np.radians(sigma_deg)], 3)
    e = sigmas * rng.standard_normal(6)
    r = Rotation.from_rotvec(e[3:]).as_matrix() @ truth.r
    return Prediction(truth.t + e[:3], np.asarray(Rotation.from_matrix(r.T).as_quat()), np.diag(sigmas**2))


def identity(poses: int, seed: int, raised_m: float, tracked: bool) -> None:
    stage, rng = Stage(geometry(raised_m)), np.random.default_rng(seed)
    print(f"raised {raised_m} m, {'with' if tracked else 'without'} prediction, {poses} poses a line")
    total: Counter[str] = Counter()
    for black in (None, 1):
        for count in (6, 5, 4, 3):
            for decoys in range(6):
                line: Counter[str] = Counter()
                for _ in range(poses):
                    truth = stage.place(rng)
                    spots = stage.spots(truth, rng.permutation(6)[:count], decoys, black, rng)
                    stage.unit.track.drop()
                    prediction = prediction_of(truth, rng) if tracked else None
                    line[outcome(stage.unit.solve_spots(spots[0], spots[1], 0.0, prediction), truth)] += 1
                total += line
                cameras = "two" if black is None else "one"
                print(f"  {cameras} cameras, {count} LEDs, {decoys} decoys: {dict(sorted(line.items()))}", flush=True)
    print(f"  all: {dict(sorted(total.items()))}")


def coverage(poses: int, seed: int, raised_m: float, ranges: tuple[float | None, ...]) -> list[Array]:
    """Print a line per range, and return the errors over sigmas, (6,) each."""
    every: list[Array] = []
    stage, rng = Stage(geometry(raised_m)), np.random.default_rng(seed)
    print(f"raised {raised_m} m, {poses} poses a line: within 2 sigma, %; RMS of error over bound; NEES of 6; statuses")
    for range_m in ranges:
        ratios, normalised, nees, statuses = [], [], [], Counter()
        for _ in range(poses):
            truth = stage.place(rng, range_m)
            stage.unit.track.drop()
            prediction = prediction_of(truth, rng) if raised_m == 0.0 else None
            spots = stage.spots(truth, np.arange(6), 0, None, rng)
            solution = stage.unit.solve_spots(spots[0], spots[1], 0.0, prediction)
            statuses[outcome(solution, truth)] += 1
            if solution.pose is None or solution.status != "ok":
                continue
            e, covariance = truth.error(solution), solution.pose.covariance
            crb = stage.bound(truth, [[SIGMA_PX**2 * np.eye(2)] * 6] * 2)
            ratios.append(e / np.sqrt(np.diag(crb)))
            normalised.append(e / np.sqrt(np.diag(covariance)))
            nees.append(e @ np.linalg.solve(covariance, e))
        report(f"{range_m or 'all'} m", normalised, ratios, nees, statuses)
        every += normalised
    return every


def report(title: str, normalised: list[Array], ratios: list[Array], nees: list[float], statuses: Counter[str]) -> None:
    if not nees:
        print(f"  {title:>7}: {dict(statuses)}")
        return
    within = 100.0 * (np.abs(normalised) < 2.0).mean(axis=0)
    rms = np.sqrt(np.square(ratios).mean(axis=0))
    text = " ".join(f"{name} {w:.1f}" for name, w in zip(NAMES, within, strict=True))
    ratio = " ".join(f"{value:.3f}" for value in rms)
    print(
        f"  {title:>7}: {text} (all {within.mean():.1f}) | {ratio} | {np.mean(nees):.2f} | {dict(statuses)}", flush=True
    )


def images(poses: int, seed: int, raised_m: float) -> list[Array]:
    """Print a line per range, and return the errors over sigmas, (6,) each."""
    from vmu_spots import bound as spot_bound

    stage, rng, look = Stage(geometry(raised_m)), np.random.default_rng(seed), RingAppearance()
    renderer = RingRenderer(stage.pair, stage.leds, look)
    print(f"rendered images, raised {raised_m} m, {poses} poses a line; columns as for coverage")
    every: tuple[list[Array], list[Array], list[float], Counter[str]] = ([], [], [], Counter())
    for range_m in RANGES_M:
        own: tuple[list[Array], list[Array], list[float], Counter[str]] = ([], [], [], Counter())
        for _ in range(poses):
            truth = stage.place(rng, range_m)
            pair = renderer.pair(truth.t, truth.q, None, rng)
            stage.unit.track.drop()
            solution = stage.unit.solve(pair[0], pair[1], 0.0)
            own[3][outcome(solution, truth)] += 1
            if solution.pose is None or solution.status != "ok":
                continue
            covariances: list[list[Array | None]] = []
            for c in range(2):
                spots, flux = renderer.led_images(c, truth.t, truth.q)
                inside = [in_image(stage.pair.lens[c], s[0], s[1], 1.0) for s in spots]
                covariances.append(
                    [spot_bound(look, s, f)[0] if i else None for s, f, i in zip(spots, flux, inside, strict=True)]
                )
            e, covariance = truth.error(solution), solution.pose.covariance
            own[0].append(e / np.sqrt(np.diag(covariance)))
            own[1].append(e / np.sqrt(np.diag(stage.bound(truth, covariances))))
            own[2].append(e @ np.linalg.solve(covariance, e))
        report(f"{range_m} m", *own)
        for mine, all_ in zip(own[:3], every[:3], strict=True):
            all_.extend(mine)
        every[3].update(own[3])
    report("all", *every)
    return every[0]


def drops(poses: int, seed: int, raised_m: float) -> None:
    """Approach from 9 m to 0.9 m in ``poses`` frames of rendered images."""
    stage, rng = Stage(geometry(raised_m)), np.random.default_rng(seed)
    renderer, statuses, worst = RingRenderer(stage.pair, stage.leds, RingAppearance()), Counter[str](), 0.0
    for k in range(poses):
        share = k / max(poses - 1, 1)
        z = 9.0 + share * (0.9 - 9.0)
        t = np.array([0.1 + 0.02 * np.sin(6.0 * share), 0.05 * np.cos(5.0 * share) * z / 9.0, z])
        truth = Truth(Rotation.from_rotvec([0.05, -0.06 * share, 0.1 * np.sin(4.0 * share)]).as_matrix(), t)
        lights = [Light((rng.uniform(-0.3, 0.3) * z, rng.uniform(-0.3, 0.3) * z, z)) for _ in range(2)]
        reflections = [Reflection(int(rng.integers(2)), *rng.uniform(50.0, 950.0, 2)) for _ in range(2)]
        lit = rng.random(6) > 0.1
        if k == 0:
            lit[:] = True
        if k > 0 and rng.random() < 0.3:
            solution = stage.unit.solve(None, None, 0.16 * k)
        else:
            pair = renderer.pair(truth.t, truth.q, list(lit), rng, Extras(lights, reflections))
            solution = stage.unit.solve(pair[0], pair[1], 0.16 * k)
        said = outcome(solution, truth)
        if solution.pose is not None:
            e = truth.error(solution)
            square = e @ np.linalg.solve(solution.pose.covariance, e)
            worst = max(worst, square) if solution.status == "ok" else worst
            said = "WRONG prediction" if solution.status == "predicted" and square > WRONG else said
        statuses[said] += 1
    print(f"approach with lost frames, {poses} frames: {dict(statuses)}, largest NEES of an ok pose {worst:.1f}")


def folder(truth_path: str, csv_path: str) -> None:
    with open(truth_path) as a, open(csv_path) as b:
        truths = {int(row["frame"]): row for row in csv.DictReader(a)}
        rows = list(csv.DictReader(b))
    print("frame   z, m  status LEDs | error, mm and deg | error over sigma")
    normalised = []
    for row in rows:
        truth = truths[int(row["frame"])]
        position = [float(row[f"{a}_m"]) - float(truth[f"{a}_m"]) for a in "xyz"]
        r, s = (Rotation.from_rotvec([float(x[f"r{a}_rad"]) for a in "xyz"]) for x in (row, truth))
        e = np.array([*position, *(r * s.inv()).as_rotvec()])
        units = ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")
        ratio = e / np.array([float(row[f"sigma_{name}"]) for name in units])
        normalised.append(ratio)
        shown = " ".join(f"{v:7.3f}" for v in (*1e3 * e[:3], *np.degrees(e[3:])))
        print(
            f"{row['frame']:>5} {float(truth['z_m']):6.2f}  {row['status']:6} {row['n_leds']:>4} | {shown} | "
            + " ".join(f"{v:5.2f}" for v in ratio)
        )
    print("RMS of error over sigma:", " ".join(f"{v:.2f}" for v in np.sqrt(np.square(normalised).mean(axis=0))))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("identity", "track", "coverage", "flat", "images", "drops", "folder"))
    parser.add_argument("paths", nargs="*")
    parser.add_argument("--poses", type=int, default=0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--raised-m", type=float, default=0.06)
    given = parser.parse_args()
    seed, raised_m = given.seed, given.raised_m
    if given.what == "identity":
        identity(given.poses or 50, seed, raised_m, tracked=False)
    elif given.what == "track":
        for height in (raised_m, 0.0):
            identity(given.poses or 50, seed, height, tracked=True)
    elif given.what == "coverage":
        coverage(given.poses or 2000, seed, raised_m, (None,))
    elif given.what == "flat":
        coverage(given.poses or 300, seed, 0.0, RANGES_M)
    elif given.what == "images":
        images(given.poses or 100, seed, raised_m)
    elif given.what == "drops":
        drops(given.poses or 200, seed, raised_m)
    else:
        folder(given.paths[0], given.paths[1])


if __name__ == "__main__":
    main()
