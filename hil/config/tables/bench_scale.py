"""Table ``[bench]`` of a scenario: how much of the approach the bench shows at full scale."""

from __future__ import annotations

from typing import Annotated, Final

from pydantic import Field

from hil.config.tables.machine import MachineErrors
from hil.config.tables.model import ConfigModel, Positive


class BenchScale(ConfigModel):
    """Scale of the bench: at a distance it moves a fraction of the way, along the same line of sight.

    Nearer than `scaled_beyond_m` the bench shows the relative motion as it is. Beyond it shows the direction of the
    target and a fraction of the additional distance, without a jump of position or velocity. What is measured on the
    bench there is converted back, except poses of the vision unit: these are not used.
    """

    scaled_beyond_m: Positive | None = None
    """Distance of the reference points beyond which the bench is scaled; unless set, nowhere."""
    scale: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """Part of the additional distance that the bench moves, between 0 and 1."""
    errors: MachineErrors = MachineErrors.model_construct()
    """Errors of the geometry of mock and emulated rigs, in addition to those of the rig."""


FULL_SCALE: Final = BenchScale.model_construct()
