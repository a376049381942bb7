"""Rig files, table ``[sign_off]``: operator of the commissioning, and findings per axis."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.model import ConfigModel, NotNegative

AxisName = Literal["rails.x", "rails.y", "rails.z", "turntable.roll", "turntable.pitch", "turntable.yaw"]
Day = Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$")]
Digest = Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]


class AxisSignOff(ConfigModel):
    """One axis that passed commissioning."""

    date: Day
    by: str
    digest: Digest  # of the rig with which it passed
    scale_error: float  # of the encoder, against the command
    following_error_max_m: NotNegative | None = None  # rails, at low speed
    following_error_max_deg: NotNegative | None = None  # turntable, at low speed


class SignOff(ConfigModel):
    """Written by ``hil commission``; ``digest`` is set when all axes and the dry run have passed."""

    waived: bool = False  # hardware runs without a valid sign-off; each report states it
    date: Day | None = None
    by: str | None = None
    hil: str | None = None  # version of this program
    digest: Digest | None = None
    axes: dict[AxisName, AxisSignOff] = Field(default_factory=dict)
