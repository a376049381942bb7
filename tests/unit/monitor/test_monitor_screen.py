"""The monitor's screen: what of a message is where on it, what is left out, and the files it is kept in."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import SceneCamera
from hil.errors import BadInput
from hil.parts.monitor.results import QUANTITIES, FrameDetection, Portion, portion_of, portion_row
from hil.parts.monitor.screen import drawing, plots
from hil.parts.monitor.screen.overlay import annotated_shapes
from hil.parts.monitor.screen.screen import HEIGHT, WIDTH, Screen, ScreenFile
from hil.parts.monitor.sources import LOWER, UPPER, VideoFrame

GREY_FRAME = VideoFrame(0, 0.0, np.full((576, 768), 90, np.uint8))
SCALE = 600 / 576  # image to screen


@pytest.fixture(scope="module")
def camera() -> SceneCamera:
    return load_scene("atv").value.camera


def portion(t_s: float, status: str = "near", **known: float) -> Portion:
    """Return a portion with only these values, each with a sigma of 0.01."""
    values = np.array([known.get(name, np.nan) for name in QUANTITIES])
    return Portion(t_s, 10, status, values, np.where(np.isfinite(values), 0.01, np.nan))


def has(part: np.ndarray, colour: drawing.Colour) -> bool:
    """Return whether ``colour`` is somewhere in ``part``, as far as a line between two pixels shows it."""
    return bool((np.abs(part.astype(int) - colour).max(axis=2) < 75).any())


def around(canvas: np.ndarray, u: float, v: float, reach: int = 2) -> np.ndarray:
    """Return the screen around the point u, v of the image."""
    column, line = round((u + 0.5) * SCALE - 0.5), round((v + 0.5) * SCALE - 0.5)
    return canvas[line - reach : line + reach + 1, column - reach : column + reach + 1]


def test_what_was_seen_is_drawn_where_it_was_seen(camera: SceneCamera) -> None:
    screen = Screen(camera, "test")
    edges = np.array([[500.0, 400.0], [np.nan, 1.0], [9e9, 0.0]])
    seen = FrameDetection(0, 0.0, "near", (200, 150, 300, 250), edges, (350.0, 275.0, 0.0), (350.0, 275.0, 60.0))
    screen.show_frame(GREY_FRAME, seen)
    assert has(around(screen.canvas, 200, 300), drawing.YELLOW)
    assert has(around(screen.canvas, 410, 275), drawing.SKY)
    assert has(around(screen.canvas, 350, 240), drawing.PINK)
    assert has(around(screen.canvas, 380, 275), drawing.PINK)
    assert has(around(screen.canvas, 500, 400), drawing.ORANGE)
    np.testing.assert_array_equal(around(screen.canvas, 600, 500), 90)


def test_a_rotated_cross_is_drawn_rotated(camera: SceneCamera) -> None:
    screen = Screen(camera, "test")
    screen.show_frame(GREY_FRAME, FrameDetection(0, 0.0, "near", cross=(350.0, 275.0, 0.5), disc=(350.0, 275.0, 60.0)))
    assert has(around(screen.canvas, 350 + 40 * np.cos(0.5), 275 - 40 * np.sin(0.5)), drawing.PINK)
    assert not has(around(screen.canvas, 390, 275), drawing.PINK)


def test_each_frame_wipes_the_marks_of_the_last(camera: SceneCamera) -> None:
    screen = Screen(camera, "test")
    screen.show_frame(GREY_FRAME, FrameDetection(0, 0.0, "far", outline=(350.0, 275.0, 100.0)))
    screen.show_frame(GREY_FRAME, FrameDetection(1, 0.1, "no_target"))
    np.testing.assert_array_equal(screen.canvas[30:600, :800], 90)
    assert has(screen.canvas[:24, :200], drawing.VERMILION)


@pytest.mark.parametrize("field", [UPPER, LOWER])
def test_a_field_fills_the_image(camera: SceneCamera, field: int) -> None:
    screen = Screen(camera, "test")
    screen.show_frame(VideoFrame(0, 0.0, np.full((288, 768), 77, np.uint8), field), FrameDetection(0, 0.0, "near"))
    np.testing.assert_array_equal(screen.canvas[30:600, :800], 77)


def test_what_is_not_observable_leaves_a_gap_in_its_plot_and_no_number(camera: SceneCamera) -> None:
    def drawn(portions: list[Portion]) -> tuple[np.ndarray, np.ndarray]:
        screen = Screen(camera, "test")
        for each in portions:
            screen.show_portion(each)
        return screen.canvas[620:900, :800].copy(), screen.canvas[:, 800:].copy()

    known = {"range_m": 9.0, "phi1_rad": 0.01}
    full = [portion(t, **{**known, "range_m": 9.0 - 0.1 * t}) for t in range(6)]
    holed = [*full[:2], portion(2.0, "far"), *full[3:]]
    numbers, with_gap = drawn(holed)
    _, without = drawn(full)
    assert (with_gap != without).any()
    assert (drawn([portion(0.0, "far")])[0] != numbers).any()
    history = plots.History()
    for each in holed:
        history.add(each)
    _, values, sigmas = history.columns("range_m")
    assert np.isnan(values).tolist() == [False, False, True, False, False, False]
    assert np.nanmax(sigmas) == 0.01


def test_the_vertices_of_a_plot_are_at_their_times_and_values() -> None:
    history = plots.History()
    for t in range(11):
        history.add(portion(float(t), range_m=10.0 - 0.5 * t))
    canvas = np.zeros((225, 400, 3), np.uint8)
    plots.draw(canvas, plots.PLOTS[0], history)
    lit = np.abs(canvas.astype(int) - drawing.ORANGE).max(axis=2) < 60
    lines, columns = np.nonzero(lit)
    # falls from the upper left to the lower right, in a straight line
    slope, start = np.polyfit(columns, lines, 1)
    assert slope == pytest.approx((225 - 44) / (1.12 * (400 - 72)), rel=0.05)
    assert np.abs(lines - (slope * columns + start)).max() < 8
    assert (columns.min(), columns.max()) == (pytest.approx(60, abs=5), pytest.approx(390, abs=5))


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [(0.0, 1.0, [0.0, 0.5, 1.0]), (-0.31, 0.29, [-0.2, 0.0, 0.2]), (7.3, 9.1, [7.5, 8.0, 8.5, 9.0])],
)
def test_ticks_are_round_numbers(low: float, high: float, expected: list[float]) -> None:
    np.testing.assert_allclose(plots.ticks(low, high, 4), expected, atol=1e-12)


def test_every_plot_draws_any_history() -> None:
    canvas = np.zeros((225, 400, 3), np.uint8)
    endless = portion(1e5, range_m=1e9)
    for portions in (
        [],
        [portion(0.0)],
        [portion(0.0, range_m=1.0)],
        [endless, endless],
        [portion(-3.0, phi1_rad=0.0)],
    ):
        history = plots.History()
        for each in portions:
            history.add(each)
        for plot in plots.PLOTS:
            plots.draw(canvas, plot, history)


@pytest.mark.parametrize("name", ["screen.mp4", "screen.mkv", "screen.avi"])
def test_a_screen_video_has_every_canvas(tmp_path: Path, camera: SceneCamera, name: str) -> None:
    path = str(tmp_path / name)
    screen = Screen(camera, "test")
    with ScreenFile(path, 12.5) as file:
        for number in range(3):
            screen.show_frame(GREY_FRAME, FrameDetection(number, 0.08 * number, "near"))
            file.write(screen.canvas)
    video = cv2.VideoCapture(path)
    assert (video.get(cv2.CAP_PROP_FRAME_COUNT), video.get(cv2.CAP_PROP_FPS)) == (3, 12.5)
    assert video.read()[1].shape == (HEIGHT, WIDTH, 3)


def test_a_screen_image_is_the_last_canvas(tmp_path: Path, camera: SceneCamera) -> None:
    path = tmp_path / "screen.png"
    screen = Screen(camera, "test")
    with ScreenFile(str(path), 12.5) as file:
        for number in range(2):
            screen.show_frame(GREY_FRAME, FrameDetection(number, 0.08 * number, "near"))
            file.write(screen.canvas)
    np.testing.assert_array_equal(cv2.imread(str(path)), screen.canvas)


@pytest.mark.parametrize(
    ("name", "said"), [("screen.gif", "must end in .mp4, .mkv, .avi, .png"), ("none/screen.mp4", "no folder")]
)
def test_a_screen_file_that_cannot_be_is_one_line(tmp_path: Path, name: str, said: str) -> None:
    with pytest.raises(BadInput, match=said):
        ScreenFile(str(tmp_path / name), 12.5)


def test_overlay_of_a_stand_alone_image_has_text_first_and_not_every_edge() -> None:
    edges = np.vstack((np.column_stack((np.arange(500.0), np.arange(500.0))), [[np.nan, 1.0]]))
    seen = FrameDetection(3, 1.25, "near", (200, 150, 300, 250), edges, (350.0, 275.0, 0.0), (350.0, 275.0, 60.0))
    found = annotated_shapes(seen, portion(1.2, range_m=8.5))
    assert [shape["text"] for shape in found if shape["kind"] == "text"] == [
        "near   t = 1.25 s   frame 3",
        "range 8.500 +- 0.0100 m",
    ]
    assert [shape["kind"] for shape in found[:2]] == ["text", "text"]
    assert [shape["part"] for shape in found[2:9]] == ["region"] * 4 + ["circle"] + ["cross"] * 2
    points = [shape["at"] for shape in found[9:]]
    assert 90 < len(points) <= 120
    assert points[1] == [5.0, 5.0]
    assert all(shape["good"] for shape in found)
    warned = annotated_shapes(seen, None, (10.0, 20.0, 100.0, 50.0), "frames hold two fields")
    assert [shape["text"] for shape in warned if shape["kind"] == "text"][1] == "frames hold two fields"
    assert [shape["to"] for shape in warned if shape["part"] == "search"][-1] == [10.0, 20.0]
    lost = annotated_shapes(FrameDetection(0, 0.0, "no_target"), None)
    assert [(shape["text"], shape["good"]) for shape in lost] == [("no_target   t = 0.00 s   frame 0", False)]


def test_a_portion_comes_back_from_its_record() -> None:
    before = portion(2.5, "far", range_m=12.25, phi3_rad=-0.5)
    (row,) = portion_row(before)
    after = portion_of(row)
    assert (after.t_s, after.frames, after.status) == (before.t_s, before.frames, before.status)
    np.testing.assert_array_equal(after.values, before.values)
    np.testing.assert_array_equal(after.sigmas, before.sigmas)
    assert (row["range_m"], row["sigma_range_m"]) == (12.25, 0.01)
