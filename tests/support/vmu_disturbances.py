"""Rows of disturbances for the vision unit: what lens, sensor, calibration and surroundings do to its images.

Each row draws frames with a real bench of its own (``vmu_pixels``) and solves them with the geometry that a lab
would have. A frame counts as a gross error if a pose with status ``ok`` is off by more than 3 deg or 1 % of the range,
and by more than 4 sigma.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from hil.config.vmu_geometry import VmuGeometry
from hil.vmu.unit import Solution, VisionUnit
from tests.support.disturbance_verdicts import USUAL_ROW, Expectation, SeedResult
from tests.support.vmu_pixels import Array, Image, PixelCamera, PixelOptics, PixelScene, turned

LENS = {"fx": 1200.0, "fy": 1200.0, "width": 1024, "height": 1024, "distortion": (-0.08, 0.02, 3e-4, -2e-4, 0.0)}
CENTRES = ((511.5, 511.5), (509.0, 512.5))
BASELINE_M = 0.2
GROSS_DEG, GROSS_SHARE, GROSS_SIGMAS = 3.0, 0.01, 4.0
PERIOD_S = 0.16


@dataclass(frozen=True)
class CalibrationErrors:
    """Standard deviations of a calibration: of each principal point, focal length, rotation, baseline and LED.

    distortion_px: at the image's corner. spot_px: least error of a spot that the geometry file states. sync_s: time
    between the exposures of both cameras that it states. focal_scale, led_scale: of both focal lengths
    alike, and of the ring. vibration_px: that it states.
    """

    principal_point_px: float = 0.0
    focal_fraction: float = 0.0
    distortion_px: float = 0.0
    rotation_deg: float = 0.0
    baseline_m: float = 0.0
    led_m: float = 0.0
    spot_px: float = 0.0
    sync_s: float = 0.0
    focal_scale: float = 0.0
    led_scale: float = 0.0
    vibration_px: float = 0.0


EXACT = CalibrationErrors()
VERY_GOOD = CalibrationErrors(0.05, 0.0002, 0.05, 0.003, 0.00003, 0.00005, 0.01)
USUAL = CalibrationErrors(0.2, 0.001, 0.2, 0.02, 0.0001, 0.0001, 0.01, focal_scale=0.001, led_scale=0.003)


def ring_m(radius_m: float = 0.12, raised_m: float = 0.06) -> Array:
    """Return six LEDs on a circle, the first one raised."""
    angles = np.radians(60.0 * np.arange(6))
    leds = np.column_stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.zeros(6)])
    leds[0, 2] = -raised_m
    return leds


def known_geometry(errors: CalibrationErrors | None) -> VmuGeometry:
    """Return the geometry file of the lab, with its tolerances; None: without any."""
    keys = {
        "leds_m": tuple(map(tuple, ring_m().tolist())),
        "left": LENS | {"cx": CENTRES[0][0], "cy": CENTRES[0][1]},
        "right": LENS | {"cx": CENTRES[1][0], "cy": CENTRES[1][1]},
        "baseline_m": (BASELINE_M, 0.0, 0.0),
    }
    if errors is not None and "tolerances" in VmuGeometry.model_fields:
        keys["tolerances"] = dict(errors.__dict__)
    return VmuGeometry.model_validate(keys)


def real_bench(errors: CalibrationErrors, rng: np.random.Generator, optics: PixelOptics) -> PixelScene:
    """Return the real cameras and LEDs behind ``known_geometry`` with random errors of that calibration."""
    corner = np.hypot(512.0, 512.0) / 1200.0
    cameras = []
    focal = 1200.0 * (1.0 + errors.focal_scale * rng.standard_normal()) if errors.focal_scale else 1200.0
    for side in range(2):
        f = focal * (1.0 + errors.focal_fraction * rng.standard_normal())
        cx, cy = np.array(CENTRES[side]) + errors.principal_point_px * rng.standard_normal(2)
        k1, k2, p1, p2, k3 = LENS["distortion"]  # type: ignore[misc]
        k1 += errors.distortion_px / (1200.0 * corner**3) * rng.standard_normal()
        place = (BASELINE_M * side, 0.0, 0.0)
        cameras.append(PixelCamera(f, f, cx, cy, 1024, 1024, (k1, k2, p1, p2, k3), place=place))
    shift = errors.baseline_m * rng.standard_normal(3)
    right = turned(cameras[1], np.radians(errors.rotation_deg) * rng.standard_normal(3))
    right = replace(right, place=tuple(float(x) for x in np.array(right.place) + shift))
    leds = ring_m() + errors.led_m * rng.standard_normal((6, 3))
    if errors.led_scale:
        leds *= 1.0 + errors.led_scale * rng.standard_normal()
    return PixelScene(cameras[0], right, leds, optics)


def somewhere(rng: np.random.Generator, near_m: float = 0.8, far_m: float = 10.0, tilt_deg: float = 20.0) -> Pose:
    """Return a random pose with the whole ring in both images."""
    z = float(np.exp(rng.uniform(np.log(near_m), np.log(far_m))))
    reach = min(0.15, 0.3 * max(z - 0.6, 0.0) / z)
    t = np.array([0.1 + rng.uniform(-reach, reach) * z, rng.uniform(-reach, reach) * z, z])
    axis, tilt = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(0.0, tilt_deg))
    lean = Rotation.from_rotvec(tilt * np.array([np.cos(axis), np.sin(axis), 0.0]))
    return Pose((lean * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])).as_rotvec(), t)


@dataclass(frozen=True)
class Pose:
    """``p_v = exp([turn]x) p_t + t_v``."""

    turn: Array
    t_v: Array

    def error(self, solution: Solution) -> Array:
        """Return the error (6,) of a solution: m, and the small rotation about v's axes, rad."""
        turn = Rotation.from_matrix(solution.R) * Rotation.from_rotvec(self.turn).inv()
        return np.concatenate([solution.t - self.t_v, turn.as_rotvec()])


