"""What a recording keeps beside the numbers: part of a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel


class RecordingTable(ConfigModel):
    """pictures: how those of rendered cameras are kept; only png, and each of them, replays to the very same poses."""

    pictures: Literal["none", "jpeg", "png"] = "jpeg"
    picture_each_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 0.5  # between two of a camera; 0: every exposure
