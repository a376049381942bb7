"""Rig files, table ``[recording]``: camera images of a recording."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel


class RecordingTable(ConfigModel):
    """Images of a recording; their replay is bit-exact with png and image_interval_s = 0 only."""

    images: Literal["none", "jpeg", "png"] = "jpeg"
    """Encoding of rendered images; "none" records none, "png" is lossless."""
    image_interval_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 0.5
    """Shortest time between two images of a camera; 0: every exposure."""