@dataclass
class Tally:
    """Results of a row. solved: frames with status ok. ratios: errors over sigmas, (6,) each. costs_s: per pair."""

    frames: int = 0
    solved: int = 0
    gross: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    ratios: list[Array] = field(default_factory=list)
    nees: list[float] = field(default_factory=list)
    costs_s: list[float] = field(default_factory=list)

    def add(self, solution: Solution, truth: Pose, cost_s: float) -> None:
        """Count one frame."""
        self.frames += 1
        self.costs_s.append(cost_s)
        self.statuses[solution.status] += 1
        if solution.status != "ok":
            return
        self.solved += 1
        error, covariance = truth.error(solution), solution.covariance
        square = float(error @ np.linalg.solve(covariance, error))
        ratio = error / np.sqrt(np.diag(covariance))
        self.ratios.append(ratio)
        self.nees.append(square)
        off = np.degrees(np.linalg.norm(error[3:])) > GROSS_DEG
        off = off or np.linalg.norm(error[:3]) > GROSS_SHARE * np.linalg.norm(truth.t_v)
        self.gross += bool(off and np.abs(ratio).max() > GROSS_SIGMAS)

    def result(self) -> SeedResult:
        """Return the results for the table."""
        ratios = [float(ratio) for frame in self.ratios for ratio in frame]
        return SeedResult(self.frames, self.solved, self.gross, dict(self.statuses), ratios, self.costs_s)

    @property
    def within(self) -> float:
        """Return the fraction of all components within two sigmas."""
        return float(np.mean(np.abs(self.ratios) < 2.0)) if self.ratios else float("nan")

    def line(self) -> str:
        """Return the row of the table."""
        if not self.ratios:
            return f"{self.solved:3d} of {self.frames}   gross 0 | {dict(self.statuses)}"
        ratios = np.array(self.ratios)
        rms = np.sqrt((ratios**2).mean())
        others = {name: count for name, count in self.statuses.items() if name != "ok"}
        return (
            f"{self.solved:3d} of {self.frames}   gross {self.gross:2d} | error/sigma rms {rms:5.2f} "
            f"max {np.abs(ratios).max():6.1f} | within 2 sigma {100 * self.within:5.1f} % | "
            f"{1e3 * np.median(self.costs_s):4.0f} ms, most {1e3 * max(self.costs_s):4.0f} | {others or ''}"
        )


Frame = tuple[PixelScene, Pose]
Frames = Callable[[np.random.Generator, int], Iterable[Frame]]


@dataclass(frozen=True)
class Row:
    """One row: what the lab's geometry file states, and the frames. tracked: solved one after the other.

    piece: frames of each approach, on a bench of its own; 0: every frame has a pose of its own.
    """

    name: str
    stated: CalibrationErrors | None
    frames: Frames
    tracked: bool = False
    swapped: bool = False
    late: bool = False
    piece: int = 0
    lead_in: int = 0
    """frames of a good track before the disturbance, not counted"""
    expected: Expectation = USUAL_ROW

    def run(self, count: int, seed: int) -> Tally:
        """Return the verdict counts of ``count`` frames."""
        tally, unit = Tally(), VisionUnit(known_geometry(self.stated))
        left = count
        while left > 0:
            frames = min(self.piece or count, left)
            unit.track.drop()
            self._solve(unit, tally, np.random.default_rng([seed, left]), frames)
            left -= frames
        return tally

    def _solve(self, unit: VisionUnit, tally: Tally, rng: np.random.Generator, count: int) -> None:
        """Add ``count`` frames, those of one approach if the row has approaches."""
        previous: np.ndarray | None = None
        uncounted = self.lead_in + self.late  # the first late image has no predecessor
        for k, (scene, truth) in enumerate(self.frames(rng, count + uncounted)):
            left, right = scene.pair(truth.turn, truth.t_v, rng)
            shown = (left, right)
            if self.swapped:
                shown = (right, left)
            if self.late:
                shown, previous = (left, right if previous is None else previous), right
                if k == 0:
                    continue
            if not self.tracked:
                unit.track.drop()
            start = time.process_time()
            solution = unit.solve(shown[0], shown[1], PERIOD_S * k)
            if k >= uncounted:
                tally.add(solution, truth, time.process_time() - start)


