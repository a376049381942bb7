"""The rig file that a commissioning leaves: it extends the one commissioned by its sign-off."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from hil import __version__
from hil.commission.steps import AxisFound, Found
from hil.config.motion_digest import motion_digest
from hil.config.rig import Rig


def signed_before(rig: Rig) -> frozenset[str]:
    """Return the axes that were found in order with the rig as it is now."""
    if rig.sign_off is None:
        return frozenset()
    digest = motion_digest(rig)
    return frozenset(name for name, axis in rig.sign_off.axes.items() if axis.digest == digest)


def as_toml(found: Found, rig: Rig, base: str, by: str, date: str) -> str:
    """Return the file. base: what it extends. by: who looked at the bench; date: ISO, 2026-03-01.

    The whole rig is signed off where the dry run was flown; until then the axes alone are.
    """
    digest = motion_digest(rig)
    lines = ["# Signed off by hil commission: it holds as long as nothing is changed that decides how the rig moves."]
    lines += ["", f"extends = {json.dumps(base)}"]
    if found.dry_run is not None:
        lines += ["", "[sign_off]", f"date = {json.dumps(date)}", f"by = {json.dumps(by)}"]
        lines += [f"hil = {json.dumps(__version__)}", f"digest = {json.dumps(digest)}"]
    for axis in found.axes:
        lines += ["", f'[sign_off.axes."{axis.name}"]', *_axis(axis, by, date, digest)]
    return "\n".join(lines) + "\n"


def _axis(found: AxisFound, by: str, date: str, digest: str) -> Sequence[str]:
    unit, error = (
        ("m", found.following_error_max) if found.axis < 3 else ("deg", math.degrees(found.following_error_max))
    )
    return [
        f"date = {json.dumps(date)}",
        f"by = {json.dumps(by)}",
        f"digest = {json.dumps(digest)}",
        f"scale_error = {found.scale_error:.6f} # of the encoder, against the command",
        f"following_error_max_{unit} = {error:.6f} # at a crawl",
    ]
