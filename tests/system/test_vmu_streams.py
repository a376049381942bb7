"""``hil vmu`` on two videos, and what it sends on a serial line."""

from __future__ import annotations

import csv
import json
import os
import threading
import tty
from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_rig
from hil.drivers.vmu.codec import Decoded
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.frame_codec import FrameDecoder
from hil.maths import quat
from hil.vmu.geometry import camera_pair, geometry_of_rig, led_positions
from hil.vmu.render import RingAppearance, RingRenderer

pytestmark = pytest.mark.xdist_group("vision unit")

FRAMES = 6


@pytest.fixture(scope="module")
def streams(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, str]:
    """Write two videos of an approach, and the geometry; return what names both, and the geometry's path."""
    folder = tmp_path_factory.mktemp("streams")
    geometry = geometry_of_rig(load_rig("mock").value)
    path = folder / "geometry.json"
    path.write_text(json.dumps(geometry.model_dump(mode="json")))
    renderer = RingRenderer(camera_pair(geometry), led_positions(geometry), RingAppearance())
    rng = np.random.default_rng(4)
    names = [str(folder / f"{side}.mkv") for side in ("left", "right")]
    size = (geometry.left.width, geometry.left.height)
    code = cv2.VideoWriter.fourcc(*"FFV1")
    writers = [cv2.VideoWriter(name, code, 6.25, size, isColor=False) for name in names]
    for k in range(FRAMES):
        turn = quat.from_rotation_vector(np.array([0.02, -0.01, 0.05]))
        for writer, image in zip(
            writers, renderer.pair(np.array([0.1, 0.0, 3.0 - 0.1 * k]), turn, None, rng), strict=True
        ):
            writer.write(image)
    for writer in writers:
        writer.release()
    return ",".join(names), str(path)


def listen(master: int, decoder: FrameDecoder, found: list[Decoded], wanted: int, done: threading.Event) -> None:
    while len(found) < wanted:
        found += decoder.feed(os.read(master, 4096), 0.0)
    done.set()


def test_poses_of_videos_go_into_the_file_and_onto_the_line(streams: tuple[str, str], tmp_path: Path) -> None:
    source, geometry = streams
    master, slave = os.openpty()
    tty.setraw(slave)
    decoder, found, done = FrameDecoder(frame_codec()), list[Decoded](), threading.Event()
    threading.Thread(target=listen, args=(master, decoder, found, FRAMES, done), daemon=True).start()
    out = tmp_path / "poses.csv"
    arguments = ["vmu", source, "--geometry", geometry, "--out", str(out), "--rs422", os.ttyname(slave), "--fast"]
    assert execute(arguments) == 0
    assert done.wait(10.0)
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert [row["status"] for row in rows] == ["ok"] * FRAMES
    assert [frame.counter for frame in found] == list(range(FRAMES))
    assert decoder.identity is not None
    for row, frame in zip(rows, found, strict=True):
        assert frame.pose is not None
        assert frame.pose.t_v == pytest.approx([float(row[key]) for key in ("x_m", "y_m", "z_m")], rel=1e-8)
        assert frame.pose.covariance[0, 0] == pytest.approx(float(row["sigma_x_m"]) ** 2, rel=1e-5)
        assert frame.t_s == pytest.approx(float(row["t_s"]), abs=1e-6)
    os.close(slave)
    os.close(master)


@pytest.mark.parametrize(
    ("source", "text"),
    [
        ("nowhere.mkv,{right}", "nowhere.mkv: no such file"),
        ("{geometry},{right}", "not a readable video"),
        ("camera:b,0", "give both cameras by number"),
        ("{left},{right},{right}", "give two streams"),
    ],
)
def test_streams_that_cannot_be_read_are_named(
    streams: tuple[str, str], source: str, text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    left, right = streams[0].split(",")
    given = source.format(left=left, right=right, geometry=streams[1])
    out = tmp_path / "poses.csv"
    assert execute(["vmu", given, "--geometry", streams[1], "--out", str(out)]) == 2
    assert text in capsys.readouterr().err
    assert not out.exists()


def test_a_port_that_cannot_be_opened_is_named(
    streams: tuple[str, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "poses.csv"
    code = execute(["vmu", streams[0], "--geometry", streams[1], "--out", str(out), "--rs422", str(tmp_path / "no")])
    assert code == 3
    assert "vmu: cannot open" in capsys.readouterr().err
