"""Emulated trackers on their wires: NatNet server, Qualisys Track Manager, or datagrams of one body."""

from __future__ import annotations

import select
import socket
import threading
from collections.abc import Mapping
from contextlib import suppress
from typing import Final, Protocol

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.clock import BenchClock
from hil.core.messages import PoseFrame
from hil.drivers.datagrams import DatagramSender
from hil.drivers.vmu.codecs import frame_codec
from hil.maths import quat
from hil.maths.random_streams import stream
from hil.params import bench as bench_params
from hil.parts.emulation.emulated_vision import seen_axes
from hil.parts.emulation.fault_injection import Faults, FaultyChannel
from hil.parts.emulation.shared_state import SharedAxisState
from hil.parts.tracker import natnet, qtm
from hil.parts.tracker.encoder_poses import pose_of
from hil.parts.tracker.frames import BodyPose
from hil.parts.tracker.measured import MeasuredBodies, TruePose
from hil.parts.tracker.table import Tracker

NAME: Final = "tracker"
_TICKS_HZ: Final = 10_000_000.0
_DATA_PORT: Final = 1511
_FORGOTTEN_S: Final = 10.0  # after a client's last message, of unicast
_LISTENED_WALL_S: Final = 0.05
_CATCHES_UP: Final = 0.25  # fraction of a period: a later measurement is dropped
_BYTES: Final = 65536
Bodies = Mapping[int | str, BodyPose]


class TrackerServer(Protocol):
    """Server of a protocol. address: host:port of its wire."""

    address: str

    def sockets(self) -> list[socket.socket]:
        """Return those on which requests may arrive."""

    def respond(self, ready: socket.socket, now_s: float) -> None:
        """Respond to what has arrived at ``ready``. Raises OSError."""

    def message(self, number: int, t_s: float, stamp_s: float, bodies: Bodies) -> bytes:
        """Return the bytes of a frame. t_s: its bench time. stamp_s: that of the tracker's clock."""

    def send(self, message: bytes, now_s: float) -> None:
        """Send a frame to all clients."""

    def close(self) -> None:
        """Release the sockets. Idempotent."""


class NatNetServer:
    """Server of NatNet by unicast. version: of its stream. latency_s: from exposure to sending."""

    def __init__(self, version: tuple[int, int], latency_s: float) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self.address = "{}:{}".format(*self._socket.getsockname())
        self._info = natnet.NatNetInfo(version, _TICKS_HZ, _DATA_PORT, "")
        self._latency_s = latency_s
        self._ahead_s = 0.0
        self._clients: dict[tuple[str, int], float] = {}

    def sockets(self) -> list[socket.socket]:
        return [self._socket]

    def respond(self, ready: socket.socket, now_s: float) -> None:
        request, client = ready.recvfrom(_BYTES)
        kind = int.from_bytes(request[:2], "little")
        self._clients[client] = now_s
        if kind == natnet.CONNECT:
            ready.sendto(natnet.server_info(self._info), client)
        elif kind == natnet.ECHO_REQUEST:
            ticks = round(_TICKS_HZ * (now_s + self._ahead_s))
            ready.sendto(natnet.HEAD.pack(natnet.ECHO, 16) + request[4:12] + ticks.to_bytes(8, "little"), client)
        elif kind == natnet.MODEL_REQUEST:
            ready.sendto(natnet.HEAD.pack(natnet.MODEL, 4) + bytes(4), client)  # no descriptions
        elif kind != natnet.KEEP_ALIVE:
            ready.sendto(natnet.HEAD.pack(natnet.UNRECOGNISED, 0), client)

    def message(self, number: int, t_s: float, stamp_s: float, bodies: Bodies) -> bytes:
        self._ahead_s = stamp_s - t_s
        return natnet.frame_message(number, bodies, self._info, (stamp_s, stamp_s + self._latency_s))

    def send(self, message: bytes, now_s: float) -> None:
        if self._info.group:
            self._socket.sendto(message, (self._info.group, self._info.port))
            return
        self._clients = {client: at_s for client, at_s in self._clients.items() if now_s - at_s < _FORGOTTEN_S}
        for client in self._clients:
            with suppress(OSError):
                self._socket.sendto(message, client)

    def close(self) -> None:
        self._socket.close()


