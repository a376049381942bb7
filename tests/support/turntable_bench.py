"""A turntable's driver and its emulator on a wire, in lock-step."""

from __future__ import annotations

from contextlib import closing, contextmanager

import numpy as np

from hil.drivers.shared_state import ChainState, SharedAxisState
from hil.errors import DeviceError
from tests.behaviour.test_turntable_drivers import DRIVERS, EMULATORS, turntable
from tests.support.lock_step import GRID_S, in_lock_step, serving

PATIENCE_S = 20.0


@contextmanager
def served(driver, chain=ChainState, identity=None, **rig):
    """Yield an emulator, an open driver and their clock. identity: expected of a serial controller."""
    with in_lock_step() as clock, closing(SharedAxisState.create()) as board:
        emulator = EMULATORS[driver](turntable(driver, **rig), clock, board, chain=chain)
        address = emulator.start()["turntable"]
        config = turntable(driver, address, **rig)
        if identity is not None:
            config = config.model_copy(update={"ascii": config.ascii.model_copy(update={"identity": identity})})
        with serving(clock, emulator), closing(DRIVERS[driver](config, clock)) as device:
            device.open(clock.now_s())
            yield emulator, device, clock


def eventually(clock, condition):
    end_s = clock.now_s() + PATIENCE_S
    while not condition():
        assert clock.now_s() < end_s, "did not happen in time"
        clock.sleep(GRID_S)


def error_of(device, clock):
    """Send and read like the loop until the device fails; return its error."""
    position = device.read(clock.now_s()).position
    end_s = clock.now_s() + PATIENCE_S
    while clock.now_s() < end_s:
        try:
            device.send(position, np.zeros(3), clock.now_s())
            device.read(clock.now_s())
        except DeviceError as error:
            return error
        clock.sleep(GRID_S)
    raise AssertionError("the device did not fail")
