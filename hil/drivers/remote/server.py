"""Server of devices for the loop: answers requests, sends a heartbeat, reports failures."""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any, Final, Protocol

import numpy as np

from hil.core.clock import BenchClock, HostPauses, Order, WallClock, pause_text
from hil.core.plug_ins import call, is_of, plug_in_error
from hil.core.realtime import SWITCH_INTERVAL_S, take_fifo
from hil.drivers.base import NO_TORQUE_LIMIT, LimitsTorque
from hil.drivers.remote import io_layout
from hil.drivers.remote.io_layout import IoSharedMemory
from hil.drivers.remote.requests import RequestLine
from hil.errors import BenchError

LOOP_SILENCE_MAX_S: Final = 0.05
"""Wall time without a due heartbeat after which the bench is stopped."""
FIFO_PRIORITY: Final = 60
"""Below the loop's, above everything else: the loop's commands must be sent."""
_COUNTERS_EVERY: Final = 50  # periods
_BEAT_WALL_S: Final = 0.004  # least time between two heartbeats: a setpoint may start a period at any time


def raise_priority(clock: BenchClock) -> None:
    """Schedule this thread, and those it starts, before everything but the loop, if the system allows it.

    Without effect in lock-step, which has no deadlines.
    """
    if not isinstance(clock, WallClock):
        return
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    take_fifo(FIFO_PRIORITY)


class Device(Protocol):
    """Any device that can be served."""

    def open(self, now_s: float) -> None: ...

    def close(self) -> None: ...


Stop = Callable[[float], None]
"""A device's method that stops it, called with the bench time, s."""


