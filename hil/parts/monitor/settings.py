"""Settings of the docking monitor; the defaults are for a docking approach."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from hil.config.scene import SceneCamera
from hil.parts.monitor.kernels.measure import TUNING


@dataclass(frozen=True)
class Region:
    """A rectangle of the image, px: columns left..right, lines top..bottom, the ends excluded."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def of_box(cls, u: int, v: int, width: int, height: int) -> Region:
        """Return the region whose first pixel is (u, v), px."""
        return cls(u, v, u + width, v + height)

    @property
    def width(self) -> int:
        """Columns."""
        return self.right - self.left

    @property
    def height(self) -> int:
        """Lines."""
        return self.bottom - self.top

    def contains(self, u: float, v: float) -> bool:
        """Return whether the point (u, v), px, is in the region."""
        return self.left <= u < self.right and self.top <= v < self.bottom


@dataclass(frozen=True)
class MonitorSettings:
    """Settings of a run.

    region: initial search region, px; the whole image if that fails. target: one of the scene's two. q,
    q_attitude: weight of the previous portion.
    acceleration_mps2, angular_acceleration_radps2: 1 sigma of the deviation from uniform motion within a portion.
    portion_frames, portion_s: a portion ends after this number of frames, or after this time. lost_s: time without a
    result after which the track is lost. growth_px: 1 sigma of the edges' growth, camera_s: time over which it and the
    other unknowns of the camera keep their values.
    """

    region: Region | None = None
    target: Literal["basic", "backup"] = "basic"
    q: float = 0.5
    q_attitude: float = 0.5
    acceleration_mps2: float = 2e-3
    angular_acceleration_radps2: float = 3e-4
    portion_frames: int = 10
    portion_s: float = 1.0
    lost_s: float = 2.0
    growth_px: float = 0.1
    camera_s: float = 30.0
    passive_angle_rad: float = 0.1
    near_bar_px: float = 2.0
    sample_px: float = 8.0
    samples_per_edge: int = 48

    def camera_sigmas(self, camera: SceneCamera) -> list[float]:
        """Return the prior 1 sigma of each unknown of the camera (``kernels/pose.py``); 0: it is not estimated."""
        stated = camera.tolerances
        point = [stated.principal_point_px] * 2
        return [
            self.growth_px, *[stated.tone_px] * 3, stated.focal_fraction, stated.aspect_fraction, *point,
            stated.distortion_px,
        ]  # fmt: skip

    def tuning(self, camera: SceneCamera) -> np.void:
        """Return the settings used by the kernels."""
        row: np.void = np.zeros(1, TUNING)[0]
        row["length"], row["most"], row["wide_bar"], row["wanted"] = self.sample_px, self.samples_per_edge, 7.0, 4.5
        row["reject"], row["rounds"], row["near_bar"] = 4.5, 2, self.near_bar_px
        row["prior"] = [self.passive_angle_rad, *self.camera_sigmas(camera)]
        return row
