"""``hil monitor``: the table's columns, the same numbers as live, and what is refused."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_scene
from hil.config.scene import PixelNoise
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.render import Conditions, TargetRenderer, film
from hil.parts.monitor.results import QUANTITIES

pytestmark = pytest.mark.xdist_group("docking monitor")

COLUMNS = [
    "t_s", "frames", "status", "d1_m", "d2_m", "d3_m", "phi1_rad", "phi2_rad", "phi3_rad", "range_m", "range_rate_mps",
    "pitch_passive_rad", "yaw_passive_rad", "los_right_rad", "los_up_rad",
]  # fmt: skip


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[np.ndarray]]:
    """Return a recording of 14 images at 8 m, and the rows of the live monitor."""
    scene = load_scene("atv").value
    path = tmp_path_factory.mktemp("monitor") / "approach.mkv"
    size = (scene.camera.width, scene.camera.height)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"FFV1"), scene.fps, size, isColor=False)
    renderer = TargetRenderer(scene, conditions=Conditions(noise=PixelNoise(read=3.0)))
    monitor, rows = DockingMonitor(scene), []
    rng = np.random.default_rng(4)
    for frame in film(renderer, lambda t: (np.array([0.1, -0.1, 8.0 - 0.1 * t]), np.array([0.0, 0.0, 0.02])), 14, rng):
        writer.write(frame.image)
        rows += monitor.feed(frame)
    writer.release()
    rows += monitor.finish()
    return path, [np.concatenate((row.values, row.sigmas)) for row in rows]


def test_a_recording_gives_the_numbers_of_the_live_run(
    recording: tuple[Path, list[np.ndarray]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Documented columns, one row per portion, bit-identical to the live monitor."""
    path, live = recording
    out, summary, frames = tmp_path / "out.csv", tmp_path / "out.json", tmp_path / "frames.csv"
    extra = ["--json", str(summary), "--frames", str(frames), "--screen", str(tmp_path / "screen.png")]
    assert execute(["monitor", str(path), "--scene", "atv", "--out", str(out), *extra]) == 0
    with out.open() as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0])[: len(COLUMNS)] == COLUMNS
    assert all(f"sigma_{name}" in rows[0] for name in QUANTITIES)
    assert [row["status"] for row in rows] == ["near", "near"]
    assert [row["frames"] for row in rows] == ["10", "4"]
    for row, values in zip(rows, live, strict=True):
        written = [float(row[name]) for name in (*QUANTITIES, *(f"sigma_{name}" for name in QUANTITIES))]
        np.testing.assert_allclose(written, values, rtol=1e-11)
    told = json.loads(summary.read_text())
    assert told["frames_used"] == 14
    assert told["last"]["range_m"] == pytest.approx(8.0 - 0.1 * 13 / 12.5, abs=0.01)
    assert len(frames.read_text().splitlines()) == 15
    assert (tmp_path / "screen.png").stat().st_size > 1000
    assert "2 portions" in capsys.readouterr().out


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the one line of an input that cannot be used."""
    assert execute(["monitor", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    (line,) = printed.err.strip().splitlines()
    return line


def test_invalid_video_is_rejected(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """One line, exit code 2, and no table."""
    video, out = tmp_path / "video.mkv", tmp_path / "out.csv"
    video.write_bytes(b"not a video at all" * 100)
    assert "video.mkv" in refused(capsys, str(video), "--scene", "atv", "--out", str(out))
    assert "no such file" in refused(capsys, str(tmp_path / "none.mkv"), "--scene", "atv", "--out", str(out))
    assert not out.exists()


def test_a_cut_video_leaves_no_table_under_its_name(
    recording: tuple[Path, list[np.ndarray]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The rows until then remain in a .part file, so that they are not mistaken for a complete table."""
    video, out = tmp_path / "cut.mkv", tmp_path / "out.csv"
    whole = recording[0].read_bytes()
    video.write_bytes(whole[: len(whole) * 3 // 5])
    assert "cut.mkv" in refused(capsys, str(video), "--scene", "atv", "--out", str(out))
    assert not out.exists()


@pytest.mark.parametrize(
    ("options", "what"),
    [
        (["--roi", "700,500,200,100"], "--roi"),
        (["--roi", "a,b"], "--roi"),
        (["--q", "1.5"], "--q"),
        (["--scene", "nowhere"], "nowhere"),
        (["--out", "/nowhere/out.csv"], "--out"),
    ],
)
def test_wrong_options_are_reported_in_one_line(
    recording: tuple[Path, list[np.ndarray]],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: list[str],
    what: str,
) -> None:
    """Each names the option and what is allowed."""
    given = {"--scene": "atv", "--out": str(tmp_path / "out.csv")}
    given.update(zip(options[::2], options[1::2], strict=True))
    arguments = [text for pair in given.items() for text in pair]
    assert what in refused(capsys, str(recording[0]), *arguments)


def test_a_region_of_interest_is_searched_first(recording: tuple[Path, list[np.ndarray]], tmp_path: Path) -> None:
    """A region without the target only adds the search of the whole image."""
    for roi in ("200,100,400,400", "0,0,64,64"):
        out = tmp_path / "out.csv"
        assert execute(["monitor", str(recording[0]), "--scene", "atv", "--out", str(out), "--roi", roi]) == 0
        assert out.read_text().count("near") == 2
