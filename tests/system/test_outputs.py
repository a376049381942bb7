"""Full disks, closed terminals, read-only folders: the verdict is given, and no exit code reports another one."""

from __future__ import annotations

import json
import os
import shutil
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, suppress
from pathlib import Path

import pytest

from hil.cli.main import BAD_INPUT, FAILED, PASSED, SAFE_STOPPED, execute
from hil.recording.catalogue import Catalogue

RUN = ("run", "scheme-1", "--duration", "0.1")
HIL = (sys.executable, "-m", "hil")


@pytest.fixture
def full_disk(tmp_path: Path) -> Iterator[Path]:
    """Return a folder on a disk in memory without a free byte."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=512k", "tmpfs", str(folder)]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"this computer mounts no disk in memory for us: {getattr(error, 'stderr', '') or error}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fill(folder: Path) -> None:
    """Leave no free byte in ``folder``."""
    with (folder / "filler").open("wb", buffering=0) as file, suppress(OSError):
        while True:
            file.write(bytes(4096))


def test_verdict_is_printed_if_the_disk_is_too_full_for_its_numbers(
    full_disk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fill(full_disk)
    out = full_disk / "numbers.json"
    assert execute([*RUN, "--json", str(out)]) == BAD_INPUT
    printed = capsys.readouterr()
    assert "FAIL scheme-1 on mock, seed 0" in printed.out
    assert printed.err.strip().splitlines()[-1] == f"{out}: cannot be written: No space left on device"
    assert os.listdir(full_disk) == ["filler"]


def test_safe_stop_keeps_its_exit_code_if_its_numbers_cannot_be_written(
    full_disk: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fill(full_disk)
    settings = ("--set", "rig.rails.following_error_max_m=1e-9")
    assert execute([*RUN, *settings, "--json", str(full_disk / "n.json")]) == SAFE_STOPPED
    lines = capsys.readouterr().err.strip().splitlines()
    assert lines[-2].startswith("safe stop: ")
    assert lines[-1].endswith("cannot be written: No space left on device")


def test_device_as_an_output_is_written_to_and_never_replaced(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    assert execute([*RUN, "--json", str(pipe)]) == FAILED
    assert json.loads(os.read(reader, 1 << 16))["scenario"] == "scheme-1"
    os.close(reader)
    assert pipe.is_fifo()
    assert execute([*RUN, "--json", "/dev/full"]) == BAD_INPUT
    assert not Path("/dev/full.part").exists()


def recordings(folder: Path) -> Path:
    """Return ``folder`` with a catalogue of one run."""
    folder.mkdir(exist_ok=True)
    entry = {"run": "r", "started_utc": "2026-11-22T10:00:00Z", "scenario": "s", "rig": "mock", "seed": 0}
    catalogue = Catalogue(folder)
    catalogue.begin(entry | {"duration_s": 1.0, "file": "r.mcap", "hil": "0"})
    return folder


def test_recordings_on_a_full_disk_are_listed_with_the_newest(
    full_disk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with closing(sqlite3.connect(recordings(tmp_path / "made") / "catalogue.sqlite")) as held:
        held.execute("SELECT 1 FROM runs").fetchall()  # keeps the log of writes
        recordings_of_two = {"run": "newest", "started_utc": "2026-11-22T11:00:00Z", "scenario": "s", "rig": "mock"}
        Catalogue(tmp_path / "made").begin(
            recordings_of_two | {"seed": 0, "duration_s": 1.0, "file": "n.mcap", "hil": "0"}
        )
        for path in (tmp_path / "made").glob("catalogue.sqlite*"):
            if not path.name.endswith("-shm"):
                shutil.copyfile(path, full_disk / path.name)
    fill(full_disk)
    assert execute(["recordings", "list", str(full_disk)]) == PASSED
    printed = capsys.readouterr().out
    assert "r.mcap" in printed
    assert "n.mcap" in printed


def test_recordings_on_a_read_only_disk_are_listed(full_disk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recordings(full_disk)
    subprocess.run(["mount", "-o", "remount,ro", str(full_disk)], check=True)
    assert execute(["recordings", "list", str(full_disk)]) == PASSED
    assert "r.mcap" in capsys.readouterr().out


def ended(command: str) -> tuple[int, str]:
    """Return exit code and standard error of a run in a shell, ``{hil}`` in ``command``."""
    text = command.format(hil=" ".join((*HIL, *RUN)))
    done = subprocess.run(["bash", "-c", text], capture_output=True, text=True, timeout=120, check=False)
    return done.returncode, done.stderr


def test_closed_and_full_standard_output_do_not_read_as_a_verdict() -> None:
    code, err = ended("{hil} > /dev/full")
    assert (code, err.splitlines()[-1]) == (BAD_INPUT, "standard output: cannot be written: No space left on device")
    code, err = ended("{hil} | true; exit ${{PIPESTATUS[0]}}")
    assert (code, "pipe" in err) == (128 + signal.SIGPIPE, False)
    code, err = ended("{hil} >&-")
    assert code == FAILED  # the verdict of a tenth of a second
    assert "Traceback" not in err


def test_closed_standard_error_leaves_the_verdict() -> None:
    assert ended("{hil} 2>&-")[0] == FAILED
    assert ended("{hil} 2>/dev/full")[0] == FAILED
