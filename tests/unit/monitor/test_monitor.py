"""Docking monitor on rendered images: acceptance, rejection, consistency of its sigmas."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from hil.config.load import Loaded, load_scene
from hil.config.scene import PixelNoise, Scene
from hil.errors import BadInput
from hil.parts.monitor.kernels.quantities import quantities
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.preprocess import bimodal_threshold
from hil.parts.monitor.render import Conditions, FlatShape, Glare, TargetRenderer, film, rectangle
from hil.parts.monitor.results import FAR_QUANTITIES, QUANTITIES, Result
from hil.parts.monitor.settings import MonitorSettings, Region
from hil.parts.monitor.sources import VideoFrame, exposure, exposures_of

PLAIN = Conditions(noise=PixelNoise(read=3.0, k=0.02))


@pytest.fixture(scope="module")
def atv() -> Scene:
    """Return the shipped ATV-like scene."""
    return load_scene("atv").value


@pytest.fixture(scope="module")
def bright() -> Scene:
    """Return the shipped scene of a bright cross on a dark disc in half frames."""
    return load_scene("bright-cross").value


def motion_at(d3: float, rate: float = -0.05) -> np.ndarray:
    """Return (12,) of a camera that closes in from ``d3`` with small angles."""
    w = np.zeros(12)
    w[0], w[2], w[4], w[5] = 0.02 * d3, -0.025 * d3, d3, rate
    w[6], w[8], w[10] = -0.03, -0.02, 0.04
    return w


def flight_of(w: np.ndarray) -> Callable[[float], tuple[np.ndarray, np.ndarray]]:
    return lambda t: (w[0:6:2] + t * w[1:6:2], w[6::2] + t * w[7::2])


def truth_of(w: np.ndarray, t_s: float) -> np.ndarray:
    out, at = np.empty(12), w.copy()
    at[0::2] += t_s * w[1::2]
    quantities(at, out)
    return out


def watched(
    scene: Scene, w: np.ndarray, conditions: Conditions, frames: int = 10, seed: int = 1
) -> tuple[list[Result], DockingMonitor]:
    """Return the portions of a flight and the monitor that watched it."""
    monitor, done = DockingMonitor(scene), []
    for frame in film(TargetRenderer(scene, conditions=conditions), flight_of(w), frames, np.random.default_rng(seed)):
        done += monitor.feed(frame)
    return done + monitor.finish(), monitor


def ratios(portion: Result, w: np.ndarray) -> np.ndarray:
    return (portion.values - truth_of(w, portion.t_s)) / portion.sigmas


@pytest.mark.parametrize(("d3", "status"), [(1.4, "near"), (5.0, "near"), (13.0, "near"), (22.0, "far"), (38.0, "far")])
def test_errors_are_within_their_sigmas_near_and_far(atv: Scene, d3: float, status: str) -> None:
    """The errors of a new monitor's portion match its sigmas, and only observable quantities have values."""
    w = motion_at(d3)
    (portion,), _ = watched(atv, w, PLAIN)
    assert (portion.status, portion.frames) == (status, 10)
    observed = np.isfinite(portion.values)
    names = {name for name, seen in zip(QUANTITIES, observed, strict=True) if seen}
    assert names == (set(QUANTITIES) if status == "near" else FAR_QUANTITIES)
    assert np.all(np.abs(ratios(portion, w)[observed]) < 4.0)
    assert portion.sigma("range_m") < 2e-4 * d3


def test_a_bright_cross_on_a_dark_disc_in_half_frames_is_no_special_case(bright: Scene) -> None:
    """Polarity and dimensions are the scene's; half frames have times of their own."""
    w = motion_at(5.0, rate=-0.3)
    (portion,), _ = watched(bright, w, Conditions(noise=PixelNoise(read=2.5, k=0.02)), frames=5)
    assert (portion.status, portion.frames) == ("near", 10)
    assert portion.t_s == pytest.approx(9.0 / 50.0)
    assert np.all(np.abs(ratios(portion, w)) < 4.5)


@pytest.mark.parametrize(
    "conditions",
    [
        replace(PLAIN, glare=(Glare((0.55, 0.1, 0.0), 400.0, 25.0),)),
        replace(PLAIN, extra=(FlatShape(rectangle(0.25, 0.25, (0.25, 0.2)), 0.35, 60.0),)),
        replace(PLAIN, extra=(FlatShape(rectangle(0.6, 0.8, (1.1, 0.0)), 0.35, 60.0),)),
        replace(PLAIN, slope_right=0.2, slope_down=-0.2, flicker=0.1),
        replace(PLAIN, gain=0.3),
        replace(PLAIN, noise=PixelNoise(read=8.0)),
    ],
    ids=["glare", "cover on the disc", "cover on a box", "uneven light", "dim", "noise"],
)
def test_occlusion_reduces_precision_without_bias(atv: Scene, conditions: Conditions) -> None:
    """Covers, glare, light and noise are outliers or wider sigmas."""
    w = motion_at(6.0)
    (portion,), _ = watched(atv, w, conditions)
    assert portion.status == "near"
    assert np.all(np.abs(ratios(portion, w)) < 4.5)


