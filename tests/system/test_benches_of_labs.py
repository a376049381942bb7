"""Eleven benches of labs, each from a rig file of at most 30 lines: verdicts in lock-step and memory, replay, campaign.

Run with ``pytest -m slow tests/system/test_benches_of_labs.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final, NamedTuple

import pytest

import hil
from hil.cli.main import execute
from tests.support.lab_benches import (
    PLANE,
    RAILS_AND_YAW,
    TABLE_OF_ONE_AXIS,
    TARGET_ON_ONE_AXIS,
    TURNED_RAILS,
    TWO_RAILS,
)

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("campaign")]

FRAMES: Final = """
name = "camera"
rotation = "t_to_v"
fields = [{ name = "counter" }, { name = "time" }, { name = "position", scale = 0.001 }, { name = "quaternion" },
          { name = "sigma_position" }, { name = "sigma_angle" }]
checksum.kind = "none"
text.start = "$POSE,"
"""
TRACKER: Final = {
    "sensors.tracker.kind": "pose", "sensors.tracker.rate_hz": 10.0, "sensors.tracker.source": "udp",
    "sensors.tracker.stamp": "capture", "gnc.navigation.handover.sigma_m": 0.02,
    "gnc.navigation.handover.sigma_deg": 0.5,
}  # fmt: skip
CASES: Final = 100


class Lab(NamedTuple):
    """A bench: scenario, keys of its rig file, suffix of the rig that it extends, settings of the scenario.

    wires: further keys where it is emulated. flown_s: of a case of its campaign; short where the compiled loop has not
    what it needs.
    """

    scenario: str
    keys: str
    base: str = ""
    settings: dict[str, Any] = {}  # noqa: RUF012
    wires: str = ""
    flown_s: float = 60.0


LABS: Final = {
    "two rails": Lab("scheme-1", TWO_RAILS),
    "three rails and yaw": Lab("scheme-1", RAILS_AND_YAW),
    "table of one axis": Lab("scheme-1", TABLE_OF_ONE_AXIS),
    "driven plane": Lab("planar", PLANE),
    "floating vehicle with a tracker": Lab("planar-floating", "", "-floating", flown_s=10.0),
    "target on one axis": Lab("scheme-1", TARGET_ON_ONE_AXIS, "-manipulator", flown_s=10.0),
    "turned rails": Lab("scheme-1", TURNED_RAILS),
    "tracker alone": Lab("scheme-1", 'vmu.driver = "none"', settings=TRACKER),
    "camera by datagrams": Lab("scheme-1", "", wires='vmu.driver = "udp"\nvmu.udp.frames = "FRAMES"'),
    "no coupler": Lab("scheme-1", 'io.driver = "none"'),
    "IMU on a wire": Lab("scheme-1", "imu.earth_rate_degps = [0.0, 0.003, -0.003]"),
}


def bench(name: str, kind: str, folder: Path, port: int = 0) -> tuple[str, dict[str, Any]]:
    """Return the path of the rig file of ``name`` in ``folder``, and the settings of its scenario."""
    lab = LABS[name]
    frames = folder / "camera.toml"
    frames.write_text(FRAMES, encoding="utf-8")
    keys = lab.keys + ("\n" + lab.wires.replace("FRAMES", str(frames)) if kind == "emulated" else "")
    text = f'extends = "{kind}{lab.base}"\nname = "lab"\n{keys}\n'
    assert len([line for line in text.splitlines() if line.strip()]) <= 30
    (folder / "lab.toml").write_text(text, encoding="utf-8")
    return str(folder / "lab.toml"), dict(lab.settings) | ({"sensors.tracker.port": port} if lab.settings else {})


@pytest.mark.parametrize("kind", ["mock", "emulated"])
@pytest.mark.parametrize("name", LABS)
def test_bench_gives_a_verdict_and_is_replayed(name: str, kind: str, tmp_path: Path) -> None:
    rig, settings = bench(name, kind, tmp_path, 24711)
    if kind == "emulated":
        settings["rig.host.time"] = "lock_step"
    run = hil.run(LABS[name].scenario, rig, 1, 20.0, settings, record=tmp_path)
    assert run.stop == "completed"
    (file,) = tmp_path.glob("*.mcap")
    assert execute(["replay", str(file)]) == 0


@pytest.mark.parametrize("name", LABS)
def test_bench_flies_in_a_campaign(name: str, tmp_path: Path) -> None:
    rig, settings = bench(name, "mock", tmp_path, 24712)
    lab = LABS[name]
    campaign = hil.campaign(
        lab.scenario, CASES, tmp_path / "cases", duration_s=lab.flown_s, overrides=settings, rig=rig
    )
    assert campaign.to_pandas()["stop"].eq("completed").sum() == CASES
