"""Digest of everything in a rig that decides its motion: a sign-off is valid for one digest."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any, Final

from hil.config.load import load_protocol
from hil.config.renamed_keys import with_first_names
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, Rig
from hil.core.files import sha256_of

_TABLES: Final = ("kind", "bench", "rails", "turntable", "io", "safety", "target_manipulator", "rotary_manipulator")


def motion_digest(rig: Rig) -> str:
    """Return "sha256:..." over the tables that decide the motion and over the files that they name.

    Keys count under their first names, so that a sign-off outlasts a renaming. Excluded are the leads, which
    ``hil identify`` measures on a signed-off rig: setpoints are limited after their lead. Raises BadInput if a
    protocol file cannot be read.
    """
    table = with_first_names("Rig", rig.model_dump(mode="json", include=set(_TABLES)))
    for device, names, key in (
        ("rails", RAIL_NAMES, "jerk_max_mps3"),
        ("turntable", GIMBAL_NAMES, "jerk_max_degps3"),
        ("target_manipulator", RAIL_NAMES, "jerk_max_mps3"),
        ("rotary_manipulator", GIMBAL_NAMES, "jerk_max_degps3"),
    ):
        if table[device] is None:
            if device == "rotary_manipulator":
                del table[device]  # added later: a sign-off from before stays valid
            continue
        if table[device]["exchange_rate_max_hz"] is None:
            del table[device]["exchange_rate_max_hz"]  # added later: a sign-off from before stays valid
        for of_emulators in [key for key in table[device] if key == "mechanics" or key.startswith("drive_following")]:
            del table[device][of_emulators]
        for name in names:
            del table[device][name]["lead_s"]
            if table[device][name][key] is None:
                del table[device][name][key]  # likewise
    if rig.bench.axes_rate_hz is None:
        del table["bench"]["axes_rate_hz"]  # likewise
    if not rig.bench.bodies:
        del table["bench"]["bodies"], table["bench"]["bodies_distance_m"]  # likewise
    if rig.rails.map.functions == (23,):
        del table["rails"]["map"]["functions"]  # likewise
    for rails in (table["rails"], table["target_manipulator"]):
        if rails is not None:
            del rails["map"]["following_error"]  # name of a fault
    if guard := rig.guard.model_dump(mode="json", exclude_defaults=True):
        table["guard"] = guard  # likewise: with its defaults it does not count
    for device, gimbals in (("turntable", rig.turntable), ("rotary_manipulator", rig.rotary_manipulator)):
        if gimbals is not None and gimbals.ascii is not None:
            table[device]["ascii"]["protocol"] = _protocol(gimbals.ascii.protocol)
    _put_files_for_paths(table)
    text = json.dumps(table, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return f"sha256:{hashlib.sha256(text.encode()).hexdigest()}"


def _protocol(name: str) -> dict[str, Any]:
    """Return the contents of a protocol file. Raises BadInput if it cannot be read."""
    dump = with_first_names("Protocol", load_protocol(name).value.model_dump(mode="json"))
    if dump["emulator"]["torque_off"] is None:
        dump["emulator"]["torque_off"] = 2  # its first default
    del dump["faults"]["following_error"]  # likewise
    return dump


def _put_files_for_paths(table: dict[str, Any]) -> None:
    """Replace each path, key ``*_file``, by the digest of the file: a path depends on the working directory."""
    for key, value in table.items():
        if isinstance(value, dict):
            _put_files_for_paths(value)
        elif isinstance(value, str) and key.endswith("_file"):
            path = Path(value)
            table[key] = sha256_of(path) if path.is_file() else "missing"
