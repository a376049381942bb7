"""Images as records: they arrive unchanged, the ones beyond the capacity are counted, and no side waits."""

from __future__ import annotations

import math
import threading
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import Rig
from hil.core.camera_images import (
    IMAGE,
    LEFT,
    MONITOR,
    OVERLAY_BYTES,
    RIGHT,
    SLOTS,
    CameraImage,
    Exposure,
    ImageEncoder,
    ImagePolicy,
    ThreadedImageSink,
    encode,
    image_data,
    image_row,
    overlay_json,
    overlay_shapes,
)
from hil.core.messages import CYCLE
from hil.frmn.image_memory import ImageMemory, RunTime
from hil.frmn.ring import Ring
from hil.loop.stages import RunZero
from hil.recording.read import contents
from hil.recording.writer import RecordingHeader, RunFile

CROSS = {"kind": "cross", "at": [1.5, 2.25], "good": True, "part": "led"}
PNG = ImagePolicy("png")


class Kept:
    """Keeps copies of what it is given."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []

    def put(self, row: np.ndarray) -> None:
        self.rows.append(row.copy())


def noise(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rng.integers(0, 256, shape, dtype=np.uint8)


def test_a_row_gives_back_what_was_put_in() -> None:
    row = image_row(LEFT, 1.25, b"data", "png", (640, 480), [CROSS], Exposure(7.5, 3, "ok", 2))
    (found,) = row
    assert (found["t_s"], found["bench_s"], found["number"], found["dropped"]) == (1.25, 7.5, 3, 2)
    assert (found["camera"], found["encoding"], found["status"]) == (b"vmu.left", b"png", b"ok")
    assert (found["width_px"], found["height_px"]) == (640, 480)
    assert image_data(found) == b"data"
    assert overlay_shapes(found) == (CROSS,)
    (again,) = image_row(LEFT, 1.25, b"da", into=row)
    assert image_data(again) == b"da"
    assert overlay_shapes(again) == ()


def test_shapes_beyond_their_room_are_cut_from_the_end() -> None:
    many = [{**CROSS, "at": [k, k]} for k in range(1000)]
    kept = overlay_shapes(image_row(LEFT, 0.0, b"", shapes=many)[0])
    assert kept == tuple(many[: len(kept)])
    assert OVERLAY_BYTES - 100 < len(overlay_json(many)) <= OVERLAY_BYTES


def test_a_shape_without_a_place_is_left_out() -> None:
    assert overlay_json([{**CROSS, "at": [math.nan, 0.0]}, CROSS]) == overlay_json([CROSS])


def test_png_is_lossless_and_jpeg_nearly(rng: np.random.Generator) -> None:
    image = noise(rng, 40, 60)
    again = cv2.imdecode(np.frombuffer(encode(image, "png"), np.uint8), cv2.IMREAD_GRAYSCALE)
    np.testing.assert_array_equal(again, image)
    smooth = np.add.outer(np.arange(100), np.arange(120)).astype(np.uint8)
    found = cv2.imdecode(np.frombuffer(encode(smooth, "jpeg"), np.uint8), cv2.IMREAD_GRAYSCALE)
    assert np.abs(found.astype(int) - smooth).max() < 6
    colour = noise(rng, 20, 30, 3)
    np.testing.assert_array_equal(cv2.imdecode(np.frombuffer(encode(colour, "png"), np.uint8), 1), colour)


@pytest.mark.parametrize("image", [np.zeros((4, 4)), np.zeros(4, np.uint8), np.zeros((0, 4), np.uint8)])
def test_what_is_no_image_is_refused(image: np.ndarray) -> None:
    with pytest.raises(ValueError, match="not an image"):
        encode(image, "png")


def test_images_are_taken_at_the_requested_rate() -> None:
    def taken(each_s: float, times: list[float]) -> list[float]:
        maker = ImageEncoder(Kept(), ImagePolicy("jpeg", each_s))
        return [t for t in times if maker.due(t)]

    beats = [k / 6.25 for k in range(10)]
    assert taken(0.0, beats) == beats
    assert taken(0.5, beats) == [beats[k] for k in (0, 4, 8)]
    assert taken(0.48, beats) == [beats[k] for k in (0, 3, 6, 9)]
    assert taken(1.0, [5.0, 0.2, 0.3]) == [5.0, 0.2]  # a clock that was set back
    assert not ImageEncoder(Kept(), ImagePolicy("none")).due(0.0)


def test_image_that_is_too_large_is_counted_and_comes_without_data(rng: np.random.Generator, tmp_path: Path) -> None:
    kept = Kept()
    maker = ImageEncoder(kept, PNG)
    maker.put(CameraImage(MONITOR, noise(rng, 1100, 700, 3), shapes=[CROSS]), CameraImage(LEFT, noise(rng, 8, 8)))
    maker.put(CameraImage(MONITOR, noise(rng, 8, 8), number=1))
    assert [(row[0]["camera"], row[0]["dropped"]) for row in kept.rows] == [
        (b"monitor", 1),
        (b"vmu.left", 0),
        (b"monitor", 1),
    ]
    assert [row[0]["size"] > 0 for row in kept.rows] == [False, True, True]
    assert overlay_shapes(kept.rows[0][0]) == (CROSS,)
    path = tmp_path / "run.mcap"
    file = RunFile(path, RecordingHeader({"schema_version": "1"}, {}, 0))
    for row in kept.rows:
        file.write_images(row)
    account = file.finish({})
    assert account.dropped == 1
    assert "too large" in account.problem
    assert [line["number"] for line in contents(path).lines["/pictures/monitor"]] == [1]


def test_image_has_the_run_s_time_of_its_exposure_although_it_waits() -> None:
    class Clock:
        """A run that begins at 1 s of bench time and is held soon after."""

        zero_s = 1.0

        def at(self, bench_s: float) -> float:
            return bench_s - self.zero_s

    class Slow(Kept):
        def __init__(self) -> None:
            super().__init__()
            self.go = threading.Event()

        def put(self, row: np.ndarray) -> None:
            assert self.go.wait(30.0)
            super().put(row)

    slow, clock = Slow(), Clock()
    beside = ThreadedImageSink(ImageEncoder(slow, PNG, clock))
    image = np.zeros((4, 4), np.uint8)
    beside.put(CameraImage(LEFT, image, bench_s=1.5))
    beside.put(CameraImage(LEFT, image, bench_s=1.75))
    clock.zero_s = math.nan
    beside.put(CameraImage(LEFT, image, bench_s=2.0))
    slow.go.set()
    beside.close()
    np.testing.assert_array_equal([row[0]["t_s"] for row in slow.rows], [0.5, 0.75, math.nan])


def test_a_maker_whose_outlet_fails_can_be_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    class Broken(Kept):
        def put(self, row: np.ndarray) -> None:
            raise OSError("gone")

    told = threading.Event()
    monkeypatch.setattr(threading, "excepthook", lambda _: told.set())
    beside = ThreadedImageSink(ImageEncoder(Broken(), PNG))
    for number in range(ThreadedImageSink.QUEUE_MAX + 5):
        beside.put(CameraImage(LEFT, np.zeros((4, 4), np.uint8), number=number))
    assert told.wait(30.0)
    beside.close()


def test_threaded_sink_never_waits_and_counts_skipped_images() -> None:
    class Slow(Kept):
        """Takes nothing before it is let."""

        def __init__(self) -> None:
            super().__init__()
            self.begun, self.go = threading.Event(), threading.Event()

        def put(self, row: np.ndarray) -> None:
            self.begun.set()
            assert self.go.wait(30.0)
            super().put(row)

    slow = Slow()
    beside = ThreadedImageSink(ImageEncoder(slow, PNG))
    image = np.zeros((4, 4), np.uint8)
    beside.put(CameraImage(LEFT, image), CameraImage(RIGHT, image))
    assert slow.begun.wait(30.0)
    for number in range(1, ThreadedImageSink.QUEUE_MAX + 4):  # three more than the capacity
        beside.put(CameraImage(LEFT, image, number=number), CameraImage(RIGHT, image, number=number))
    slow.go.set()
    beside.close()
    beside.close()
    assert len(slow.rows) == 2 * (ThreadedImageSink.QUEUE_MAX + 1)
    assert [row[0]["number"] for row in slow.rows[::2]] == list(range(ThreadedImageSink.QUEUE_MAX + 1))
    assert [int(row[0]["dropped"]) for row in slow.rows[-2:]] == [3, 3]


def test_the_run_s_time_is_known_where_the_cell_is_shared() -> None:
    here = RunTime()
    there = RunTime(here.descriptor)
    assert math.isnan(there.at(3.0))
    here.set_zero(2.5)
    assert there.at(3.0) == 0.5
    here.set_zero(math.nan)
    assert math.isnan(there.at(3.0))
    here.close()


def test_time_of_the_run_is_reported_when_it_starts_changes_and_stops() -> None:
    told: list[float] = []
    run_zero = RunZero([told.append])
    for zero_s in (math.nan, 1.0, 1.0, 1.02, math.nan, math.nan, 1.06):  # a period was lost
        run_zero.set(zero_s)
    np.testing.assert_array_equal(told, [1.0, 1.02, math.nan, 1.06])


@pytest.fixture
def png_rig() -> Rig:
    return load_rig("mock", ("rig.recording.images=png", "rig.recording.image_interval_s=0")).value


def test_another_process_gets_ring_and_time_by_their_descriptors(png_rig: Rig) -> None:
    ring, run = Ring.create(IMAGE, SLOTS, "pictures"), RunTime()
    run.set_zero(10.0)
    memory = ImageMemory(ring.descriptor, ring.slots, run.descriptor)
    maker = ImageMemory(*memory).encoder(png_rig)
    assert maker is not None
    assert maker.due(12.5)
    maker.put(CameraImage(RIGHT, np.zeros((4, 6), np.uint8), bench_s=12.5, number=7, shapes=[CROSS]))
    (row,) = ring.reader().read()
    assert (row["t_s"], row["bench_s"], row["number"]) == (2.5, 12.5, 7)
    assert (row["width_px"], row["height_px"]) == (6, 4)
    none = load_rig("mock", ("rig.recording.images=none",)).value
    assert ImageMemory(*memory).encoder(none) is None
    ring.close()
    run.close()


def test_images_dropped_by_their_source_are_counted_as_dropped(tmp_path: Path) -> None:
    file = RunFile(tmp_path / "run.mcap", RecordingHeader({"schema_version": "1"}, {}, 0))
    for left_out in (1, 1, 4):
        file.write_images(image_row(LEFT, 0.0, b"x", exposure=Exposure(dropped=left_out)))
    file.write_images(image_row(RIGHT, 0.0, b"x", exposure=Exposure(dropped=2)))
    account = file.finish({})
    assert account.dropped == 6
    assert "6 messages" in account.problem


def test_image_outside_the_run_s_time_has_the_time_at_which_the_run_stands(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    file = RunFile(path, RecordingHeader({"schema_version": "1"}, {}, 1_000_000_000))
    file.write_images(image_row(LEFT, math.nan, b"x", exposure=Exposure(3.5)))
    rows = np.zeros(1, CYCLE)
    rows["t_s"] = 4.0
    file.write_cycles(rows)
    file.write_images(image_row(LEFT, math.nan, b"x", exposure=Exposure(9.5)))
    file.finish({})
    found = contents(path).lines["/pictures/vmu.left"]
    assert [(line["timestamp"]["sec"], line["t_s"], line["bench_s"]) for line in found] == [
        (1, None, 3.5),
        (5, None, 9.5),
    ]


def test_shapes_are_recorded_as_foxglove_draws_them(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    shapes = [
        CROSS,
        {"kind": "circle", "at": [5.0, 6.0], "radius": 2.5, "good": False},
        {"kind": "line", "from": [0.0, 0.0], "to": [3.0, 4.0], "good": True},
        {"kind": "text", "at": [7.0, 8.0], "text": "ok", "good": True},
    ]
    file = RunFile(path, RecordingHeader({"schema_version": "1"}, {}, 0))
    file.write_images(image_row(LEFT, 2.0, b"x", shapes=shapes))
    file.finish({})
    (found,) = contents(path).lines["/pictures/vmu.left/annotations"]
    (circle,), (lines,), (text,) = found["circles"], found["points"], found["texts"]
    assert (circle["position"], circle["diameter"]) == ({"x": 5.0, "y": 6.0}, 5.0)
    assert lines["type"] == 4  # pairs of points: two of the cross, one line
    assert [(p["x"], p["y"]) for p in lines["points"]] == [
        (-3.5, 2.25),
        (6.5, 2.25),
        (1.5, -2.75),
        (1.5, 7.25),
        (0, 0),
        (3, 4),
    ]
    assert (text["text"], text["position"]) == ("ok", {"x": 7.0, "y": 8.0})
    assert circle["outline_color"] != lines["outline_color"]


def test_images_without_cycles_reach_the_disk_eventually(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "run.mcap"
    file = RunFile(path, RecordingHeader({"schema_version": "1"}, {}, 0))
    row = image_row(MONITOR, 1.0, noise(rng, 1_000_000).tobytes())
    sizes = []
    for _ in range(20):
        file.write_images(row)
        sizes.append(path.stat().st_size)
    assert sizes[-1] > 5_000_000
    assert len(contents(path).lines["/pictures/monitor"]) >= 8  # as the file is, without an end
    file.finish({})


def test_ring_that_dropped_images_reports_it() -> None:
    ring = Ring.create(IMAGE, 4, "pictures")
    reader = ring.reader()
    for number in range(6):
        ring.put(image_row(LEFT, float(number), b"x", exposure=Exposure(number=number)))
    found = reader.read()
    assert [int(row["number"]) for row in found] == [3, 4, 5]
    assert reader.lost == 3
    ring.close()


def test_the_shipped_rigs_keep_two_jpegs_a_second() -> None:
    found = load_rig("emulated").value.recording
    assert SimpleNamespace(**found.model_dump()) == SimpleNamespace(images="jpeg", image_interval_s=0.5)
