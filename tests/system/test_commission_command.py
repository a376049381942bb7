"""``hil commission`` on the wires of an emulated rig: the whole path, and the faults that it is there to find."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.checks.compatibility import sign_off_gap
from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.config.motion_digest import motion_digest
from hil.core.modes import Mode
from hil.loop.runner import Runner
from hil.parts.commissioning.prompt import ScriptedPrompt, StepFailed
from hil.parts.commissioning.steps import Commissioning, CommissioningPlan
from hil.parts.emulation.fault_injection import FaultControl
from hil.parts.emulation.operator import AutoOperator
from hil.parts.wires.wired import WiredBench
from hil.session import build
from hil.session.warm_up import warm_up

pytestmark = pytest.mark.wires

X, Y, YAW = 0, 1, 5
SPEED = 2.0
SIGNED = ("rails.x", "rails.z", "turntable.roll", "turntable.pitch")
RIG = """
extends = "emulated"
name = "near its start"
rails.x.park_m = 4.95
rails.y.park_m = -0.25
io.pump_timeout_s = 0.5
io.timeout_s = 1.0
io.coils.brakes_released = 26
io.inputs.brakes_closed = 2
"""


@pytest.fixture(scope="module")
def rig_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a rig of which four axes are signed already."""
    path = tmp_path_factory.mktemp("rigs") / "near.toml"
    path.write_text(RIG)
    digest = motion_digest(load_rig(str(path)).value)
    entry = f'{{ date = "2026-03-01", by = "T", digest = "{digest}", scale_error = 0.0 }}'
    path.write_text(RIG + "[sign_off.axes]\n" + "".join(f'"{name}" = {entry}\n' for name in SIGNED))
    return path


@pytest.fixture
def bench(rig_file: Path) -> Iterator[WiredBench]:
    """Yield a bench of one test: an axis that is wired wrongly may end on its limit switch."""
    job = build.Job(load_scenario("scheme-1"), load_rig(str(rig_file)), 0, 0.02, SPEED)
    warm_up(job)
    with build.wired_bench(job) as wired:
        yield wired


def commission(bench: WiredBench, axis: int) -> tuple[StepFailed, Runner]:
    """Commission one axis, which does not pass; return why, and the session."""
    assert bench.board is not None
    technician = AutoOperator(bench.board, bench.addresses)
    runner = bench.runner()
    plan = CommissioningPlan([axis])
    steps = Commissioning(runner, bench.rig, ScriptedPrompt(), plan, technician, technician.position)
    with pytest.raises(StepFailed) as raised:
        steps.run()
    return raised.value, runner


