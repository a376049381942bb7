"""Keys of a part of the plant that an FMU can replace."""

from __future__ import annotations

from pydantic import Field

from hil.config.model import ConfigModel


class ModelFmu(ConfigModel):
    """FMU for co-simulation (FMI 2.0, 3.0) instead of a built-in model."""

    fmu: str | None = None
    """FMU that replaces the built-in model."""
    fmu_mapping: str | None = None
    """File that maps the FMU's variables to the records; by name without one."""
    fmu_parameters: dict[str, bool | int | float | str] = Field(default_factory=dict)
    """Parameters and start values of the FMU, in its units."""


class ThrusterModel(ModelFmu):
    """Model of the valves and their thrust, without their places, which are the chaser's."""
