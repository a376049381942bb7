"""``hil cameras``: find, show and focus the cameras of a vision unit."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

from cyclopts import App, Parameter
from rich.console import Console

from hil.cli.options import (
    File,
    Group,
    Integer,
    OptionalInteger,
    Positive,
    above_zero,
    bounded,
    refuse,
    within,
)
from hil.cli.output import deliver, print_columns
from hil.errors import BadInput, Problem

if TYPE_CHECKING:
    import numpy as np

    from hil.drivers.cameras.base import Camera, CameraFrame

_NAME: Final = "camera"
_WAIT_WALL_S: Final = 2.0

app = App(name="cameras")
app.command(
    "hil.parts.cameras.cli.camera_aid:aid",
    name="aid",
    help="Live page for the set-up of two cameras: spots, peaks, skew.",
)
Images = Annotated[Integer, bounded(1)]
Pixels = Annotated[OptionalInteger, within(16, 16384)]


@dataclass(frozen=True)
class CameraOptions:
    """Options of a camera."""

    interface: str = "genicam"
    """genicam (GigE Vision, USB3 Vision), gentl or v4l2."""
    width: Pixels = None
    """Image width, px; default: 1024."""
    height: Pixels = None
    """Image height, px; default: 1024."""
    pixel_format: str = "Mono8"
    """Mono8, Mono10, Mono12 or Mono16."""
    trigger: str = "none"
    """none (free-running), software or hardware."""
    exposure_ms: Annotated[float | None, above_zero(at_most=1e3)] = None
    """Exposure time."""
    gain_db: Annotated[float | None, within(0.0, 1e3)] = None
    """Gain."""
    packet_bytes: Annotated[OptionalInteger, within(576, 65000)] = None
    """Packet size of a GigE camera."""
    rate_hz: Positive = 6.25
    """Images per second."""


_DEFAULTS = CameraOptions()


@app.command(name="list", help="List the cameras that answer: GigE Vision, USB3 Vision, GenTL, V4L2.")
def list_found(*, json: File = None) -> int:
    """List the cameras that answer: GigE Vision, USB3 Vision, GenTL, V4L2.

    Parameters
    ----------
    json
        File for the list, - for standard output.
    """
    from hil.drivers.cameras.base import CameraInfo
    from hil.drivers.cameras.interfaces import list_cameras

    cameras = list_cameras()
    deliver(
        {"cameras": [camera._asdict() for camera in cameras]},
        json,
        lambda: print_columns(CameraInfo._fields, [list(camera) for camera in cameras]),
    )
    return 0 if cameras else 1


@app.command(name="show", help="Take images of one camera: size, levels, rate, losses; the last one as a file.")
def show(
    camera: str,
    /,
    *,
    out: str | None = None,
    images: Images = 10,
    options: Group[CameraOptions] = _DEFAULTS,
) -> int:
    """Take images of one camera: size, levels, rate, losses; the last one as a file.

    Parameters
    ----------
    camera
        IP address, serial number or identifier; of V4L2 the device, /dev/video0.
    out
        File for the last image (*.png).
    images
        Number of images.
    """
    import cv2
    import numpy as np

    problems = option_problems(options)
    if out is not None and (Path(out).suffix != ".png" or not Path(out).absolute().parent.is_dir()):
        problems.append(Problem("--out", "", f"{out}: give a file *.png in a folder that exists"))
    refuse(problems)
    console, taken, incomplete, times = Console(), [], 0, []
    opened = open_camera_of(camera, options)
    try:
        for _ in range(images):
            image = _take(opened, options)
            times.append(time.monotonic())
            if image is None:
                incomplete += 1
            else:
                taken.append(image)
    finally:
        opened.close()
    if not taken:
        console.print(f"{camera}: {incomplete} images, all with missing packets", style="red")
        return 1
    last = taken[-1]
    rate = f"{(len(times) - 1) / (times[-1] - times[0]):.2f} Hz" if len(times) > 1 else "one image"
    levels = np.percentile(last, [1, 50, 99])
    console.print(
        f"{camera}: {last.shape[1]} x {last.shape[0]} px, {rate}, {incomplete} of {images} with missing packets; "
        f"levels {levels[0]:.0f} / {levels[1]:.0f} / {levels[2]:.0f} (1, 50, 99 %), highest {last.max()}, "
        f"{100.0 * np.mean(last == 255):.3f} % saturated",
        highlight=False,
        soft_wrap=True,
    )
    if out is not None and not cv2.imwrite(out, last):
        raise BadInput.single("--out", "", f"{out}: cannot be written")
    return 0


@app.command(name="identity", help="Write which cameras these are, and the part of the sensor that they send.")
def identity(
    left: str,
    right: str | None = None,
    /,
    *,
    out: str,
    options: Group[CameraOptions] = _DEFAULTS,
) -> int:
    """Write cameras.json into a folder of images: which cameras took them, and which part of their sensors.

    hil calibrate writes it into geometry and scene files, hil vmu and hil monitor compare it with them.

    Parameters
    ----------
    left
        Left camera of a vision unit, or, alone, the docking monitor's: IP address, serial number or identifier.
    right
        Right camera.
    out
        Folder of the images.
    """
    from hil.config.camera_identity import CAMERAS_FILE, MONITOR_CAMERA, write_identities

    problems = option_problems(options)
    if not Path(out).is_dir():
        problems.append(Problem("--out", "", f"{out}: give a folder that exists"))
    refuse(problems)
    identities = {}
    for name, camera in {MONITOR_CAMERA: left}.items() if right is None else {"left": left, "right": right}.items():
        opened = open_camera_of(camera, options)
        try:
            identities[name] = opened.identity
        finally:
            opened.close()
    write_identities(identities, Path(out))
    console = Console()
    for name, each in identities.items():
        stated = ", ".join(f"{key} {value}" for key, value in each.model_dump(exclude_none=True).items())
        console.print(f"{name}: {stated or 'the camera reports nothing of itself'}", highlight=False, soft_wrap=True)
    console.print(str(Path(out) / CAMERAS_FILE), highlight=False)
    return 0


@app.command(name="focus", help="Print the sharpness of the spots of one camera, image by image, until Ctrl-C.")
def focus(
    camera: str,
    /,
    *,
    images: Annotated[int | None, Parameter(help="Number of images; default: until Ctrl-C.")] = None,
    options: Group[CameraOptions] = _DEFAULTS,
) -> int:
    """Print the sharpness of the spots of one camera, image by image, until Ctrl-C.

    Parameters
    ----------
    camera
        IP address, serial number or identifier; of V4L2 the device, /dev/video0.
    """
    refuse(option_problems(options))
    from hil.vmu.detect import SpotDetector

    console, detector = Console(), SpotDetector(size_of(options)[::-1])
    opened = open_camera_of(camera, options)
    best, count = math.inf, 0
    try:
        while images is None or count < images:
            count += 1
            image = _take(opened, options)
            if image is None:
                console.print("missing packets", style="red")
                continue
            width = _spot_width(detector.spots(image), image)
            best = min(best, width)
            text = "no spots" if math.isinf(width) else f"spots {width:.2f} px wide, sharpest {best:.2f} px"
            console.print(f"{text}, highest level {image.max()}", highlight=False)
    except KeyboardInterrupt:
        pass
    finally:
        opened.close()
    return 0 if math.isfinite(best) else 1


def _spot_width(spots: np.ndarray, image: np.ndarray) -> float:
    """Return the median 1-sigma width of the spots, px; inf without one."""
    import numpy as np

    widths = []
    for spot in spots:
        u, v = round(float(spot["u"])), round(float(spot["v"]))
        box = image[max(0, v - 12) : v + 13, max(0, u - 12) : u + 13].astype(float)
        light = np.maximum(box - np.median(box) - 0.05 * (box.max() - np.median(box)), 0.0)
        rows, columns = np.indices(light.shape)
        total = light.sum()
        mean = (light * rows).sum() / total, (light * columns).sum() / total
        widths.append(math.sqrt((light * ((rows - mean[0]) ** 2 + (columns - mean[1]) ** 2)).sum() / total / 2.0))
    return float(np.median(widths)) if widths else math.inf


def option_problems(options: CameraOptions) -> list[Problem]:
    """Return a problem for each option that a camera cannot have."""
    from typing import get_args

    from hil.config.tables.cameras import CameraInterface, PixelFormat

    problems = []
    for name, allowed in (
        ("interface", get_args(CameraInterface)),
        ("pixel_format", get_args(PixelFormat)),
        ("trigger", ("none", "software", "hardware")),
    ):
        value = getattr(options, name)
        if value not in allowed:
            text = f"{value}: unknown, allowed: {', '.join(allowed)}"
            problems.append(Problem(f"--{name.replace('_', '-')}", "", text))
    return problems


def size_of(options: CameraOptions) -> tuple[int, int]:
    """Return width and height of the images, px."""
    return options.width or 1024, options.height or 1024


def open_camera_of(camera: str, options: CameraOptions) -> Camera:
    """Return ``camera``, started. Raises DeviceError."""
    from hil.config.tables.cameras import VisionCameras
    from hil.drivers.cameras.interfaces import open_camera

    settings = VisionCameras.model_validate(
        {
            "interface": options.interface,
            "trigger": options.trigger,
            "pixel_format": options.pixel_format,
            "exposure_s": None if options.exposure_ms is None else 1e-3 * options.exposure_ms,
            "gain_db": options.gain_db,
            "packet_bytes": options.packet_bytes,
        }
    )
    opened = open_camera(_NAME, camera, settings, size_of(options), options.rate_hz)
    opened.start()
    return opened


def _take(camera: Camera, options: CameraOptions) -> np.ndarray | None:
    """Return the next image, None if packets of it are missing. Raises LinkTimeout if there is none."""
    if options.trigger == "software":
        time.sleep(1.0 / options.rate_hz)
        camera.trigger()
    return take_frame(camera, options).image


def take_frame(camera: Camera, options: CameraOptions) -> CameraFrame:
    """Return the next frame. Raises LinkTimeout if there is none."""
    from hil.errors import LinkTimeout

    frame = camera.receive(_WAIT_WALL_S + 1.0 / options.rate_hz)
    if frame is None:
        hint = "; is the trigger connected?" if options.trigger == "hardware" else ""
        raise LinkTimeout(_NAME, f"no image within {_WAIT_WALL_S:g} s{hint}")
    return frame
