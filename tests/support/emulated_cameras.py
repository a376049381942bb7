"""Emulated GigE Vision cameras for tests; they need libaravis and two addresses on the loopback interface."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from hil.config.tables.cameras import CameraHabits
from hil.core.clock import WallClock
from hil.drivers.cameras.libaravis import aravis
from hil.errors import DeviceError, LinkLost
from hil.parts.emulation.cameras import OBLIGING, CameraEmulator

LEFT, RIGHT = "127.0.0.2", "127.0.0.3"


def require_libaravis() -> None:
    """Skip the test without the library."""
    try:
        aravis("cameras")
    except DeviceError as error:
        pytest.skip(str(error))


@contextmanager
def emulated(
    address: str,
    image_at: Callable[[float], np.ndarray],
    sensor: tuple[int, int] = (2048, 2048),
    exposure_s: float | None = None,
    habits: CameraHabits = OBLIGING,
) -> Iterator[CameraEmulator]:
    """Serve a camera; skip the test if none can be served."""
    require_libaravis()
    camera = CameraEmulator(f"camera.{address[-1]}", address, WallClock(), image_at, sensor, exposure_s, habits)
    stop = threading.Event()
    try:
        camera.start()
    except LinkLost as error:
        pytest.skip(str(error))
    thread = threading.Thread(target=camera.run, args=(stop,))
    thread.start()
    try:
        yield camera
    finally:
        stop.set()
        thread.join()
        camera.close()
