"""``hil identify`` as it is typed: its files, its refusals, and the wires of an emulated rig."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.cli.main import execute
from hil.config.load import load_rig
from hil.config.rig import BENCH_AXES

LOCK_STEP = ("--set", "rig.host.time=lock_step")
HARDWARE = """
extends = "emulated"
name = "lab"
kind = "hardware"
rails.modbus.x.port = 502
rails.modbus.y.port = 503
rails.modbus.z.port = 504
turntable.driver = "ascii"
turntable.ascii.port = "/dev/null"
vmu.rs422.port = "/dev/null"
io.port = 505
"""


def test_rig_file_that_it_writes_lays_the_lead_over_the_rig(tmp_path: Path) -> None:
    out, numbers = tmp_path / "led.toml", tmp_path / "numbers.json"
    assert execute(["identify", "mock", "--axis", "rails.x", "--out", str(out), "--json", str(numbers)]) == 0
    found = json.loads(numbers.read_text())["axes"]["rails.x"]
    rig = load_rig(str(out)).value
    assert rig.rails.x.lead_s == pytest.approx(found["lead_s"], abs=5e-5)
    assert (rig.rails.y.lead_s, rig.kind) == (0.0, "mock")
    assert found["passed"]
    assert found["setpoint_to_encoder_ms"] == pytest.approx(20.0 + 1e3 * found["lead_s"])


def test_lead_of_a_rig_in_a_file_is_read_from_its_folder(tmp_path: Path) -> None:
    (tmp_path / "rigs").mkdir()
    mine = tmp_path / "rigs" / "mine.toml"
    mine.write_text('extends = "mock"\nname = "mine"\n')
    out = tmp_path / "led.toml"
    assert execute(["identify", str(mine), "--axis", "turntable.yaw", "--out", str(out)]) == 0
    rig = load_rig(str(out)).value
    assert rig.name == "mine"
    assert rig.turntable.yaw.lead_s < 0.0


def test_lead_shrinks_the_pose_error_that_a_run_reports(tmp_path: Path) -> None:
    errors = []
    for k, rig in enumerate((["mock"], ["mock", "--set", "rig.rails.x.lead_s=-0.0107"])):
        path = tmp_path / f"{k}.json"
        execute(["run", "scheme-1", "--duration", "60", "--json", str(path), "--rig", *rig])
        run = json.loads(path.read_text())
        errors.append(run["bench"]["pose_error_mm"]["rms"])
        assert run["latency"]["pose_to_command_ms"]["p99"] == pytest.approx(0.0, abs=1e-6)
        assert run["latency"]["setpoint_to_encoder_ms"]["p50"] == pytest.approx(9.5, abs=1.5)
    assert errors[0] > 3.0 * errors[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("mock", "--axis", "rails.w"), ("--axis", "rails.w", "rails.x", "turntable.yaw")),
        (("mock", "--out", "lead.ini"), ("--out", "lead.ini", ".toml")),
        (("mock", "--out", "nowhere/lead.toml"), ("--out", "nowhere/lead.toml", "folder")),
        (("emulated", "--speed", "0"), ("--speed", "0", "above 0")),
        (("mock", "--speed", "2"), ("--speed", "2", "mock")),
        (("mock", "--set", "rig.rails.x.lead_s=0.3"), ("rails.x.lead_s", "0.3", "0.2")),
    ],
)
def test_bad_option_is_refused_in_a_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    assert execute(["identify", *arguments]) == 2
    line = capsys.readouterr().err.strip()
    assert "\n" not in line
    assert all(word in line for word in words), line


def test_file_that_exists_is_not_written_over(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "lab.toml").write_text("mine")
    assert execute(["identify", "mock", "--out", str(tmp_path / "lab.toml")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "lab.toml").read_text() == "mine"


def test_hardware_does_not_move_before_confirmation(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(HARDWARE)
    assert execute(["identify", str(path)]) == 2
    assert "clear the bench, then add --yes" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.wires
def test_ctrl_c_on_an_emulated_rig_ends_as_a_safe_stop_and_leaves_no_emulator() -> None:
    command = [sys.executable, "-m", "hil", "identify", "emulated", "--axis", "rails.y"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            pids: list[int] = []
            while len(pids) < 3:
                line = process.stderr.readline()
                assert line, "ended before the emulators were up"
                found = re.match(r"emulator process (\d+):", line)
                pids += [int(found[1])] if found else []
            time.sleep(1.5)  # wherever this falls, in opening or in moving
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=30.0)
        finally:
            process.kill()
    assert process.returncode == 3
    assert errors.strip().splitlines()[-1] == "stopped by the operator"
    deadline = time.monotonic() + 5.0
    while any(Path(f"/proc/{pid}").exists() for pid in pids):
        assert time.monotonic() < deadline, "an emulator is left"
        time.sleep(0.02)


@pytest.mark.slow
def test_axis_is_measured_over_a_wire(tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    code = execute(["identify", "emulated", "--axis", "rails.y", *LOCK_STEP, "--json", str(numbers)])
    assert code == 0
    found = json.loads(numbers.read_text())["axes"]["rails.y"]
    assert abs(found["lead_s"]) < 0.05
    assert found["sweep"][0]["gain"] == pytest.approx(1.0, abs=0.1)


@pytest.mark.slow
def test_all_axes_are_measured_over_their_wires(tmp_path: Path) -> None:
    numbers = tmp_path / "numbers.json"
    assert execute(["identify", "emulated", *LOCK_STEP, "--json", str(numbers)]) == 0
    assert set(json.loads(numbers.read_text())["axes"]) == set(BENCH_AXES)
