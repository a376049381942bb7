"""Videos of others: times, half frames, depths, rotation, lost images, in the containers and codecs of cameras."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.config.load import Loaded, load_scene
from hil.core.video import LOWER_FIRST, UPPER_FIRST, Video
from hil.errors import BadInput
from hil.parts.monitor.sources import open_source
from hil.vmu.sources import StreamPairs

av: Any = pytest.importorskip("av")

SHAPE = (96, 128)
RATE_HZ = 25


def scene_image(number: int) -> np.ndarray:
    """Return a smooth image with a bar at the place of its number, which survives compression."""
    rows, columns = np.mgrid[: SHAPE[0], : SHAPE[1]]
    base = 60.0 + 0.5 * rows + 0.3 * columns
    base[:, 8 * number : 8 * number + 8] += 80.0
    return np.clip(base, 0, 255).astype(np.uint8)


def written(
    path: Path, times: Sequence[int], codec: str = "ffv1", pix_fmt: str = "gray", base: Fraction = Fraction(1, RATE_HZ),
    options: dict[str, str] | None = None, rotation: int = 0,
) -> Path:  # fmt: skip
    """Write images 0, 1, ... with the given times in units of ``base``."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream(codec, rate=RATE_HZ, options=options or {})
        stream.height, stream.width = SHAPE
        stream.pix_fmt, stream.time_base, stream.codec_context.time_base = pix_fmt, base, base
        if rotation:
            stream.set_display_rotation(rotation)
        for number, time in enumerate(times):
            frame = av.VideoFrame.from_ndarray(scene_image(number), format="gray").reformat(format=pix_fmt)
            frame.pts, frame.time_base = time, base
            for packet in stream.encode(frame):
                container.mux(packet)
        for packet in stream.encode():
            container.mux(packet)
    return path


