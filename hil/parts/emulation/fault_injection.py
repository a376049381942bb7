"""Fault injection into a running emulated device, and its control port.

The control port speaks lines of text (``nc 127.0.0.1 PORT`` will do); each gets one line back:

    on drop 0.2       one packet in five is lost          off drop
    on stuck y        the y axis stands still             off stuck y
    on jump y 0.05    its encoder jumps by 50 mm, once    clear          all faults off, encoders repaired
    list              what is on                          help           what can be switched on here
    kinds             the same for programs, a line of JSON
"""

from __future__ import annotations

import contextlib
import heapq
import itertools
import json
import math
import socket
import threading
from collections.abc import Sequence
from typing import Any

import numpy as np

from hil.config.tables.faults import EMULATED, ErrorTerm


class Faults:
    """Which faults of ``device`` are on. Any thread may switch; the emulator looks.

    parts: of EMULATED, of which this device consists. axes: short names of its axes.
    """

    def __init__(self, device: str, parts: Sequence[str], axes: Sequence[str] = ()) -> None:
        self.device = device
        self.kinds = {name: term for part in parts for name, term in EMULATED[part].items()}
        self.axes = tuple(axes)
        self._lock = threading.Lock()
        self._on: dict[tuple[str, str], float] = {}
        self.clears = 0
        """Number of ``clear`` so far: a device then also repairs what its faults have left."""

    def on(self, kind: str, axis: str = "", value: float | None = None) -> None:
        """Switch a fault on; ValueError, with a message for the user, if there is no such fault."""
        term = self._kind(kind, axis)
        if value is not None and (problem := term.problem((value,)) if term.values else "takes no number"):
            raise ValueError(f"{kind} {problem.removeprefix('value = ')}")
        size = value if value is not None else 1.0 if term.default is None else term.default
        with self._lock:
            self._on[kind, axis] = size

    def off(self, kind: str, axis: str = "") -> None:
        self._kind(kind, axis)
        with self._lock:
            self._on.pop((kind, axis), None)

    def clear(self) -> None:
        with self._lock:
            self._on.clear()
            self.clears += 1

    @property
    def active(self) -> bool:
        """Whether any fault is on."""
        return bool(self._on)

    def value(self, kind: str, axis: str = "") -> float | None:
        """Return the number that belongs to a fault that is on, None for one that is off."""
        return self._on.get((kind, axis))

    def pop(self, kind: str, axis: str = "") -> float | None:
        """The same, and switch it off: for what happens once."""
        if not self._on:
            return None
        with self._lock:
            return self._on.pop((kind, axis), None)

    def shown(self) -> str:
        """Return what is on, in one line."""
        with self._lock:
            active = [f"{kind} {axis} {value:g}".replace("  ", " ") for (kind, axis), value in self._on.items()]
        return ", ".join(active) or "none"

    def execute(self, line: str) -> str:
        """Execute a line of the control port; return the response line."""
        word, *words = line.split() or [""]
        try:
            if word in ("on", "off") and words:
                kind, *rest = words
                axis = rest.pop(0) if kind in self.kinds and self.kinds[kind].of_axis and rest else ""
                value = float(rest.pop(0)) if word == "on" and rest else None
                if rest:
                    return f"error: {' '.join(rest)}: too much"
                if word == "off":
                    self.off(kind, axis)
                else:
                    self.on(kind, axis, value)
                return "ok"
        except ValueError as error:
            return f"error: {error}"
        if line.strip() == "clear":
            self.clear()
            return "ok"
        if line.strip() == "list":
            return self.shown()
        if line.strip() == "kinds":
            return json.dumps({"axes": self.axes, "kinds": {name: _told(term) for name, term in self.kinds.items()}})
        return f"error: allowed: on FAULT, off FAULT, clear, list; faults: {self._menu()}"

    def _kind(self, kind: str, axis: str) -> ErrorTerm:
        term = self.kinds.get(kind)
        if term is None:
            raise ValueError(f"unknown fault {kind!r}, {self.device} has: {self._menu()}")
        if term.of_axis and axis not in self.axes:
            raise ValueError(f"{kind} {axis!r}: give an axis, one of {', '.join(self.axes)}")
        return term

    def _menu(self) -> str:
        def entry(name: str, term: ErrorTerm) -> str:
            axis = f" {'|'.join(self.axes)}" if term.of_axis else ""
            return f"{name}{axis}" + (f" [{term.unit}]" if term.values else "")

        return ", ".join(entry(name, term) for name, term in self.kinds.items())


