"""The loop's hold on the processes that serve its devices: the I/O process, and the watchdog of a bench with lines."""

from __future__ import annotations

import socket
import sys
from typing import Final, Self

from hil.config.rig import Rig
from hil.core.clock import WallClock
from hil.drivers.base import DiscreteIo
from hil.drivers.emulator_process import EmulatorProcess
from hil.drivers.remote import io_layout
from hil.drivers.remote.devices import IoLink, RemoteAxes, RemoteIo, RemotePoses, RemoteTurntable
from hil.drivers.remote.io_layout import IoSharedMemory
from hil.drivers.remote.requests import IoRequests

_READY_WALL_S: Final = 60.0
_PROGRAMS: Final = {io_layout.HOST: "hil.processes.io_server", io_layout.GUARD: "hil.processes.watchdog"}
TITLES: Final = {io_layout.HOST: "I/O process", io_layout.GUARD: "watchdog process"}


class _Child:
    """One such process and the way to ask it for something."""

    def __init__(self, name: str, rig: Rig, clock: WallClock, exchange: IoSharedMemory) -> None:
        here, there = socket.socketpair()
        configuration = {
            "rig": rig.model_dump(mode="json"),
            "epoch_ns": clock.epoch_ns,
            "speed": clock.speed,
            "descriptors": exchange.descriptors,
            "requests": there.fileno(),
        }
        program = [sys.executable, "-m", _PROGRAMS[name]]
        try:
            self.process = EmulatorProcess(name, program, configuration, (*exchange.descriptors, there.fileno()))
        finally:
            there.close()
        self.requests = IoRequests(here)
        self.link = IoLink(name, exchange, self.requests, clock, self.process.ended)


class HostProcesses:
    """Starts the processes that ``rig`` needs; ``close`` ends them, and they stop the bench first."""

    def __init__(self, rig: Rig, clock: WallClock) -> None:
        self._rig = rig
        self._exchange = IoSharedMemory.create()
        self._children: dict[str, _Child] = {}
        try:
            for name in (io_layout.HOST, *((io_layout.GUARD,) if rig.has_io else ())):
                self._children[name] = _Child(name, rig, clock, self._exchange)
        except BaseException:
            self.close()
            raise

    @property
    def pids(self) -> dict[str, int]:
        """The process of each, by its cell: HOST, GUARD."""
        return {name: child.process.pid for name, child in self._children.items()}

    def wait_ready(self) -> None:
        """Return once all serve. Raises DeviceError when one does not come up."""
        for child in self._children.values():
            child.process.wait_ready(_READY_WALL_S)

    def devices(self) -> tuple[RemoteAxes, RemoteAxes, RemotePoses, DiscreteIo | None, RemoteAxes | None]:
        """Return rails, turntable, vision unit, digital lines and what moves the target, as the loop sees them."""
        rig, link = self._rig, self._children[io_layout.HOST].link
        guard = self._children.get(io_layout.GUARD)
        lines = RemoteIo(rig.io, guard.link) if guard is not None and rig.io is not None else None
        return (
            RemoteAxes("rails", rig.rails, link),
            RemoteTurntable("turntable", rig.turntable, link),
            RemotePoses(rig.vmu, link),
            lines,
            RemoteAxes("target", rig.moved_target, link) if rig.moved_target is not None else None,
        )

    def close(self) -> None:
        """End the processes. Idempotent."""
        for child in self._children.values():
            child.process.ask_to_end()
        for child in self._children.values():
            child.process.close()
            child.requests.close()
        self._exchange.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