class QtmServer:
    """Qualisys Track Manager with the bodies ``names``, for any number of clients."""

    def __init__(self, names: list[str]) -> None:
        self._names = names
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.address = "{}:{}".format(*self._listener.getsockname())
        self._clients: dict[socket.socket, qtm.PacketSplitter] = {}
        self._streams: set[socket.socket] = set()
        self._last = b""

    def sockets(self) -> list[socket.socket]:
        return [self._listener, *self._clients]

    def respond(self, ready: socket.socket, now_s: float) -> None:
        if ready is self._listener:
            client, _ = ready.accept()
            client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._clients[client] = qtm.PacketSplitter()
            client.sendall(qtm.command("QTM RT Interface connected"))
            return
        try:
            data = ready.recv(_BYTES)
            for _, content in self._clients[ready].feed(data):
                if response := self._response(content.rstrip(b"\0").decode("ascii", "replace"), ready):
                    ready.sendall(response)
        except (OSError, ValueError):
            data = b""
        if not data:
            self._drop(ready)

    def _response(self, text: str, client: socket.socket) -> bytes:
        word, _, rest = text.partition(" ")
        match word.lower():
            case "version":
                return qtm.command(f"Version set to {rest}" if rest else f"Version is {qtm.VERSION}")
            case "qtmversion":
                return qtm.command("QTM Version is 2023.3 (emulated)")
            case "byteorder":
                return qtm.command("Byte order is little endian")
            case "getstate":
                return qtm.packet(qtm.EVENT, b"\x03")  # a capture has begun
            case "getparameters":
                return qtm.parameters(self._names)
            case "getcurrentframe":
                return self._last or qtm.packet(qtm.NO_MORE_DATA, b"")
            case "streamframes" if rest.lower() == "stop":
                self._streams.discard(client)
                return b""
            case "streamframes" if "6dres" in rest.lower().split():
                self._streams.add(client)
                return b""
        return qtm.packet(qtm.ERROR, b"Parse error\0")

    def message(self, number: int, t_s: float, stamp_s: float, bodies: Bodies) -> bytes:
        self._last = qtm.frame_message(number, stamp_s, self._names, bodies)
        return self._last

    def send(self, message: bytes, now_s: float) -> None:
        for client in [*self._streams]:
            try:
                client.sendall(message)
            except OSError:
                self._drop(client)

    def _drop(self, client: socket.socket) -> None:
        self._streams.discard(client)
        self._clients.pop(client, None)
        client.close()

    def close(self) -> None:
        for client in [*self._clients]:
            self._drop(client)
        self._listener.close()


class TextSender:
    """Sender of datagrams of the chaser's body, by a frame file."""

    def __init__(self, config: Tracker, clock: BenchClock) -> None:
        self._config, self._codec = config, frame_codec(config.frames)
        self._wire = DatagramSender(clock, port=config.port)
        self.address = self._wire.path
        sigmas = np.repeat((config.sigma_m, np.radians(config.sigma_deg)), 3)
        self._covariance = np.diag(sigmas * sigmas)

    def sockets(self) -> list[socket.socket]:
        return []

    def respond(self, ready: socket.socket, now_s: float) -> None:
        """Do nothing: there are no requests."""

    def message(self, number: int, t_s: float, stamp_s: float, bodies: Bodies) -> bytes:
        pose = bodies.get(self._config.chaser.body)
        if pose is None or pose.q is None:
            return b""
        q = quat.conjugate(pose.q)
        return self._codec.encode(PoseFrame(number, stamp_s, stamp_s, pose.position, q, self._covariance))

    def send(self, message: bytes, now_s: float) -> None:
        if message:
            self._wire.write(message)

    def close(self) -> None:
        self._wire.close()


class TrackerEmulator:
    """Tracker that measures the bodies of a bench at its rate, and serves its clients meanwhile."""

    def __init__(
        self, config: Tracker, server: TrackerServer, true_pose: TruePose, clock: BenchClock, seed: int
    ) -> None:
        self._config, self._server, self._true_pose, self._clock = config, server, true_pose, clock
        self._bodies = MeasuredBodies(config, seed)
        self.faults = Faults(NAME, ("wire",))
        self._channel = FaultyChannel(self.faults, stream(seed, "wire", "tracker wire"))

    def start(self) -> dict[str, str]:
        """Return the address of the server."""
        return {NAME: self._server.address}

    def run(self, stop: threading.Event) -> None:
        rate_hz, number = self._config.rate_hz, 0
        while not stop.is_set():
            number = max(number + 1, int(np.ceil(self._clock.now_s() * rate_hz - _CATCHES_UP)))
            t_s = number / rate_hz
            self._serve_until(t_s)
            bodies = self._bodies.at(t_s, *self._true_pose(t_s))
            message = self._server.message(number, t_s, self._bodies.stamp_s(t_s, t_s), bodies)
            self._channel.put(message, t_s + self._config.latency_s)

    def close(self) -> None:
        """Release the sockets."""
        self._server.close()

    def _serve_until(self, t_s: float) -> None:
        """Respond to requests and send what is due, until bench time ``t_s``."""
        while (now_s := self._clock.now_s()) < t_s:
            for message in self._channel.due(now_s):
                self._server.send(message, now_s)
            until_s = min(t_s, self._channel.next_s)
            if not self._server.sockets():
                self._clock.sleep_until(until_s)
                continue
            wait_s = self._clock.wall_s(until_s - now_s)
            ready, _, _ = select.select(self._server.sockets(), [], [], min(max(0.0, wait_s), _LISTENED_WALL_S))
            for each in ready:
                with suppress(OSError):
                    self._server.respond(each, now_s)


def emulated_tracker(
    scenario: Scenario, rig: Rig, seed: int, board: SharedAxisState, clock: BenchClock
) -> TrackerEmulator:
    """Return the emulator of the tracker of ``rig``, which sees the axes of ``board``."""
    config: Tracker = rig.table_of_part(NAME)
    bench, seen = bench_params.bench_as_built(rig, scenario.step_s, scenario.bench), seen_axes(scenario, rig, board)

    def true_pose(t_s: float) -> tuple[np.ndarray, np.ndarray]:
        return pose_of(bench, np.concatenate(seen(t_s)))

    true_pose(0.0)  # compiles
    server: TrackerServer
    if config.driver == "natnet":
        server = NatNetServer((4, 1), config.latency_s)
    elif config.driver == "qtm":
        server = QtmServer([str(body.body) for body in config.bodies.values()])
    else:
        server = TextSender(config, clock)
    return TrackerEmulator(config, server, true_pose, clock, seed)
