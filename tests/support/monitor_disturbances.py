"""Rows of disturbances for the docking monitor: what lens, sensor, time and scene file do to its results."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from hil.config.load import load_scene
from hil.config.scene import CameraTolerances, Scene
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.results import QUANTITIES, Result
from hil.parts.monitor.sources import VideoFrame
from tests.support.disturbance_verdicts import USUAL_ROW, Expectation, SeedResult
from tests.support.tv_pixels import TvCamera, TvTarget

Array = npt.NDArray[np.float64]
FRAMES = 10
EXACT = CameraTolerances.model_validate(dict.fromkeys(CameraTolerances.model_fields, 0.0))
GROSS_DEG, GROSS_SHARE, GROSS_SIGMAS = 3.0, 0.01, 4.0


@dataclass
class MonitorTally:
    """Results of a row. ratios: errors over sigmas of the values of each portion."""

    portions: int = 0
    measured: int = 0
    gross: int = 0
    consistent: int = 0
    statuses: Counter[str] = field(default_factory=Counter)
    ratios: list[Array] = field(default_factory=list)
    costs_s: list[float] = field(default_factory=list)

    def result(self) -> SeedResult:
        """Return the results for the table."""
        ratios = [float(ratio) for portion in self.ratios for ratio in portion]
        return SeedResult(self.portions, self.measured, self.gross, dict(self.statuses), ratios, self.costs_s)

    def add(self, found: Result, truth: Array, cost_s: float) -> None:
        """Count a portion; truth: (12,), by QUANTITIES; cost_s: processor time."""
        self.costs_s.append(cost_s)
        self.portions += 1
        self.statuses[found.status] += 1
        seen = np.isfinite(found.values)
        if not seen.any():
            return
        self.measured += 1
        self.consistent += found.consistent
        error = found.values - truth
        ratio = np.abs(error / found.sigmas)
        self.ratios.append((error / found.sigmas)[seen])
        for k, name in enumerate(QUANTITIES):
            if not seen[k] or ratio[k] <= GROSS_SIGMAS or name.endswith("mps"):
                continue
            limit = np.radians(GROSS_DEG) if name.endswith("rad") else GROSS_SHARE * truth[6]
            self.gross += bool(abs(error[k]) > limit)

    def line(self) -> str:
        """Return the row of the table."""
        if not self.ratios:
            return f"{self.measured:3d} of {self.portions}   gross 0 | {dict(self.statuses)}"
        ratios = np.concatenate(self.ratios)
        return (
            f"{self.measured:3d} of {self.portions}   gross {self.gross:2d} | error/sigma rms "
            f"{np.sqrt((ratios**2).mean()):7.2f} max {np.abs(ratios).max():7.1f} | within 2 sigma "
            f"{100 * np.mean(np.abs(ratios) < 2.0):5.1f} % | consistent {self.consistent} | {dict(self.statuses)}"
        )


@dataclass(frozen=True)
class MonitorRow:
    """One row. draw: the real camera of a portion. stated: tolerances of the scene file. lost: frames left out.

    plate_m: place of the plate along y3 in the scene file. roll_deg: of the real ship, beyond its usual few degrees.
    roll_max_deg: in the scene file; None: as shipped. boxes: whether the ship has its boxes, in the scene file too.
    frozen: number of images that are the one before, unsynced: that begin at another line. rate: of the real images,
    relative to that of the scene file, by which they are stamped.
    """

    name: str
    draw: Callable[[np.random.Generator], TvCamera]
    stated: CameraTolerances | None = None
    lost: int = 0
    said_fields: str = "whole"
    plate_m: float = 0.0
    roll_deg: float = 0.0
    roll_max_deg: float | None = None
    boxes: bool = True
    frozen: int = 0
    unsynced: int = 0
    rate: float = 1.0
    expected: Expectation = USUAL_ROW

    def scene(self) -> Scene:
        """Return the scene file of the lab."""
        scene = load_scene("atv").value
        camera = scene.camera.model_copy(update={"tolerances": self.stated or EXACT})
        plate = scene.target.plate.model_copy(update={"offset_m": self.plate_m})  # type: ignore[union-attr]
        parts = {"plate": plate} | ({} if self.boxes else {"boxes": ()})
        target = scene.target.model_copy(update=parts)
        changed = {"camera": camera, "fields": self.said_fields, "target": target}
        if self.roll_max_deg is not None:
            changed["roll_max_deg"] = self.roll_max_deg
        return scene.model_copy(update=changed)

    def run(self, portions: int, seed: int) -> MonitorTally:
        """Return the verdict counts of ``portions`` portions, each of a new monitor."""
        tally = MonitorTally()
        for number in range(portions):
            self.add_portion(tally, number, seed)
        return tally

    def add_portion(self, tally: MonitorTally, number: int, seed: int) -> None:
        """Measure one portion by a new monitor."""
        scene, rng = self.scene(), np.random.default_rng([seed, number])
        camera, w = self.draw(rng), random_approach(rng)
        if self.roll_deg:
            _turn_ship(w, np.radians(self.roll_deg))
        target, monitor = TvTarget(scene, camera), DockingMonitor(scene)
        left_out = (
            set(rng.choice(np.arange(2, FRAMES + self.lost - 2), self.lost, replace=False)) if self.lost else set()
        )
        still = int(rng.integers(1, FRAMES - self.frozen + 1)) if self.frozen else FRAMES
        rolled = set(rng.choice(FRAMES, self.unsynced, replace=False).tolist()) if self.unsynced else set()
        held: Array | None = None
        shown, found = 0, []
        last_s, cost_s = 0.0, 0.0
        for k in range(FRAMES + self.lost):
            if k in left_out:
                continue
            t_s = k / (scene.fps * self.rate)
            image = target.frame(lambda t, w=w: (w[0:6:2] + t * w[1:6:2], w[6::2] + t * w[7::2]), t_s, rng)
            if held is not None and still <= k < still + self.frozen:
                image = held
            elif k in rolled:
                image = np.roll(image, int(rng.integers(image.shape[0])), axis=0)
            held = image
            start = time.process_time()
            found += (
                monitor.feed(image)
                if self.said_fields != "whole"
                else monitor.feed(VideoFrame(shown, shown / scene.fps, image))
            )
            cost_s += time.process_time() - start
            shown, last_s = shown + 1, t_s
            if found:
                break
        found += monitor.finish()
        end_s = last_s if self.said_fields == "whole" else found[0].t_s
        tally.add(found[0], portion_truth(w, end_s), cost_s)


def _turn_ship(w: Array, roll: float) -> None:
    """Turn the ship in ``w`` (12,) about its axis y3, without a rotation of its own."""
    turn = Rotation.from_rotvec([0.0, 0.0, -roll]).as_matrix()
    w[0:6:2], w[1:6:2] = turn @ w[0:6:2], turn @ w[1:6:2]
    flip = np.diag([1.0, -1.0, -1.0])
    rotation = flip @ turn @ flip @ Rotation.from_rotvec(w[6::2]).as_matrix()
    w[6::2], w[7::2] = Rotation.from_matrix(rotation).as_rotvec(), 0.0


def random_approach(rng: np.random.Generator) -> Array:
    """Return (12,) of an approach between 3 and 12 m with the target in the image."""
    d3 = float(np.exp(rng.uniform(np.log(3.0), np.log(12.0))))
    passive, sight = rng.uniform(-0.05, 0.05, 2), rng.uniform(-0.03, 0.03, 2)
    place = [
        passive[0] * d3,
        passive[1] * d3,
        d3,
        passive[1] + sight[1],
        -passive[0] + sight[0],
        rng.uniform(-0.06, 0.06),
    ]
    speed = 0.02 * d3
    rates = [*(rng.uniform(-0.1, 0.1, 2) * speed), rng.uniform(-1.0, 1.0) * speed, *rng.normal(0.0, 1e-3, 3)]
    w = np.empty(12)
    w[0::2], w[1::2] = place, rates
    return w


def portion_truth(w: Array, t_s: float) -> Array:
    """Return QUANTITIES (12,) at ``t_s``."""
    d, phi, rate = w[0:6:2] + t_s * w[1:6:2], w[6::2] + t_s * w[7::2], w[1:6:2]
    a = np.diag([1.0, -1.0, -1.0]) @ Rotation.from_rotvec(phi).as_matrix()
    x = -a.T @ d
    away = float(np.linalg.norm(d))
    angles = [np.arctan2(d[1], np.hypot(d[0], d[2])), np.arctan2(d[0], d[2])]
    return np.array([*d, *phi, away, d @ rate / away, *angles, np.arctan2(x[0], x[2]), np.arctan2(x[1], x[2])])


def _stated(**tolerances: float) -> CameraTolerances:
    """Return the given tolerances and no others."""
    return EXACT.model_copy(update=tolerances)


def _always(**errors: float | str) -> Callable[[np.random.Generator], TvCamera]:
    return lambda _: TvCamera(**errors)  # type: ignore[arg-type]


def _normal(**sigmas: float) -> Callable[[np.random.Generator], TvCamera]:
    return lambda rng: TvCamera(**{name: sigma * rng.standard_normal() for name, sigma in sigmas.items()})


def _film(rng: np.random.Generator) -> TvCamera:
    """Return a television camera with all of its errors, as on a recording of an approach."""
    return TvCamera(
        f_share=0.01 * rng.standard_normal(),
        aspect=0.01 * rng.standard_normal(),
        distortion=0.011 * rng.standard_normal(),
        gain=rng.uniform(0.9, 1.4),
        gamma=float(np.exp(0.2 * rng.standard_normal())),
        s_curve=rng.uniform(0.0, 0.4),
        jitter_px=0.2,
        fields="upper_first",
        blur_px=rng.uniform(0.7, 1.1),
        noise_levels=4.0,
    )


_TONE = _stated(tone_px=0.2)
_FILM = _stated(focal_fraction=0.01, aspect_fraction=0.01, distortion_px=1.0, tone_px=0.2)
_SAME = Expectation(drawn=False)
_NO_ROLL = Expectation(drawn=False)

MONITOR_ROWS = (
    MonitorRow("clean", _always()),
    MonitorRow("overexposed x1.6", _always(gain=1.6)),
    MonitorRow("overexposed x1.6, tone curve estimated", _always(gain=1.6), _TONE, expected=_SAME),
    MonitorRow("gamma 0.6", _always(gamma=0.6), _TONE, expected=_SAME),
    MonitorRow("gamma 1.6", _always(gamma=1.6), _TONE, expected=_SAME),
    MonitorRow("S-curve", _always(s_curve=0.8), _TONE, expected=_SAME),
    MonitorRow("distortion, 2 px at the corner", _normal(distortion=0.0219), _stated(distortion_px=2.0)),
    MonitorRow("focal length 1 %", _normal(f_share=0.01), _stated(focal_fraction=0.01)),
    MonitorRow("focal length 3 %", _normal(f_share=0.03), _stated(focal_fraction=0.03)),
    MonitorRow("aspect 1 %", _normal(aspect=0.01), _stated(aspect_fraction=0.01)),
    MonitorRow("aspect 3 %", _normal(aspect=0.03), _stated(aspect_fraction=0.03)),
    MonitorRow("lost frames", _always(), lost=2),
    MonitorRow("30 % of the frames lost", _always(), lost=4),
    MonitorRow("video frozen for 5 of 10 frames", _always(), frozen=5),
    MonitorRow("vertical sync lost in 3 of 10 frames", _always(), unsynced=3),
    MonitorRow("half a field of time", _always(fields="upper_first"), _stated(time_s=0.02), expected=_SAME),
    MonitorRow("wrong field order", _always(fields="lower_first"), said_fields="upper_first"),
    MonitorRow("vibration of 0.5 px", _always(jitter_px=0.5)),
    MonitorRow("shadow next to an arm", _always(shadow=0.4)),
    MonitorRow("low noise", _always(noise_levels=0.5, finer=True)),
    MonitorRow("low noise, edges off by 0.02 px", _always(noise_levels=0.5, coarse=True), expected=_SAME),
    MonitorRow("plate 1 mm behind the disc", _always(plate_behind_m=0.001), expected=_SAME),
    MonitorRow("plate 1 mm behind the disc, stated", _always(), plate_m=-0.001),
    MonitorRow("focal length 0.5 %, not stated", _always(f_share=0.005), CameraTolerances(), expected=_SAME),
    MonitorRow("1 px at the corner, not stated", _always(distortion=0.011), CameraTolerances(), expected=_SAME),
    MonitorRow("ship rolled by 60 deg", _always(), roll_deg=60.0, roll_max_deg=180.0, expected=_NO_ROLL),
    MonitorRow("ship rolled by 90 deg", _always(), roll_deg=90.0, roll_max_deg=180.0, expected=_NO_ROLL),
    MonitorRow("ship rolled by 180 deg", _always(), roll_deg=180.0, roll_max_deg=180.0, expected=_NO_ROLL),
    MonitorRow("ship without boxes, any roll", _always(), roll_max_deg=180.0, boxes=False, expected=_NO_ROLL),
    MonitorRow(
        "ship without boxes, rolled by 90 deg", _always(), roll_deg=90.0, roll_max_deg=180.0, boxes=False,
        expected=_NO_ROLL,
    ),
    MonitorRow("ship without boxes, roll stated", _always(), boxes=False),
    *(
        MonitorRow(f"gamma {gamma:g}, default tolerances", _always(gamma=gamma), CameraTolerances(), expected=_SAME)
        for gamma in (0.4, 0.6, 1.6, 2.5)
    ),
    MonitorRow("S-curve, default tolerances", _always(s_curve=0.8), CameraTolerances(), expected=_SAME),
    MonitorRow("logarithm, default tolerances", _always(log_curve=10.0), CameraTolerances(), expected=_SAME),
    *(
        MonitorRow(f"noise of {noise:g} levels, parts displaced by 0.03 px", _always(noise_levels=noise, parts_px=0.03),
            CameraTolerances(), expected=_SAME)
        for noise in (0.5, 1.0, 2.0, 10.0)
    ),
    MonitorRow("noise of 20 levels", _always(noise_levels=20.0), CameraTolerances(), expected=_SAME),
    MonitorRow(
        "focal length drifts by 0.06 % per s, stated", _normal(f_drift=6e-4),
        _stated(focal_drift_per_s=6e-4, focal_fraction=1e-3), expected=_SAME
    ),
    MonitorRow(
        "23.976 images per second taken for 25, stated", _always(), CameraTolerances(rate_fraction=0.05),
        rate=23.976 / 25.0, expected=_SAME
    ),
    MonitorRow(
        "aspect 1 %, not stated", _always(aspect=0.01), CameraTolerances(),
        expected=Expectation(refused=("rejected_camera",)),
    ),
    MonitorRow("television film", _film, _FILM, said_fields="upper_first"),
)  # fmt: skip
