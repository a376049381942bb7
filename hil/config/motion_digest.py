"""Digest of everything in a rig that decides its motion: a sign-off is valid for one digest."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Final

from hil.config.load import load_protocol
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, UNIT_AXES, Rig
from hil.core.files import sha256_of

_NOT_COUNTED: Final = {"name", "sign_off", "recording", "telemetry"}


def motion_digest(rig: Rig) -> str:
    """Return "sha256:..." over all tables that decide or protect the motion, and over the files that they name.

    Excluded are what is recorded, what only emulators have, the bench's error budget, the leads, which ``hil identify``
    measures on a signed-off rig (setpoints are limited after their lead), the reference of the drift check, and the CPU
    of the loop. Raises BadInput if a protocol file cannot be read.
    """
    table = rig.model_dump(mode="json", exclude=_NOT_COUNTED)
    for key in ("linear_axes", "rotary_axes"):
        if not table[key]:  # as before there were any
            del table[key]
    del table["vmu"]["drift_check"], table["host"]["cpu"]
    for key in ("floating", "imu"):
        if getattr(rig, key) is None:  # as before there were any
            del table[key]
    for key, default in (("lab_axes", UNIT_AXES), ("rails_order", "xyz"), ("geometry_file", None)):
        if getattr(rig.bench, key) == default:  # as before there were any
            del table["bench"][key]
    for key in ("errors", "tolerance_m", "tolerance_deg", "thermal_sigma_m", "thermal_sigma_deg"):
        del table["bench"][key]
    if rig.console.on_loss != "continue":
        del table["console"]["on_loss"]  # the operator's choice of two safe reactions
    for device, names in (
        ("rails", RAIL_NAMES),
        ("turntable", GIMBAL_NAMES),
        ("target_manipulator", RAIL_NAMES),
        ("rotary_manipulator", GIMBAL_NAMES),
    ):
        if table[device] is None:
            continue
        for of_emulators in [key for key in table[device] if key == "mechanics" or key.startswith("drive_following")]:
            del table[device][of_emulators]
        (table[device].get("cia402") or {}).pop("emulated", None)
        for name in names:
            del table[device][name]["lead_s"]
        if not table[device]["controllers"]:
            del table[device]["controllers"]
    for device, gimbals in (("turntable", rig.turntable), ("rotary_manipulator", rig.rotary_manipulator)):
        if gimbals is not None and gimbals.ascii is not None:
            protocol = load_protocol(gimbals.ascii.protocol).value.model_dump(mode="json")
            if protocol["gimbals"] == list(GIMBAL_NAMES):
                del protocol["gimbals"]
            table[device]["ascii"]["protocol"] = protocol
    if (rails := rig.target_manipulator) is not None and rails.sharing == "none":
        for key in ("sharing", "path_s", "path_m"):  # as before there were any
            del table["target_manipulator"][key]
    _drop_not_fixed(table)
    _put_files_for_paths(table)
    text = json.dumps(table, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def _drop_not_fixed(table: dict[str, Any]) -> None:
    """Remove the position of each axis that is not fixed: as before there were fixed ones."""
    for key in ("fixed_m", "fixed_deg"):
        if key in table and table[key] is None:
            del table[key]
    for value in table.values():
        if isinstance(value, dict):
            _drop_not_fixed(value)


def _put_files_for_paths(table: dict[str, Any]) -> None:
    """Replace each path, key ``*_file``, by the digest of the file: a path depends on the working directory."""
    for key, value in table.items():
        if isinstance(value, dict):
            _put_files_for_paths(value)
        elif isinstance(value, str) and key.endswith("_file"):
            path = Path(value)
            table[key] = sha256_of(path) if path.is_file() else "missing"
