"""Fixtures that many test modules share."""

from __future__ import annotations

import gc
import os
import re

OF_USERS = re.compile(r"FORCE_COLOR|NO_COLOR|CLICOLOR.*|COLUMNS|LINES|TTY_.*|PYTHON(WARNINGS|OPTIMIZE)|NUMBA_.*|MPL.*")
"""Variables by which a user changes what programs print or compile, for instance in a test's child processes."""
for _name in filter(OF_USERS.fullmatch, tuple(os.environ)):
    del os.environ[_name]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before numpy: the workers share the cores, and idle threads spin
gc.set_threshold(50_000)  # as the command line does: what the tests import stays, and searches for garbage are in vain

import shutil
import subprocess
import tomllib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import settings

import hil
from hil.config.load import load_rig, load_scenario
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from tests.support.plain_filters import PLAIN as PLAIN_FILTERS
from tests.support.undecided import WiresTests

# examples drawn from a fixed seed; no deadline, because a first call may compile a kernel
settings.register_profile("hil", deadline=None, derandomize=True, database=None, max_examples=150)
settings.load_profile("hil")

_ONE_WORKER = {
    "vmu": "vision unit",
    "monitor": "docking monitor",
    "monte_carlo": "campaign",
    "pytest_plugin": "test campaigns",
}
"""Packages whose unit tests share fixtures or kernels that are expensive to make, and the name of their group."""

_LONGEST_FIRST = ("wires", "system", "behaviour", "contract")
"""Marker and folders of the tests, by the duration of their groups."""


def pytest_configure(config: pytest.Config) -> None:
    """Repeat tests that pauses of the computer fail."""
    config.pluginmanager.register(WiresTests())


@pytest.hookimpl(tryfirst=True)  # before xdist reads the groups
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Assign each test to the group of one worker, so that expensive fixtures are made once.

    Tests marked ``wires`` run one after the other. A module may name its own group by ``xdist_group``; any other
    module is a group of its own. The groups begin in the order of ``_LONGEST_FIRST``, so that no worker waits at the
    end for a long one.
    """
    items.sort(key=_rank)
    groups = {item: "wires" if item.get_closest_marker("wires") else _group(item) for item in items}
    for node in {node for item in items for node in item.listchain()}:  # xdist would join the groups of all nodes
        node.own_markers[:] = [marker for marker in node.own_markers if marker.name != "xdist_group"]
    for item, group in groups.items():
        item.add_marker(pytest.mark.xdist_group(group))


def _rank(item: pytest.Item) -> int:
    """Return the position of the test's kind in ``_LONGEST_FIRST``."""
    kinds = {"wires"} if item.get_closest_marker("wires") else {*item.path.parts}
    return next((n for n, kind in enumerate(_LONGEST_FIRST) if kind in kinds), len(_LONGEST_FIRST))


def _group(item: pytest.Item) -> str:
    """Return the group that the module names, or that of its folder, or the module's name."""
    named = item.get_closest_marker("xdist_group")
    return str(named.args[0]) if named else _ONE_WORKER.get(item.path.parent.name, item.path.stem)


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


LATE = ("vmu.latency_s=0.1", "vmu.latency_jitter_s=0.25", "vmu.duplicate_probability=0.2", "vmu.loss_probability=0.1")
"""Poses that come late, out of order, twice and not at all: several in one cycle, none in others."""


@pytest.fixture(scope="session")
def recorded_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the recording of 8 s of scheme-1 on the mock rig whose poses come as in LATE; do not change it.

    Its filters are those of the bench paper.
    """
    settings = dict(setting.split("=") for setting in (*LATE, *PLAIN_FILTERS))
    overrides = {key: tomllib.loads(f"value={value}")["value"] for key, value in settings.items()}
    folder = tmp_path_factory.mktemp("recorded")
    found = hil.run("scheme-1", seed=3, duration_s=8.0, overrides=overrides, record=folder)
    return Path(found.summary["recording"]["file"])


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
