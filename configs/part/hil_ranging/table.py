"""Table ``[ranging]`` of scenario files."""

from typing import Annotated

from pydantic import Field

from hil.config.tables.model import ConfigModel, Positive


class Ranging(ConfigModel):
    """Samples of the distance. The name of a number ends in its unit; the text under a key is its meaning."""

    rate_hz: Annotated[float, Field(gt=0.0, le=1000.0)] = 10.0
    """Samples per second, at most one per cycle."""
    range_max_m: Positive = 100.0
    """Longest distance that is measured."""
    alarm_below_m: Annotated[float, Field(ge=0.0)] = 0.0
    """An alarm of low priority stands while the distance is shorter; `safety.request_hold(text)` would hold the run."""
