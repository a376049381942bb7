"""``hil cameras aid``: a live page for the set-up of two cameras."""

from __future__ import annotations

import time
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import Parameter
from rich.console import Console

from hil.cli.options import Flag, Group, Integer, refuse, within
from hil.cli.output import say
from hil.errors import BadInput, Problem
from hil.parts.cameras.cli.cameras import CameraOptions, open_camera_of, option_problems, size_of, take_frame

if TYPE_CHECKING:
    import numpy as np

    from hil.drivers.cameras.base import Camera, CameraFrame
    from hil.parts.cameras.aid import PairNumbers

_SIDES: Final = ("left", "right")
_LONGEST_EXPOSURE_S: Final = 0.1
_DEFAULTS: Final = CameraOptions(trigger="software")
Port = Annotated[Integer, within(0, 65535)]


def aid(
    left: str,
    right: str,
    /,
    *,
    geometry: str | None = None,
    port: Port = 8766,
    save: str | None = None,
    expose: Flag = False,
    pairs: Annotated[int | None, Parameter(help="Number of pairs; default: until Ctrl-C.")] = None,
    options: Group[CameraOptions] = _DEFAULTS,
) -> int:
    """Show both images, their spots, peaks and widths, and the numbers of each pair, on a page of this computer.

    Parameters
    ----------
    left
        IP address, serial number or identifier of the left camera.
    right
        The same of the right camera.
    geometry
        Geometry file: pairs are solved, with status, epipolar distance and range.
    port
        Port of the page; 0 for any free one.
    save
        Folder for pairs, left/NNNN.png and right/NNNN.png, as the page asks for them: for hil calibrate --hand-held.
    expose
        Set the exposure times so that the median spot is bright and not saturated; needs --exposure-ms to start from.
    """
    problems = option_problems(options)
    if expose and options.exposure_ms is None:
        problems.append(Problem("--expose", "", "needs --exposure-ms, the exposure to start from"))
    if save is not None and not Path(save).absolute().parent.is_dir():
        problems.append(Problem("--save", "", f"{save}: its parent folder does not exist"))
    refuse(problems)
    from hil.config.camera_identity import write_identities
    from hil.parts.cameras.aid import SetUpAid
    from hil.parts.cameras.aid_server import AidServer
    from hil.vmu.unit import VisionUnit

    console, unit = Console(), None
    if geometry is not None:
        unit = VisionUnit(geometry)
        say("preparing the vision unit: about a minute at the first time", console)
        unit.warm_up()
    measured, folder = SetUpAid((size_of(options),) * 2, unit), None if save is None else Path(save)
    exposures = [_exposure_control(options) for _ in _SIDES] if expose else []
    saved, count, numbers = None if folder is None else 0, 0, None
    with ExitStack() as stack:
        server = AidServer(port)
        stack.callback(server.close)
        cameras = [open_camera_of(camera, options) for camera in (left, right)]
        for camera in cameras:
            stack.callback(camera.close)
        measured.packet_bytes = (cameras[0].packet_bytes, cameras[1].packet_bytes)
        say(f"camera aid: {server.address}", console)
        stack.enter_context(suppress(KeyboardInterrupt))
        while pairs is None or count < pairs:
            count += 1
            frames = _take_pair(cameras, options)
            numbers, pictures = measured.add(frames, (cameras[0].shutter, cameras[1].shutter), time.monotonic())
            whole = [name for name, frame in zip(_SIDES, frames, strict=True) if frame.image is not None]
            if folder is not None and saved is not None and len(whole) == len(_SIDES) and server.asked_to_save():
                _write_pair(folder, saved, frames)
                write_identities({name: each.identity for name, each in zip(_SIDES, cameras, strict=True)}, folder)
                saved += 1
            server.show(numbers.as_json() | {"saved": saved}, dict(zip(whole, pictures, strict=True)))
            for camera, frame, control in zip(cameras, frames, exposures, strict=False):
                if frame.image is not None and control.update(frame.image):
                    camera.set_exposure(control.exposure_s)
    if numbers is not None:
        _print(numbers, [control.exposure_s for control in exposures], console)
    return 0 if numbers is not None and all((numbers.left, numbers.right)) else 1


def _exposure_control(options: CameraOptions):  # type: ignore[no-untyped-def]  # BrightnessControl is slow to import
    from hil.drivers.cameras.brightness import BrightnessControl
    from hil.parts.cameras.aid import WANTED_PEAK, led_level
    from hil.vmu.detect import SpotDetector

    assert options.exposure_ms is not None
    detector = SpotDetector(size_of(options)[::-1])
    return BrightnessControl(
        WANTED_PEAK,
        1e-3 * options.exposure_ms,
        _LONGEST_EXPOSURE_S,
        lambda image: led_level(image, detector.spots(image)),
    )


def _take_pair(cameras: list[Camera], options: CameraOptions) -> tuple[CameraFrame, CameraFrame]:
    """Return the next frame of each camera."""
    if options.trigger == "software":
        time.sleep(1.0 / options.rate_hz)
        for camera in cameras:
            camera.trigger()
    return take_frame(cameras[0], options), take_frame(cameras[1], options)


def _write_pair(folder: Path, number: int, frames: tuple[CameraFrame, CameraFrame]) -> None:
    for name, frame in zip(_SIDES, frames, strict=True):
        (folder / name).mkdir(parents=True, exist_ok=True)
        _write(folder / name / f"{number:04d}.png", frame.image)


def _write(path: Path, image: np.ndarray | None) -> None:
    import cv2

    if image is None or not cv2.imwrite(str(path), image):
        raise BadInput.single("--save", "", f"{path}: cannot be written")


def _print(numbers: PairNumbers, exposures_s: list[float], console: Console) -> None:
    for name, side in zip(_SIDES, (numbers.left, numbers.right), strict=True):
        if side is None:
            say(f"{name}: packets lost", console)
            continue
        say(
            f"{name}: {side.spots} spots, {side.width_px:.2f} px wide, peak {side.peak:.0f} of 255, {side.saturated} "
            f"saturated, background {side.background:.0f}: {side.advice}",
            console,
        )
    if numbers.status:
        say(f"pair: {numbers.status}, epipolar {numbers.epipolar_px:.3f} px, range {numbers.range_m:.3f} m", console)
    if exposures_s:
        say(f"exposure: {', '.join(f'{1e3 * exposure_s:.3g} ms' for exposure_s in exposures_s)}", console)
