"""Fixtures that many test modules share."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

from hil.config.load import load_rig, load_scenario
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.recording.session import recording
from hil.report.summary import summarise
from hil.session import build

# examples drawn from a fixed seed; no deadline, because a first call may compile a kernel
settings.register_profile("hil", deadline=None, derandomize=True, database=None, max_examples=150)
settings.load_profile("hil")

# modules beside tests/unit that use no wires and hang on no time of the wall: they may run beside each other
_NO_WIRES = {
    "test_approach",
    "test_approach_events",
    "test_bad_input",
    "test_calibrate_command",
    "test_campaign_command",
    "test_campaign_parity",
    "test_console_operator",
    "test_frmn_processes",
    "test_frmn_torn_reads",
    "test_fusion_study",
    "test_gnc_check",
    "test_monitor_beside",
    "test_monitor_command",
    "test_operated_bench",
    "test_own_gnc",
    "test_own_gnc_over_udp",
    "test_reach",
    "test_record_command",
    "test_recorder_killed",
    "test_rendered_loop",
    "test_rendered_pictures",
    "test_replay",
    "test_runs_in_memory",
    "test_two_computers",
    "test_vmu_command",
    "test_vmu_streams",
}
_FAMILIES = {
    "vision unit": ("vmu", "rendered", "calib"),
    "docking monitor": ("monitor", "docking"),
    "campaign": ("campaign", "own_gnc"),
}


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Name the worker's group of each test, so that what is dear is made once.

    Tests on wires and on the wall clock go one after the other; those of the same kernels compile them in one
    place; any other module keeps its fixtures to itself.
    """
    for item in items:
        name = item.path.stem
        if "unit" not in item.path.parts and name not in _NO_WIRES:
            name = "wires"
        families = (family for family, words in _FAMILIES.items() if any(word in name for word in words))
        item.add_marker(pytest.mark.xdist_group(next(families, name)))


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a generator of a fixed seed."""
    return np.random.default_rng(20240517)


@pytest.fixture(scope="session")
def scheme_1() -> Scenario:
    """Return the shipped scenario scheme-1."""
    return load_scenario("scheme-1").value


@pytest.fixture(scope="session")
def scheme_2() -> Scenario:
    """Return the shipped scenario scheme-2."""
    return load_scenario("scheme-2").value


PLAIN = (
    "truth.relative_motion=hill",
    "truth.gravity_gradient=false",
    "truth.solar_pressure=false",
    "truth.flexible_array=false",
    "truth.misalignment_sigma_deg=0.0",
    "truth.force_scatter_sigma=0.0",
    "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
)


@pytest.fixture(scope="session")
def plain_1() -> Scenario:
    """Return scheme-1 with the linear motion of the bench paper and no disturbance."""
    return load_scenario("scheme-1", PLAIN).value


@pytest.fixture(scope="session")
def plain_2() -> Scenario:
    """Return scheme-2 with the linear motion of the bench paper and no disturbance."""
    return load_scenario("scheme-2", PLAIN).value


@pytest.fixture(scope="session")
def mock_rig() -> Rig:
    """Return the shipped rig mock."""
    return load_rig("mock").value


LATE = ("vmu.latency_s=0.1", "vmu.latency_jitter_s=0.25", "vmu.duplicate_share=0.2", "vmu.loss_share=0.1")
"""Poses that come late, out of order, twice and not at all: several in one cycle, none in others."""


@pytest.fixture(scope="session")
def recorded_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the recording of 8 s of scheme-1 on the mock rig whose poses come as in LATE; do not change it."""
    job = build.Job(load_scenario("scheme-1", LATE), load_rig("mock"), 3, 8.0, 1.0)
    folder = tmp_path_factory.mktemp("recorded")
    with recording(job, "mock", folder, lambda _: None) as taken:
        with build.runner(job, lambda *_: None, lambda _: None, taps=taken.taps) as runner:
            outcome = runner.run()
        summary, _ = summarise(outcome, job.scenario.value, job.rig.value, "mock", 3, 50.0)
        taken.finish(summary)
    return taken.path


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 2 MB; skips where this user must not mount one."""
    place = tmp_path / "disk"
    place.mkdir()
    if (
        shutil.which("mount") is None
        or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", "size=2m", "tmpfs", str(place)], capture_output=True, check=False
        ).returncode
    ):
        pytest.skip("cannot mount a tmpfs")
    yield place
    subprocess.run(["umount", "-l", str(place)], check=True)
