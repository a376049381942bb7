"""Options that several commands have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import cyclopts
from cyclopts import Parameter

Settings = Annotated[
    tuple[str, ...],
    Parameter(name="--set", negative=(), help="Override a key: gnc.control.deadband_m=0.004 or rig.vmu.timeout_s=0.5."),
]


def _whole_number(_type: object, tokens: Sequence[cyclopts.Token]) -> int:
    """Return a whole number; cyclopts by itself would cut 1.5 to 1."""
    return int(tokens[0].value)


Whole = Annotated[int, Parameter(converter=_whole_number)]
MaybeWhole = Annotated[int | None, Parameter(converter=_whole_number)]
Output = Annotated[str | None, Parameter(allow_leading_hyphen=True)]