def each_bench(errors: CalibrationErrors, optics: PixelOptics | None = None) -> Frames:
    """Return frames that each have random errors of the calibration and a random pose."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            yield real_bench(errors, rng, optics or PixelOptics()), somewhere(rng)

    return frames


def _false_lights(number: int) -> Frames:
    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(VERY_GOOD, rng, PixelOptics()), somewhere(rng)
            z = truth.t_v[2]
            both = number // 2
            lights = np.column_stack([rng.uniform(-0.35, 0.35, (both, 2)) * z, rng.uniform(0.7, 1.3, both) * z])
            lights = np.column_stack([lights, rng.uniform(0.3, 1.2, both)])
            glare = [
                np.column_stack([rng.uniform(20.0, 1000.0, (n, 2)), rng.uniform(0.3, 1.2, n)])
                for n in ((number - both + 1) // 2, (number - both) // 2)
            ]
            yield replace(scene, lights_v=lights, glare=(glare[0], glare[1])), truth

    return frames


@dataclass(frozen=True)
class ApartScene(PixelScene):
    """A bench whose right camera sees the ring at another pose, that of its own exposure."""

    seen_right: Pose = field(kw_only=True)

    def pair(self, turn: Array, t_v: Array, rng: np.random.Generator) -> tuple[Image, Image]:
        """Return the left image of the given pose and the right one of ``seen_right``."""
        return self.image(0, turn, t_v, rng), self.image(1, self.seen_right.turn, self.seen_right.t_v, rng)


def drawn_motion(errors: CalibrationErrors, right_later_s: float) -> Frames:
    """Return frames that each have a bench, a pose and a motion of their own; the right image ``right_later_s`` later.

    Speeds along each axis have a standard deviation of 0.3 m/s, rates of 0.05 rad/s.
    """

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for _ in range(count):
            scene, truth = real_bench(errors, rng, PixelOptics()), somewhere(rng, 1.5, 6.0)
            turn = Rotation.from_rotvec(0.05 * right_later_s * rng.standard_normal(3))
            later = Pose(
                (turn * Rotation.from_rotvec(truth.turn)).as_rotvec(),
                truth.t_v + 0.3 * right_later_s * rng.standard_normal(3),
            )
            yield ApartScene(scene.left, scene.right, scene.leds_m, scene.optics, seen_right=later), truth

    return frames


def approach(errors: CalibrationErrors, speed_mps: float = 0.25, right_later_s: float = 0.0) -> Frames:
    """Return frames of a bench and an approach from 2 to 6 m, every 0.16 s; the right image ``right_later_s`` later."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        scene, phase, from_m = real_bench(errors, rng, PixelOptics()), rng.uniform(0.0, 6.0, 3), rng.uniform(2.0, 6.0)

        def pose_at(t: float) -> Pose:
            z = max(from_m - speed_mps * t, 1.0)
            across = 0.03 * z * np.array([np.sin(0.9 * t + phase[0]), np.cos(0.7 * t + phase[1])])
            turn = np.array([0.08 * np.sin(0.5 * t), 0.08 * np.cos(0.4 * t), 0.4 + 0.05 * t + phase[2]])
            return Pose(turn, np.array([0.1 + across[0], across[1], z]))

        for k in range(count):
            later = pose_at(PERIOD_S * k + right_later_s)
            parts = (scene.left, scene.right, scene.leds_m, scene.optics)
            yield ApartScene(*parts, seen_right=later) if right_later_s else scene, pose_at(PERIOD_S * k)

    return frames


def _glint(lead_in: int) -> Frames:
    """Return an approach with a glint that wanders on the ring after ``lead_in`` frames, as bright as the LEDs."""

    def frames(rng: np.random.Generator, count: int) -> Iterable[Frame]:
        for k, (scene, truth) in enumerate(approach(VERY_GOOD)(rng, count)):
            if k < lead_in:
                yield scene, truth
                continue
            angle, lift = rng.uniform(0.0, 2.0 * np.pi), rng.uniform(-0.06, 0.02)
            spot = np.array([0.12 * np.cos(angle), 0.12 * np.sin(angle), lift])
            place = Rotation.from_rotvec(truth.turn).apply(spot) + truth.t_v
            leds = scene.leds_m[1:] if k % 3 == 0 else scene.leds_m  # now and then the raised LED is hidden too
            yield replace(scene, leds_m=leds, lights_v=np.array([[*place, rng.uniform(0.5, 1.5)]])), truth

    return frames


