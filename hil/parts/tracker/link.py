"""Links to trackers on wires: a thread reads frames with their bench time of receipt, the loop polls for them."""

from __future__ import annotations

import select
import socket
import struct
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from typing import Final, Protocol

import numpy as np

from hil.core.clock import BenchClock
from hil.core.messages import POSITION_ONLY
from hil.drivers.datagrams import DatagramPort
from hil.drivers.vmu.codecs import frame_codec
from hil.errors import LinkLost
from hil.maths import quat
from hil.parts.tracker import natnet, qtm
from hil.parts.tracker.frames import BodyPose, TrackedFrame
from hil.parts.tracker.table import Tracker

NAME: Final = "tracker"
_READ_WALL_S: Final = 0.1  # bound of one blocking read
_RESPONSE_WALL_S: Final = 3.0
_ALIVE_WALL_S: Final = 1.0
_REOPENED_WALL_S: Final = 1.0
_KEPT: Final = 1024  # frames that the loop has not asked for
_BYTES: Final = 65536
NowS = Callable[[], float]


class TrackerClient(Protocol):
    """A connected client. Errors: OSError, ValueError, struct.error."""

    def read(self) -> Iterator[TrackedFrame]:
        """Yield the frames that arrive within a bounded wait."""

    def close(self) -> None:
        """Release the sockets. Idempotent."""


class NatNetClient:
    """Client of a NatNet server, by unicast or multicast as the server streams.

    address: of its commands. local: of this computer in the network of the cameras. now_s: returns the time.
    """

    def __init__(self, address: tuple[str, int], local: str, now_s: NowS) -> None:
        self._now_s, self._address = now_s, address
        self._stack = ExitStack()
        self._commands = self._stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        try:
            self.server = self._connect()
            self._sockets = [self._commands, self._stream(local)]
        except BaseException:
            self.close()
            raise
        self._alive_s = time.monotonic()

    def read(self) -> Iterator[TrackedFrame]:
        for each in select.select(self._sockets, [], [], _READ_WALL_S)[0]:
            message = each.recv(_BYTES)
            received_s = self._now_s()
            if natnet.is_frame(message):
                yield natnet.frame_of(message, self.server, received_s)
        if time.monotonic() - self._alive_s > _ALIVE_WALL_S:
            self._commands.sendto(natnet.keep_alive(), self._address)
            self._alive_s = time.monotonic()

    def close(self) -> None:
        """Release the sockets."""
        self._stack.close()

    def _connect(self) -> natnet.NatNetInfo:
        self._commands.sendto(natnet.connect_request(), self._address)
        self._commands.settimeout(_RESPONSE_WALL_S)
        while True:
            message = self._commands.recv(_BYTES)
            if natnet.is_server_info(message):
                return natnet.server_of(message)

    def _stream(self, local: str) -> socket.socket:
        stream = self._stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        stream.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        stream.bind(("", self.server.port))
        if self.server.group:
            group = socket.inet_aton(self.server.group) + socket.inet_aton(local)
            stream.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, group)
        return stream


class QtmClient:
    """Client of Qualisys Track Manager."""

    def __init__(self, config: Tracker, now_s: NowS) -> None:
        self._now_s, self._packets = now_s, qtm.PacketSplitter()
        self._pending: deque[tuple[int, bytes]] = deque()
        self._socket = socket.create_connection(config.address, timeout=_RESPONSE_WALL_S)
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._next(qtm.COMMAND)  # its welcome
            self._socket.sendall(qtm.command(f"Version {qtm.VERSION}"))
            self._next(qtm.COMMAND)
            self._socket.sendall(qtm.command("GetParameters 6D"))
            self.names = qtm.names_of(self._next(qtm.XML))
            self._socket.sendall(qtm.command("StreamFrames AllFrames 6DRes"))
        except BaseException:
            self.close()
            raise

    def read(self) -> Iterator[TrackedFrame]:
        if not self._pending and select.select([self._socket], [], [], _READ_WALL_S)[0]:
            self._receive()
        received_s = self._now_s()
        while self._pending:
            kind, content = self._pending.popleft()
            if kind == qtm.DATA:
                yield qtm.frame_of(content, self.names, received_s)
            elif kind == qtm.ERROR:
                raise ValueError(content.rstrip(b"\0").decode("ascii", "replace"))

    def close(self) -> None:
        """Release the socket."""
        self._socket.close()

    def _receive(self) -> None:
        data = self._socket.recv(_BYTES)
        if not data:
            raise OSError("the server has closed the connection")
        self._pending.extend(self._packets.feed(data))

    def _next(self, expected: int) -> bytes:
        """Return the content of the next packet of the type ``expected``; events are skipped."""
        while True:
            while not self._pending:
                self._receive()
            kind, content = self._pending.popleft()
            if kind == expected:
                return content
            if kind == qtm.ERROR:
                raise ValueError(content.rstrip(b"\0").decode("ascii", "replace"))


