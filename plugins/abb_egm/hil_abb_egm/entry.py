"""Registry entry, and model of the table ``[arm.abb_egm]``."""

from __future__ import annotations

from typing import Annotated, Final, Literal

from pydantic import Field

from hil.config.tables.driver_registry import DriverEntry, WireKey
from hil.config.tables.model import ConfigModel, NotNegative
from hil_robot_arms.settings import ArmGeometry

PERIOD_S: Final = 0.004
"""Cycle of the controller."""


class EgmSettings(ConfigModel):
    """Wire and guidance of EGM."""

    geometry: ArmGeometry
    host: str = "127.0.0.1"
    """Address of this computer, of the transmission protocol UDPUC."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """UDP port of it."""
    mode: Literal["pose", "joint"] = "pose"
    """EGMActPose and EGMRunPose, or EGMActJoint and EGMRunJoint."""
    silence_max_s: Annotated[float, Field(gt=0.0, le=10.0)] = 0.1
    """Silence after which the controller stops: CommTimeout of EGMSetupUC."""
    emulated_lag_s: NotNegative = 0.012
    """Emulated controller: time from an answer to the motion."""
    emulated_clock_factor: Annotated[float, Field(ge=0.99, le=1.01)] = 1.0
    """Emulated controller: its second, in seconds of the bench."""


ENTRY = DriverEntry(
    "arm",
    "abb_egm",
    driver="hil_abb_egm.driver:EgmLink",
    emulator="hil_abb_egm.emulator:EgmController",
    settings=EgmSettings,
    wires=[WireKey("abb_egm", "udp")],
    model="hil_robot_arms.settings:arm_model",
    keeps_bench_time=lambda arm: True,
)
