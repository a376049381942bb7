"""A campaign whose disk fills up, on a small disk in memory."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from hil.cli.main import SAFE_STOPPED, execute
from hil.config.load import load_scenario

RUNS = 600
OPTIONS = ("--runs", str(RUNS), "--duration", "0.2", "--workers", "1")
KILOBYTES = 256


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """Return a folder on a disk of its own that holds KILOBYTES."""
    folder = tmp_path / "disk"
    folder.mkdir()
    try:
        command = ["mount", "-t", "tmpfs", "-o", f"size={KILOBYTES}k", "tmpfs", str(folder)]
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"this computer mounts no disk in memory for us: {getattr(error, 'stderr', '') or error}")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


def fly(folder: Path) -> int:
    return execute(["campaign", load_scenario("scheme-1").value.name, "--out", str(folder), *OPTIONS])


@pytest.mark.slow
def test_full_disk_stops_the_campaign_which_resumes_to_the_same_table(
    small_disk: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fly(tmp_path / "roomy") == 0
    capsys.readouterr()
    folder = small_disk / "c"
    assert fly(folder) == SAFE_STOPPED
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert "No space left on device: completed cases are kept, run it again" in said
    kept = sorted(folder.glob("parts/*.parquet"))
    assert kept
    assert not list(folder.rglob("*.part"))
    cases = [case for path in kept for case in pq.read_table(path).column("case").to_pylist()]
    assert cases == sorted(set(cases))
    written = {path: path.stat().st_mtime_ns for path in kept}
    assert fly(folder) == SAFE_STOPPED  # still full: the same message, and nothing is lost
    assert {path: path.stat().st_mtime_ns for path in kept} == written
    subprocess.run(["mount", "-o", "remount,size=64m", str(small_disk)], check=True)
    assert fly(folder) == 0
    assert (folder / "cases.parquet").read_bytes() == (tmp_path / "roomy" / "cases.parquet").read_bytes()
