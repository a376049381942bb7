"""Emulated cameras of vision unit and docking monitor: images of the emulated axes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

import numpy as np

from hil.bench.kinematics import pose_on_bench
from hil.config.load import load_scene
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.camera_images import MONITOR
from hil.core.clock import WallClock
from hil.core.messages import Array
from hil.drivers.cameras.base import SIDES
from hil.errors import BadInput
from hil.maths.random_streams import stream
from hil.params import bench as bench_params
from hil.parts.cameras.pose_sensor import estimator_of_unit
from hil.parts.cameras.rendered import RenderedCameras
from hil.parts.emulation.cameras import CameraEmulator
from hil.parts.emulation.emulated_vision import SeenAxes, seen_axes
from hil.parts.emulation.shared_state import SharedAxisState
from hil.parts.monitor import params as monitor_params
from hil.parts.monitor.camera import view
from hil.parts.monitor.render import Conditions, TargetRenderer
from hil.parts.monitor.setup import MONITOR_ADDRESS
from hil.sensors.vision_unit import parameters as vmu_params
from hil.session.assembly import start_axes
from hil.vmu.estimators import board_of
from hil.vmu.geometry import geometry_of_rig
from hil.vmu.sources import ImageFolder

_EXPOSURE_S: Final = 0.01
Images = Callable[[float], np.ndarray]
"""Image, (height, width), uint8, of an exposure at a bench time, s."""


def emulated_images(scenario: Scenario, rig: Rig, seed: int, board: SharedAxisState, side: str) -> Images:
    """Return the images of the camera ``side`` over bench time, s; its kernels are compiled when this returns."""
    return _images(scenario, rig, seed, SIDES.index(side), seen_axes(scenario, rig, board))


def _images(scenario: Scenario, rig: Rig, seed: int, camera: int, seen: SeenAxes) -> Images:
    cameras = rendered_cameras(scenario, rig, seed)
    noise, warm_up = stream(seed, "pictures").spawn(2)[camera], stream(seed, "pictures")
    start = start_axes(scenario, rig)
    cameras.image(camera, start.rail_m, start.gimbal_rad, warm_up)
    return lambda t_s: cameras.image(camera, *seen(t_s), noise)


def rendered_cameras(scenario: Scenario, rig: Rig, seed: int) -> RenderedCameras:
    """Return the renderer of the vision unit of ``rig``."""
    bench = bench_params.bench_as_built(rig, scenario.step_s, scenario.bench)
    mounting = vmu_params.mounting_as_built(rig, scenario)
    board, rng = board_of(estimator_of_unit(rig.vmu)), stream(seed, "pictures")
    return RenderedCameras(bench, mounting, geometry_of_rig(rig), scenario.vmu.images, rng, board)


def emulated_television(
    scenario: Scenario, rig: Rig, seed: int, board: SharedAxisState, clock: WallClock
) -> CameraEmulator:
    """Return the television camera of the docking monitor, which observes the axes of ``board``.

    Its images are as bright as the scene at an exposure of 10 ms, and in proportion at others.
    """
    config = scenario.monitor
    scene = load_scene(config.scene).value
    renderer = TargetRenderer(scene, scene.chosen(config.target), Conditions(blur_px=config.blur_px))
    bench, mounting, noise = (
        bench_params.bench_as_built(rig, scenario.step_s, scenario.bench),
        monitor_params.mounting(config),
        stream(seed, "monitor"),
    )
    r, q = np.empty(3), np.empty(4)

    def image_of(rail_m: Array, gimbal_rad: Array) -> np.ndarray:
        pose_on_bench(bench, rail_m, gimbal_rad, r, q)
        d, phi = view(mounting, r, q)
        return renderer.frame(0, lambda _: (d, phi), noise).image

    seen = seen_axes(scenario, rig, board)

    def image_at(t_s: float) -> np.ndarray:
        return image_of(*seen(t_s))

    start = start_axes(scenario, rig)
    image_of(start.rail_m, start.gimbal_rad)  # compiles
    size, address = (scene.camera.width, scene.camera.height), rig.monitor_camera.camera or MONITOR_ADDRESS
    return CameraEmulator(MONITOR, address, clock, image_at, size, _EXPOSURE_S, rig.monitor_camera.emulated)


def images_at_start(scenario: Scenario, rig: Rig) -> tuple[Images, Images]:
    """Return the images of both cameras with the axes at the start of ``scenario``, each with noise of its own."""
    start = start_axes(scenario, rig)
    left, right = (_images(scenario, rig, 0, side, lambda _: (start.rail_m, start.gimbal_rad)) for side in range(2))
    return left, right


def images_of_folder(folder: Path, rig: Rig) -> tuple[Images, Images]:
    """Return the images of ``folder``, one per period of the vision unit from the first exposure on, then the last one.

    A missing or damaged image is black. Raises BadInput for images of another size than the rig's cameras.
    """
    images = ImageFolder(folder)
    size = rig.vmu.camera.height_px, rig.vmu.camera.width_px
    black = np.zeros(size, np.uint8)
    for pair in images:
        for image in (pair.left, pair.right):
            if image is not None and image.shape != size:
                text = (
                    f"frame {pair.frame} is {image.shape[1]} x {image.shape[0]}, the cameras are {size[1]} x {size[0]}"
                )
                raise BadInput.single(str(folder), "", text)

    first_s: list[float] = []

    def images_of(side: str) -> Images:
        def image_at(t_s: float) -> np.ndarray:
            if not first_s:
                first_s.append(t_s)
            exposure = max(0, round((t_s - first_s[0]) * rig.vmu.rate_hz))
            frame = images.frames[min(exposure, len(images.frames) - 1)]
            image: np.ndarray | None = getattr(images.pair(frame), side)
            return black if image is None else image

        return image_at

    return images_of("left"), images_of("right")
