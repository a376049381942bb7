"""Benches without a vision unit, and those whose poses come as datagrams: in memory, in lock-step, in a campaign."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.core.sensor_records import ACCEPTED
from hil.recording import read
from tests.support.run_settings import NEAR

TRACKER = {
    "rig.vmu.driver": "none", "sensors.tracker.kind": "pose", "sensors.tracker.rate_hz": 10.0,
    "gnc.navigation.handover.sigma_m": 0.02, "gnc.navigation.handover.sigma_deg": 0.5,
}  # fmt: skip
FRAMES = """
name = "tracker"
rotation = "t_to_v"
fields = [{ name = "counter" }, { name = "time" }, { name = "position", scale = 0.001 }, { name = "quaternion" },
          { name = "sigma_position" }, { name = "sigma_angle" }]
checksum.kind = "none"
text.separator = " "
"""


@pytest.fixture
def frames(tmp_path: Path) -> str:
    """Return the path of a file of frames of text."""
    (tmp_path / "tracker.toml").write_text(FRAMES)
    return str(tmp_path / "tracker.toml")


def near() -> dict[str, object]:
    return {key: json.loads(value) for key, _, value in (setting.partition("=") for setting in NEAR)}


def test_a_tracker_alone_navigates_in_memory() -> None:
    run = hil.run("scheme-1", duration_s=20.0, overrides={**near(), **TRACKER})
    assert run.stop == "completed"
    assert not run.summary["alarms"]
    assert np.max(run.summary["navigation"]["position_rmse_m"]) < 0.003
    assert run.summary["verdict"]["field_of_view"]["passed"]


def test_a_tracker_by_datagrams_of_text_is_fused_in_lock_step_as_in_memory(tmp_path: Path, frames: str) -> None:
    by_datagrams = {**near(), **TRACKER, "sensors.tracker.source": "udp", "sensors.tracker.port": 24611}
    by_datagrams |= {"sensors.tracker.stamp": "capture", "sensors.tracker.frames": frames}
    lock_step = {"rig.host.time": "lock_step"}
    run = hil.run("scheme-1", "emulated", 3, 2.0, by_datagrams | lock_step, record=tmp_path / "wires")
    assert run.stop == "completed"
    (path,) = (tmp_path / "wires").glob("*.mcap")
    arrivals = read.load(path).sensor_arrivals
    assert (arrivals["result"] == ACCEPTED).sum() >= 15
    in_memory = hil.run("scheme-1", "mock", 3, 2.0, by_datagrams)
    assert in_memory.stop == "completed"
    for each in (run, in_memory):
        assert np.max(each.summary["navigation"]["position_rmse_m"]) < 0.004


@pytest.mark.parametrize("form", ["hil", "text"])
def test_a_vision_unit_by_datagrams_flies_in_lock_step(frames: str, form: str) -> None:
    overrides = {"rig.vmu.driver": "udp", "rig.host.time": "lock_step"}
    if form == "text":
        overrides["rig.vmu.udp.frames"] = frames
    run = hil.run("scheme-1", "emulated", 1, 3.0, {**near(), **overrides})
    assert run.stop == "completed"
    assert run.summary["vision"]["frames"] >= 15
    assert run.summary["vision"]["crc_errors"] == run.summary["vision"]["skipped_bytes"] == 0


def test_a_run_prints_the_standard_deviation_of_each_state(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "hil"):
        hil.run("scheme-1", duration_s=1.0, overrides=TRACKER)
    assert "no vision unit: position x known to" in caplog.text
    assert "gyro drift z known to" in caplog.text


def test_a_campaign_flies_without_a_vision_unit(tmp_path: Path) -> None:
    campaign = hil.campaign("scheme-1", 4, tmp_path / "cases", duration_s=30.0, overrides=TRACKER)
    assert len(campaign.to_pandas()) == 4
    assert max(case["position_rmse_m_x"] for case in campaign.to_pandas().to_dict("records")) < 0.01
