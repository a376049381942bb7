"""Set-up aid: numbers of images, of pairs, and its page."""

from __future__ import annotations

import json
import math
import urllib.error
import urllib.request
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from hil.drivers.cameras.base import CameraFrame
from hil.drivers.cameras.brightness import BrightnessControl, brightest_hundredth
from hil.parts.cameras.aid import WANTED_PEAK, SetUpAid, led_level, side_numbers
from hil.parts.cameras.aid_server import AidServer
from hil.vmu.detect import SpotDetector

SHAPE = (240, 320)


def picture(peak: float, width_px: float = 1.2, spots: int = 6, background: float = 20.0) -> np.ndarray:
    """Return an image of Gaussian lights, by no code of the vision unit."""
    v, u = np.indices(SHAPE, dtype=float)
    light = np.full(SHAPE, background)
    for k in range(spots):
        u0, v0 = 60.3 + 35.7 * k, 90.6 + 11.3 * (k % 3)
        light += (peak - background) * np.exp(-((u - u0) ** 2 + (v - v0) ** 2) / (2.0 * width_px**2))
    noisy = light + np.random.default_rng(1).normal(0.0, 1.0, SHAPE)
    return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)


def numbers_of(image: np.ndarray):  # type: ignore[no-untyped-def]
    return side_numbers(image, SpotDetector(SHAPE).spots(image))


def test_numbers_are_those_of_the_lights() -> None:
    found = numbers_of(picture(180.0))
    assert (found.spots, found.saturated, found.advice) == (6, 0, "ok")
    assert found.width_px == pytest.approx(1.2, abs=0.1)
    assert found.peak == pytest.approx(180.0, abs=15.0)
    assert found.background == pytest.approx(20.0, abs=1.0)


@pytest.mark.parametrize(
    ("image", "advice"),
    [
        (picture(180.0, spots=0), "no spots"),
        (picture(600.0), "too bright"),
        (picture(50.0), "dim: expose 3"),
        (picture(180.0, 4.0), "turn the focus"),
    ],
)
def test_advice_names_what_is_wrong(image: np.ndarray, advice: str) -> None:
    assert advice in numbers_of(image).advice


def test_exposure_follows_the_leds_and_not_the_background() -> None:
    """Six LEDs are a thousandth of the pixels: by the brightest hundredth they would be saturated."""
    detector, levels = SpotDetector(SHAPE), {}
    for name, level in (
        ("leds", lambda image: led_level(image, detector.spots(image))),
        ("pixels", brightest_hundredth),
    ):
        control = BrightnessControl(WANTED_PEAK, 0.002, 0.1, level)
        for _ in range(60):
            factor = control.exposure_s / 0.002
            image = picture(60.0 * factor, 1.2, 6, 4.0 * factor)
            control.update(image)
        levels[name] = numbers_of(image)
    assert levels["leds"].peak == pytest.approx(WANTED_PEAK, rel=0.15)
    assert levels["leds"].saturated == 0
    assert levels["pixels"].saturated == 6


def test_pair_has_lost_images_and_the_skew_of_its_stamps() -> None:
    aid = SetUpAid(((320, 240), (320, 240)), None)
    aid.packet_bytes = (1500, 8192)
    image = picture(180.0)
    for k in range(9):
        numbers, pictures = aid.add(
            (CameraFrame(image, k, 5.0 + k), CameraFrame(image, k, 2.0 + k)), ("", ""), float(k)
        )
    assert numbers.skew_s == 0.0
    assert len(pictures) == 2
    assert tuple(pictures[0][90, 60]) != (image[90, 60],) * 3 or pictures[0].shape == (*SHAPE, 3)
    numbers, _ = aid.add((CameraFrame(image, 9, 14.0), CameraFrame(image, 9, 11.0004)), ("", ""), 9.0)
    assert numbers.skew_s == pytest.approx(-4e-4)
    numbers, pictures = aid.add((CameraFrame(None, 10), CameraFrame(image, 10)), ("Global", ""), 10.0)
    assert (numbers.left, numbers.lost, len(pictures)) == (None, (1, 0), 1)
    assert math.isnan(numbers.skew_s)
    shown = json.loads(json.dumps(numbers.as_json(), allow_nan=False))
    assert (shown["left"], shown["skew_s"], shown["right"]["advice"]) == (None, None, "ok")
    assert shown["packet_bytes"] == [1500, 8192]


@pytest.fixture
def server() -> Iterator[AidServer]:
    made = AidServer(0)
    yield made
    made.close()


def answer(server: AidServer, path: str, method: str = "GET", **headers: str) -> tuple[int, bytes]:
    request = urllib.request.Request(server.address + path, method=method, headers=headers)
    try:
        with urllib.request.urlopen(request, timeout=5.0) as found:
            return found.status, found.read()
    except urllib.error.HTTPError as error:
        return error.code, b""


def test_page_shows_the_newest_pair(server: AidServer) -> None:
    image = cv2.cvtColor(picture(180.0), cv2.COLOR_GRAY2BGR)
    server.show({"number": 3, "left": None}, {"left": image})
    assert json.loads(answer(server, "state.json")[1]) == {"number": 3, "left": None}
    status, content = answer(server, "left.jpg?3")
    shown = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)
    assert status == 200
    assert shown is not None
    assert shown.shape == image.shape
    assert [answer(server, name)[0] for name in ("", "aid.js", "aid.css", "right.jpg", "../aid.py")] == [200] * 3 + [
        404
    ] * 2


def test_pair_is_saved_for_the_page_alone(server: AidServer) -> None:
    assert answer(server, "save", "POST")[0] == 403  # as a page of another site could
    assert answer(server, "state.json", Host="bench.example:80")[0] == 404  # a name that points at this computer
    assert not server.asked_to_save()
    assert answer(server, "save", "POST", **{"X-Camera-Aid": "1"})[0] == 204
    assert server.asked_to_save()
    assert not server.asked_to_save()
