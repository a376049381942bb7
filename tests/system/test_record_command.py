"""Recording through the command line: run, list, recover, export, report; and everything that can be wrong."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from hil.cli.main import INCOMPLETE, execute
from hil.recording.catalogue import BROKEN_OFF, Catalogue
from hil.recording.read import contents, load
from hil.recording.recover import recover
from hil.recording.replay import replay
from tests.support.run_settings import NEAR, UNHURRIED, typed


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with two recorded runs of one scenario, seeds 1 and 2."""
    found = tmp_path_factory.mktemp("runs") / "made" / "here"
    for seed in (1, 2):
        options = [
            "--seed",
            str(seed),
            "--duration",
            "4",
            "--record",
            str(found),
            "--json",
            f"{found.parents[1]}/run.json",
        ]
        assert execute(["run", "scheme-1", *options]) == 1
    return found


def files(folder: Path) -> list[str]:
    return sorted(map(str, folder.glob("*.mcap")))


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the one line that the command printed."""
    capsys.readouterr()
    assert execute(list(arguments)) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1, lines
    return lines[0]


def test_recorded_runs_are_listed(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert execute(["recordings", "list", str(folder), "--failed", "--since", "2020-01-01", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)["runs"]
    assert [(run["scenario"], run["seed"], run["passed"], run["cycles"]) for run in found] == [
        ("scheme-1", 1, False, 201),
        ("scheme-1", 2, False, 201),
    ]
    assert [run["file"] for run in found] == files(folder) or len({run["file"] for run in found}) == 2
    for options in (["--passed"], ["--scenario", "scheme-2"], ["--since", "2999-01-01T10:00"]):
        assert execute(["recordings", "list", "--record", str(folder), *options]) == 0
        assert capsys.readouterr().out.startswith("0 runs")


def test_json_of_a_run_names_its_recording(folder: Path) -> None:
    told = json.loads((folder.parents[1] / "run.json").read_text())["recording"]
    assert told["file"] in files(folder)
    assert (told["dropped"], told["problem"]) == (0, "")


def test_a_recording_holds_configuration_versions_and_the_run_s_numbers(folder: Path) -> None:
    recorded = load(Path(files(folder)[0]))
    assert "recording" not in (recorded.summary or {})
    assert recorded.scenario.name == "scheme-1"
    assert recorded.rig.kind == "mock"
    assert recorded.run["hil"]
    assert recorded.run["numpy"] == np.__version__
    assert recorded.run["calibration_motion"].startswith("sha256:")
    assert recorded.summary is not None
    assert recorded.summary["timing"]["cycles"] == len(recorded.cycles) == 201
    kinds = {note["kind"] for note in recorded.log}
    assert {"mode", "event"} <= kinds
    assert len(recorded.arrivals) > 0
    assert np.all(np.diff(recorded.arrivals["frame"]["counter"]) == 1)


class Links(HTMLParser):
    """Collects every address that a browser would request."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.tags: set[str] = set()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]


def test_report_compares_runs_and_is_self_contained(folder: Path, tmp_path: Path) -> None:
    whole = Path(files(folder)[0]).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    out = tmp_path / "report.html"
    assert execute(["report", files(folder)[1], str(cut), "-o", str(out)]) == INCOMPLETE
    page = out.read_text(encoding="utf-8")
    links = Links()
    links.feed(page)
    assert len(links.addresses) >= 2 * 6
    assert all(address.startswith("data:image/svg+xml;base64,") for address in links.addresses)
    assert not {"script", "link", "iframe"} & links.tags
    assert "url(" not in page
    for word in ("FAIL", "latency", "phase approach begins", "numba", "deadband_m", "NEES", "recording broke off"):
        assert word in page
    assert "Twin consistency" in page
    assert "in sigmas" in page
    assert page.count("<h2>Verdict</h2>") == 2


def test_a_run_that_broke_off_replays_as_far_as_it_goes(folder: Path, tmp_path: Path) -> None:
    whole = Path(files(folder)[0]).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) // 2])
    assert 0 < len(load(cut).cycles) < 201
    assert execute(["replay", str(cut)]) == INCOMPLETE


def test_ending_of_the_exported_file_is_its_format(folder: Path, tmp_path: Path) -> None:
    target = tmp_path / "run.parquet"
    assert execute(["export", files(folder)[0], "-o", str(target)]) == 0
    assert target.read_bytes()[:4] == b"PAR1"


