"""Rig files, table ``[sign_off]``: operator of the commissioning, and findings per axis."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from hil.config.tables.model import ConfigModel, NotNegative

AxisName = Literal["rails.x", "rails.y", "rails.z", "turntable.roll", "turntable.pitch", "turntable.yaw"]
Day = Annotated[str, Field(pattern=r"^\d{4}-\d{2}-\d{2}$")]
KeyId = Annotated[str, Field(pattern=r"^([0-9a-f]{16})?$")]
Digest = Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]


class AxisSignOff(ConfigModel):
    """One axis that passed commissioning."""

    date: Day
    """Date."""
    by: str
    """Operator."""
    key: KeyId = ""
    """Key of the operator, empty for a name that nothing proves."""
    seal: str = ""
    """HMAC-SHA-256 of date, operator, axis, digest and findings, with that key."""
    digest: Digest
    """Digest of the configuration with which the axis passed."""
    scale_error: float
    """Of the encoder relative to the command."""
    following_error_max_m: NotNegative | None = None
    """Rails: largest following error at low speed."""
    following_error_max_deg: NotNegative | None = None
    """Turntable: the same."""


class SignOff(ConfigModel):
    """Written by ``hil commission``; ``digest`` is set when all axes and the dry run have passed."""

    waived: bool = False
    """Permits hardware without a valid sign-off; each report states it."""
    date: Day | None = None
    """Date."""
    by: str | None = None
    """Operator."""
    key: KeyId = ""
    """Key of the operator, empty for a name that nothing proves."""
    seal: str = ""
    """HMAC-SHA-256 of date, operator and digest, with that key."""
    hil: str | None = None
    """Version of this program."""
    digest: Digest | None = None
    """Digest of the whole configuration; present once all axes and the dry run have passed."""
    axes: dict[AxisName, AxisSignOff] = Field(default_factory=dict)
    """Sign-off of each axis."""
