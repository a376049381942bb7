"""What a release is made of agrees: requirements with hashes, constraints, extras, actions, documented options."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

from hil.core.build_info import VERSION
from hil.errors import _EXTRAS
from hil.parts.campaigns.pytest_plugin.options import OPTIONS

ROOT = Path(__file__).resolve().parents[2]
USES = sorted((ROOT / "requirements").glob("*.txt"))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
BY_THE_WALL_CLOCK = {
    "they test time itself: watchdogs, the relay's 50 ms, kills, time to rest, lateness": """
        test_child_process test_datagram_flood test_emergency_stop test_failing_surroundings test_flight_computer
        test_fork_server test_hanging_gnc test_io_processes test_killed_in_each_mode test_killed_processes
        test_preflight_command test_realtime test_record_command test_runs_on_wires
        test_stop_in_each_phase test_two_controllers test_undecided
    """,
    "they test the time-outs of a driver, or a program of another maker is at the other end of the wire": """
        test_canopen_node test_genicam_cameras test_io_modbus test_mbpoll test_rails_middle_man test_rails_modbus
        test_turntable_ascii_noise test_turntable_timeouts test_vmu_rs422
    """,
    "bench and GNC run free of each other, over a network that loses and delays": """
        test_gnc_killed test_gnc_link test_two_hosts
    """,
    "a page, a browser, a viewer or a person keeps the wall clock": """
        test_campaign_on_wires test_commission_at_the_page test_commission_command test_console test_console_crowd
        test_console_network test_console_page test_console_strangers test_fault_matrix test_foxglove
        test_halt_from_page test_identify_command test_network_of_page test_page_widths
    """,
    "processes of cameras, trackers, the vision unit or the docking monitor run at their own pace": """
        test_calibrate_command test_cameras_in_the_loop test_images_on_wires test_live_monitor
        test_monitor_beside test_tracker_links
    """,
}
"""Modules with tests of the marker ``wires``, by the reason; all others are in lock-step or in simulated time."""


def pins(path: Path) -> dict[str, str]:
    """Return the version of each package that ``path`` pins, by its name in the form of the index."""
    found = re.findall(r"^([\w.-]+)(?:\[[\w,]+\])?==([\w.+!]+)", path.read_text(), re.MULTILINE)
    return {re.sub(r"[-_.]+", "-", name).lower(): version for name, version in found}


@pytest.mark.parametrize("path", USES, ids=lambda path: path.stem)
def test_requirements_of_each_use_have_hashes_and_the_versions_of_the_constraints(path: Path) -> None:
    constraints, own = pins(ROOT / "constraints.txt"), pins(path)
    constraints = {} if path.stem == "audit" else constraints  # in an environment of its own
    assert {path.stem for path in USES} == {"build", "run", "dev", "docs", "audit"}
    assert len(own) > (5 if path.stem == "build" else 40)
    assert {name: version for name, version in own.items() if constraints.get(name, version) != version} == {}
    blocks = re.split(r"\n(?=\S)", path.read_text())
    assert [
        block.splitlines()[0] for block in blocks if "--hash=sha256:" not in block and not block.startswith("#")
    ] == []


def test_version_is_the_same_in_all_files_and_the_changelog_has_its_date() -> None:
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text())
    assert citation["version"] == VERSION
    assert f"\n## {VERSION} ({citation['date-released']})\n" in (ROOT / "CHANGELOG.md").read_text()
    for path in (ROOT / "plugins").glob("*/pyproject.toml"):
        plugin = tomllib.loads(path.read_text())["project"]
        own = [each for each in plugin["dependencies"] if each.startswith("hil-")]
        assert plugin["version"] == VERSION, path
        assert own
        assert [each for each in own if not each.endswith(f">={VERSION}")] == [], path


def test_metadata_are_of_a_version_that_indexes_take() -> None:
    for path in (ROOT / "pyproject.toml", *(ROOT / "plugins").glob("*/pyproject.toml")):
        targets = tomllib.loads(path.read_text())["tool"]["hatch"]["build"]["targets"]
        assert {name: each["core-metadata-version"] for name, each in targets.items()} == {
            "sdist": "2.4", "wheel": "2.4",
        }  # fmt: skip


def test_extra_named_for_a_missing_package_installs_it_and_is_in_all() -> None:
    extras = PROJECT["optional-dependencies"]
    (everything,) = extras["all"]
    for package, extra in _EXTRAS.items():
        assert extra in extras
        assert extra == "dev" or extra in everything
        name = {"cv2": "opencv"}.get(package, package)
        assert any(name in requirement for requirement in extras[extra]), package


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_workflow_pins_actions_by_commit_and_grants_nothing_by_default(path: Path) -> None:
    content = yaml.safe_load(path.read_text())
    assert content["permissions"] == {}
    steps = [step for job in content["jobs"].values() for step in job["steps"]]
    used = [step["uses"] for step in steps if "uses" in step]
    assert used
    assert all(re.fullmatch(r"[\w./-]+@[0-9a-f]{40}", each) for each in used)
    for target in re.findall(r"\bmake ([\w-]+)", path.read_text()):
        assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.MULTILINE), target


def test_what_is_installed_has_its_digest_checked() -> None:
    files = [ROOT / "Makefile", *WORKFLOWS]
    commands = re.findall(r"pip install ((?:[^\n]|\\\n)*)", "\n".join(path.read_text() for path in files))
    own = ("--no-deps", "dist/*.whl", "constraints-oracle.txt")
    assert len(commands) >= 5
    assert [each for each in commands if "--require-hashes" not in each and not any(word in each for word in own)] == []


def test_modules_with_tests_by_the_wall_clock_are_listed_with_the_reason() -> None:
    listed = {name for names in BY_THE_WALL_CLOCK.values() for name in names.split()}
    tests = [path for folder in ("tests", "plugins") for path in (ROOT / folder).rglob("test_*.py")]
    marker = r"^(@|pytestmark = .*)pytest\.mark\.wires\b|^    +.*pytest\.mark\.wires[],]"
    assert listed == {path.stem for path in tests if re.search(marker, path.read_text(encoding="utf-8"), re.MULTILINE)}


def test_documented_options_of_pytest_exist() -> None:
    pages = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "docs" / "how-to").glob("*.md")]
    commands = [line for page in pages for line in page.read_text().splitlines() if line.startswith("pytest ")]
    assert len(commands) >= 4
    contract_suite = (ROOT / "tests" / "contract" / "conftest.py").read_text()
    of_contracts = set(re.findall(r'addoption\("(--[\w-]+)"', contract_suite))
    for command in commands:
        known = of_contracts if "tests/contract" in command else set(OPTIONS)
        assert set(re.findall(r"(?<= )--[\w-]+", command.split("#")[0])) <= known, command
