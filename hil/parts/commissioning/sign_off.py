"""Sign-off of a commissioned rig: a rig file that extends the commissioned one."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from hil.config.motion_digest import motion_digest
from hil.config.rig import Rig
from hil.config.tables.sign_off import SignOff
from hil.core.build_info import VERSION
from hil.core.operator_keys import OperatorKey, Signature
from hil.parts.commissioning.steps import AxisFindings, Findings


def signed_before(rig: Rig) -> frozenset[str]:
    """Return the axes that were signed off with the present rig."""
    if rig.sign_off is None:
        return frozenset()
    digest = motion_digest(rig)
    return frozenset(name for name, axis in rig.sign_off.axes.items() if axis.digest == digest)


def as_toml(findings: Findings, rig: Rig, base: str, by: OperatorKey | str, date: str) -> str:
    """Return the text of the file. base: the file it extends. by: the technician's key, or name alone. date: ISO.

    With a dry run the whole rig is signed off, without one only the axes.
    """
    digest = motion_digest(rig)
    lines = ["# Sign-off by hil commission: valid until a value is changed that affects the rig's motion."]
    lines += ["", f"extends = {json.dumps(base)}"]
    if findings.dry_run is not None:
        lines += ["", "[sign_off]", f"date = {json.dumps(date)}", *_signed(by, rig_record(date, digest))]
        lines += [f"hil = {json.dumps(VERSION)}", f"digest = {json.dumps(digest)}"]
    for axis in findings.axes:
        lines += ["", f'[sign_off.axes."{axis.name}"]', *_axis(axis, by, date, digest)]
    return "\n".join(lines) + "\n"


def free_file(rig: str) -> tuple[Path, str]:
    """Return a free path for the sign-off of ``rig``, a file or a shipped rig, and what the file at it extends.

    It is in the folder of the rig's file, or in the present one: ``lab-signed.toml``, then ``lab-signed-2.toml``.
    """
    file = Path(rig)
    folder = file.absolute().parent if file.suffix == ".toml" else Path.cwd()
    paths = (folder / f"{file.stem}-signed{f'-{n}' if n > 1 else ''}.toml" for n in itertools.count(1))
    return next(path for path in paths if not path.exists()), file.name


def rig_record(date: str, digest: str) -> list[Any]:
    """Return what the sign-off of a rig seals."""
    return ["sign-off", date, digest]


def axis_record(name: str, date: str, digest: str, scale_error: float, error_max: float) -> list[Any]:
    """Return what the sign-off of an axis seals. error_max: following error, m or deg."""
    return ["axis", name, date, digest, scale_error, error_max]


def signatures(sign_off: SignOff) -> Iterator[tuple[str, Signature, list[Any]]]:
    """Yield what is signed in a sign-off, its signature, and the record that it seals."""
    if sign_off.digest is not None:
        record = rig_record(sign_off.date or "", sign_off.digest)
        yield "rig", Signature(sign_off.by or "", sign_off.key, sign_off.seal), record
    for name, axis in sign_off.axes.items():
        error = axis.following_error_max_m if axis.following_error_max_m is not None else axis.following_error_max_deg
        record = axis_record(name, axis.date, axis.digest, axis.scale_error, error or 0.0)
        yield name, Signature(axis.by, axis.key, axis.seal), record


def _axis(axis: AxisFindings, by: OperatorKey | str, date: str, digest: str) -> Sequence[str]:
    unit, error = ("m", axis.following_error_max) if axis.axis < 3 else ("deg", math.degrees(axis.following_error_max))
    scale_error, error = round(axis.scale_error, 6), round(error, 6)
    return [
        f"date = {json.dumps(date)}",
        *_signed(by, axis_record(axis.name, date, digest, scale_error, error)),
        f"digest = {json.dumps(digest)}",
        f"scale_error = {scale_error:.6f} # of the encoder, relative to the command",
        f"following_error_max_{unit} = {error:.6f} # at crawl speed",
    ]


def _signed(by: OperatorKey | str, record: list[Any]) -> list[str]:
    return [f"{name} = {json.dumps(value)}" for name, value in asdict(Signature.of(by, record)).items() if value]
