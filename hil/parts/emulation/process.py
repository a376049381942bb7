"""Emulator process: one emulated device, with a control port for its faults.

``EmulatedDevices`` has it forked once per device of an emulated rig.
"""

from __future__ import annotations

import math
import threading
from typing import Protocol

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.driver_registry import DeviceTable
from hil.core.child_process import Message, Service, serve
from hil.core.clock import WallClock, clock_of
from hil.core.plug_ins import wrong_return
from hil.core.realtime import speed_held, take_fifo
from hil.drivers.setpoint_limiter import compile_profile
from hil.parts.emulation.digital_io import PublishChain
from hil.parts.emulation.fault_injection import ControlPort, Faults
from hil.parts.emulation.shared_state import SharedAxisState

_FIFO_PRIORITY = 40  # below everything that the bench itself is run by
_CAMERA_FIFO_PRIORITY = 35  # cameras take milliseconds per image, and libaravis waits for triggers in a busy loop


class Emulator(Service, Protocol):
    """An emulated device, and the faults that can be injected into it."""

    @property
    def faults(self) -> Faults | None: ...


class FaultInjectionService:
    """Serves an emulator, and the control port of its faults if it has some. name: of the process, in errors."""

    def __init__(self, emulator: Emulator, name: str = "emulator") -> None:
        self._emulator, self._name = emulator, name
        self._port = ControlPort(emulator.faults) if emulator.faults else None

    def start(self) -> dict[str, str]:
        """Open the wires; return name -> address, with the control port as ``DEVICE.faults``."""
        addresses, faults = self._emulator.start(), self._emulator.faults
        if not (isinstance(addresses, dict) and all(isinstance(each, str) for each in addresses.values())):
            expected = "expected a dict of the name of each wire to its address"
            raise wrong_return(self._name, self._emulator.start, f"{addresses!r:.60}, {expected}")
        if faults is None or self._port is None:
            return addresses
        return {**addresses, f"{faults.device}.faults": self._port.address}

    def run(self, stop: threading.Event) -> None:
        """Serve the wires until ``stop`` is set."""
        self._emulator.run(stop)
        if not stop.is_set():
            raise wrong_return(self._name, self._emulator.run, "before it was asked to end")

    def close(self) -> None:
        """Close control port and wires."""
        if self._port is not None:
            self._port.close()
        self._emulator.close()


def make_emulator(configuration: Message) -> Emulator:
    """Return the emulator of the device that ``configuration`` names."""
    name, seed = configuration["device"], configuration["seed"]
    device, _, part = name.partition(".")
    scenario = Scenario.model_validate(configuration["scenario"], strict=False)
    rig = Rig.model_validate(configuration["rig"], strict=False)
    clock = clock_of(configuration)
    board = SharedAxisState(configuration["board"])
    if device == "monitor":
        from hil.parts.emulation.emulated_cameras import emulated_television

        assert isinstance(clock, WallClock)  # ensured by ``check_lock_step``
        return emulated_television(scenario, rig, seed, board, clock)
    if device == "tracker":
        from hil.parts.emulation.trackers import emulated_tracker

        return emulated_tracker(scenario, rig, seed, board, clock)
    if device == "imu":
        from hil.parts.emulation.imu import emulated_imu

        return emulated_imu(scenario, rig, seed, board, clock)
    if device == "sensor":
        from hil.parts.emulation.emulated_vision import emulated_sensor

        return emulated_sensor(scenario, rig, seed, board, part, clock)
    emulator: Emulator
    if device in rig.axis_groups:
        emulator = rig.axis_groups[device].parts(device)[name].make_emulator(clock, board, seed=seed, name=name)
        return emulator
    table: DeviceTable = getattr(rig, device)
    if device in rig.robots:
        emulator = table.make_emulator(rig, clock, board, seed=seed, name=device)
    elif device == "io":
        publish: PublishChain = board.write_chain
        if rig.floating is not None:
            from hil.parts.emulation.floating_vehicle import FloatingVehicle

            publish = FloatingVehicle(scenario, rig, seed, board).publish
        emulator = table.make_emulator(clock, publish, seed=seed)
    elif part:
        from hil.parts.emulation.emulated_cameras import emulated_images

        emulator = table.make_emulator(clock, emulated_images(scenario, rig, seed, board, part), part)
    else:
        from hil.parts.emulation.emulated_vision import emulated_vision  # its imports take a second

        vision = emulated_vision(scenario, rig, seed, board, configuration["images"])
        emulator = table.make_emulator(clock, vision.pose_at, vision.transport, seed=seed, at_end=vision.at_end)
    return emulator


def make(configuration: Message) -> Service:
    """Return the service of the emulator; its threads get a real-time priority, as real hardware keeps time.

    At more than twice the speed that this computer holds the emulators and the bench together can fill all cores, which
    a real-time policy must not: then only the coupler has it, whose relay opens if it does not run for 50 ms. Those
    that make images take so much of a core that they have it only up to real time. In lock-step nothing is in time.
    """
    device, speed = configuration["device"], configuration["clock"].get("speed", math.inf)
    service = FaultInjectionService(make_emulator(configuration), f"{device} emulator")
    is_camera = device == "monitor" or device.startswith("vmu.")
    makes_images = is_camera or (device == "vmu" and configuration["scenario"]["vmu"]["source"] != "model")
    if (device == "io" and speed < math.inf) or speed <= (1.0 if makes_images else 2.0 * speed_held()):
        take_fifo(_CAMERA_FIFO_PRIORITY if is_camera else _FIFO_PRIORITY)
    return service


def prepare() -> None:
    """Load the compiler, which the first kernel does."""
    compile_profile()


def main() -> None:
    """Run the emulator that the parent asks for."""
    serve(make)