class DeviceServer:
    """Serves ``devices`` by name in ``run`` until it is stopped, then closes all of them.

    name: IO or WATCHDOG, the mailbox of this process' heartbeat. period_wall_s: longest time between two steps.
    Subclasses define ``step``.
    """

    def __init__(
        self,
        devices: Mapping[str, Device],
        memory: IoSharedMemory,
        requests: socket.socket,
        clock: BenchClock,
        name: str,
        period_wall_s: float = 0.001,
    ) -> None:
        self.memory = memory
        self.clock = clock
        self.served: set[str] = set()
        self._period_wall_s = clock.poll_s(period_wall_s)
        self._devices = devices
        self._requests = RequestLine(requests, clock, name, 0)
        self._beat = memory.block[name]
        self._wake = memory.wakes[name]
        self._heartbeat = np.zeros(1, io_layout.HEARTBEAT)
        self._heartbeat["watched"] = 1
        self._peer_heartbeat = np.zeros(1, io_layout.HEARTBEAT)
        self._stop = np.zeros(1, io_layout.STOP)
        self._stops: dict[str, int] = {}
        self._pauses = HostPauses()

    def start(self) -> dict[str, str]:
        """Accept requests; no device is opened before the loop requests it."""
        self._beat.write(self._heartbeat, self.clock.now_s())
        self.clock.start_thread(self._handle_requests, "requests", Order.REQUESTS)
        return {}

    def run(self, stop: threading.Event) -> None:
        periods = 0
        stepped_s = beat_s = self.clock.host_s()
        while not stop.is_set():
            self.clock.wait_wake(self._wake, self._period_wall_s)
            wall_s = self.clock.host_s()
            self._pauses.note(wall_s - stepped_s - self._period_wall_s, wall_s)
            now_s = self.clock.now_s()
            if wall_s - beat_s >= _BEAT_WALL_S:
                beat_s = wall_s
                self._heartbeat["pause_s"] = self._pauses.recent_s(wall_s)
                self._beat.write(self._heartbeat, now_s)
            self.step(now_s)
            stepped_s = self.clock.host_s()
            periods += 1
            if periods % _COUNTERS_EVERY == 0:
                for name in tuple(self.served):
                    try:
                        self._write_counters(name, now_s)
                    except BenchError as error:
                        self.fail(name, error, now_s)

    def close(self) -> None:
        """Stop and close all devices; one that raises does not keep the others from it."""
        self.clock.release()
        with contextlib.suppress(BenchError):
            self.stop_all(self.clock.now_s())
        for name, device in self._devices.items():
            with contextlib.suppress(BenchError):
                call(name, device.close)

    def step(self, now_s: float) -> None:
        """Do the work of one period."""
        raise NotImplementedError

    def stop_all(self, now_s: float) -> None:
        """Stop what the devices move or switch."""

    def on_opened(self, name: str) -> None:
        """Act on the opening of a device, before the request is answered."""

    def own_pause(self) -> str:
        """Return the recent pause of this process, as an addition to the text of an alarm; "" without one."""
        return pause_text("this process", self._pauses.recent_s(self.clock.host_s()))

    def silence_s(self, sender: str, now_s: float) -> float:
        """Return the time, s of wall time, since the last heartbeat of ``sender``; 0 while none is due."""
        number, beat_s = self.memory.block[sender].read(self._peer_heartbeat)
        return (now_s - beat_s) / self.clock.speed if number and self._peer_heartbeat["watched"][0] else 0.0

    def stop_requested(self, device: str) -> int:
        """Return the kind of the newest stop of ``device`` ordered since the last call, 0 for none."""
        box = self.memory.block[f"{device}.stop"]
        if box.written == self._stops.get(device, 0):
            return 0
        self._stops[device], _ = box.read(self._stop)
        return int(self._stop["kind"][0])

    def stop_in_thread(self, name: str, stop: Stop, now_s: float) -> None:
        """Call ``stop`` of a device in a thread: it may take longer than a period, and the heartbeat must continue."""

        def run() -> None:
            try:
                call(name, stop, now_s)
            except BenchError as error:
                self.fail(name, error, now_s)

        self.clock.start_thread(run, "stop", Order.REQUESTS)

    def fail(self, name: str, error: BenchError, now_s: float) -> None:
        """Report the failure to the loop; the device is not served any more until it is opened again."""
        self.served.discard(name)
        self.memory.block[f"{name}.failure"].write(io_layout.failure_record(error, name), now_s)

    def report_thread(self, error: BaseException) -> bool:
        """Report what a thread of a device has raised and not caught; return whether it is of one."""
        name = next((name for name, device in self._devices.items() if is_of(device, error)), None)
        if name is not None:
            self.fail(name, plug_in_error(name, error), self.clock.now_s())
        return name is not None

    def _write_counters(self, name: str, now_s: float) -> None:
        count = getattr(self._devices[name], "counters", None)
        if count is not None:
            self.memory.block[f"{name}.counters"].write(io_layout.counters_record(call(name, count)), now_s)

    def _handle_requests(self) -> None:
        """Answer requests one after the other, until the loop closes its end of the socket."""
        with contextlib.suppress(OSError, ValueError):  # the loop has ended
            while (request := self._requests.receive()) is not None:
                self._requests.send(self._handle(**request))
        self._requests.close()

    def _handle(self, do: str, device: str, axis: int = 0, reduced: bool | None = None) -> dict[str, Any]:
        name, now_s = device, self.clock.now_s()
        served = self._devices[name]
        try:
            if do == "open":
                self.served.discard(name)
                call(name, served.open, now_s)
                self.on_opened(name)
                self.served.add(name)
            elif do == "close":
                self.served.discard(name)
                self._write_counters(name, now_s)
                call(name, served.close)
            elif do == "home":
                call(name, served.home, now_s)  # type: ignore[attr-defined]
            elif do == "torque":
                if not isinstance(served, LimitsTorque):
                    return {"torque": NO_TORQUE_LIMIT}
                if reduced is not None:
                    call(name, served.limit_torque, axis, reduced)
                return {"torque": call(name, served.torque_limit, axis)}
        except BenchError as error:
            record = io_layout.failure_record(error, name)
            return {"failure": [field.decode(errors="replace") for field in record[0]]}
        return {}
