"""Table ``[monitor]`` of a scenario: docking monitor in parallel with a run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel, Triple


class DockingMonitorConfig(ConfigModel):
    """source: "rendered" renders the docking target from the bench's encoders. scene: shipped, or a scene file's path.

    The camera's axes are the vision unit's, x1 = -y_c, x2 = z_c, x3 = -x_c; the target's C are y1 = -y_H, y2 = -z_H,
    y3 = x_H. blur_px: 1 sigma of the point spread of lens and tube.
    """

    source: Literal["none", "rendered"] = "none"
    scene: str = "atv"
    target: Literal["basic", "backup"] = "basic"
    camera_position_m: Triple = (0.8, 0.0, -0.5)  # in c: chaser's reference point to the camera
    target_position_m: Triple = (-0.3, 0.0, -0.5)  # in H: target's reference point to the centre of the target's disc
    blur_px: Annotated[float, Field(ge=0.0, le=5.0)] = 0.8
