"""A ring of LEDs before two cameras, and the spots of it that the tests hand to the vision unit."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from hil.config.vmu_geometry import VmuGeometry
from hil.core.messages import Array
from hil.vmu.geometry import EXACT, camera_pair, led_positions
from hil.vmu.kernels.hypotheses import difference
from hil.vmu.kernels.lens import in_image
from hil.vmu.kernels.records import SPOT
from hil.vmu.pose import Prediction, matrix_of
from hil.vmu.render import projections
from hil.vmu.unit import Pose

SIGMA_PX = 0.05
LENS = {"fx": 1200.0, "fy": 1200.0, "width": 1024, "height": 1024, "distortion": (-0.08, 0.02, 3e-4, -2e-4, 0.0)}


def ring(raised_m: float = 0.06, marked_led: int | None = None) -> VmuGeometry:
    """Return six LEDs on a circle, the first one raised, before two cameras 0.2 m apart."""
    angles = np.radians(60.0 * np.arange(6))
    leds = np.column_stack([0.12 * np.cos(angles), 0.12 * np.sin(angles), np.zeros(6)])
    leds[0, 2] = -raised_m
    return VmuGeometry.model_validate(
        {
            "leds_m": tuple(tuple(float(v) for v in led) for led in leds),
            "left": LENS | {"cx": 511.5, "cy": 511.5},
            "right": LENS | {"cx": 509.0, "cy": 512.5},
            "baseline_m": (0.2, 0.0, 0.0),
            "marked_led": marked_led,
            "tolerances": EXACT,
        }
    )


@dataclass(frozen=True)
class Truth:
    """A pose ``p_v = exp([turn]x) p_t + t``."""

    t: Array
    turn: Array

    @property
    def q(self) -> Array:
        return np.asarray(Rotation.from_rotvec(-self.turn).as_quat())

    def error(self, pose: Pose) -> Array:
        """Return the error (6,) of ``pose``: m, and the small rotation about v's axes, rad."""
        out = np.empty(6)
        difference(matrix_of(pose.q_vt), pose.t_v, matrix_of(self.q), self.t, out)
        return out

    def nees(self, pose: Pose) -> float:
        """Return the error's normalised square, six components."""
        e = self.error(pose)
        return float(e @ np.linalg.solve(pose.covariance, e))

    def prediction(self, rng: np.random.Generator, sigma_m: float = 0.03, sigma_deg: float = 1.5) -> Prediction:
        """Return a prediction whose error matches its covariance."""
        sigmas = np.repeat([sigma_m, np.radians(sigma_deg)], 3)
        e = sigmas * rng.standard_normal(6)
        turned = Rotation.from_rotvec(e[3:]) * Rotation.from_rotvec(self.turn)
        return Prediction(self.t + e[:3], np.asarray(turned.inv().as_quat()), np.diag(sigmas**2))


def somewhere(rng: np.random.Generator, near_m: float = 1.3, far_m: float = 10.0, tilt_deg: float = 25.0) -> Truth:
    """Return a random pose within the view of both cameras."""
    z = float(np.exp(rng.uniform(np.log(near_m), np.log(far_m))))
    t = np.array([rng.uniform(-0.1, 0.1) * z + 0.1, rng.uniform(-0.15, 0.15) * z, z])
    axis, tilt = rng.uniform(0.0, 2.0 * np.pi), np.radians(rng.uniform(0.0, tilt_deg))
    lean = Rotation.from_rotvec(tilt * np.array([np.cos(axis), np.sin(axis), 0.0]))
    return Truth(t, (lean * Rotation.from_rotvec([0.0, 0.0, rng.uniform(-np.pi, np.pi)])).as_rotvec())


def spots_of(
    geometry: VmuGeometry,
    truth: Truth,
    rng: np.random.Generator,
    lit: tuple[int, ...] = (0, 1, 2, 3, 4, 5),
    decoys: int = 0,
    black: int | None = None,
    bright: int | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return the spots of both images in random order. decoys: lights in space. bright: LED of twice the flux."""
    pair = camera_pair(geometry)
    near = [truth.t * rng.uniform(0.8, 1.2) + rng.uniform(-0.2, 0.2, 3) * truth.t[2] for _ in range(decoys)]
    leds = projections(pair, led_positions(geometry), truth.t, truth.q)
    strays = projections(pair, np.array(near).reshape(-1, 3), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))
    found = []
    for c in range(2):
        lights = [(leds[c, n], 1000.0 if n == bright else 500.0) for n in lit] + [(uv, 500.0) for uv in strays[c]]
        lights = [light for light in lights if in_image(pair.lens[c], *light[0], 1.0)]
        spots = np.zeros(0 if c == black else len(lights), SPOT)
        for spot, (uv, flux) in zip(spots, lights, strict=False):
            spot["u"], spot["v"] = uv + SIGMA_PX * rng.standard_normal(2)
            spot["var_u"] = spot["var_v"] = SIGMA_PX**2
            spot["flux"], spot["size"] = flux, 1.2
        rng.shuffle(spots)
        found.append(spots)
    return found[0], found[1]
