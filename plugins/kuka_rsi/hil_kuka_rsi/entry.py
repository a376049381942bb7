"""Registry entry, and model of the table ``[arm.kuka_rsi]``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.tables.driver_registry import DriverEntry, WireKey
from hil.config.tables.model import ConfigModel, NotNegative
from hil_kuka_rsi.codec import Rotation
from hil_robot_arms.settings import ArmGeometry


class RsiSettings(ConfigModel):
    """Wire and correction of RSI."""

    geometry: ArmGeometry
    host: str = "127.0.0.1"
    """Address of this computer, IP_NUMBER of the Ethernet configuration."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """UDP port, PORT of it."""
    period_ms: Literal[4, 12] = 12
    """Cycle of the controller: 12 ms in mode #IPO, 4 ms in #IPO_FAST."""
    mode: Literal["absolute", "relative"] = "absolute"
    """Whether POSCORR adds a correction to the pose at its start, or in each cycle to the last one."""
    rotation: Rotation = "frame"
    """Whether A, B, C of a correction are a rotation about the axes of the base, or added to those of the pose."""
    sen_type: str = "ImFree"
    """SENTYPE of the Ethernet configuration; others are rejected by the controller."""
    late_max: Annotated[int, Field(ge=1, le=1000)] = 10
    """Cycles in a row without an answer after which the controller stops: Timeout of its object ETHERNET."""
    emulated_lag_s: NotNegative = 0.0
    """Emulated controller: time from an answer to the motion, in addition to one cycle."""
    emulated_clock_factor: Annotated[float, Field(ge=0.99, le=1.01)] = 1.0
    """Emulated controller: its second, in seconds of the bench."""

    @property
    def period_s(self) -> float:
        """Cycle of the controller, s."""
        return 1e-3 * self.period_ms


ENTRY = DriverEntry(
    "arm",
    "kuka_rsi",
    driver="hil_kuka_rsi.driver:RsiLink",
    emulator="hil_kuka_rsi.emulator:RsiController",
    settings=RsiSettings,
    wires=[WireKey("kuka_rsi", "udp")],
    model="hil_robot_arms.settings:arm_model",
    keeps_bench_time=lambda arm: True,
)
