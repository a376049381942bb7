"""The processes that serve the loop's devices: the I/O process, and the watchdog process of a rig with digital I/O."""

from __future__ import annotations

import socket
from typing import Final, Self

import numpy as np

from hil.config.rig import Rig
from hil.core.child_process import ChildProcess
from hil.core.clock import BenchClock, Order
from hil.core.fork_server import ForkServer
from hil.drivers.base import AxisGroup, DiscreteIo, PoseSource
from hil.drivers.remote.devices import IoLink, RemoteAxes, RemoteIo, RemotePoses, RemoteTurntable
from hil.drivers.remote.io_layout import HEARTBEAT, IO, WATCHDOG, IoSharedMemory
from hil.drivers.remote.requests import IoRequests
from hil.drivers.split_axes import AbsentVmu

_READY_WALL_S: Final = 60.0
_ORDERS: Final = {IO: Order.IO, WATCHDOG: Order.WATCHDOG}
_MODULES: Final = {IO: "hil.parts.wires.io_server", WATCHDOG: "hil.parts.wires.watchdog"}


class _ChildLink:
    """One of the processes, its requests and its link."""

    def __init__(
        self,
        name: str,
        rig: Rig,
        clock: BenchClock,
        memory: IoSharedMemory,
        server: ForkServer | None,
        period_s: float | None,
    ) -> None:
        here, there = socket.socketpair()
        configuration = {
            "rig": rig.model_dump(mode="json"),
            "clock": clock.configuration(_ORDERS[name], name),
            "descriptors": memory.descriptors,
            "requests": there.fileno(),
            "period_s": period_s,
        }
        descriptors = (*memory.descriptors, *clock.descriptors, there.fileno())
        try:
            self.child = ChildProcess(f"{name} process", _MODULES[name], configuration, descriptors, server=server)
        finally:
            there.close()
        self.requests = IoRequests(here, name, clock)
        served = {"io": rig.io} if name == WATCHDOG else {**rig.axis_groups, **rig.robots, "vmu": rig.vmu}
        plug_ins = [device for device, table in served.items() if table is not None and table.is_plug_in]
        self.link = IoLink(name, memory, self.requests, clock, self.child.end_text, plug_ins)


class IoProcesses:
    """Starts the processes that ``rig`` needs; ``close`` ends them, and they stop the bench first.

    server: forks them; None: each is a program of its own, which hardware requires. period_s: of the setpoints.
    """

    def __init__(
        self, rig: Rig, clock: BenchClock, server: ForkServer | None = None, period_s: float | None = None
    ) -> None:
        self._rig = rig
        self._clock = clock
        self._memory = IoSharedMemory.create(rig.held_numbers)
        self._processes: dict[str, _ChildLink] = {}
        try:
            for name in (IO, *((WATCHDOG,) if rig.has_io else ())):
                self._processes[name] = _ChildLink(name, rig, clock, self._memory, server, period_s)
        except BaseException:
            self.close()
            raise

    @property
    def children(self) -> dict[str, ChildProcess]:
        """Processes IO and, if there is one, WATCHDOG."""
        return {name: process.child for name, process in self._processes.items()}

    @property
    def pids(self) -> dict[str, int]:
        """Their process numbers."""
        return {name: child.pid for name, child in self.children.items()}

    def pauses(self) -> dict[str, float]:
        """Return the last pause of each process by the host, s, as it was at its last heartbeat; 0 without one."""
        heartbeat, pauses = np.zeros(1, HEARTBEAT), {}
        for name in self._processes:
            self._memory.block[name].read(heartbeat)
            pauses[f"the {name} process"] = float(heartbeat["pause_s"][0])
        return pauses

    def calls(self, name: str) -> list[str]:
        """Return the calls of plug-ins under way in IO or WATCHDOG, or in which it has ended."""
        return self._memory.calls_of(name)

    def wait_ready(self) -> None:
        """Return once all serve. Raises DeviceError if one does not start."""
        for process in self._processes.values():
            process.child.wait_ready(_READY_WALL_S)

    def devices(
        self,
    ) -> tuple[RemoteAxes, RemoteAxes, PoseSource, DiscreteIo | None, RemoteAxes | None, dict[str, AxisGroup]]:
        """Return the loop's rails, turntable, vision unit, digital I/O, axes of the target, further ones by name."""
        rig, link = self._rig, self._processes[IO].link
        watchdog = self._processes.get(WATCHDOG)
        lines = RemoteIo(rig.io, watchdog.link) if watchdog is not None and rig.io is not None else None
        return (
            RemoteAxes("rails", rig.rails, link, wakes=False),  # the turntable's setpoint follows at once
            (RemoteTurntable if rig.arm is None else RemoteAxes)("turntable", rig.turntable, link),
            self._poses(link),
            lines,
            RemoteAxes("target", rig.target_axes, link) if rig.target_axes is not None else None,
            {name: RemoteAxes(name, table, link) for name, table in rig.held_axes.items()},
        )

    def _poses(self, link: IoLink) -> PoseSource:
        vmu = self._rig.vmu
        if not self._rig.has_vmu:
            return AbsentVmu()
        made: PoseSource = vmu.make_driver(self._clock) if vmu.entry.has_processes else RemotePoses(vmu, link)
        return made

    def close(self) -> None:
        """End the processes. Idempotent."""
        for process in self._processes.values():
            process.child.ask_to_end()
        for process in self._processes.values():
            process.child.close()
            process.requests.close()
        self._memory.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
