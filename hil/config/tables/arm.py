"""Tables ``[arm]`` and ``[target_arm]`` of a rig: robots that take poses, in place of axes."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from hil.config.tables.driver_registry import DeviceTable


class Arm(DeviceTable):
    """Robot that carries what axes would carry: these have driver = "arm", on a mock rig "mock"."""

    device: ClassVar = "arm"

    timeout_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """Longest silence of the controller, and oldest accepted feedback."""
    lag_s: Annotated[float, Field(ge=0.0, le=0.5)] | None = None
    """Lag of the controller, by `hil identify`: time from a setpoint to the motion, for the check of what `lead_s`
    leaves of it; unless set, unknown."""
