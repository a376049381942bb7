"""Record of a rig's last preflight, in the folder of its file: hardware runs need one of the last hour."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Final

from hil.checks.compatibility import requires_sign_off
from hil.checks.signed_record import read_signed, write_signed
from hil.config.load import Loaded
from hil.config.motion_digest import motion_digest
from hil.config.rig import Rig
from hil.core.operator_keys import OperatorKey
from hil.errors import BadInput, Problem

VALID_S: Final = 3600.0
MEASURED_S: Final = 60.0
"""Shortest measurement of the lateness."""
_RATE_TOLERANCE: Final = 1e-6


def record_path(rig: Loaded[Rig]) -> Path:
    """Return the file of the record: ``lab.preflight.json`` next to ``lab.toml``."""
    return Path(rig.source).with_suffix(".preflight.json")


def write_record(rig: Loaded[Rig], rate_hz: float, measured_s: float, passed: bool, by: OperatorKey | str) -> None:
    """Write the record of a preflight of hardware. Raises BadInput if it cannot be written.

    rate_hz: of the loop. measured_s: duration of the measurement of the lateness, s. by: key of
    the operator, or a name that nothing proves.
    """
    record = {
        "unix_time_s": time.time(),
        "digest": motion_digest(rig.value),
        "rate_hz": rate_hz,
        "measured_s": measured_s,
        "passed": passed,
    }
    write_signed(record, record_path(rig), by)


def check_preflight(rig: Loaded[Rig], step_s: float, now_unix_s: float | None = None) -> list[Problem]:
    """Return a problem if hardware has no passed preflight of the last hour for this rig and period.

    A waived sign-off waives it too; rigs that are not hardware need none.
    """
    if not requires_sign_off(rig.value):
        return []
    reason = _gap(rig, step_s, time.time() if now_unix_s is None else now_unix_s)
    advice = f"run hil preflight --rig {rig.source} --devices"
    return [Problem(str(record_path(rig)), "preflight", f"{reason}: {advice}")] if reason else []


def _gap(rig: Loaded[Rig], step_s: float, now_unix_s: float) -> str:
    path = record_path(rig)
    if not path.exists():
        return "is missing"
    try:
        record = read_signed(path)
        age_s, measured_s = now_unix_s - float(record["unix_time_s"]), float(record["measured_s"])
        digest, passed, rate_hz = record["digest"], record["passed"], float(record["rate_hz"])
    except (BadInput, ValueError, LookupError, TypeError):
        return "cannot be read"
    if passed is not True:
        return "has failed"
    if not 0.0 <= age_s <= VALID_S:
        return f"is {age_s / 60.0:.0f} min old, allowed {VALID_S / 60.0:.0f} min"
    if not measured_s >= MEASURED_S:
        return f"measured the lateness for {measured_s:g} s, required {MEASURED_S:g} s"
    if digest != motion_digest(rig.value):
        return "is of another configuration of this rig"
    if abs(rate_hz * step_s - 1.0) > _RATE_TOLERANCE:
        return f"is for {rate_hz:g} Hz, the scenario has {1.0 / step_s:g} Hz"
    return ""
