"""Emulated cameras of a vision unit that is computed on this host."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

import numpy as np

from hil.config.rig import Vmu
from hil.core.clock import WallClock
from hil.drivers.vmu import NAME
from hil.errors import DeviceError
from hil.parts.emulation.cameras import CameraEmulator

ADDRESSES: Final = {"left": "127.0.0.2", "right": "127.0.0.3"}
"""Addresses of emulated cameras unless the rig file sets others."""


def emulated_camera(table: Vmu, clock: WallClock, image_at: Callable[[float], np.ndarray], side: str) -> CameraEmulator:
    """Return the camera ``side``, left or right, of ``table``; image_at: its image at a bench time, s."""
    if table.settings.interface != "genicam":
        raise DeviceError(NAME, f'cameras.interface = "{table.settings.interface}": only "genicam" can be emulated')
    address, habits = getattr(table.settings, side) or ADDRESSES[side], table.settings.emulated
    return CameraEmulator(f"{NAME}.{side}", address, clock, image_at, habits=habits)
