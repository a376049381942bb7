"""Header of a recording: names, versions, configuration and calibration."""

from __future__ import annotations

import importlib.metadata
import json
import platform
from pathlib import Path
from typing import Any

from hil.config.motion_digest import motion_digest
from hil.config.scenario import Scenario
from hil.core.arithmetic import formula_versions
from hil.core.build_info import build_info
from hil.core.clock import utc_text
from hil.core.files import sha256_of
from hil.core.part import hooks, parts
from hil.params.sensors import sensors_of
from hil.recording import audit
from hil.recording.schema import HELD_FILE, PARTS_FILE, SENSORS_FILE, VERSION
from hil.recording.writer import RecordingHeader
from hil.session.assembly import Job


def header_of(job: Job, rig_name: str, run: str, started_ns: int) -> RecordingHeader:
    """Return the header of the recording ``run`` of ``job``. Raises BadInput for an invalid file that it refers to."""
    scenario, rig = job.scenario.value, job.rig.value
    facts = {
        "schema_version": str(VERSION),
        audit.AUDIT: audit.VERSION,
        "run": run,
        "scenario": scenario.name,
        "scenario_file": job.scenario.source,
        "rig": rig_name,
        "rig_file": job.rig.source,
        "rig_kind": rig.kind,
        "seed": str(job.seed),
        "duration_s": repr(job.duration_s),
        "step_s": repr(scenario.step_s),
        "speed": repr(job.speed),
        "started_utc": utc_text(started_ns),
        "hil": build_info().version,
        "hil_commit": build_info().commit,
        "python": platform.python_version(),
        "system": platform.platform(),
        "host": platform.node(),
        "calibration_motion": motion_digest(rig),
        "calibration_sign_off": (rig.sign_off.digest or "") if rig.sign_off else "",
        "mcap": importlib.metadata.version("mcap"),
        **formula_versions(),
        "without_fixed_bits": ", ".join(_without_fixed_bits(scenario)),
        **file_digests({"scenario": scenario.model_dump(mode="json"), "rig": rig.model_dump(mode="json")}),
    }
    files = {"scenario.json": scenario.model_dump_json(), "rig.json": rig.model_dump_json(), **_calibrations(job)}
    return RecordingHeader(facts, files, started_ns)


def _without_fixed_bits(scenario: Scenario) -> list[str]:
    """Return the parts of the run whose arithmetic is not this program's: their last bits depend on the computer."""
    gnc = scenario.gnc
    parts = {
        "shadow filter": gnc.shadow.enabled,
        "pictures": scenario.vmu.source == "rendered" or scenario.monitor.has_images,
        "GNC of the user": gnc.binary is not None or bool(gnc.foreign),
        "sensors of the user": any(
            not each.kind.module.__module__.startswith("hil.") for each in sensors_of(scenario).values()
        ),
    }
    return [name for name, present in parts.items() if present]


def _calibrations(job: Job) -> dict[str, str]:
    """Return what parts assume of cameras and targets, and what the rows of sensors and held axes mean."""
    scenario, rig = job.scenario.value, job.rig.value
    files: dict[str, str] = {}
    about = {}
    for part, version, origin in parts().usable.values():
        tables, used = part.tables_in(scenario, rig), part.used_by(scenario, rig)
        if tables or used:
            topics = [sink.topic for sink in part.sinks.values() if sink.topic and used]
            about[part.name] = {"version": version, "origin": origin, "topics": topics, "tables": tables}
    if about:
        files[PARTS_FILE] = json.dumps(about)
    for attachments in hooks("attachments", scenario, rig):
        files |= attachments(scenario, rig)
    if sensors_of(scenario):
        files[SENSORS_FILE] = json.dumps(sensor_columns(scenario))
    if groups := rig.groups_at_places:
        files[HELD_FILE] = json.dumps(
            {
                name: {"axes": table.axis_names, "unit": "m" if table.si_per_unit == 1.0 else "rad"}
                for name, table in groups.items()
            }
        )
    return files


def sensor_columns(scenario: Scenario) -> dict[str, Any]:
    """Return kind and components of each further sensor, by name: what its rows in a recording mean."""
    return {
        name: {"kind": config.kind, "components": [{"name": c.name, "unit": c.unit} for c in kind.components]}
        for name, (kind, config, _) in sensors_of(scenario).items()
    }


def file_digests(table: dict[str, Any], prefix: str = "calibration_") -> dict[str, str]:
    """Return a digest of each file that a key of the configuration ending in ``_file`` names; prefix: of the key."""
    digests: dict[str, str] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            digests |= file_digests(value, f"{prefix}{key}.")
        elif key.endswith("_file") and isinstance(value, str):
            path = Path(value)
            digest = f"sha256:{sha256_of(path)}" if path.is_file() else "missing"
            digests[f"{prefix}{key}"] = f"{path.name} {digest}"
    return digests
