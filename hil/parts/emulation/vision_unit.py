"""An emulated vision unit: exposes on the beat, thinks for a while, sends its frame down the line."""

from __future__ import annotations

import heapq
import math
import threading
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from hil.config.rig import Vmu, VmuLine
from hil.core.clock import BenchClock
from hil.core.messages import PoseFrame
from hil.drivers.datagrams import DatagramSender
from hil.drivers.vmu import NAME
from hil.drivers.vmu.codec import STATUS_NO_POSE, ReportedIdentity
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.entry import frames_of
from hil.drivers.vmu.transport import Transport
from hil.maths.random_streams import stream
from hil.parts.emulation.fault_injection import Faults, FaultyWire
from hil.parts.emulation.pty_line import PtyLine

IDENTITY: Final = ReportedIdentity("hil", "VMU-0001", "1.4")
IDENTITY_PERIOD_S: Final = 1.0
_CATCHES_UP = 0.25  # fraction of a frame period: a later exposure is dropped


class VmuEmulator:
    """Speaks the unit's frames on a pseudo terminal at ``config.rs422.baud``.

    ``pose_at(t_s)`` is called at each exposure, multiples of 1/rate_hz of bench time, and returns the
    measured pose with its noise (its counter and times are overwritten here), or None when the ring is
    not seen. Each frame leaves ``processing_s``, and what ``transport`` draws for it, after its exposure.
    at_end: called when the unit is let go of.
    """

    def __init__(
        self,
        config: Vmu,
        clock: BenchClock,
        pose_at: Callable[[float], PoseFrame | None],
        transport: Transport | None = None,
        seed: int = 0,
        at_end: Callable[[], None] = lambda: None,
    ) -> None:
        self._config, self._rate_hz = config, config.rate_hz
        self._processing_s = config.processing_s
        self._serial = config.rs422 or VmuLine()
        self._codec = frame_codec(frames_of(config))
        self._identifies = bool(self._codec.identity_sync)
        self._clock = clock
        self._pose_at = pose_at
        self._transport = transport
        self._at_end = at_end
        self.faults = Faults(NAME, ("wire", "vmu"))
        self._wire = FaultyWire(self.faults, stream(seed, "wire"))
        self._frame = b""  # the newest one
        self._on_the_way: list[tuple[float, int, bytes]] = []  # a heap by time of sending
        self._sent = 0
        self._line: PtyLine | DatagramSender | None = None
        self._counter = 0

    def start(self) -> dict[str, str]:
        """Open the line; return ``{"vmu": path of its pseudo terminal}``."""
        self._line = self._open_line()
        return {NAME: self._line.path}

    def _open_line(self) -> PtyLine | DatagramSender:
        return PtyLine(self._serial.baud, self._clock, self._serial.adapter_latency_s)

    def run(self, stop: threading.Event) -> None:
        """Serve until ``stop`` is set; after ``start``."""
        line = self._line
        if line is None:
            raise RuntimeError("VmuEmulator.run before start")
        exposure = math.ceil(self._clock.now_s() * self._rate_hz)
        identify_s = self._clock.now_s()
        while True:
            exposure = max(exposure, math.ceil(self._clock.now_s() * self._rate_hz - _CATCHES_UP))
            exposed_s = exposure / self._rate_hz
            if self._on_the_way and self._on_the_way[0][0] <= exposed_s:
                if self._wait(self._on_the_way[0][0], stop):
                    return
                packet = heapq.heappop(self._on_the_way)[2]
                if self.faults.value("link_down") is None:
                    line.write(packet)
                continue
            if self._wait(exposed_s, stop):
                return
            if self._identifies and exposed_s >= identify_s:
                self._send(self._codec.encode_identity(IDENTITY), exposed_s)
                identify_s = exposed_s + IDENTITY_PERIOD_S
            delays = self._transport.delays() if self._transport else (0.0,)
            frame = self._expose(exposed_s, bool(delays))
            for delay_s in delays or (0.0,):
                self._send(frame, exposed_s + self._processing_s + delay_s)
            exposure += 1

    def _send(self, frame: bytes, due_s: float) -> None:
        """Put ``frame`` on its way, as the wire's faults let it through."""
        for delay_s, packet in self._wire.passed(frame):
            heapq.heappush(self._on_the_way, (due_s + delay_s, self._sent, packet))
            self._sent += 1

    def close(self) -> None:
        """Let go of the line; idempotent. Not while ``run`` is at work."""
        if self._line is not None:
            self._line.close()
            self._line = None
            self._at_end()

    def _expose(self, t_s: float, has_pose: bool) -> bytes:
        if self.faults.value("freeze") is not None and self._frame:
            return self._frame  # counter and time as they were
        counter = self._counter
        self._counter = (counter + 1) & 0xFFFF_FFFF
        pose = self._pose_at(t_s) if has_pose else None
        stamp_s = max(0.0, t_s + (self.faults.value("clock_jump") or 0.0))
        if pose is None:
            self._frame = self._codec.encode_status(counter, stamp_s, STATUS_NO_POSE)
        else:
            self._frame = self._codec.encode(replace(pose, counter=counter, t_s=stamp_s))
        return self._frame

    def _wait(self, t_s: float, stop: threading.Event) -> bool:
        """Wait until bench time ``t_s``; return whether ``stop`` is set."""
        self._clock.sleep_until(t_s)
        return stop.is_set()


class UdpVmuEmulator(VmuEmulator):
    """Sends the unit's frames as datagrams, to the port of the rig file if it names one."""

    def _open_line(self) -> DatagramSender:
        return DatagramSender(self._clock, self._config.settings.host, self._config.settings.port)
