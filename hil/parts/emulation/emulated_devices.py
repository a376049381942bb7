"""Emulated devices of a rig, each in a child process, so that killing one is like a loss of its power."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, Self

import numpy as np

from hil.config.rig import Rig, SensorLine
from hil.config.scenario import Scenario
from hil.config.tables.sensors import device_of
from hil.core.child_process import ChildProcess
from hil.core.clock import BenchClock, Order
from hil.core.fork_server import ForkServer
from hil.errors import PlugInError
from hil.frmn.image_memory import ImageMemory
from hil.parts.emulation.shared_state import SharedAxisState

_READY_WALL_S = 60.0  # the first start compiles
_EMULATORS = "hil.parts.emulation.process"
_SERVER = ForkServer(
    _EMULATORS, "hil.parts.wires.io_server", "hil.parts.wires.watchdog", "hil.parts.emulation.rails",
    "hil.parts.emulation.cia402", "hil.parts.emulation.digital_io", "hil.parts.emulation.vision_unit",
    "hil.parts.emulation.emulated_vision",
)  # fmt: skip


class EmulatedDevices:
    """Starts an emulator process for each device of ``rig`` and keeps them until ``close``.

    images: memory for those of a rendered vision unit; None: not sent. sensors: names of those on wires of their own.
    """

    server: Final = _SERVER
    """Forks the emulators, and may fork the other processes of a bench without hardware."""

    def __init__(
        self,
        scenario: Scenario,
        rig: Rig,
        clock: BenchClock,
        seed: int,
        images: ImageMemory | None = None,
        sensors: Sequence[str] = (),
    ) -> None:
        self.board = SharedAxisState.create()
        if rig.floating is None:  # otherwise the vehicle writes where its axes would stand
            self._write_fixed_axes(rig)
        self._rig = rig
        configuration = {
            "scenario": scenario.model_dump(mode="json"),
            "rig": rig.model_dump(mode="json"),
            "seed": seed,
            "board": self.board.descriptor,
        }
        self.processes: dict[str, ChildProcess] = {}
        """Of each device, by the device's name; to stop one is to cut the device's power."""
        self._sends_images = "vmu" if images else ""
        parts = {name: part for key, table in rig.axis_groups.items() for name, part in table.parts(key).items()}
        axes = [*(name for name, part in parts.items() if part.driver != "arm"), *rig.robots]
        orders = {"io": Order.COUPLER} | dict.fromkeys(axes, Order.AXES)
        try:
            for device in (*axes, *_devices(scenario, rig), *map(device_of, sensors)):
                memory = images if device == "vmu" else None
                self.processes[device] = ChildProcess(
                    f"{device} emulator",
                    _EMULATORS,
                    {
                        **configuration,
                        "device": device,
                        "images": memory,
                        "clock": clock.configuration(orders.get(device, Order.CAMERAS), f"{device} emulator"),
                    },
                    (self.board.descriptor, *clock.descriptors, *(memory.descriptors if memory else ())),
                    server=self.server,
                )
        except BaseException:
            self.close()
            raise

    def _write_fixed_axes(self, rig: Rig) -> None:
        """Write where the axes stand that no emulator moves."""
        for name, table in rig.axis_groups.items():
            at = [axis.si("park") for axis in table.axes if axis.is_fixed]
            numbers = [n for n, axis in enumerate(table.axes) if axis.is_fixed]
            if numbers:
                self.board.write(name, 0.0, np.array(at), np.zeros(len(at)), numbers)

    @property
    def pids(self) -> dict[str, int]:
        """Numbers of ``processes``."""
        return {device: process.pid for device, process in self.processes.items()}

    def process_of(self, address: str) -> str:
        """Return the name of the process that serves the wire or control port ``address``, as in ``pids``."""
        owners = [name for name in self.processes if address == name or address.startswith(f"{name}.")]
        return max(owners, key=len)

    def wait_ready(self) -> tuple[Rig, dict[str, str]]:
        """Return the rig with the wires that the emulators opened, and the address of each wire and control port.

        Raises DeviceError if an emulator does not start.
        """
        addresses: dict[str, str] = {}
        for process in self.processes.values():
            addresses |= process.wait_ready(_READY_WALL_S)["addresses"]
        try:
            return _connected(self._rig, addresses), addresses
        except KeyError as missing:
            text = f"start returned no address {missing}, only {', '.join(addresses)}"
            raise PlugInError(f"{self.process_of(missing.args[0])} emulator", text) from None

    def ended(self) -> dict[str, str]:
        """Return how the processes that have ended did so, by their names."""
        return {process.name: text for process in self.processes.values() if (text := process.end_text())}

    def close(self) -> None:
        """End all of them, together and at once: an emulated device has nothing to bring to a safe state. Idempotent.

        A vision unit that sends images ends in order, so that the last ones arrive.
        """
        if self._sends_images in self.processes:
            self.processes[self._sends_images].close()
        for process in self.processes.values():
            process.kill()
        for process in self.processes.values():
            process.close()
        self.board.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _devices(scenario: Scenario, rig: Rig) -> tuple[str, ...]:
    """Return what is emulated in a process each other than axes: devices, and parts of devices as ``DEVICE.PART``."""
    parts = rig.vmu.entry.emulated_parts if rig.has_vmu else ()
    vision = [f"vmu.{part}" for part in parts] if parts else ["vmu"] if rig.has_vmu else []
    tracker = rig.table_of_part("tracker") is not None
    television = scenario.monitor.source == "camera"
    more = {"io": rig.has_io, "monitor": television, "tracker": tracker, "imu": rig.imu is not None}
    return (*vision, *(device for device, is_there in more.items() if is_there))


def _connected(rig: Rig, addresses: dict[str, str]) -> Rig:
    """Return ``rig`` with the emulators' addresses in place of its wires."""
    tables: dict[str, Any] = {name: table.connected(name, addresses) for name, table in rig.axis_groups.items()}
    if (target := tables.pop("target", None)) is not None:
        tables["target_manipulator" if rig.moved_target is not None else "rotary_manipulator"] = target
    for key in ("linear_axes", "rotary_axes"):
        tables[key] = {name: tables.pop(name, table) for name, table in getattr(rig, key).items()}
    tables |= {name: robot.connected(name, addresses) for name, robot in rig.robots.items()}
    if rig.has_vmu:
        tables["vmu"] = rig.vmu.connected("vmu", addresses)
    if rig.io is not None and rig.has_io:
        tables["io"] = rig.io.connected("io", addresses)
    if (tracker := rig.table_of_part("tracker")) is not None:
        tables["tracker"] = tracker.connected(addresses["tracker"])
    if rig.imu is not None:
        tables["imu"] = rig.imu.connected(addresses["imu"])
    lines = {
        name.removeprefix("sensor."): SensorLine(port=address)
        for name, address in addresses.items()
        if name.startswith("sensor.") and not name.endswith(".faults")
    }
    return rig.model_copy(update={**tables, "sensors": rig.sensors | lines})
