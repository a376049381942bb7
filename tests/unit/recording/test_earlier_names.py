"""Recordings of version 0.1 are read, although keys have been renamed since."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_geometry, load_rig, load_scenario, load_scene, shipped
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.scene import Scene
from hil.config.tables.model import ConfigModel
from hil.config.vmu_geometry import VmuGeometry
from hil.errors import BadInput
from hil.recording import read
from hil.recording.schema import _RENAMED, with_present_names
from hil.vmu.geometry import geometry_of_rig

MODELS: dict[str, type[ConfigModel]] = {m.__name__: m for m in (Scenario, Rig, Scene, VmuGeometry)}


def has_key(model: Any, key: str) -> bool:
    """Return whether ``model`` has the dotted ``key``."""
    for name in key.split("."):
        if name == "*":
            continue
        if not hasattr(model, "model_fields") or name not in model.model_fields:
            return False
        annotation = model.model_fields[name].annotation
        inner = [a for a in (annotation, *getattr(annotation, "__args__", ())) if hasattr(a, "model_fields")]
        model = inner[0] if inner else None
    return True


def test_earlier_keys_are_gone_and_lead_to_keys_that_exist() -> None:
    assert set(_RENAMED) == set(MODELS)
    for name, renamed in _RENAMED.items():
        for old, new in renamed.items():
            assert has_key(MODELS[name], new), new
            assert not has_key(MODELS[name], old), old


def earlier_text(model: str, table: dict[str, Any]) -> str:
    """Return a table as version 0.1 recorded it; keys with ``*`` keep their present names."""
    for old, new in _RENAMED[model].items():
        if "." not in old:
            if new in table:
                table[old] = table.pop(new)
            continue
        place: Any = table
        *parents, last = new.split(".")
        for parent in parents:
            place = place.get(parent) or {}
        if last in place:
            place[old.rsplit(".", 1)[1]] = place.pop(last)
    return json.dumps(table)


def recorded(tmp_path: Path, files: dict[str, str]) -> read.Recorded:
    scenario, rig = load_scenario("scheme-1").value, load_rig("mock").value
    return read.Recorded(tmp_path / "run.mcap", {}, None, scenario, rig, *[np.zeros(0)] * 2, [], None, True, files)


@pytest.mark.parametrize(("kind", "load"), [("scenarios", load_scenario), ("rigs", load_rig), ("targets", load_scene)])
def test_each_shipped_file_is_read_as_version_0_1_recorded_it(tmp_path: Path, kind: str, load: Any) -> None:
    for loaded in (load(name).value for name in shipped(kind)):
        model = type(loaded)
        text = earlier_text(model.__name__, loaded.model_dump(mode="json"))
        found = recorded(tmp_path, {"a.json": text}).calibration("a.json", model)
        assert found == loaded
        assert json.loads(text) != loaded.model_dump(mode="json") or kind == "targets"


def test_phases_dispersions_values_and_removed_keys_of_a_recorded_scenario_are_read() -> None:
    found = with_present_names(
        "Scenario",
        {
            "gnc": {
                "vision_only": {"gain": 1.0},
                "guidance": {"phases": {"ready": {"until_s": 300.0}}},
                "navigation": {"sensors": "vision"},
            },
            "dispersions": {"vmu": {"loss_share": {"kind": "uniform", "low": 0.0, "high": 0.1}}},
            "monitor": {"target": "reserve"},
            "console": {"adjustable": ["gnc.control.caution", "gnc.control.lead_s"]},
            "imu": {},
        },
    )
    assert found == {
        "gnc": {"guidance": {"phases": {"ready": {"end_time_s": 300.0}}}, "navigation": {"backend": "vision_alone"}},
        "dispersions": {"vmu": {"loss_probability": {"kind": "uniform", "low": 0.0, "high": 0.1}}},
        "monitor": {"target": "backup"},
        "console": {"adjustable": ["gnc.control.deadband_sigmas", "gnc.control.lead_s"]},
        "imu": {},
    }


def test_recorded_geometry_of_the_cameras_is_read(tmp_path: Path) -> None:
    table = geometry_of_rig(load_rig("mock").value).model_dump(mode="json", exclude_none=True)
    calibration = {
        "id": "a", "date": "2026-03-01", "target": "leds", "views": 1, "rms_px": 0.1, "noise": 1.0,
        "rail_sigma_m": 1e-5, "gimbal_sigma_deg": 0.01, "lever_arm_m": [0, 0, 0], "gimbal_order": "zyx",
        "camera_station_m": [0.6, 0, 0], "camera_axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "target_station_m": [0.1, 0, 0], "target_axes": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "covariance": [],
    }  # fmt: skip
    text = json.dumps(table | {"calibration": calibration})
    found = recorded(tmp_path, {"vmu_geometry.json": text}).calibration("vmu_geometry.json", VmuGeometry).calibration
    assert found is not None
    assert (found.camera_position_m[0], found.target_position_m[0]) == (0.6, 0.1)
    (tmp_path / "vmu.json").write_text(text)
    with pytest.raises(BadInput, match="camera_station_m: unknown key"):  # of files, present names alone
        load_geometry(str(tmp_path / "vmu.json"))


def test_recorded_change_of_a_setting_has_the_present_name_of_its_key() -> None:
    note = {"kind": "setting", "name": "ann", "cycle": 3, "message": "gnc.control.caution=1.5"}
    assert read.present_note(note)["message"] == "gnc.control.deadband_sigmas=1.5"
    order = {"kind": "order", "message": "go"}
    assert read.present_note(order) == order