def test_bad_input_is_one_clear_line(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good, foreign, missing = files(folder)[0], tmp_path / "x.mcap", str(tmp_path / "none.mcap")
    foreign.write_text("t_s,x\n0,1\n")
    for command in (["replay"], ["recover"], ["export"], ["report", "-o", str(tmp_path / "r.html")]):
        assert "not a recording" in refused(capsys, command[0], str(foreign), *command[1:])
        assert "No such file" in refused(capsys, command[0], missing, *command[1:])
        of_folder = "holds no finished campaign" if command[0] == "report" else "is a folder"
        assert of_folder in refused(capsys, command[0], str(tmp_path), *command[1:])
    assert ".html" in refused(capsys, "report", good, "-o", str(tmp_path / "r.pdf"))
    assert "folder does not exist" in refused(capsys, "report", good, "-o", str(tmp_path / "no" / "r.html"))
    assert "folder does not exist" in refused(capsys, "export", good, "-o", str(tmp_path / "no" / "r.csv"))
    assert "r.parquet ends in .parquet, and the format is csv" in refused(
        capsys, "export", good, "-o", str(tmp_path / "r.parquet"), "--format", "csv"
    )
    assert "--record" in refused(capsys, "recordings", "list", str(tmp_path))
    assert "2026-13-01" in refused(capsys, "recordings", "list", str(folder), "--since", "2026-13-01")
    assert "--passed" in refused(capsys, "recordings", "list", str(folder), "--failed", "--passed")
    assert "no such file" in refused(capsys, "replay", good, "--gnc", str(tmp_path / "none.toml"))
    assert "gnc.pkf" in refused(capsys, "replay", good, "--set", "gnc.pkf.q=1.0")
    assert "cannot record there" in refused(capsys, "run", "scheme-1", "--record", str(foreign))


@pytest.mark.parametrize("rig", ["mock", "emulated"])
def test_a_catalogue_that_is_none_leaves_no_recording_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], rig: str
) -> None:
    (tmp_path / "catalogue.sqlite").write_bytes(b"no database at all, but long enough to be looked at" * 40)
    assert "not a catalogue" in refused(capsys, "run", "scheme-1", "--rig", rig, "--record", str(tmp_path))
    assert not files(tmp_path)


def test_an_existing_file_is_not_recovered_over(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = Path(files(folder)[0]).read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[:-40])
    assert execute(["recover", str(cut)]) == 0
    assert "exists" in refused(capsys, "recover", str(cut))


def start_on_wires(folder: Path, duration_s: float) -> tuple[subprocess.Popen[str], dict[str, int]]:
    """Start a recorded run on the emulated rig; return it once its processes are up, with their numbers."""
    command = [sys.executable, "-m", "hil", "run", "scheme-1", "--rig", "emulated", *typed(*NEAR, *UNHURRIED)]
    command += ["--duration", str(duration_s), "--record", str(folder)]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)
    assert process.stderr is not None
    pids: dict[str, int] = {}
    for line in iter(process.stderr.readline, ""):
        if found := re.match(r"(recorder|watchdog) process (\d+)", line):
            pids[found[1]] = int(found[2])
        if "watchdog" in pids:
            break
    return process, pids


@pytest.mark.slow
@pytest.mark.wires
def test_a_run_on_wires_is_recorded_whole_and_replays_bit_by_bit(tmp_path: Path) -> None:
    process, _ = start_on_wires(tmp_path, 6.0)
    _, err = process.communicate(timeout=120.0)
    assert process.returncode == 1, err
    [path] = files(tmp_path)
    recorded = load(Path(path))
    assert recorded.intact
    assert len(recorded.cycles) == 301
    assert replay(recorded, recorded.scenario).identical
    assert (recorded.arrivals["cycle"] == -1).any()  # those that came while the bench was armed
    assert [n["message"] for n in recorded.log if n["kind"] == "mode"][:3] == ["off", "standby", "placing"]


@pytest.mark.slow
@pytest.mark.wires
def test_a_run_on_wires_outlives_its_recorder(tmp_path: Path) -> None:
    process, pids = start_on_wires(tmp_path, 6.0)
    os.kill(pids["recorder"], signal.SIGKILL)
    _, err = process.communicate(timeout=120.0)
    assert process.returncode == 1, err
    assert "recorder process was ended by SIGKILL" in err
    [path] = files(tmp_path)
    assert recover(Path(path)).out is not None


@pytest.mark.slow
@pytest.mark.wires
def test_a_killed_loop_on_wires_leaves_a_whole_file_that_replays(tmp_path: Path) -> None:
    process, pids = start_on_wires(tmp_path, 60.0)
    end = time.monotonic() + 60.0
    while Path(files(tmp_path)[0]).stat().st_size < 200_000:  # well into the run
        assert time.monotonic() < end
        time.sleep(0.1)
    process.kill()
    process.communicate()
    while Path(f"/proc/{pids['recorder']}").exists():
        assert time.monotonic() < end
        time.sleep(0.01)
    recorded = load(Path(files(tmp_path)[0]))
    assert recorded.intact
    assert recorded.summary is None
    assert len(recorded.cycles) > 50
    assert replay(recorded, recorded.scenario).identical
    assert Catalogue(tmp_path).runs()[0]["state"] == BROKEN_OFF


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["mock", pytest.param("emulated", marks=pytest.mark.wires)])
def test_full_disk_is_reported_and_no_written_data_is_lost(small_disk: Path, tmp_path: Path, rig: str) -> None:
    if rig == "emulated":
        (small_disk / "other").write_bytes(bytes(1_750_000))
        near = typed(*NEAR, *UNHURRIED)
    else:
        near = ()
    command = [
        sys.executable,
        "-m",
        "hil",
        "run",
        "scheme-1",
        "--rig",
        rig,
        *near,
        "--duration",
        "60" if not near else "6",
    ]
    done = subprocess.run([*command, "--record", str(small_disk)], capture_output=True, text=True, check=False)
    assert done.returncode == 1, done.stderr  # the verdict of a run that was not ready
    assert "No space left on device" in done.stderr
    assert "hil recover" in done.stderr
    [path] = files(small_disk)
    assert not contents(Path(path)).intact
    found = recover(Path(path), tmp_path / "whole.mcap")
    assert found.out is not None
    recorded = load(found.out)
    assert len(recorded.cycles) > 50
    np.testing.assert_allclose(recorded.cycles["t_s"], 0.02 * np.arange(len(recorded.cycles)), atol=1e-9)
    assert execute(["recover", path, "-o", str(small_disk / "again.mcap")]) == 2
