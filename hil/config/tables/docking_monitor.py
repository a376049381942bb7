"""Table ``[monitor]`` of a scenario: docking monitor in parallel with a run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.tables.model import ConfigModel, NotNegative, Positive, Triple


class DockingMonitorConfig(ConfigModel):
    """Docking monitor in parallel with a run.

    The camera's axes are the vision unit's, x1 = -y_c, x2 = z_c, x3 = -x_c; the target's C are y1 = -y_H, y2 = -z_H,
    y3 = x_H.
    """

    source: Literal["none", "model", "rendered", "camera"] = "none"
    """"model": the bench's pose with the noise below; "rendered": measured on images that are rendered at the encoder
    positions; "camera": on those of `[monitor_camera]` of the rig."""
    scene: str = "atv"
    """Shipped scene (`atv`, `bright-cross`) or path of a scene file."""
    target: Literal["basic", "backup"] = "basic"
    """Target of the scene that is measured."""
    camera_position_m: Triple = (0.8, 0.0, -0.5)
    """In c: chaser's reference point to the camera."""
    target_position_m: Triple = (-0.3, 0.0, -0.5)
    """In H: target's reference point to the centre of the docking target's disc."""
    blur_px: Annotated[float, Field(ge=0.0, le=5.0)] = 0.8
    """Point spread of lens and tube, 1 sigma."""
    interlock: bool = True
    """Whether a disagreement with the navigation is an alarm, to which `gnc.reactions` reacts."""
    interlock_sigmas: Positive = 5.0
    """Standard deviations of both by which they may differ, in addition to the errors of the mounting."""
    interlock_error_max_m: NotNegative = 0.005
    """Error of the mounting of camera and docking target: position."""
    interlock_error_max_deg: NotNegative = 0.1
    """The same for the attitude, and for the line of sight."""
    interlock_frames: Annotated[int, Field(ge=1, le=100)] = 2
    """Consecutive measurements that set the interlock, and release it."""
    latency_s: Annotated[float, Field(ge=0.0, le=1.0)] = 0.1
    """Of a modelled measurement, from its last image to the loop."""
    reference_range_m: Positive = 8.0
    """From the camera; beyond it the standard deviations below grow in proportion."""
    sigma_range_scale: Positive = 3e-5
    """Standard deviation of the range, as a fraction of it."""
    sigma_sight_deg: Positive = 0.0006
    """Of the line of sight."""
    sigma_angle_deg: Positive = 0.009
    """Of the attitude, per axis."""
    range_min_m: Positive = 1.0
    """Nearer than this the target is not measured."""
    near_range_m: Positive = 16.0
    """Up to this range pitch and yaw are measured as well."""
    range_max_m: Positive = 40.0
    """Farther than this the target is not measured."""

    @property
    def has_images(self) -> bool:
        """Whether the run measures on images."""
        return self.source in ("rendered", "camera")
