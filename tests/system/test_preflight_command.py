"""``hil preflight`` through the command line; what this machine's lateness and privileges are does not matter here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from hil.cli.main import execute
from tests.support.run_settings import UNHURRIED, typed

OF_THIS_MACHINE = (
    "clock",
    "PTP",
    "scheduling",
    "memory lock",
    "CPU",
    "processors",
    "disk",
    "kernel",
    "compiled",
    "lateness",
)


@pytest.fixture(autouse=True)
def _short_measurement(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DURATION_S", "WIRED_S"):
        monkeypatch.setattr(f"hil.preflight.lateness.{name}", 0.5)


def _preflight(tmp_path: Path, *arguments: str) -> tuple[int, dict[str, Any]]:
    path = tmp_path / "preflight.json"
    code = execute(["preflight", "--json", str(path), *arguments])
    return code, json.loads(path.read_text())


def _own(found: dict[str, Any]) -> dict[str, bool | None]:
    """Return the results that do not depend on the machine."""
    return {c["name"]: c["passed"] for c in found["checks"] if not c["name"].startswith(OF_THIS_MACHINE)}


def test_preflight_on_mock_prints_a_table_and_its_verdict_is_its_exit_code(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    code, found = _preflight(tmp_path)
    printed = capsys.readouterr().out
    assert code == (0 if found["passed"] else 1)
    assert found["passed"] == all(check["passed"] is not False for check in found["checks"])
    assert (found["scenario"], found["rig"], found["rate_hz"]) == ("scheme-1", "mock", 50.0)
    assert _own(found) == {"reachability of scheme-1": True, "devices": None}
    assert sum(row["cycles"] for row in found["lateness_histogram"]) == 25
    for words in ("Preflight of mock for scheme-1", "what to do", "Lateness of an empty loop", "below"):
        assert words in printed
    assert ("PASS" in printed) == found["passed"]


@pytest.mark.wires
def test_preflight_on_emulated_opens_every_device(tmp_path: Path) -> None:
    code, found = _preflight(tmp_path, "--rig", "emulated", "--scenario", "scheme-2", *typed(*UNHURRIED))
    assert code == (0 if found["passed"] else 1)
    own = _own(found)
    assert own.pop("overtravel") is None  # the places of the switches are measured
    assert set(own.values()) == {True}, found
    assert {"reachability of scheme-2", "device rails", "device turntable", "device vmu", "port vmu.rs422.port"} <= set(
        own
    )
    assert "host rails.modbus.x" in own
    assert sum(row["cycles"] for row in found["lateness_histogram"]) == 25


def test_plan_out_of_reach_fails_the_preflight(tmp_path: Path) -> None:
    code, found = _preflight(tmp_path, "--set", "initial.position_m=[13.0, 0.0, 0.0]")
    assert code == 1
    assert found["passed"] is False
    assert _own(found)["reachability of scheme-1"] is False


@pytest.mark.parametrize("arguments", [("--rig", "nowhere"), ("--scenario", "scheme-9"), ("--json", "/no/such/x.json")])
def test_bad_input_of_preflight_is_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]) -> None:
    assert execute(["preflight", *arguments]) == 2
    assert len(capsys.readouterr().err.strip().splitlines()) == 1
