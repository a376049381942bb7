"""GenICam cameras by libaravis, against an emulated GigE Vision camera."""

from __future__ import annotations

import math
import re
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import cv2
import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.camera_identity import read_identities
from hil.config.tables.cameras import CameraHabits, VisionCameras
from hil.drivers.cameras.base import Camera, CameraFrame, to_8_bits
from hil.drivers.cameras.interfaces import open_camera
from hil.drivers.cameras.processes import CameraProcesses
from hil.errors import DeviceError
from hil.parts.cameras.aid_server import AidServer
from hil.parts.emulation.cameras import CameraEmulator
from tests.support.emulated_cameras import LEFT, emulated

pytestmark = pytest.mark.wires

SIZE = (320, 240)
IMAGE = np.random.default_rng(1).integers(0, 256, SIZE[::-1], dtype=np.uint8)


@pytest.fixture(scope="module")
def emulator() -> Iterator[CameraEmulator]:
    with emulated(LEFT, lambda t_s: IMAGE, (640, 480)) as camera:
        yield camera


def opened(address: str = LEFT, size: tuple[int, int] = SIZE, **settings: object) -> Camera:
    return open_camera("vmu.left", address, VisionCameras.model_validate(settings), size, 20.0)


def taken(camera: Camera, count: int = 1) -> list[CameraFrame]:
    """Return ``count`` frames of software triggers."""
    camera.start()
    frames = []
    try:
        for _ in range(count):
            camera.trigger()
            frame = camera.receive(2.0)
            assert frame is not None
            frames.append(frame)
    finally:
        camera.close()
    return frames


def test_images_arrive_bit_for_bit_with_consecutive_numbers_and_rising_stamps(emulator: CameraEmulator) -> None:
    frames = taken(opened(), 5)
    assert all(frame.image is not None and np.array_equal(frame.image, IMAGE) for frame in frames)
    assert {b.number - a.number for a, b in pairwise(frames)} == {1}
    assert all(b.stamp_s > a.stamp_s for a, b in pairwise(frames))


def test_file_of_another_camera_than_the_emulated_one_is_refused(emulator: CameraEmulator) -> None:
    """Another serial number, region, binning or orientation, by what the camera reports over its wire."""
    camera = opened()
    cameras = CameraProcesses.__new__(CameraProcesses)
    cameras.identities = {"vmu.left": camera.identity}
    camera.close()
    known = emulator.identity(SIZE)
    assert cameras.check_identities({"vmu.left": known}) == ""
    others = {
        "serial": "X",
        "sensor_px": (800, 600),
        "offset_px": (176, 120),
        "binning": (2, 1),
        "reversed": (True, False),
    }
    for key, value in others.items():
        with pytest.raises(DeviceError, match=rf"^vmu\.left: {key} .*: calibrate this camera$"):
            cameras.check_identities({"vmu.left": known.model_copy(update={key: value})})


def test_sixteen_bits_are_reduced_to_eight(emulator: CameraEmulator) -> None:
    (frame,) = taken(opened(pixel_format="Mono16"))
    assert frame.image is not None
    assert np.array_equal(frame.image, IMAGE)


def test_an_image_with_missing_packets_is_not_used(emulator: CameraEmulator) -> None:
    camera = opened(packet_bytes=1400)
    assert camera.packet_bytes == 1400
    camera.start()
    emulator.faults.on("drop", value=0.3)
    end = time.monotonic() + 30.0  # the emulator takes faults up a little later
    try:
        while True:
            camera.trigger()
            frame = camera.receive(2.0)
            if frame is not None and frame.image is None:
                break
            assert time.monotonic() < end
    finally:
        emulator.faults.off("drop")
        camera.close()


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        ({"address": "127.0.0.9"}, "vmu.left: no camera '127.0.0.9'"),
        ({"pixel_format": "Mono12"}, "vmu.left: pixel format 'Mono12': the camera has "),
        ({"trigger": "hardware", "trigger_source": "Line7"}, "vmu.left: trigger source 'Line7': the camera has "),
        ({"size": (800, 600)}, "vmu.left: images of 640 x 480 px, the geometry has 800 x 600"),
    ],
)
def test_a_camera_that_cannot_be_used_is_named_in_one_line(
    emulator: CameraEmulator, settings: dict[str, object], text: str
) -> None:
    with pytest.raises(DeviceError, match=re.escape(text)) as raised:
        opened(**settings)  # type: ignore[arg-type]
    assert "\n" not in str(raised.value)


