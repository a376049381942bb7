"""Cameras of this host: tables ``[vmu.cameras]``, ``[vmu.drift_check]`` and ``[monitor_camera]`` of a rig file."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.model import ConfigModel, NotNegative, Positive

CameraInterface = Literal["genicam", "gentl", "v4l2"]
PixelFormat = Literal["Mono8", "Mono10", "Mono12", "Mono16"]


class CameraHabits(ConfigModel):
    """Habits of emulated cameras."""

    gain_unit: str | None = None
    """Unit of the feature `Gain`; unset: the camera has `GainRaw` alone, a whole number."""
    trigger_selector: str = "FrameStart"
    """Name of the selector that comes first."""
    stamps: bool = True
    """false: the time stamp of each frame is 0."""


class CameraSettings(ConfigModel):
    """Interface, trigger and exposure of a camera."""

    interface: CameraInterface = "genicam"
    """GenICam cameras (GigE Vision, USB3 Vision) by Aravis, or by the GenTL producers in the folders of
    `GENICAM_GENTL64_PATH`; or V4L2 devices by OpenCV."""
    trigger: Literal["software", "hardware", "none"] = "software"
    """Exposures by commands of this host, by a signal at `trigger_source`, or by the cameras' own rate."""
    trigger_source: str = "Line1"
    """Input of the hardware trigger."""
    clock: Literal["own", "system"] = "own"
    """Clock of the cameras' time stamps: their own, or this host's system time (PTP)."""
    latency_s: NotNegative = 0.0
    """Least time from software trigger to exposure; without one, from exposure to arrival. For `clock = "own"`."""
    pixel_format: PixelFormat = "Mono8"
    """Pixel format; 10 to 16 bits, unpacked, are reduced to 8."""
    exposure_s: Annotated[float, Field(gt=0.0, le=1.0)] | None = None
    """Exposure time; unless set, as the camera has it."""
    gain_db: NotNegative | None = None
    """Gain; unless set, as the camera has it."""
    packet_bytes: Annotated[int, Field(ge=576, le=65000)] | None = None
    """Packet size of GigE cameras; unless set, as the camera has it."""
    features: dict[str, bool | int | float | str] = Field(default_factory=dict)
    """Features of a GenICam camera by their names, set before all others, in the order of the file."""
    brightness_levels: Annotated[float, Field(ge=20.0, le=250.0)] | None = None
    """Grey level of the brightest hundredth of the image, to which the exposure time is controlled; unless set, not."""
    exposure_max_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.02
    """Longest exposure time of that control."""
    emulated: CameraHabits = CameraHabits.model_construct()
    """Habits of the emulated cameras."""


class VisionCameras(CameraSettings):
    """Two cameras, left and right, whose images the vision unit of this host solves."""

    left: str | None = None
    """Left camera: IP address, serial number or identifier (`hil cameras list`); of V4L2 the device, `/dev/video0`."""
    right: str | None = None
    """Right camera."""
    pair_within_s: Positive = 0.005
    """Largest difference of the times of exposure of a pair."""
    pair_wait_s: Positive = 0.05
    """Longest wait for the image of the other camera; then one is used alone."""


class DriftCheckViews(ConfigModel):
    """Views that the bench takes before an unattended run, in which the cameras of this host must match their
    calibration, `vmu.geometry_file`."""

    views: Annotated[int, Field(ge=0, le=40)] = 0
    """Number of views, at least 2; 0: no check."""
    near_m: Positive = 0.7
    """Least range from camera to target."""
    far_m: Positive = 2.5
    """Largest range from camera to target."""
    turn_deg: Annotated[float, Field(gt=0.0, le=45.0)] = 15.0
    """Largest angle of each gimbal."""
    settle_s: Positive = 0.5
    """Time at rest before an exposure."""
    max_rms_px: Positive = 0.15
    """Limit of the residuals, RMS over all pixels."""
    max_drift_px: Positive = 0.03
    """Accepted drift, RMS over all pixels."""
    alarm_probability: Annotated[float, Field(gt=0.0, lt=1.0)] = 1e-3
    """Probability of a chance result below which a drift is significant."""

    @model_validator(mode="after")
    def _views_can_be_planned(self) -> Self:
        if self.views == 1:
            raise ValueError("views 1: allowed 0 (no check), or 2 to 40")
        if self.near_m >= self.far_m:
            raise ValueError(f"near_m {self.near_m:g}: must be less than far_m {self.far_m:g}")
        return self


class MonitorCamera(CameraSettings):
    """Television camera of the docking monitor, for `monitor.source = "camera"`; it has the rate of the scene."""

    camera: str | None = None
    """As `left` of the vision unit's cameras."""
    trigger: Literal["software", "hardware", "none"] = "none"
    """Exposures by the camera's own rate, by commands of this host, or by a signal at `trigger_source`."""
    timeout_s: Positive = 1.0
    """Longest time without an image; then the monitor ends, and the run continues without it."""