def _told(term: ErrorTerm) -> dict[str, Any]:
    """Return ``term`` for programs, by the keys of the line ``kinds``; value: what its number means."""
    default = 1.0 if term.default is None else term.default
    return {"text": term.effect, "of_axis": term.of_axis, "value": term.unit, "default": default, "high": term.high,
            "once": term.once}  # fmt: skip


class FaultyWire:
    """One direction of a device's wire: what was sent, as it arrives under the faults that are on."""

    def __init__(self, faults: Faults, generator: np.random.Generator) -> None:
        self._faults = faults
        self._generator = generator

    def passed(self, packet: bytes) -> list[tuple[float, bytes]]:
        """Return (delay in s of bench time, packet) of everything that arrives of one packet: none, one or two."""
        value = self._faults.value
        if value("link_down") is not None or self._strikes(value("drop")):
            return []
        if self._strikes(value("corrupt")):
            packet = self._corrupted(packet)
        copies = 2 if self._strikes(value("duplicate")) else 1
        return [(value("delay") or 0.0, packet)] * copies

    def _strikes(self, share: float | None) -> bool:
        return share is not None and self._generator.random() < share

    def _corrupted(self, packet: bytes) -> bytes:
        """Flip one bit in each of one to three bytes."""
        damaged = bytearray(packet)
        for _ in range(int(self._generator.integers(1, 4)) if damaged else 0):
            damaged[int(self._generator.integers(len(damaged)))] ^= 1 << int(self._generator.integers(8))
        return bytes(damaged)


class FaultyChannel:
    """Packets in transit in one direction of a wire, under its faults. Times are bench time, s.

    Packets due at the same time keep their order.
    """

    def __init__(self, faults: Faults, generator: np.random.Generator) -> None:
        self._wire = FaultyWire(faults, generator)
        self._in_transit: list[tuple[float, int, bytes]] = []
        self._number = itertools.count()

    def put(self, packet: bytes, now_s: float) -> None:
        """Send one packet at ``now_s``."""
        for delay_s, arriving in self._wire.passed(packet):
            heapq.heappush(self._in_transit, (now_s + delay_s, next(self._number), arriving))

    @property
    def next_s(self) -> float:
        """Time at which the next packet arrives, infinite without one."""
        return self._in_transit[0][0] if self._in_transit else math.inf

    def due(self, now_s: float) -> list[bytes]:
        """Return the packets that have arrived by ``now_s``."""
        arrived = []
        while self.next_s <= now_s:
            arrived.append(heapq.heappop(self._in_transit)[2])
        return arrived


class ControlPort:
    """Listens on 127.0.0.1, a port by the system, and lets people switch ``faults``; a thread of its own."""

    def __init__(self, faults: Faults) -> None:
        self._faults = faults
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = "{}:{}".format(*self._listener.getsockname())
        self._thread = threading.Thread(target=self._listen, name="control port", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Hang up; idempotent."""
        with contextlib.suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)  # wakes accept
        self._listener.close()

    def _listen(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            threading.Thread(target=self._serve, args=(connection,), name="control", daemon=True).start()

    def _serve(self, connection: socket.socket) -> None:
        with connection, connection.makefile("rw", encoding="utf-8", errors="replace") as lines:
            try:
                for line in lines:
                    lines.write(self._faults.execute(line) + "\n")
                    lines.flush()
            except OSError:
                return


class FaultControl:
    """The other end of a control port, for tests, consoles and the fault matrix."""

    def __init__(self, address: str, timeout_s: float = 5.0) -> None:
        host, _, port = address.rpartition(":")
        self._socket = socket.create_connection((host, int(port)), timeout_s)
        self._lines = self._socket.makefile("rw", encoding="utf-8")

    def send(self, line: str) -> str:
        """Send one line; return its answer. ValueError where the device refuses."""
        self._lines.write(line + "\n")
        self._lines.flush()
        answer = self._lines.readline().rstrip("\n")
        if answer.startswith("error: "):
            raise ValueError(answer.removeprefix("error: "))
        return answer

    def close(self) -> None:
        self._lines.close()
        self._socket.close()