def test_black_frames_are_reported_and_the_target_is_detected_again(atv: Scene) -> None:
    """Twenty black frames give no numbers, and none of what follows suffers."""
    w = motion_at(6.0, rate=-0.1)
    conditions = replace(PLAIN, black_s=((10 / 12.5 - 1e-6, 30 / 12.5 - 1e-6),))
    portions, _ = watched(atv, w, conditions, frames=40)
    assert [portion.status for portion in portions] == ["near", "no_target", "no_target", "near"]
    assert sum(count for _, count in portions[1].reasons) == 10
    assert np.all(np.isnan(portions[1].values))
    assert np.all(np.abs(ratios(portions[3], w)) < 4.5)


def other_pictures(scene: Scene) -> dict[str, np.ndarray]:
    """Return images without the target."""
    rng = np.random.default_rng(5)
    height, width = scene.camera.height, scene.camera.width
    pictures = {"noise": np.full((height, width), 100.0), "black": np.zeros((height, width))}
    sky = np.full((height, width), 12.0)
    pictures["moon"] = cv2.circle(sky.copy(), (380, 280), 200, 120.0, -1, cv2.LINE_AA)
    disc = cv2.circle(sky.copy(), (380, 280), 100, 200.0, -1, cv2.LINE_AA)
    pictures["disc"] = disc
    crossed = disc.copy()
    cv2.line(crossed, (330, 280), (430, 280), 20.0, 10, cv2.LINE_AA)
    cv2.line(crossed, (380, 230), (380, 330), 20.0, 10, cv2.LINE_AA)
    pictures["disc and cross alone"] = crossed
    circles = sky.copy()
    for _ in range(14):
        u, v = rng.integers(60, 500, 2)
        cv2.circle(circles, (int(u), int(v)), int(rng.integers(8, 60)), float(rng.integers(40, 255)), -1)
    pictures["circles"] = circles
    return {
        name: np.clip(one + rng.normal(0.0, 3.0, one.shape), 0, 255).astype(np.uint8) for name, one in pictures.items()
    }


def test_something_else_gives_never_numbers(atv: Scene, bright: Scene) -> None:
    """No target, or a rejection with its reason: also for another ship seen through the same camera."""
    pictures = other_pictures(atv)
    ship = bright.model_copy(update={"camera": atv.camera, "fields": "whole"})
    rng = np.random.default_rng(2)
    for d3 in (4.0, 9.0, 25.0):
        at = motion_at(d3)
        pictures[f"other ship at {d3} m"] = TargetRenderer(ship, conditions=PLAIN).image(at[0:6:2], at[6::2], 0.0, rng)
    for name, picture in pictures.items():
        monitor = DockingMonitor(atv)
        for number in range(2):
            monitor.feed(VideoFrame(number, 0.08 * number, picture))
            assert monitor.last is not None
            assert not monitor.last.used, name
            assert monitor.last.reason, name
        (portion,) = monitor.finish()
        assert portion.frames == 0, name
        assert np.all(np.isnan(portion.values)), name
        assert portion.status == "no_target" or portion.status.startswith("rejected_"), name


def test_a_cross_off_its_position_in_the_scene_raises_sigma_squared(atv: Scene) -> None:
    """Inconsistent geometry is reported, and inflates the sigmas until they cover it."""
    wrong = atv.target.cross.model_copy(update={"offset_m": 0.36})  # type: ignore[union-attr]
    w = motion_at(6.0)
    monitor, done = DockingMonitor(atv), []
    renderer = TargetRenderer(atv, atv.target.model_copy(update={"cross": wrong}), PLAIN)
    for frame in film(renderer, flight_of(w), 10, np.random.default_rng(1)):
        done += monitor.feed(frame)
    (portion,) = done
    assert not portion.consistent
    assert portion.frames == 0 or np.all(np.abs(ratios(portion, w)) < 4.0)


def test_the_same_frames_give_the_same_numbers(atv: Scene) -> None:
    """Bit for bit: nothing depends on chance or on the clock."""
    w = motion_at(7.0)
    (first,), _ = watched(atv, w, PLAIN)
    (second,), _ = watched(atv, w, PLAIN)
    np.testing.assert_array_equal(first.values, second.values)
    np.testing.assert_array_equal(first.sigmas, second.sigmas)


def test_a_slow_camera_still_gives_a_portion_a_second(atv: Scene) -> None:
    """A portion is ten frames, or what came in a second."""
    scene = atv.model_copy(update={"fps": 4.0})
    portions, _ = watched(scene, motion_at(6.0), PLAIN, frames=9)
    assert [portion.frames for portion in portions] == [4, 4, 1]
    np.testing.assert_allclose([portion.t_s for portion in portions], [0.75, 1.75, 2.0])


