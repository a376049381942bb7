"""The loop closed through two emulated GigE Vision cameras: verdict, losses, a camera that ends, equal poses."""

from __future__ import annotations

import csv
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from contextlib import ExitStack
from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.cli.main import BAD_INPUT, SAFE_STOPPED, execute
from hil.config.load import load_rig, load_scenario
from hil.config.rig import Rig
from hil.drivers.cameras.base import SIDES
from hil.loop.outcome import Outcome
from hil.maths.random_streams import stream
from hil.parts.emulation.emulated_cameras import images_of_folder, rendered_cameras
from hil.session.assembly import start_axes
from hil.session.build import Job, wired_bench
from hil.session.warm_up import warm_up
from hil.vmu.geometry import geometry_of_rig
from tests.support.emulated_cameras import LEFT, RIGHT, emulated, require_libaravis
from tests.support.run_settings import NEAR, UNHURRIED, typed

pytestmark = pytest.mark.wires

PASSED, FAILED = 0, 1
SOURCE = "vmu.source=cameras"
FRAMES = 40
OTHERS = {"serial": "X", "offset_px": [528, 512], "binning": [2, 2], "reversed": [True, False]}


def run(duration_s: float, commands: dict[str, str] | None = None, killed: str = "") -> Outcome:
    """Run scheme 1 from near with cameras; commands: of the cameras' control ports; killed: process ended after 5 s."""
    require_libaravis()
    settings = [SOURCE, *NEAR, *UNHURRIED]
    job = Job(load_scenario("scheme-1", settings), load_rig("emulated", settings), 0, duration_s, 1.0)
    warm_up(job)
    with wired_bench(job) as bench:
        for camera, command in (commands or {}).items():
            host, port = bench.addresses[f"{camera}.faults"].rsplit(":", 1)
            with socket.create_connection((host, int(port))) as control:
                control.sendall(f"{command}\n".encode())
                assert control.recv(100) == b"ok\n"
        runner = bench.runner()
        if killed:
            threading.Timer(15.0, lambda: os.kill(bench.pids[killed], signal.SIGKILL)).start()
        return runner.run()


def test_kernels_are_loaded_before_a_run_through_cameras() -> None:
    warm_up(Job(load_scenario("scheme-1", [SOURCE]), load_rig("emulated", [SOURCE]), 0, 4.0, 1.0))


@pytest.mark.slow
def test_scheme_1_passes_through_cameras(tmp_path: Path) -> None:
    """Measured by ``hil run scheme-1 --rig emulated --set vmu.source=cameras --json -``, under ``vision``."""
    require_libaravis()
    arguments = ("--rig", "emulated", "--duration", "60", "--json", str(tmp_path / "run.json"))
    assert execute(["run", "scheme-1", *typed(SOURCE, *NEAR, *UNHURRIED), *arguments]) == 0


@pytest.mark.slow
@pytest.mark.parametrize("lost", [0.01, 0.05])
def test_lost_packets_cost_images_and_not_the_run(lost: float) -> None:
    outcome = run(15.0, {f"vmu.{side}": f"on drop {lost}" for side in ("left", "right")})
    assert outcome.stop == "completed"
    found = outcome.vision_counters
    assert found["incomplete"] > 0
    assert found["frames"] > 0.5 * found["pairs"]


@pytest.mark.slow
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_camera_that_ends_is_a_safe_stop_that_names_it(side: str) -> None:
    outcome = run(60.0, killed=f"vmu.{side}")
    assert outcome.stop.startswith(f"vmu.{side}: ")