def test_levels_are_rounded_and_saturation_stays_saturation() -> None:
    raw = np.array([[0, 7, 8, 2048, 4087, 4088, 4095]], np.uint16)
    assert to_8_bits(raw, 12).tolist() == [[0, 0, 1, 128, 255, 255, 255]]


def test_set_up_aid_measures_two_cameras_and_saves_what_its_page_asks_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    addresses = "127.0.0.5", "127.0.0.6"  # those of the other tests are in use
    words = ["cameras", "aid", *addresses, "--width", "320", "--height", "240", "--port", "0", "--pairs", "3"]
    with (
        emulated(addresses[0], lambda t_s: IMAGE, (640, 480)),
        emulated(addresses[1], lambda t_s: IMAGE, (640, 480)),
        patch.object(AidServer, "asked_to_save", lambda _: True),
    ):
        assert execute([*words, "--save", str(tmp_path / "pairs")]) == 0
    printed = capsys.readouterr().out
    assert "camera aid: http://127.0.0.1:" in printed
    assert printed.count("of 255") == 2
    for side in ("left", "right"):
        saved = sorted((tmp_path / "pairs" / side).iterdir())
        assert [path.name for path in saved] == ["0000.png", "0001.png", "0002.png"]
        np.testing.assert_array_equal(cv2.imread(str(saved[0]), cv2.IMREAD_GRAYSCALE), IMAGE)
        assert read_identities(tmp_path / "pairs")[side] is not None


def made(**habits: object) -> CameraHabits:
    return CameraHabits.model_validate(habits)


MAKES = {
    "gain in dB": (made(gain_unit="dB"), {"gain_db": 6.0}, ""),
    "gain in units of its own": (made(), {"gain_db": 6.0}, "gain_db = 6: the camera has GainRaw alone"),
    "gain without a unit": (made(gain_unit=""), {"gain_db": 6.0}, "gain_db = 6: the unit of its Gain is not declared"),
    "gain in percent": (made(gain_unit="%"), {"gain_db": 6.0}, "gain_db = 6: the unit of its Gain is %"),
    "gain too high": (made(gain_unit="dB"), {"gain_db": 26.0}, "gain_db = 26: allowed 0 to 10"),
    "another selector of exposures": (made(trigger_selector="ExposureStart"), {}, ""),
    "no selector of exposures": (
        made(trigger_selector="ExposureActive"),
        {},
        "trigger: <FrameStart> or",
    ),
}


@pytest.mark.parametrize("make", MAKES)
def test_make_of_a_camera_is_set_up_or_refused_in_one_line(make: str) -> None:
    habits, settings, text = MAKES[make]
    with emulated("127.0.0.7", lambda t_s: IMAGE, (640, 480), habits=habits):
        if not text:
            assert len(taken(opened("127.0.0.7", **settings), 2)) == 2
            return
        with pytest.raises(DeviceError, match=re.escape(f"vmu.left: {text}")):
            opened("127.0.0.7", **settings)


def test_time_stamp_that_is_always_zero_is_none() -> None:
    with emulated("127.0.0.8", lambda t_s: IMAGE, (640, 480), habits=made(stamps=False)):
        assert all(math.isnan(frame.stamp_s) for frame in taken(opened("127.0.0.8"), 3))