class TextClient:
    """Receiver of datagrams of one body: poses or points in the tracker's frame, by a frame file."""

    def __init__(self, config: Tracker, clock: BenchClock) -> None:
        self._now_s, self._body = clock.now_s, config.chaser.body
        self._decoder = frame_codec(config.frames).decoder(True, by_camera=False)
        self._port = DatagramPort(clock, *config.address, _READ_WALL_S)

    def read(self) -> Iterator[TrackedFrame]:
        data = self._port.read()
        received_s = self._now_s()
        for decoded in self._decoder.feed(data, received_s) if data else ():
            pose, bodies = decoded.pose, dict[int | str, BodyPose]()
            if pose is not None:
                q = None if decoded.status == POSITION_ONLY else quat.conjugate(pose.q_vt)
                bodies[self._body] = BodyPose(pose.t_v, q, float(np.sqrt(pose.covariance[0, 0])))
            yield TrackedFrame(decoded.t_s, received_s, bodies)

    def close(self) -> None:
        """Release the port."""
        self._port.close()


class TrackerLink:
    """Frames of a client that a thread reads; a stream that is lost is opened again. Raises LinkLost if it cannot be
    opened at first."""

    def __init__(self, open_client: Callable[[], TrackerClient], address: tuple[str, int], clock: BenchClock) -> None:
        self._open, self._shown, self._clock = open_client, "{}:{}".format(*address), clock
        self._frames: deque[TrackedFrame] = deque(maxlen=_KEPT)
        self._ending = threading.Event()
        self.failure = ""
        """Why the stream is gone, "" while it is there."""
        self.invalid = 0
        """Messages that were no frame."""
        try:
            client = open_client()
        except (OSError, ValueError, struct.error) as cause:
            raise LinkLost(NAME, f"{self._shown}: {cause or 'no response'}: is it streaming?") from cause
        self._reader = clock.start_thread(lambda: self._run(client), f"{NAME}-reader")

    def poll(self, now_s: float) -> list[TrackedFrame]:
        """Return the frames received since the last call; never waits."""
        return [self._frames.popleft() for _ in range(len(self._frames))]

    def close(self) -> None:
        """End the reader; idempotent."""
        self._ending.set()
        self._clock.join(self._reader, _RESPONSE_WALL_S)

    def _run(self, client: TrackerClient) -> None:
        while not self._ending.is_set():
            try:
                self._frames.extend(client.read())
                self.failure = ""
            except (ValueError, struct.error):
                self.invalid += 1
            except OSError as cause:
                self.failure = f"{self._shown}: {cause or 'no response'}"
                client.close()
                self._ending.wait(_REOPENED_WALL_S)
                with suppress(OSError, ValueError, struct.error):
                    client = self._open()
        client.close()


def open_link(config: Tracker, clock: BenchClock) -> TrackerLink:
    """Return the open link to the tracker of a rig file. clock: bench time of receipts. Raises LinkLost."""
    clients: dict[str, Callable[[], TrackerClient]] = {
        "natnet": lambda: NatNetClient(config.address, config.local, clock.now_s),
        "qtm": lambda: QtmClient(config, clock.now_s),
        "text": lambda: TextClient(config, clock),
    }
    return TrackerLink(clients[config.driver], config.address, clock)