@pytest.fixture
def approach(tmp_path: Path) -> tuple[Rig, Path]:
    """Return the rig, and the geometry file next to the folders of an approach's images."""
    job = Job(load_scenario("scheme-1", [SOURCE]), load_rig("emulated", ["rig.vmu.rate_hz=2"]), 0, 1.0, 1.0)
    rig, start = job.rig.value, start_axes(job.scenario.value, job.rig.value)
    cameras, rng = rendered_cameras(job.scenario.value, rig, 3), stream(3, "pictures")
    for side in SIDES:
        (tmp_path / side).mkdir()
    for k in range(FRAMES):
        pair = cameras.pair(start.rail_m - np.array([0.002 * k, 0.0, 0.0]), start.gimbal_rad + 1e-4 * k, rng)
        for side, image in zip(SIDES, pair, strict=True):
            assert cv2.imwrite(str(tmp_path / side / f"{k:04d}.png"), image)
    geometry = tmp_path / "vmu.json"
    geometry.write_text(geometry_of_rig(rig).model_dump_json())
    return rig, geometry


@pytest.mark.slow
def test_poses_are_the_same_from_a_folder_and_through_cameras(approach: tuple[Rig, Path], tmp_path: Path) -> None:
    rig, geometry = approach
    with ExitStack() as stack:
        for address, image_at in zip((LEFT, RIGHT), images_of_folder(tmp_path, rig), strict=True):
            stack.enter_context(emulated(address, image_at))
        live = _poses(f"camera:{LEFT},{RIGHT}", geometry, tmp_path / "live.csv", "--frames", "20")
    first = int(live[0]["frame"])
    folder = _poses(str(tmp_path), geometry, tmp_path / "folder.csv", "--start-frame", str(first), "--frames", "20")
    assert {row["status"] for row in live} == {"ok"}
    assert live == folder


def _poses(source: str, geometry: Path, out: Path, *options: str) -> list[dict[str, str]]:
    options = ("--geometry", str(geometry), "--out", str(out), "--rate-hz", "2", *options)
    assert execute(["vmu", source, *options]) == 0
    with out.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_a_run_with_a_live_television_camera_is_replayed_bit_for_bit(tmp_path: Path) -> None:
    require_libaravis()
    settings = ("monitor.source=camera", "rig.recording.images=png", "rig.recording.image_interval_s=0.0")
    options = ("--rig", "emulated", "--duration", "20", "--record", str(tmp_path))
    assert execute(["run", "scheme-1", *typed(*settings, *NEAR, *UNHURRIED), *options]) in {PASSED, FAILED}
    (recorded,) = tmp_path.glob("*.mcap")
    assert execute(["replay", str(recorded)]) == PASSED
    assert execute(["replay", str(recorded), "--monitor"]) == PASSED


@pytest.mark.slow
def test_a_run_begins_with_the_drift_check_and_a_camera_that_moved_refuses_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    require_libaravis()
    geometry, report = tmp_path / "vmu.toml", tmp_path / "run.json"
    drive = ("--drive", "--rig", "emulated", "--count", "16", "--out", str(geometry))
    assert execute(["calibrate", str(tmp_path / "views"), *drive, *typed(*UNHURRIED)]) in {PASSED, FAILED}
    settings = (SOURCE, f'rig.vmu.geometry_file="{geometry}"', "rig.vmu.drift_check.views=4", *NEAR, *UNHURRIED)
    options = ("--rig", "emulated", "--duration", "5", "--json", str(report))
    execute(["run", "scheme-1", *typed(*settings), *options])
    found = json.loads(report.read_text())
    assert found["stop"] == "completed"
    assert found["drift_check"]["passed"]
    capsys.readouterr()
    moved = "rig.vmu.camera.baseline_m=0.201"
    assert execute(["run", "scheme-1", *typed(*settings, moved), *options]) == SAFE_STOPPED
    found = json.loads(report.read_text())
    assert not found["drift_check"]["passed"]
    assert "stereo" in found["drift_check"]["moved"]
    assert found["stop"].startswith("vmu: drift check against calibration vmu-")
    assert f"safe stop: {found['stop']}" in capsys.readouterr().err.splitlines()


