"""A test campaign on emulated wires, and on hardware with an operator at a terminal."""

from __future__ import annotations

import json
import os
import re
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.clock import WallClock
from hil.parts.emulation.emulated_devices import EmulatedDevices
from tests.support.pytest_runs import environment, pytest_command, pytest_run
from tests.support.run_settings import HARDWARE_WIRES, UNHURRIED
from tests.system.test_killed_processes import lab_file

NEAR = {
    "initial.position_m": [0.5, 0.01, -0.01],
    "rig.rails.x.park_m": 0.5,
    "rig.rails.y.park_m": 0.01,
    "rig.rails.z.park_m": -0.01,
    "duration_s": 2.0,
}
SETTINGS = [f"{key}={value}" for key, value in NEAR.items()]
TESTS = f"""
import pytest

pytestmark = pytest.mark.scenario("scheme-1", overrides={NEAR})

@pytest.mark.requirement("RVD-001")
def test_whole(run):
    assert run.stop == "completed"

def test_hold(bench):
    bench.home()
    bench.arm()
    assert bench.start(until=1.0).stop == "on hold"
"""


@pytest.mark.xdist_group("test campaigns")
def test_same_file_on_mock_and_in_lock_step_is_one_page_with_twins(tmp_path: Path) -> None:
    (tmp_path / "test_bench.py").write_text(TESTS)
    for rig in ("mock", "emulated"):
        done = pytest_run(tmp_path, "--rig", rig, "--results", "day")
        assert done.returncode == 0, done.stdout
    assert "mock: 2 passed\nemulated, lock-step: 2 passed" in done.stdout
    page = (tmp_path / "day" / "day.html").read_text()
    assert "4 of 4 tests passed on 2 rigs" in page
    assert page.count("mock / emulated, lock-step") == 2


class Technician:
    """Operator at a pseudo-terminal, who answers each question from ``answers``, then no."""

    def __init__(self, answers: dict[str, str]) -> None:
        self._ours, self._theirs = os.openpty()
        self.terminal = os.ttyname(self._theirs)
        self.shown = ""
        self._answers = answers

    def attend(self, process: subprocess.Popen[str]) -> None:
        """Answer until ``process`` has ended."""
        os.set_blocking(self._ours, False)
        answered = 0
        while process.poll() is None:
            try:
                self.shown += os.read(self._ours, 4096).decode()
            except BlockingIOError:
                with suppress(subprocess.TimeoutExpired):
                    process.wait(0.05)
            for found in re.finditer(r"(Operator's name: |\[y (\d\d) / n\] )", self.shown[answered:]):
                question = self.shown[answered : answered + found.end()]
                answered += found.end()
                reply = next((text for words, text in self._answers.items() if words in question), "n")
                digits = f" {found[2]}" if reply == "y" else ""
                os.write(self._ours, f"{reply}{digits}\n".encode())
                break


def hardware_day(folder: Path, lab: str, answer: str, *options: str) -> tuple[dict[str, Any], str]:
    """Return the results of ``TESTS`` on hardware, whose operator gives ``answer``, and what the operator was shown."""
    (folder / "test_bench.py").write_text(TESTS)
    technician = Technician({"name": "Ada", "clear of people": answer})
    command = pytest_command(f"--rig={lab}", "--results=day", f"--operator-terminal={technician.terminal}", *options)
    with subprocess.Popen(
        command, cwd=folder, env=environment(), text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT
    ) as process:
        technician.attend(process)
        assert process.stdout is not None
        output = process.stdout.read()
    assert process.returncode == 0, output
    day = json.loads((folder / "day" / "day.json").read_text())
    assert day["setups"]["lab"]["operator"] == "Ada"
    return day, technician.shown


@pytest.mark.wires
def test_hardware_moves_when_the_operator_confirms(tmp_path: Path) -> None:
    rig = load_rig("emulated", (*SETTINGS, *UNHURRIED, "rig.io.driver=none")).value  # a pause is no fault here
    with EmulatedDevices(load_scenario("scheme-1", SETTINGS).value, rig, WallClock(), 0) as emulated:
        wired, _ = emulated.wait_ready()
        lab = lab_file(tmp_path / "lab.toml", wired)
        with (tmp_path / "lab.toml").open("a") as file:
            file.write("".join(f"[rails.{axis}]\npark_m = {NEAR[f'rig.rails.{axis}.park_m']}\n" for axis in "xyz"))
        day, shown = hardware_day(tmp_path, lab, "y", "-k", "whole")
    assert [each["outcome"] for each in day["tests"]] == ["passed"]
    assert "Next test: test_bench.py::test_whole" in shown
    assert [row["step"] for test in day["tests"] for row in test["evidence"]] == ["hardware"]


def test_hardware_stays_closed_if_the_operator_does_not_confirm(tmp_path: Path) -> None:
    lab = tmp_path / "lab.toml"
    lab.write_text(f'extends = "emulated"\nname = "lab"\nkind = "hardware"\nsign_off.waived = true\n{HARDWARE_WIRES}')
    day, shown = hardware_day(tmp_path, str(lab), "n")  # nothing is at the wires: an attempt to open them fails
    assert [each["outcome"] for each in day["tests"]] == ["skipped"] * 2
    assert "Next test: test_bench.py::test_whole" in shown
    assert [row for test in day["tests"] for row in test["evidence"]] == []
