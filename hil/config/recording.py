"""Rig files, tables ``[recording]`` and ``[telemetry]``: camera images of a recording, rows for viewers."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel, Positive


class RecordingTable(ConfigModel):
    """Images of a recording; their replay is bit-exact with png and image_interval_s = 0 only."""

    images: Literal["none", "jpeg", "png"] = "jpeg"
    """Encoding of rendered images; "none" records none, "png" is lossless."""
    image_interval_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 0.5
    """Shortest time between two images of a camera; 0: every exposure."""


class TelemetryTable(ConfigModel):
    """Rows of a run for those who watch it; a recording has every cycle."""

    rate_hz: Positive | None = None
    """Rows per second for the console's page, for viewers (JSON messages of a recording, Foxglove) and for other
    computers, the cycle's rate divided by a whole number; unless set, one per cycle, and 10 for viewers."""
