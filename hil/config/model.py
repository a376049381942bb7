"""Base of the configuration models.

The name of a key ends in its unit (``_m``, ``_mps``, ``_deg`` ...), numbers are finite, unknown keys are
errors. Angles are in degrees; ``hil.params`` converts them to radians.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]
Triple = tuple[float, float, float]
Matrix3 = tuple[Triple, Triple, Triple]


class ConfigModel(BaseModel):
    """Base of all tables of configuration files."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, strict=True)
