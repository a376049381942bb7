"""Convex bodies of chaser, target and bench."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final, Literal

from pydantic import Field

from hil.config.model import ConfigModel, NotNegative, Triple

BODIES_MAX: Final = 8  # of each kind


class Body(ConfigModel):
    """Convex hull of points, widened by a radius: one point is a sphere, two are a rod with round ends, eight a box."""

    vertices_m: Annotated[tuple[Triple, ...], Field(min_length=1, max_length=16)]
    """Its points, 1 to 16, in the frame of `on`."""
    radius_m: NotNegative = 0.0
    """Radius by which the hull is widened."""


class SpacecraftBody(Body):
    """Part of a spacecraft that stands forward of its interface."""

    on: Literal["chaser", "target"]
    """`chaser`: in c, from the chaser's reference point; `target`: in H, from the target's."""


class BenchBody(Body):
    """Part of the bench or of the lab."""

    on: Literal["carriage", "turntable", "lab"]
    """`carriage`: moves with the rails, in L from the turntable's centre of rotation; `turntable`: rotates with it, in
    c from the chaser's reference point; `lab`: stands still, in L from the target's reference point."""


def check_kinds(bodies: Sequence[SpacecraftBody | BenchBody], fixed: str) -> None:
    """Raise ValueError if there are too many bodies of a kind, or none that can meet. fixed: kind that rests."""
    kinds = [body.on for body in bodies]
    for kind in kinds:
        if kinds.count(kind) > BODIES_MAX:
            raise ValueError(f'bodies: {kinds.count(kind)} with on = "{kind}", allowed {BODIES_MAX}')
    if kinds and (fixed not in kinds or set(kinds) == {fixed}):
        found = ", ".join(f'"{kind}"' for kind in sorted(set(kinds)))
        raise ValueError(f'bodies: all have on = {found}, allowed is "{fixed}" together with one that moves')
