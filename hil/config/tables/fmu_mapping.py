"""Mapping files of FMUs: which variable stands for which field of the records."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.tables.model import ConfigModel

VariableName = Annotated[str, Field(min_length=1, max_length=400)]
VariableNames = VariableName | Annotated[tuple[VariableName, ...], Field(min_length=1, max_length=64)]


class MappedVariables(ConfigModel):
    """Variables of one field, with properties that the FMU itself does not state."""

    variables: VariableNames
    """An array or the common name of its elements, or one variable per element."""
    order: Literal["scalar_last", "scalar_first"] = "scalar_last"
    """Order of a quaternion in the FMU."""
    unit: str | None = None
    """Unit in the FMU, instead of its own definition."""


class FmuMapping(ConfigModel):
    """Mapping file. Fields that are not named are found by their own name."""

    inputs: dict[str, VariableNames | MappedVariables] = Field(default_factory=dict)
    """Field of the input record = variable."""
    outputs: dict[str, VariableNames | MappedVariables] = Field(default_factory=dict)
    """Field of the output record = variable."""
    setup: dict[str, VariableNames | MappedVariables] = Field(default_factory=dict)
    """Field of the setup record = parameter."""
