"""Pose sensor with rendered images: renders the stereo pair and solves it with the vision unit."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from hil.bench.kinematics import pose_on_bench
from hil.config.scenario import RenderedImages
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import LEFT, RIGHT, CameraImage, ImageSink, Shape
from hil.core.messages import Array, PoseFrame
from hil.maths import quat
from hil.sensors.mounting import camera_pose
from hil.vmu.estimators import FlatTarget, PoseEstimator, Solved, solve_pair
from hil.vmu.geometry import camera_pair, led_positions
from hil.vmu.overlay import shapes
from hil.vmu.render import Extras, Light, RingAppearance, RingRenderer
from hil.vmu.unit import Solution, VisionUnit

if TYPE_CHECKING:
    from hil.vmu.board_render import BoardRenderer

_DECOY_NEAREST_M: Final = 0.25  # from the ring's centre, in its plane
_DECOY_FARTHEST_M: Final = 1.0


class RenderedCameras:
    """Renders the stereo pair of the axis positions.

    bench: BENCH_PARAMS. mounting: MOUNTING. scene: the rendered geometry. rng: draws the positions of other lights.
    board: printed target in place of the LED ring.
    """

    def __init__(
        self,
        bench: np.record,
        mounting: np.record,
        scene: VmuGeometry,
        pictures: RenderedImages,
        rng: np.random.Generator,
        board: FlatTarget | None = None,
    ) -> None:
        self._bench = bench
        self._mounting = mounting
        appearance = RingAppearance(
            psf_sigma_px=pictures.psf_sigma_px,
            led_diameter_m=pictures.led_diameter_m,
            flux_1m_levels=pictures.led_flux_1m_levels,
            background_levels=pictures.background_levels,
            electrons_per_level=pictures.electrons_per_level,
            read_noise_levels=pictures.read_noise_levels,
        )
        self._renderer = RingRenderer(camera_pair(scene), led_positions(scene), appearance)
        self._board = _board_renderer(scene, board, appearance)
        self._decoys = _decoys(rng, pictures.decoy_lights)
        self._r, self._q = np.empty(3), np.empty(4)

    def pair(self, rail_m: Array, gimbal_rad: Array, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Return the images (h, w) of axes at ``rail_m`` (3,) and ``gimbal_rad`` (3,), with noise of ``rng``."""
        t_v, q_vt, extras = self._view(rail_m, gimbal_rad)
        if self._board is not None:
            return self._board.image(0, t_v, q_vt, rng), self._board.image(1, t_v, q_vt, rng)
        return self._renderer.pair(t_v, q_vt, None, rng, extras)

    def image(self, camera: int, rail_m: Array, gimbal_rad: Array, rng: np.random.Generator) -> np.ndarray:
        """Return the image of one camera (0 left, 1 right)."""
        t_v, q_vt, extras = self._view(rail_m, gimbal_rad)
        if self._board is not None:
            return self._board.image(camera, t_v, q_vt, rng)
        return self._renderer.image(camera, t_v, q_vt, None, rng, extras)

    def _view(self, rail_m: Array, gimbal_rad: Array) -> tuple[Array, Array, Extras]:
        t_v, q_vt = np.empty(3), np.empty(4)
        pose_on_bench(self._bench, rail_m, gimbal_rad, self._r, self._q)
        camera_pose(self._mounting, self._r, self._q, t_v, q_vt)
        lights = [Light(tuple(quat.transform(q_vt, position) + t_v)) for position in self._decoys]
        return t_v, q_vt, Extras(lights=lights)


class RenderedPoseSensor:
    """Renders the stereo pair of the axis positions and returns the pose solved from it.

    cameras: with the rendered geometry; estimator: with the geometry that the unit assumes. rng: noise of the images.
    Every error of the bench, and of the calibration if they differ, affects the pose as it would in a lab.
    shown: receives the images with their overlay. only_noise: the poses' covariance covers the noise alone.
    """

    def __init__(
        self,
        cameras: RenderedCameras,
        estimator: PoseEstimator,
        rng: np.random.Generator,
        shown: ImageSink | None = None,
        only_noise: bool = False,
    ) -> None:
        self._cameras = cameras
        self._estimator = estimator
        self._rng = rng
        self._shown = shown
        self._only_noise = only_noise
        self._exposures = 0

    def measure(self, rail_m: Array, gimbal_rad: Array, t_s: float) -> PoseFrame | None:
        """Return the pose solved from the images of axes at ``rail_m`` (3,) and ``gimbal_rad`` (3,)."""
        left, right = self._cameras.pair(rail_m, gimbal_rad, self._rng)
        solution = solve_pair(self._estimator, left, right, t_s)
        if self._shown is not None:
            self._show(self._shown, left, right, solution, t_s)
        self._exposures += 1
        return solution.frame(0, t_s, self._only_noise)

    def _show(self, shown: ImageSink, left: np.ndarray, right: np.ndarray, solution: Solved, t_s: float) -> None:
        """Send the pair with its overlay, if due."""
        if not shown.due(t_s):
            return
        views = (
            CameraImage(
                name,
                image,
                bench_s=t_s,
                number=self._exposures,
                status=solution.status,
                shapes=self._overlay(solution, camera),
            )
            for camera, (name, image) in enumerate(((LEFT, left), (RIGHT, right)))
        )
        shown.put(*views)

    def _overlay(self, solution: Solved, camera: int) -> list[Shape]:
        """Return the overlay of an image; only the LED ring has one."""
        unit = self._estimator
        if not (isinstance(unit, VisionUnit) and isinstance(solution, Solution)):
            return []
        return shapes(unit.solver.scene, solution, camera)


def _board_renderer(scene: VmuGeometry, board: FlatTarget | None, appearance: RingAppearance) -> BoardRenderer | None:
    if board is None:
        return None
    from hil.vmu.board_render import BoardRenderer  # needs OpenCV

    return BoardRenderer(camera_pair(scene), board, appearance)


def _decoys(rng: np.random.Generator, count: int) -> Array:
    """Return positions of lights around the ring, in its plane, (count, 3), m, in t."""
    angle, distance = rng.uniform(0.0, math.tau, count), rng.uniform(_DECOY_NEAREST_M, _DECOY_FARTHEST_M, count)
    return np.column_stack([distance * np.cos(angle), distance * np.sin(angle), np.zeros(count)])
