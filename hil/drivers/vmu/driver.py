"""The vision unit on a serial port or on UDP: a reader thread decodes frames, the loop polls for them."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from typing import Any, Final

from hil.config.rig import Vmu, VmuLine
from hil.core.clock import BenchClock
from hil.core.messages import PoseFrame
from hil.drivers.datagrams import DatagramPort
from hil.drivers.latest import Latest
from hil.drivers.serial_port import open_serial
from hil.drivers.vmu import COUNTERS, NAME
from hil.drivers.vmu.codec import STATUS_NO_POSE, Decoded
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.entry import frames_of
from hil.drivers.vmu.frame_codec import FrameDecoder
from hil.drivers.vmu.unit_clock import UnitClock
from hil.drivers.wire_reader import READ_WALL_S, WireReader
from hil.errors import DeviceError, DriveFault, LinkLost, LinkTimeout, ProtocolError

_LOOK_WALL_S: Final = 0.01
_COUNTER_MASK: Final = 0xFFFF_FFFF
_HALF_COUNTER: Final = 0x8000_0000
_HISTORY: Final = 64  # frames; 10 s of a unit at 6.25 Hz
_BITS_PER_BYTE: Final = 10
_CLOCKS_AGREE_S: Final = 0.001  # a shared clock may be off by this
_OLDEST_S: Final = 5.0  # no frame takes longer from exposure to arrival
_JUMP_S: Final = 0.5  # a clock of the unit's own that goes off by more than this at once has jumped
_IDENTITY_WAIT_S: Final = 2.5  # the identity frame has a period of 1 s


class Rs422Vmu:
    """Pose source on ``config.rs422``. Times of reception are read from ``clock``, bench time.

    Only new and valid frames, also those without a pose, restart the time-out; rejected, repeated and older ones do
    not. A frame overtaken by others is returned once: it belongs to its own time.

    Times of exposure are bench time if ``config.clock`` is "shared". The clock of another unit is synchronised by its
    fastest frames: the smallest recent difference of reception and time stamp, less line time and ``processing_s``.
    """

    _of_datagrams = False

    def __init__(self, config: Vmu, clock: BenchClock) -> None:
        self.name = NAME
        self._timeout_s = config.timeout_s
        self._line = config.rs422 or VmuLine()
        self._codec = frame_codec(frames_of(config))
        self._expected = config.identity
        self._own_clock = config.clock == "own"
        self._fastest_s = config.processing_s + _BITS_PER_BYTE * self._codec.size / self._line.baud
        self._clock = clock
        self._address = self._line.port
        self._reader: WireReader | None = None
        self._reset(0.0)

    def _reset(self, now_s: float) -> None:
        self._opened_s = now_s
        self._received: Latest[bool] = Latest(self.name)  # time of the last valid frame
        self._newest: int | None = None  # frame counter
        self._seen: deque[int] = deque(maxlen=_HISTORY)  # counters handed on
        self._offsets: deque[float] = deque(maxlen=_HISTORY)  # reception less time stamp
        self._clock_offset = UnitClock(self._fastest_s)
        self._decoder: FrameDecoder = self._codec.decoder(self._of_datagrams)
        self._frames: deque[PoseFrame] = deque()
        self._counts = dict.fromkeys(COUNTERS, 0)
        self._future_s = 0.0  # by which the newest stamp of a shared clock was ahead of its reception

    def open(self, now_s: float) -> None:
        """Open the port and start to read; the time-out runs from ``now_s``. Raises LinkLost.

        If the rig file requires an identity, waits for the identity frame: ProtocolError for another identity,
        LinkTimeout without one.
        """
        self.close()
        self._reset(now_s)
        if self._address is None:
            raise LinkLost(self.name, "rs422.port is not set")
        try:
            port = self._open_port()
        except Exception as cause:  # pyserial: OSError, ValueError (baud), termios.error
            self.close()
            raise LinkLost(self.name, f"cannot open {self._address}: {cause}") from cause
        self._received.put(True, now_s)
        self._reader = WireReader(self.name, port, self._clock, self._receive)
        try:
            self._check_identity(now_s)
        except DeviceError:
            self.close()
            raise

    def _open_port(self) -> Any:
        """Return the open port; pending bytes, which it discards, have an unknown time of reception."""
        return open_serial(self._clock, self._line.port or "", self._line.baud, timeout=READ_WALL_S, exclusive=True)

    def _check_identity(self, now_s: float) -> None:
        """Wait for the identity frame and check it, if the rig file requires an identity."""
        expected = {name: text for name, text in self._expected.model_dump().items() if text is not None}
        if not expected:
            return
        while (identity := self._decoder.identity) is None:
            self._check()
            if self._clock.now_s() - now_s > _IDENTITY_WAIT_S:
                raise LinkTimeout(self.name, f"no identity frame within {_IDENTITY_WAIT_S:g} s{self._hint()}")
            self._clock.sleep(_LOOK_WALL_S)
        for name, text in expected.items():
            if getattr(identity, name) != text:
                raise ProtocolError(self.name, f"wrong unit: {name} {getattr(identity, name)!r}, expected {text!r}")
        self._received.put(True, self._clock.now_s())

    def poll(self, now_s: float) -> list[PoseFrame]:
        """Return the frames received since the last call, oldest first; never waits.

        Raises LinkTimeout after more than ``timeout_s`` without a new frame, LinkLost when the port is gone,
        DriveFault when the unit reports a fault.
        """
        self._check()
        try:
            self._received.get(now_s, self._timeout_s)
        except LinkTimeout as silence:
            raise LinkTimeout(self.name, silence.what + self._hint()) from None
        return [self._frames.popleft() for _ in range(len(self._frames))]

    def _check(self) -> None:
        """Raise the error that the unit has reported, or that of its wire."""
        self._received.check()
        if self._reader is not None:
            self._reader.check()

    def counters(self) -> dict[str, int]:
        """Return the counters since ``open``, named as in ``hil.drivers.vmu.COUNTERS``."""
        return self._counted() | self._clock_offset.numbers()

    def _counted(self) -> dict[str, int]:
        return self._counts | self._decoder.counts()

    def close(self) -> None:
        """End the reader and close the port: well under 0.1 s, idempotent, never raises."""
        self._received.fail(LinkLost(self.name, "is closed"))
        if self._reader is not None:
            self._reader.close()
            self._reader = None

    def _hint(self) -> str:
        """Return the counters, for diagnosis: a wrong baud rate shows as skipped bytes."""
        seen = ", ".join(f"{name} {count}" for name, count in self._counted().items() if count)
        ahead = self._future_s
        future = f", the newest {ahead:.4f} s from the future: the unit's clock is ahead" if ahead > 0.0 else ""
        return f" (since open: {seen}{future})" if seen else ""

    def _receive(self, data: bytes, received_s: float) -> None:
        for decoded in self._decoder.feed(data, received_s):
            self._accept(decoded, received_s)

    def _accept(self, decoded: Decoded, received_s: float) -> None:
        if self._sent_before_open(decoded.t_s, received_s):
            self._counts["late"] += 1
            return
        if self._clock_jumped(decoded.t_s, received_s):
            self._counts["clock_jumps"] += 1
            return
        in_order = self._in_order(decoded.counter)
        if in_order is None:
            return
        self._clock_offset.add(received_s - decoded.t_s, received_s)
        exposed_s = self._bench_time(decoded.t_s, received_s)
        if decoded.pose is not None:
            self._counts["frames"] += 1
            self._frames.append(replace(decoded.pose, t_s=exposed_s))
        elif decoded.status == STATUS_NO_POSE:
            self._counts["no_pose"] += 1
        else:
            self._received.fail(DriveFault(self.name, f"reports fault 0x{decoded.status:02x}"))
        if in_order:
            self._received.put(True, received_s)

    def _sent_before_open(self, stamp_s: float, received_s: float) -> bool:
        """Whether a frame was buffered in the adapter before ``open``, so that its time of reception is wrong."""
        return not self._own_clock and stamp_s < self._opened_s and received_s < self._opened_s + _OLDEST_S

    def _clock_jumped(self, stamp_s: float, received_s: float) -> bool:
        """Whether a time of exposure is impossible: after reception, long before it, or far from its neighbours."""
        age_s = received_s - stamp_s
        if not self._own_clock:
            self._future_s = -age_s if age_s < -_CLOCKS_AGREE_S else 0.0
            return not -_CLOCKS_AGREE_S <= age_s <= _OLDEST_S
        return bool(self._offsets) and abs(age_s - min(self._offsets)) > _JUMP_S

    def _bench_time(self, stamp_s: float, received_s: float) -> float:
        if not self._own_clock:
            return stamp_s
        self._offsets.append(received_s - stamp_s)
        return stamp_s + min(self._offsets) - self._fastest_s

    def _in_order(self, counter: int) -> bool | None:
        """Compare the counter, which wraps, with the newest one; count lost, repeated and overtaken frames.

        Returns True for a new frame, False for an overtaken one, None for one to be discarded.
        """
        ahead = 1 if self._newest is None else (counter - self._newest) & _COUNTER_MASK
        if ahead == 0 or counter in self._seen:
            self._counts["duplicates"] += 1
            return None
        if ahead < _HALF_COUNTER:
            self._counts["lost"] += ahead - 1
            self._newest = counter
            self._seen.append(counter)
            return True
        self._counts["late"] += 1
        if _COUNTER_MASK + 1 - ahead > _HISTORY:
            return None  # far behind: the counter was restarted, or the frames are from before that
        self._counts["lost"] = max(0, self._counts["lost"] - 1)
        self._seen.append(counter)
        return False


class UdpVmu(Rs422Vmu):
    """Pose source on ``config.udp``; each datagram has one frame or several."""

    _of_datagrams = True

    def __init__(self, config: Vmu, clock: BenchClock) -> None:
        super().__init__(config, clock)
        self._settings = config.settings
        self._address = f"{self._settings.host}:{self._settings.port}"
        self._fastest_s = config.processing_s
        self._reset(0.0)

    def _open_port(self) -> DatagramPort:
        return DatagramPort(self._clock, self._settings.host, self._settings.port, READ_WALL_S)
