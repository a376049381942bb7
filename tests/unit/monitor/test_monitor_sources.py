"""Image sources of the monitor: times of the images, and invalid sources."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.config.load import Loaded, load_scene
from hil.config.scene import Scene
from hil.errors import BadInput
from hil.parts.monitor.sources import LOWER, UPPER, WHOLE, open_source

COUNT = 12


@pytest.fixture(scope="module")
def scene() -> Loaded[Scene]:
    """Return a scene with a small camera."""
    loaded = load_scene("atv")
    camera = loaded.value.camera.model_copy(update={"width": 96, "height": 64, "cx": 47.5, "cy": 31.5, "f": 140.0})
    return Loaded(loaded.value.model_copy(update={"camera": camera}), "scene.json", {})


@pytest.fixture(scope="module")
def pictures() -> list[np.ndarray]:
    rng = np.random.default_rng(7)
    return [rng.integers(0, 256, (64, 96), dtype=np.uint8) for _ in range(COUNT)]


def write_video(path: Path, pictures: list[np.ndarray], fps: float = 12.5, code: str = "FFV1") -> Path:
    height, width = pictures[0].shape
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*code), fps, (width, height), isColor=False)
    for picture in pictures:
        writer.write(picture)
    writer.release()
    return path


def test_a_video_yields_every_image_bit_for_bit_with_its_time(
    tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray]
) -> None:
    source = open_source(str(write_video(tmp_path / "a.mkv", pictures)), scene)
    assert source.image_count == COUNT
    frames = list(source)
    assert [frame.number for frame in frames] == list(range(COUNT))
    np.testing.assert_allclose([frame.t_s for frame in frames], np.arange(COUNT) / 12.5)
    assert {frame.field for frame in frames} == {WHOLE}
    for frame, picture in zip(frames, pictures, strict=True):
        assert frame.image.dtype == np.uint8
        np.testing.assert_array_equal(frame.image, picture)


def test_an_interlaced_video_gives_half_frames(
    tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray]
) -> None:
    path = str(write_video(tmp_path / "a.mkv", pictures[:2]))
    for order, fields in (("upper_first", [UPPER, LOWER]), ("lower_first", [LOWER, UPPER])):
        woven = Loaded(scene.value.model_copy(update={"fields": order}), scene.source, {})
        frames = list(open_source(path, woven))
        np.testing.assert_allclose([frame.t_s for frame in frames], np.arange(4) / 25.0)
        assert [frame.field for frame in frames] == fields * 2
        for i, frame in enumerate(frames):
            first = 0 if frame.field == UPPER else 1
            np.testing.assert_array_equal(frame.image, pictures[i // 2][first::2])


@pytest.mark.parametrize(("name", "code"), [("a.mkv", "FFV1"), ("a.avi", "MJPG")])
def test_a_truncated_video_yields_its_complete_images_then_raises(
    tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray], name: str, code: str
) -> None:
    path = write_video(tmp_path / name, pictures, code=code)
    whole = [frame.image for frame in open_source(str(path), scene)]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    got = []
    with pytest.raises(BadInput, match=rf"a\.\w+: truncated or damaged: \d complete images, {COUNT} expected$"):
        got.extend(frame.image for frame in open_source(str(path), scene))
    assert 3 <= len(got) <= 7
    for image, picture in zip(got, whole, strict=False):
        np.testing.assert_array_equal(image, picture)


def test_an_image_lost_within_the_file_leaves_a_gap_in_the_times(
    tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray], caplog: pytest.LogCaptureFixture
) -> None:
    many = 12 * pictures  # Matroska finds its way again at the next cluster, 5 s on
    path = write_video(tmp_path / "a.mkv", many)
    data = bytearray(path.read_bytes())
    start = len(data) // 4
    data[start : start + 20_000] = bytes(20_000)
    path.write_bytes(data)
    got = list(open_source(str(path), scene))
    assert "images are missing between the others: their times are left out" in caplog.text
    right = [np.array_equal(frame.image, many[round(frame.t_s * 12.5)]) for frame in got]
    assert right.count(False) <= 1
    assert len(got) < len(many) - 2
    assert got[-1].t_s == pytest.approx((len(many) - 1) / 12.5)


def test_a_folder_is_read_in_the_order_of_its_numbers_and_a_lost_image_leaves_a_gap(
    tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray]
) -> None:
    for number in (8, 9, 10, 12):
        cv2.imwrite(str(tmp_path / f"{number}.png"), pictures[number - 8])
    (tmp_path / "notes.txt").write_text("not an image", encoding="utf-8")
    frames = list(open_source(str(tmp_path), scene))
    np.testing.assert_allclose([frame.t_s * 12.5 for frame in frames], [0, 1, 2, 4])
    np.testing.assert_array_equal(frames[3].image, pictures[4])


def test_images_without_numbers_are_counted(tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray]) -> None:
    for name in ("b", "a", "c"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), pictures[ord(name) - ord("a")])
    frames = list(open_source(str(tmp_path), scene))
    np.testing.assert_allclose([frame.t_s * 12.5 for frame in frames], [0, 1, 2])
    np.testing.assert_array_equal(frames[1].image, pictures[1])


def refused(name: str | Path, scene: Loaded[Scene]) -> str:
    """Return the line that reports why a source is invalid."""
    with pytest.raises(BadInput) as caught:
        list(open_source(str(name), scene))
    text = str(caught.value)
    assert "\n" not in text
    return text


def test_what_is_no_source_is_one_line(tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray]) -> None:
    text = tmp_path / "text.mkv"
    text.write_text("this is not a video\n" * 100, encoding="utf-8")
    assert refused(text, scene).startswith(f"{text}: not a readable video")
    (tmp_path / "empty.mkv").touch()
    assert "not a readable video" in refused(tmp_path / "empty.mkv", scene)
    assert "no such file or folder" in refused(tmp_path / "missing.mkv", scene)
    assert refused("977", scene) == "camera 977: no such camera, or it is in use"
    folder = tmp_path / "folder"
    folder.mkdir()
    assert "no images: allowed are .bmp" in refused(folder, scene)
    (folder / "0000.png").write_text("no", encoding="utf-8")
    assert refused(folder, scene) == f"{folder}/0000.png: not a readable image"


def test_another_size_than_the_cameras_is_one_line(
    tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray]
) -> None:
    small = [picture[:32, :64] for picture in pictures]
    path = write_video(tmp_path / "small.mkv", [np.ascontiguousarray(picture) for picture in small])
    assert refused(path, scene) == f"{path}: image size: 64 x 32: must be 96 x 64, the camera of scene.json"
    folder = tmp_path / "folder"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), pictures[0])
    cv2.imwrite(str(folder / "1.png"), small[1])
    assert refused(folder, scene).startswith(f"{folder}/1.png: image size: 64 x 32")


def test_another_rate_than_the_scenes_is_one_line(
    tmp_path: Path, scene: Loaded[Scene], pictures: list[np.ndarray]
) -> None:
    path = write_video(tmp_path / "fast.mkv", pictures, fps=25.0)
    said = "image rate: 25 images per second: must be 12.5, fps of scene.json"
    assert refused(path, scene) == f"{path}: {said}"


class Clicks:
    """Scripted television camera: images, and the clock time of each."""

    def __init__(self, pictures: list[np.ndarray], times_s: list[float]) -> None:
        self._pictures, self._times_s, self._taken = pictures, times_s, 0

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float) -> bool:
        return True

    def read(self) -> tuple[bool, np.ndarray | None]:
        if self._taken == len(self._times_s):
            return False, None
        self._taken += 1
        return True, self._pictures[self._taken - 1]

    def release(self) -> None:
        pass

    def clock(self) -> float:
        return self._times_s[min(self._taken, len(self._times_s)) - 1]


def test_a_camera_counts_image_periods_so_that_a_recording_has_the_same_times(
    scene: Loaded[Scene], pictures: list[np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = Clicks(pictures, [50.0, 50.083, 50.158, 50.405, 50.48])  # 12.5 a second, two lost, hands that tremble
    monkeypatch.setattr(cv2, "VideoCapture", lambda index: camera)
    source = open_source("0", scene, camera.clock)
    slots = []
    with pytest.raises(BadInput, match="camera 0: delivers no more images"):
        slots.extend(frame.t_s * 12.5 for frame in source)
    np.testing.assert_allclose(slots, [0, 1, 2, 5, 6])
