"""Camera process: triggers a camera, controls its exposure, and hands its frames on with their times of exposure.

``python -m hil.parts.cameras.process`` is started by ``CameraProcesses``, once per camera.
"""

from __future__ import annotations

import math
import os
import threading
import time
from collections import deque
from typing import Final

import numpy as np

from hil.config.camera_identity import CameraIdentity
from hil.config.tables.cameras import CameraSettings
from hil.core.child_process import Message, Parent
from hil.core.clock import WallClock
from hil.core.realtime import drop_priority, take_fifo
from hil.drivers.cameras.base import Camera, CameraFrame
from hil.drivers.cameras.brightness import BrightnessControl
from hil.drivers.cameras.camera_clock import CameraClock
from hil.drivers.cameras.frame_memory import frame_ring, frame_type
from hil.drivers.cameras.interfaces import camera_type, open_camera
from hil.drivers.remote.server import FIFO_PRIORITY
from hil.errors import DeviceError

_RECEIVE_WALL_S: Final = 0.05
_TRIGGERS_KEPT: Final = 16
_EXPOSURE_S: Final = 0.01  # with which the control of the brightness starts


class CameraServer:
    """Receives the frames of a camera and writes them into shared memory.

    configuration: as sent by ``CameraProcesses``. Raises DeviceError if the camera cannot be used.
    """

    def __init__(self, configuration: Message) -> None:
        self._settings = settings_of(configuration)
        self._rate_hz = configuration["rate_hz"]
        self._clock = WallClock(configuration["epoch_ns"], configuration["speed"])
        size = (configuration["size"][0], configuration["size"][1])
        name = configuration["name"]
        wall_rate_hz = self._rate_hz * self._clock.speed
        self._camera: Camera = open_camera(name, configuration["identifier"], self._settings, size, wall_rate_hz)
        self._brightness = _brightness_control(self._settings)
        self._ring = frame_ring(size, configuration["ring"])
        self._wake = configuration["wake"]
        self._record = np.zeros(1, frame_type(size))
        self._triggered = self._settings.trigger == "software"
        self._triggers_s: deque[float] = deque(maxlen=_TRIGGERS_KEPT)
        self._camera_clock = CameraClock(self._settings.latency_s, self._triggered)
        self._ended = threading.Event()
        self._failures: list[DeviceError] = []

    @property
    def shutter(self) -> str:
        """The camera's shutter, empty without one."""
        return self._camera.shutter

    @property
    def identity(self) -> CameraIdentity:
        """The camera's identity."""
        return self._camera.identity

    def run(self, parent: Parent) -> None:
        """Serve until the parent ends. Raises DeviceError."""
        if self._brightness is not None:
            self._camera.set_exposure(self._brightness.exposure_s)
        self._camera.start()
        if self._triggered:
            threading.Thread(target=self._trigger, name="trigger", daemon=True).start()
        try:
            while not parent.wait_end(0.0):
                frame = self._camera.receive(_RECEIVE_WALL_S)
                if frame is not None:
                    self._hand_on(frame, self._clock.now_s())
                if self._failures:
                    raise self._failures[0]
        finally:
            self._ended.set()
            self._camera.close()

    def _trigger(self) -> None:
        """Trigger exposures at multiples of the period of bench time."""
        exposure = math.ceil(self._clock.now_s() * self._rate_hz)
        try:
            while not self._ended.is_set():
                self._clock.sleep_until(exposure / self._rate_hz)
                now_s = self._clock.now_s()
                self._triggers_s.append(now_s)
                self._camera.trigger()
                exposure = max(exposure + 1, math.ceil(self._clock.now_s() * self._rate_hz - 0.5))
        except DeviceError as error:
            if not self._ended.is_set():
                self._failures.append(error)

    def _hand_on(self, frame: CameraFrame, arrived_s: float) -> None:
        record = self._record
        record["exposed_s"] = self._exposed_s(frame, arrived_s)
        record["arrived_s"], record["number"] = arrived_s, frame.number
        record["complete"], record["jumps"] = frame.image is not None, self._camera_clock.jumps
        if frame.image is not None:
            record["image"] = frame.image
        self._ring.put(record)
        os.eventfd_write(self._wake, 1)
        control = self._brightness
        if control is not None and frame.image is not None and control.update(frame.image):
            self._camera.set_exposure(control.exposure_s)

    def _exposed_s(self, frame: CameraFrame, arrived_s: float) -> float:
        speed = self._clock.speed
        if math.isnan(frame.stamp_s):
            exposed_s = self._camera_clock.unstamped_s(arrived_s, tuple(self._triggers_s))
            return exposed_s if frame.image is not None else math.nan
        if self._settings.clock == "system":
            return self._clock.now_s() - (time.time() - frame.stamp_s) * speed
        stamp_s = frame.stamp_s * speed
        certain_s = stamp_s if frame.image is not None else math.nan
        self._camera_clock.add(certain_s, arrived_s, tuple(self._triggers_s))
        return self._camera_clock.exposed_s(stamp_s)


def settings_of(configuration: Message) -> CameraSettings:
    """Return the settings in a configuration of ``CameraProcesses``."""
    return CameraSettings.model_validate(configuration["settings"], strict=False)


def _brightness_control(settings: CameraSettings) -> BrightnessControl | None:
    if settings.brightness_levels is None:
        return None
    start_s = settings.exposure_s or _EXPOSURE_S
    return BrightnessControl(settings.brightness_levels, start_s, settings.exposure_max_s)


def main() -> None:
    """Serve the camera; an error is reported to the parent as a message with ``failure``."""
    parent = Parent()
    drop_priority()
    try:
        camera_type(settings_of(parent.configuration).interface)
        take_fifo(FIFO_PRIORITY - 5)  # after the imports, which fill a core; before the library starts its threads
        server = CameraServer(parent.configuration)
        parent.send(ready=True, shutter=server.shutter, identity=server.identity.model_dump(mode="json"))
        server.run(parent)
    except DeviceError as error:
        parent.send(failure=[type(error).__name__, error.device, error.what])


if __name__ == "__main__":
    main()