def bar_of(image: np.ndarray) -> int:
    """Return the number of the image that ``image`` shows."""
    levels = np.asarray(image, float).mean(axis=0) - 0.3 * np.arange(SHAPE[1])
    return int(np.argmax([levels[8 * k : 8 * k + 8].mean() for k in range(SHAPE[1] // 8)]))


KINDS = [
    ("a.mkv", "ffv1", "gray", {}),
    ("a.mkv", "ffv1", "gray10le", {}),
    ("a.mkv", "ffv1", "yuv420p", {}),
    ("a.avi", "mjpeg", "yuvj420p", {}),
    ("a.mp4", "libx264", "yuv420p", {}),
    ("a.mp4", "libx264", "yuv420p10le", {}),
    ("a.mov", "prores_ks", "yuv422p10le", {}),
    ("a.mkv", "libx264", "yuv420p", {"x264-params": "tff=1"}),
    ("a.mkv", "libx264", "yuv420p", {"x264-params": "bff=1"}),
    ("a.mpg", "mpeg2video", "yuv420p", {"flags": "+ildct+ilme", "b": "4000000"}),
]


@pytest.mark.parametrize(("name", "codec", "pix_fmt", "options"), KINDS)
def test_levels_and_times_are_those_of_the_images(
    tmp_path: Path, name: str, codec: str, pix_fmt: str, options: dict[str, str]
) -> None:
    found = list(Video(written(tmp_path / name, range(10), codec, pix_fmt, options=options)))
    assert [bar_of(each.image) for each in found] == list(range(10))
    np.testing.assert_allclose([each.t_s - found[0].t_s for each in found], np.arange(10) / RATE_HZ, atol=1e-3)
    for number, each in enumerate(found):
        assert each.image.dtype == np.uint8
        assert abs(float(np.mean(each.image)) - scene_image(number).mean()) < 1.0
    expected = {"tff=1": UPPER_FIRST, "bff=1": LOWER_FIRST}.get(options.get("x264-params", ""), "")
    if codec == "libx264":
        assert {each.fields for each in found} == {expected}


@pytest.mark.parametrize("name", ["a.mkv", "a.avi", "a.mp4"])
def test_lost_images_leave_gaps_and_a_later_start_is_no_truncation(tmp_path: Path, name: str) -> None:
    codec, pix_fmt = ("mjpeg", "yuvj420p") if name == "a.avi" else ("libx264", "yuv420p")
    found = list(Video(written(tmp_path / name, [0, 1, 2, 5, 6, 7], codec, pix_fmt)))
    times = [each.t_s - found[0].t_s for each in found]
    np.testing.assert_allclose(times, np.array([0, 1, 2, 5, 6, 7]) / RATE_HZ, atol=1e-3)
    late = list(Video(written(tmp_path / f"late{name}", range(50, 56), codec, pix_fmt)))
    assert len(late) == 6


def test_variable_rate_has_the_times_of_the_file(tmp_path: Path) -> None:
    times = [0, 40, 95, 120, 171]
    found = list(Video(written(tmp_path / "a.mkv", times, base=Fraction(1, 1000))))
    np.testing.assert_allclose([each.t_s - found[0].t_s for each in found], np.array(times) / 1000.0, atol=1e-6)


def test_rotation_flag_is_refused_with_its_angle(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mp4", range(4), "libx264", "yuv420p", rotation=90)
    with pytest.raises(BadInput, match=r"a\.mp4: rotation flag: -?(90|270) deg: signs of a pose depend on it"):
        list(Video(path))


def test_cut_video_is_truncated(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mkv", range(12))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(BadInput, match=r"truncated or damaged: .* complete images, 12 expected"):
        list(Video(path))


def cut_by_edit_list(path: Path, length_s: float, from_: int, rate_hz: int = RATE_HZ) -> Path:
    """Let the file begin with image ``from_`` and end after ``length_s``, as programs cut without encoding."""
    content = bytearray(path.read_bytes())
    last = content.find(b"elst") + 12 * int.from_bytes(content[content.find(b"elst") + 8 :][:4], "big")
    times_per_s = 512 * rate_hz  # of the writer
    _, begin = struct.unpack_from(">Ii", content, last)
    struct.pack_into(">Ii", content, last, round(1000 * length_s), begin + from_ * times_per_s // rate_hz)
    path.write_bytes(bytes(content))
    return path


@pytest.mark.parametrize("start", [0, 50])
@pytest.mark.parametrize(("first", "number"), [(0, 6), (6, 6), (5, 4), (0, 12)])
@pytest.mark.parametrize(("name", "codec"), [("a.mp4", "libx264"), ("a.mov", "prores_ks"), ("a.mp4", "mpeg4")])
def test_edit_list_leaves_its_images(
    tmp_path: Path, name: str, codec: str, first: int, number: int, start: int
) -> None:
    pix_fmt, options = ("yuv422p10le", {}) if codec == "prores_ks" else ("yuv420p", {"g": "4"})
    path = written(tmp_path / name, range(start, start + 12), codec, pix_fmt, options=options)
    found = list(Video(cut_by_edit_list(path, number / RATE_HZ, first)))
    assert [bar_of(each.image) for each in found] == list(range(first, first + number))
    np.testing.assert_allclose([each.t_s for each in found], (start + np.arange(number)) / RATE_HZ, atol=1e-3)


def test_pairs_of_two_videos_have_the_same_times(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """An image that one video lacks leaves its partner alone, and the later pairs right."""
    left, right = written(tmp_path / "l.mkv", range(8)), written(tmp_path / "r.mkv", [0, 1, 2, 4, 5, 6, 7])
    pairs = list(StreamPairs(f"{left},{right}"))
    assert [pair.frame for pair in pairs] == list(range(8))
    np.testing.assert_allclose([pair.t_s or 0.0 for pair in pairs], np.arange(8) / RATE_HZ, atol=1e-3)
    assert [pair.frame for pair in pairs if pair.right is None] == [3]
    assert all(pair.left is not None for pair in pairs)
    assert f"{left}: 1 images have no partner at their times in the other video" in caplog.text


def test_interlaced_video_is_refused_by_the_vision_unit(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mkv", range(3), "libx264", "yuv420p", options={"x264-params": "bff=1"})
    with pytest.raises(BadInput, match=r"a\.mkv: interlaced: lower_first: the lines of an image are of two exposures"):
        list(StreamPairs(f"{path},{path}"))


def test_monitor_has_the_times_of_the_file(tmp_path: Path) -> None:
    """Images of an uneven rate keep their times; another order of the half frames than the scene's is refused."""
    loaded = load_scene("atv")
    camera = loaded.value.camera.model_copy(update={"width": SHAPE[1], "height": SHAPE[0]})
    scene = Loaded(loaded.value.model_copy(update={"camera": camera, "fps": 25.0}), "scene.json", {})
    times = [0, 40, 87, 120, 160]
    uneven = written(tmp_path / "a.mkv", times, base=Fraction(1, 1000))
    found = list(open_source(str(uneven), scene))
    np.testing.assert_allclose([frame.t_s for frame in found], np.array(times) / 1000.0, atol=1e-9)
    woven = written(tmp_path / "b.mkv", range(3), "libx264", "yuv420p", options={"x264-params": "bff=1"})
    halves = Loaded(scene.value.model_copy(update={"fields": "upper_first"}), "scene.json", {})
    for given in (scene, halves):
        with pytest.raises(BadInput, match=r"fields of scene\.json: .*: the video is interlaced, lower_first"):
            list(open_source(str(woven), given))
