"""Table ``[arm]`` of a rig: one robot that takes poses and stands for rails and turntable."""

from __future__ import annotations

from typing import Annotated, ClassVar

from pydantic import Field

from hil.config.tables.driver_registry import DeviceTable


class Arm(DeviceTable):
    """Robot that carries what rails and turntable would carry: these have driver = "arm", on a mock rig "mock"."""

    device: ClassVar = "arm"

    timeout_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """Longest silence of the controller, and oldest accepted feedback."""
