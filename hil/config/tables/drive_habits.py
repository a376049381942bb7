"""Habits in which CiA 402 drives differ, as data: what an emulated drive does that another does not."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil.config.tables.model import ConfigModel, Delay, NotNegative

ObjectIndex = Annotated[int, Field(ge=0x1000, le=0xFFFF)]


class DriveHabits(ConfigModel):
    """Habits of emulated CiA 402 drives; the defaults oblige every driver."""

    mode_lag_s: Delay = 0.0
    """From a new 0x6060 until 0x6061 shows it and the drive acts on it."""
    mode_only_enabled: bool = False
    """A new mode is taken only while the drive is enabled."""
    bits_lag_s: Delay = 0.0
    """From a new mode until bits 10, 12 and 13 of the statusword are those of the mode."""
    state_lag_s: Delay = 0.0
    """From a new state until the statusword shows it."""
    no_remote_frames: bool = False
    """Identifiers of TPDOs without bit 30 are refused."""
    velocity_unit: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] | None = None
    """Value of 0x60A9, and unit of all velocities; default: that of the data sheet, else increments per second."""
    declares_velocity: bool = True
    """false: 0x60A9 is missing, whatever the unit."""
    declared_scale: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    """Increments per turn that 0x608F declares, as a multiple of the true ones."""
    missing: tuple[ObjectIndex, ...] = ()
    """Objects of the data sheet that the drive does not have."""
    missing_code: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] = 0x06020000
    """SDO abort code with which it answers for them."""
    aborts: tuple[ObjectIndex, ...] = ()
    """Objects that cannot be written, also if the data sheet allows it."""
    supported_modes: Annotated[int, Field(ge=0, le=0xFFFF_FFFF)] | None = None
    """Value of 0x6502; default: that of the data sheet, else all that its objects allow."""
    keeps_error: bool = False
    """0x603F keeps an error of the past, also through a reset."""
    enable_s: NotNegative = 0.0
    """Search for the commutation angle before operation is enabled."""
    warnings_hz: Annotated[float, Field(ge=0.0, le=100.0)] = 0.0
    """Bursts of emergency messages without an error, per second."""
    foreign_nodes: tuple[Annotated[int, Field(ge=1, le=127)], ...] = ()
    """Nodes of others on the same bus, in operation, that answer each SYNC with a PDO."""
