"""Sign-off of a commissioned rig: a rig file that extends the commissioned one."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence

from hil.commission.steps import AxisFindings, Findings
from hil.config.motion_digest import motion_digest
from hil.config.rig import Rig
from hil.core.build_info import VERSION


def signed_before(rig: Rig) -> frozenset[str]:
    """Return the axes that were signed off with the present rig."""
    if rig.sign_off is None:
        return frozenset()
    digest = motion_digest(rig)
    return frozenset(name for name, axis in rig.sign_off.axes.items() if axis.digest == digest)


def as_toml(findings: Findings, rig: Rig, base: str, by: str, date: str) -> str:
    """Return the text of the file. base: the file it extends. by: the technician's name; date: ISO, 2026-03-01.

    With a dry run the whole rig is signed off, without one only the axes.
    """
    digest = motion_digest(rig)
    lines = ["# Sign-off by hil commission: valid until a value is changed that affects the rig's motion."]
    lines += ["", f"extends = {json.dumps(base)}"]
    if findings.dry_run is not None:
        lines += ["", "[sign_off]", f"date = {json.dumps(date)}", f"by = {json.dumps(by)}"]
        lines += [f"hil = {json.dumps(VERSION)}", f"digest = {json.dumps(digest)}"]
    for axis in findings.axes:
        lines += ["", f'[sign_off.axes."{axis.name}"]', *_axis(axis, by, date, digest)]
    return "\n".join(lines) + "\n"


def _axis(axis: AxisFindings, by: str, date: str, digest: str) -> Sequence[str]:
    unit, error = ("m", axis.following_error_max) if axis.axis < 3 else ("deg", math.degrees(axis.following_error_max))
    return [
        f"date = {json.dumps(date)}",
        f"by = {json.dumps(by)}",
        f"digest = {json.dumps(digest)}",
        f"scale_error = {axis.scale_error:.6f} # of the encoder, relative to the command",
        f"following_error_max_{unit} = {error:.6f} # at crawl speed",
    ]
