"""What every process that serves devices for the loop does: answers requests, keeps a beat, tells failures."""

from __future__ import annotations

import contextlib
import json
import os
import select
import socket
import sys
import threading
from collections.abc import Mapping
from typing import Any, Final, Protocol

import numpy as np

from hil.core.clock import WallClock
from hil.core.realtime import SWITCH_INTERVAL_S, take_fifo
from hil.drivers.base import accepted_setpoint
from hil.drivers.remote import io_layout
from hil.drivers.remote.io_layout import IoSharedMemory
from hil.errors import BenchError

LOOP_SILENCE_MAX_S: Final = 0.05
"""Wall time without a heartbeat of a process that is to be heard after which the bench is stopped."""
FIFO_PRIORITY: Final = 60
"""Below the loop's, above everything else: what the loop commands must get out."""
_COUNTERS_EVERY: Final = 50  # periods


def raise_priority() -> None:
    """Put this thread, and those it starts, before everything but the loop, where the system allows it.

    Kernels are loaded now: later that would keep the interpreter from every other thread for a tenth of a second.
    """
    nothing = np.zeros(3)
    accepted_setpoint(("", "", ""), nothing, nothing, nothing)
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    take_fifo(FIFO_PRIORITY)


class Device(Protocol):
    """What is common to everything that can be served."""

    def open(self, now_s: float) -> None: ...

    def close(self) -> None: ...


class Stoppable(Protocol):
    """What can be brought to a stand."""

    def stop(self, now_s: float) -> None: ...


class DeviceServer:
    """Serves ``devices`` by name from ``run`` until it is told to stop; then all are closed.

    name: HOST or GUARD, the cell of this process' heartbeat. period_wall_s: longest time between two looks at
    everything. Subclasses say in ``serve`` what is done in each.
    """

    faults = None

    def __init__(
        self,
        devices: Mapping[str, Device],
        exchange: IoSharedMemory,
        requests: socket.socket,
        clock: WallClock,
        name: str,
        period_wall_s: float = 0.001,
    ) -> None:
        self.exchange = exchange
        self.clock = clock
        self._period_wall_s = period_wall_s
        self.served: set[str] = set()
        self._devices = devices
        self._requests = requests
        self._beat = exchange.block[name]
        self._wake = exchange.wakes[name]
        self._heartbeat = np.zeros(1, io_layout.HEARTBEAT)
        self._heartbeat["watched"] = 1
        self._heard = np.zeros(1, io_layout.HEARTBEAT)
        self._stop = np.zeros(1, io_layout.STOP)
        self._stops: dict[str, int] = {}

    def start(self) -> dict[str, str]:
        """Begin to answer; nothing is opened before the loop asks for it."""
        self._beat.write(self._heartbeat, self.clock.now_s())
        threading.Thread(target=self._answer, name="requests", daemon=True).start()
        return {}

    def run(self, stop: threading.Event) -> None:
        """Serve until ``stop`` is set."""
        periods = 0
        while not stop.is_set():
            ready, _, _ = select.select([self._wake], [], [], self._period_wall_s)
            if ready:
                with contextlib.suppress(BlockingIOError):
                    os.eventfd_read(self._wake)
            now_s = self.clock.now_s()
            self._beat.write(self._heartbeat, now_s)
            self.serve(now_s)
            periods += 1
            if periods % _COUNTERS_EVERY == 0:
                for name in tuple(self.served):
                    self._tell_counters(name, now_s)

    def close(self) -> None:
        """Let go of all devices."""
        for device in self._devices.values():
            device.close()

    def serve(self, now_s: float) -> None:
        """Do a period's work."""
        raise NotImplementedError

    def begin(self, name: str) -> None:
        """Do what is due when a device has been opened, before the loop is told."""

    def silent_s(self, cell: str, now_s: float) -> float:
        """Return for how long, s of wall time, a process that is to be heard has been silent; 0 where it may be."""
        number, heard_s = self.exchange.block[cell].read(self._heard)
        return (now_s - heard_s) / self.clock.speed if number and self._heard["watched"][0] else 0.0

    def stop_is_new(self, device: str) -> bool:
        """Return whether the loop has ordered another stop of ``device``."""
        number, _ = self.exchange.block[f"{device}.stop"].read(self._stop)
        if number == self._stops.get(device, 0):
            return False
        self._stops[device] = number
        return True

    def stop_soon(self, device: Stoppable, now_s: float) -> None:
        """Stop ``device`` without waiting for it: stopping may take a moment of its own, the heartbeat must not."""
        threading.Thread(target=device.stop, args=(now_s,), name="stop", daemon=True).start()

    def fail(self, name: str, error: BenchError, now_s: float) -> None:
        """Tell the loop, once; the device is not asked any more until it is opened again."""
        self.served.discard(name)
        self.exchange.block[f"{name}.failure"].write(io_layout.failure_record(error, name), now_s)

    def _tell_counters(self, name: str, now_s: float) -> None:
        count = getattr(self._devices[name], "counters", None)
        if count is not None:
            self.exchange.block[f"{name}.counters"].write(io_layout.counters_record(count()), now_s)

    def _answer(self) -> None:
        """Answer requests one after the other; the end of the socket ends it."""
        with self._requests, self._requests.makefile("rwb") as lines:
            for line in lines:
                request = json.loads(line)
                answer = self._do(request["do"], request["device"])
                with contextlib.suppress(OSError):
                    lines.write(json.dumps(answer).encode() + b"\n")
                    lines.flush()

    def _do(self, do: str, name: str) -> dict[str, Any]:
        device, now_s = self._devices[name], self.clock.now_s()
        try:
            if do == "open":
                self.served.discard(name)
                device.open(now_s)
                self.begin(name)
                self.served.add(name)
            elif do == "close":
                self.served.discard(name)
                self._tell_counters(name, now_s)
                device.close()
            elif do == "home":
                device.home(now_s)  # type: ignore[attr-defined]
        except BenchError as error:
            record = io_layout.failure_record(error, name)
            return {"failure": [field.decode(errors="replace") for field in record[0]]}
        return {}