def _wrong_ring(rng: np.random.Generator, count: int) -> Iterable[Frame]:
    for _ in range(count):
        scene = real_bench(VERY_GOOD, rng, PixelOptics())
        scale = rng.choice([-1.0, 1.0]) * rng.uniform(0.06, 0.2)
        yield replace(scene, leds_m=(1.0 + scale) * ring_m()), somewhere(rng)


def _of(name: str, **errors: float) -> Row:
    """Return the row of a single kind of error, which the geometry file states."""
    single = CalibrationErrors(**errors)
    return Row(name, single, each_bench(single))


_APART = replace(VERY_GOOD, sync_s=0.01)
_FRAME_APART = replace(VERY_GOOD, sync_s=PERIOD_S)
_OVEREXPOSED = PixelOptics(background_levels=250.0, texture_levels=10.0)
_BRIGHT = PixelOptics(background_levels=70.0, texture_levels=15.0)
_SAME = Expectation(drawn=False)
_USUAL, _FRAME_LATER = Expectation(solved=0.9), Expectation(solved=0.6)
_NOT_TOGETHER = Expectation(refused=("rejected_sync", "rejected_geometry_file"))
_OTHER_GEOMETRY = Expectation(refused=("rejected_geometry_file",))

_PIECE = 4

ROWS = (
    Row("clean, known exactly", EXACT, each_bench(EXACT)),
    Row("clean, very good calibration stated", VERY_GOOD, each_bench(EXACT), expected=_SAME),
    _of("principal points 0.05 px", principal_point_px=0.05),
    _of("right camera turned 0.01 deg", rotation_deg=0.01),
    _of("LEDs 0.05 mm off", led_m=5e-5),
    _of("LEDs 0.1 mm off", led_m=1e-4),
    _of("focal lengths 0.2 %", focal_fraction=2e-3),
    _of("baseline 0.1 mm", baseline_m=1e-4),
    Row("coma 0.5 px", VERY_GOOD, each_bench(VERY_GOOD, PixelOptics(coma_px=0.5))),
    Row("halo of 10 %", VERY_GOOD, each_bench(VERY_GOOD, PixelOptics(halo=0.1))),
    Row("bright textured background", VERY_GOOD, each_bench(VERY_GOOD, _BRIGHT)),
    Row("20 false lights", VERY_GOOD, _false_lights(20)),
    Row("50 false lights", VERY_GOOD, _false_lights(50)),
    Row("very good calibration", VERY_GOOD, each_bench(VERY_GOOD)),
    Row("usual calibration", USUAL, each_bench(USUAL), expected=_USUAL),
    Row("usual calibration, nothing stated", None, each_bench(USUAL), expected=_USUAL),
    Row("very good calibration, tracked", VERY_GOOD, approach(VERY_GOOD), tracked=True, piece=_PIECE),
    Row("10 ms between the cameras", _APART, drawn_motion(VERY_GOOD, 0.01)),
    Row(
        "10 ms between the cameras, tracked", _APART, approach(VERY_GOOD, right_later_s=0.01), tracked=True,
        piece=_PIECE,
    ),
    Row("10 ms apart, not stated", VERY_GOOD, drawn_motion(VERY_GOOD, 0.01), expected=_NOT_TOGETHER),
    Row(
        "glint on a tracked ring", VERY_GOOD, _glint(12), tracked=True, piece=_PIECE, lead_in=12,
        expected=Expectation(0.5),
    ),
    Row(
        "right images one frame late", VERY_GOOD, approach(VERY_GOOD), late=True, piece=_PIECE,
        expected=_NOT_TOGETHER,
    ),
    Row(
        "right images late, tracked", VERY_GOOD, approach(VERY_GOOD), late=True, tracked=True, piece=_PIECE,
        expected=_NOT_TOGETHER,
    ),
    Row(
        "right images late, default tolerances", None, approach(USUAL), late=True, piece=_PIECE,
        expected=_NOT_TOGETHER,
    ),
    Row("right images late, stated", _FRAME_APART, drawn_motion(VERY_GOOD, -PERIOD_S), expected=_FRAME_LATER),
    Row("cameras swapped", VERY_GOOD, each_bench(VERY_GOOD), swapped=True, expected=_OTHER_GEOMETRY),
    Row("wrong ring", VERY_GOOD, _wrong_ring, expected=_OTHER_GEOMETRY),
    Row(
        "overexposed background", VERY_GOOD, each_bench(VERY_GOOD, _OVEREXPOSED),
        expected=Expectation(refused=("rejected_bright",)),
    ),
)  # fmt: skip