def test_the_threshold_parts_two_modes() -> None:
    """Otsu's threshold of a bimodal histogram lies between its modes."""
    counts = np.zeros(256)
    counts[30:40], counts[180:200] = 50.0, 20.0
    found = bimodal_threshold(counts, 0, 255)
    assert found is not None
    assert 38 <= found < 180


@pytest.mark.slow
def test_two_sigmas_cover_as_often_as_they_should(atv: Scene) -> None:
    """800 fresh portions at 1.4 to 40 m, with the accelerations that are allowed for: in 93 to 98.5 % 2 sigmas hold."""
    rng = np.random.default_rng(77)
    settings = MonitorSettings()
    sizes = np.repeat([settings.acceleration_mps2, settings.angular_acceleration_radps2], 3)
    rows, end_s = [], 9 / atv.fps
    for _ in range(800):
        w = motion_at(float(np.exp(rng.uniform(np.log(1.4), np.log(40.0)))))
        w[[6, 8, 10]] += rng.uniform(-0.02, 0.02, 3)
        bend = sizes * rng.normal(size=6)

        def flight(t: float, w: np.ndarray = w, bend: np.ndarray = bend) -> tuple[np.ndarray, np.ndarray]:
            at = w[0::2] + t * w[1::2] + 0.5 * bend * (t - end_s) ** 2
            return at[:3], at[3:]

        conditions = replace(PLAIN, noise=PixelNoise(read=float(rng.uniform(1.0, 8.0))))
        monitor, done = DockingMonitor(atv), []
        for frame in film(TargetRenderer(atv, conditions=conditions), flight, 10, rng):
            done += monitor.feed(frame)
        assert done[0].frames > 0
        rows.append(ratios(done[0], w))
    for name, column in zip(QUANTITIES, np.array(rows).T, strict=True):
        seen = column[np.isfinite(column)]
        assert 0.93 <= np.mean(np.abs(seen) < 2.0) <= 0.985, name


@pytest.mark.parametrize("name", ["atv", "bright-cross"])
def test_plain_images_are_frames_at_the_rate_of_the_scene(name: str) -> None:
    scene = load_scene(name).value
    renderer, rng = TargetRenderer(scene, conditions=PLAIN), np.random.default_rng(1)
    at = motion_at(5.0)
    images = [renderer.image(at[0:6:2], at[6::2], 0.0, rng) for _ in range(3)]
    by_image, by_frame = DockingMonitor(name), DockingMonitor(scene)
    for slot, image in enumerate(images):
        by_image.feed(image)
        for frame in exposures_of(image, slot, Loaded(scene, name, {})):
            assert frame.t_s == pytest.approx(exposure(scene, frame.number)[0])
            by_frame.feed(frame)
        assert by_image.last is not None
        assert by_frame.last is not None
        np.testing.assert_array_equal(by_image.last.pose, by_frame.last.pose)
    assert by_image.finish()[0].t_s == by_frame.finish()[0].t_s > 1.5 / scene.fps
    with pytest.raises(BadInput, match="image: image size: 32 x 32: must be "):
        by_image.feed(np.zeros((32, 32), np.uint8))
    with pytest.raises(BadInput, match=r"image: float64 of shape \(32, 32\): must be "):
        by_image.feed(np.zeros((32, 32)))  # type: ignore[arg-type]


def test_region_of_search_confines_the_search_and_drops_a_target_outside(atv: Scene) -> None:
    """The target is at (371, 302); what is inside of the region is followed wherever it moves."""
    w = motion_at(5.0)
    frames = list(film(TargetRenderer(atv, conditions=PLAIN), flight_of(w), 40, np.random.default_rng(1)))
    monitor = DockingMonitor(atv)

    def statuses(first: int, last: int) -> set[str]:
        found = set()
        for frame in frames[first:last]:
            monitor.feed(frame)
            assert monitor.last is not None
            found.add(monitor.last.status)
        return found

    assert statuses(0, 5) == {"near"}
    monitor.search_in(Region(0, 0, 200, 200))
    (cut,) = monitor.feed(frames[5])
    assert (cut.frames, cut.t_s) == (5, frames[4].t_s)  # the portion of the dropped target ends
    assert statuses(6, 20) == {"no_target"}
    monitor.search_in(Region(250, 180, 500, 420))
    assert statuses(20, 24) == {"near"}
    monitor.search_in(Region(300, 200, 440, 400))
    assert monitor.last is not None
    tracked = monitor.feed(frames[24]) or monitor.last.tracked
    assert tracked
    monitor.search_in(Region(0, 0, 200, 200))
    assert statuses(25, 28) == {"no_target"}
    monitor.search_in(None)
    assert statuses(28, 40) == {"near"}
    (portion,) = monitor.finish()
    assert np.all(np.abs(ratios(portion, w)) < 4.5)