@pytest.mark.slow
def test_computer_without_cameras_gets_its_first_pose_in_two_commands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The last section of docs/how-to/use-cameras.md."""
    require_libaravis()
    geometry, poses = tmp_path / "vmu.json", tmp_path / "poses.csv"
    command = [sys.executable, "-m", "hil", "emulate", "cameras", "--geometry-out", str(geometry)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as desk:
        try:
            assert desk.stdout is not None
            assert [desk.stdout.readline().split()[0] for _ in range(3)] == ["vmu.left", "vmu.right", "Ctrl-C"]
            options = ("--geometry", str(geometry), "--out", str(poses), "--frames", "5")
            assert execute(["vmu", f"camera:{LEFT},{RIGHT}", *options]) == PASSED
            for key, value in OTHERS.items():
                other = json.loads(geometry.read_text())
                other["right"]["identity"][key] = value
                (tmp_path / "other.json").write_text(json.dumps(other))
                options = ("--geometry", str(tmp_path / "other.json"), "--out", str(tmp_path / "no.csv"))
                capsys.readouterr()
                assert execute(["vmu", f"camera:{LEFT},{RIGHT}", *options]) == SAFE_STOPPED
                (line,) = capsys.readouterr().err.splitlines()
                assert f"vmu.right: {key} " in line
            desk.send_signal(signal.SIGINT)
            desk.communicate(timeout=20)
        finally:
            desk.kill()
    with poses.open() as file:
        assert [(row["status"], row["identity"]) for row in csv.DictReader(file)] == [("ok", "proven")] * 5


def test_cameras_need_a_rig_on_wires(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "scheme-1", *typed(SOURCE)]) == BAD_INPUT
    assert capsys.readouterr().err.splitlines() == [
        '--set: vmu.source: "cameras": rig "mock" is in memory, use one on wires, as emulated'
    ]


def test_emulated_cameras_have_one_interface(capsys: pytest.CaptureFixture[str]) -> None:
    interface = 'rig.vmu.cameras.interface="gentl"'
    assert execute(["run", "scheme-1", "--rig", "emulated", *typed(SOURCE, interface)]) == BAD_INPUT
    assert capsys.readouterr().err.splitlines() == [
        '--set: rig.vmu.cameras.interface: "gentl": emulated cameras have "genicam"'
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ('pixel_format="Mono12"', "vmu.left: pixel format 'Mono12': the camera has "),
        ('trigger_source="Line7"', "vmu.left: trigger source 'Line7': the camera has "),
        ('trigger_source="Line0"', "allowed 0.4 s; trigger at Line0?"),  # at which there is no signal
    ],
)
def test_cameras_that_cannot_be_used_are_one_line(setting: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    require_libaravis()
    settings = (SOURCE, 'rig.vmu.cameras.trigger="hardware"', f"rig.vmu.cameras.{setting}", *UNHURRIED)
    options = ("--rig", "emulated", "--duration", "5")
    assert execute(["run", "scheme-1", *typed(*settings), *options]) == SAFE_STOPPED
    (line,) = (line for line in capsys.readouterr().err.splitlines() if line.startswith("safe stop: "))
    assert text in line


@pytest.mark.slow
def test_a_camera_of_another_size_than_its_pair_is_one_line(
    approach: tuple[Rig, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    rig, geometry = approach
    size = rig.vmu.camera.width_px, rig.vmu.camera.height_px
    smaller = size[0] // 2, size[1] // 2
    with ExitStack() as stack:
        for address, pixels in ((LEFT, size), (RIGHT, smaller)):
            image = np.zeros(pixels[::-1], np.uint8)
            stack.enter_context(emulated(address, lambda t_s, image=image: image, pixels))
        options = ("--geometry", str(geometry), "--out", str(geometry.with_name("poses.csv")))
        assert execute(["vmu", f"camera:{LEFT},{RIGHT}", *options]) == SAFE_STOPPED
    (line,) = (line for line in capsys.readouterr().err.splitlines() if "images of" in line)
    expected = f"images of {smaller[0]} x {smaller[1]} px, the geometry has {size[0]} x {size[1]}"
    assert line.endswith(f"vmu.right: {expected}")


def test_a_missing_camera_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    require_libaravis()
    assert execute(["cameras", "show", "127.0.0.9"]) == SAFE_STOPPED
    (line,) = capsys.readouterr().err.splitlines()
    assert "camera: no camera '127.0.0.9'" in line
