"""Cameras of a vision unit that is computed on this host: table ``[vmu.cameras]`` of a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel, NotNegative, Positive

CameraInterface = Literal["genicam", "v4l2"]
PixelFormat = Literal["Mono8", "Mono10", "Mono12", "Mono16"]


class VisionCameras(ConfigModel):
    """Two cameras, left and right, whose images the vision unit of this host solves."""

    interface: CameraInterface = "genicam"
    """GenICam cameras (GigE Vision, USB3 Vision) by Aravis, or V4L2 devices by OpenCV."""
    left: str | None = None
    """Left camera: IP address, serial number or identifier (`hil cameras list`); of V4L2 the device, `/dev/video0`."""
    right: str | None = None
    """Right camera."""
    trigger: Literal["software", "hardware", "none"] = "software"
    """Exposures by commands of this host, by a signal at `trigger_source`, or by the cameras' own rate."""
    trigger_source: str = "Line1"
    """Input of the hardware trigger."""
    clock: Literal["own", "system"] = "own"
    """Clock of the cameras' time stamps: their own, or this host's system time (PTP)."""
    latency_s: NotNegative = 0.0
    """Least time from software trigger to exposure; without one, from exposure to arrival. For `clock = "own"`."""
    pair_within_s: Positive = 0.005
    """Largest difference of the times of exposure of a pair."""
    pair_wait_s: Positive = 0.05
    """Longest wait for the image of the other camera; then one is used alone."""
    pixel_format: PixelFormat = "Mono8"
    """Pixel format; 10 to 16 bits, unpacked, are reduced to 8."""
    exposure_s: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    """Exposure time; unless set, as the camera has it."""
    gain_db: NotNegative | None = None
    """Gain; unless set, as the camera has it."""
    packet_bytes: Annotated[int, Field(ge=576, le=65000)] | None = None
    """Packet size of GigE cameras; unless set, as the camera has it."""
