"""A turntable's driver and its emulator on a wire, in lock-step."""

from __future__ import annotations

from contextlib import closing, contextmanager

import numpy as np

from hil.config.rig import AsciiTurntableLine, Cia402, GimbalAxis, Servo, Turntable
from hil.drivers.turntable.ascii.driver import AsciiTurntable
from hil.drivers.turntable.cia402.driver import Cia402Turntable
from hil.errors import DeviceError
from hil.parts.emulation.ascii_turntable import AsciiTurntableEmulator
from hil.parts.emulation.cia402 import Cia402Emulator
from hil.parts.emulation.shared_state import ChainState, SharedAxisState
from tests.support.lock_step import GRID_S, in_lock_step, serving

DRIVERS = {"cia402": Cia402Turntable, "ascii": AsciiTurntable, "acu": AsciiTurntable, "ensemble": AsciiTurntable}
EMULATORS = {"cia402": Cia402Emulator, "ascii": AsciiTurntableEmulator, "acu": AsciiTurntableEmulator}
EMULATORS["ensemble"] = AsciiTurntableEmulator
PARK_DEG = (3.0, -2.0, 0.5)
PATIENCE_S = 20.0


def turntable(
    driver, address=None, interface="serial", timeout_s=0.4, cia402=None, protocol=None, line=None, **of_axes
):
    shipped = {"acu": "acu", "ensemble": "aerotech-ensemble"}.get(driver, "hil-ascii")
    axes = [
        GimbalAxis(
            travel_deg=(-60.0, 60.0), rate_max_degps=40.0, acceleration_max_degps2=80.0, park_deg=park, **of_axes
        )
        for park in PARK_DEG
    ]
    return Turntable(
        driver="cia402" if driver == "cia402" else "ascii",
        timeout_s=timeout_s,
        servo=Servo(gain_per_s=30.0, lag_s=0.006),
        roll=axes[0],
        pitch=axes[1],
        yaw=axes[2],
        cia402=Cia402(interface=interface, channel=address, **(cia402 or {})),
        ascii=AsciiTurntableLine(port=address, protocol=protocol or shipped, **(line or {})),
    )


@contextmanager
def served(driver, chain=ChainState, identity=None, prepare=lambda emulator: None, listen=None, **rig):
    """Yield an emulator, an open driver and their clock. identity: expected of a serial controller.

    prepare: called with the emulator before it starts. listen: its address; None: a line of its own.
    """
    with in_lock_step() as clock, closing(SharedAxisState.create()) as board:
        emulator = EMULATORS[driver](turntable(driver, listen, **rig), clock, board, chain=chain)
        prepare(emulator)
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
    position: np.ndarray | None = None
    end_s = clock.now_s() + PATIENCE_S
    while clock.now_s() < end_s:
        try:
            if position is None:
                position = device.read(clock.now_s()).position
            device.send(position, np.zeros(3), clock.now_s())
            device.read(clock.now_s())
        except DeviceError as error:
            return error
        clock.sleep(GRID_S)
    raise AssertionError("the device did not fail")