@pytest.mark.parametrize(
    ("fault", "axis", "what", "found"),
    [
        ("rails: on reversed y", Y, "rails.y: first move", "by the encoder; encoder and motor have opposite signs"),
        ("rails: on mirrored y", Y, "rails.y: sign", "measured; motor and encoder both have the wrong sign"),
        pytest.param(
            "rails: on scaled y 1.1",
            Y,
            "rails.y: scale",
            "+18.* mm measured; set the counts per revolution",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "turntable: on scaled yaw 0.9",
            YAW,
            "turntable.yaw: scale",
            "+2.2.* deg measured; set the counts per revolution",
            marks=pytest.mark.slow,
        ),
        pytest.param(
            "rails: on stuck y",
            Y,
            "rails.y: following",
            "by the encoder; the axis does not follow",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_axis_that_is_wired_wrongly_is_named_with_what_to_do(
    bench: WiredBench, fault: str, axis: int, what: str, found: str
) -> None:
    device, _, line = fault.partition(": ")
    assert bench.board is not None
    control = FaultControl(bench.addresses[f"{device}.faults"])
    try:
        control.send(line)
        failure, runner = commission(bench, axis)
        end_s = time.monotonic() + 10.0
        while abs(bench.board.read(device, runner.now_s())[1]).max() > 2e-3:
            assert time.monotonic() < end_s, "still moves"
            time.sleep(0.01)
    finally:
        control.send("clear")
        control.close()
    assert failure.what == what
    assert re.search(found.replace("+", r"\+"), str(failure)), str(failure)
    assert runner.safety.modes.mode is not Mode.OFF


def test_a_relay_that_does_not_monitor_the_pump_is_found(bench: WiredBench) -> None:
    control = FaultControl(bench.addresses["io.faults"])
    try:
        control.send("on pump_ignored")
        failure, _ = commission(bench, Y)
    finally:
        control.send("clear")
        control.close()
    assert failure.what == "io: charge pump"
    assert "time-out of the charge pump chain closed 0.65 s after the last pulse, allowed 0.5 s" in str(failure)


@pytest.mark.slow
def test_whole_path_ends_in_a_rig_file_that_is_signed_off(rig_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = rig_file.with_name("signed.toml")
    arguments = [
        "--axis",
        "rails.y",
        "--axis",
        "turntable.yaw",
        "--yes",
        "--operator",
        "T. Echnician",
        "--date",
        "2026-03-02",
    ]
    code = execute(["commission", str(rig_file), *arguments, "--out", str(out), "--speed", f"{SPEED:g}"])
    printed = capsys.readouterr()
    assert code == 0, printed.err
    told = printed.out
    titles = re.findall(r"^-- (.*)$", told, re.MULTILINE)
    assert titles == [
        "emergency stop",
        "safety chain",
        "identity of the devices",
        "rails.y: sign and scale",
        "turntable.yaw: sign and scale",
        "limits",
        "dry run",
    ]
    assert "io: emergency stop detected, safety chain open" in told
    assert "io: released, chain stayed open, closed again after the reset" in told
    for line in (
        r"io: chain read as open 0\.\d+ s after the last pulse, time-out 0\.5 s",
        r"io: chain opened while the watchdog process was stopped for 0\.65 s",
        r"io: holding brakes read as closed after 0\.\d+ s",
        r"io: holding brakes read as open after 0\.\d+ s",
        r"rails\.y: its driver cannot limit the torque: full torque",
        r"turntable\.yaw: torque at most 300 per mille of the rated one \(0x6072, reduced\)\n"
        r"(.*\n)+?turntable\.yaw: torque at most 1000 per mille of the rated one \(0x6072\)",
        r"rails\..*, 0\.\d+ s after enable was switched off",
        r"turntable\..*, 0\.\d+ s after enable was switched off",
    ):
        assert re.search(line, told), told
    assert told.strip().endswith("the rig is signed off")
    rig = load_rig(str(out)).value
    assert sign_off_gap(rig) == ""
    assert rig.sign_off is not None
    assert (rig.sign_off.by, rig.sign_off.date) == ("T. Echnician", "2026-03-02")
    assert abs(rig.sign_off.axes["rails.y"].scale_error) < 0.02
    assert 0.0 < (rig.sign_off.axes["turntable.yaw"].following_error_max_deg or 0.0) < 0.5


@pytest.mark.slow
def test_ctrl_c_at_a_question_ends_as_a_safe_stop() -> None:
    command = [
        sys.executable,
        "-m",
        "hil",
        "commission",
        "emulated",
        "--axis",
        "rails.y",
        "--operator",
        "T",
        "--speed",
        "2",
    ]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(command, text=True, **pipes) as process:  # type: ignore[call-overload]
        try:
            told = ""
            while "Has the carriage moved" not in told:
                letter = process.stdout.read(1)
                assert letter, f"ended before it asked: {told} {process.stderr.read()}"
                told += letter
                if asked := re.search(r"\[y (\d\d) / n\]$", told):  # the emergency stop; the next question stays open
                    process.stdin.write(f"y {asked[1]}\n")
                    process.stdin.flush()
            time.sleep(1.0)  # longer than the drives' watchdogs: the axes are kept under command
            assert process.poll() is None
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=30.0)
        finally:
            process.kill()
    assert process.returncode == 3
    assert errors.strip().splitlines()[-1] == "stopped by the operator"
