"""Table ``[monitor]`` of a scenario: docking monitor in parallel with a run."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel, Triple


class DockingMonitorConfig(ConfigModel):
    """Docking monitor in parallel with a run.

    The camera's axes are the vision unit's, x1 = -y_c, x2 = z_c, x3 = -x_c; the target's C are y1 = -y_H, y2 = -z_H,
    y3 = x_H.
    """

    source: Literal["none", "rendered"] = "none"
    """"rendered": images of a television camera, rendered at the encoder positions."""
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
