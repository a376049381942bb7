"""Pass poses of a motion capture on to a sensor of kind "pose": NatNet 3.0 to 4.x, as OptiTrack Motive streams it.

    python natnet_poses.py SERVER --chaser 1 --target 2 [--port 5005]

SERVER is the address of the computer with Motive, 1 and 2 the streaming IDs of two rigid bodies. The target's body
has the axes and the origin of H, the chaser's those of c; its origin is the tracked point, ``point_x_m`` and so on
of the sensor. Chaser relative to target does not depend on the axes and the origin of the capture, and a target that
moves may be moved. The sensor:

    [[sensors]]
    kind = "pose"
    name = "mocap"
    source = "udp"
    port = 5005
    stamp = "capture"

A measurement is the middle of the cameras' exposure: as long before the datagram's arrival as by the server's own
clock. The network's delay, about 0.2 ms, is not in it. A frame without either of the bodies is not passed on.
"""

from __future__ import annotations

import argparse
import json
import select
import socket
import struct
import sys
import time
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

COMMANDS, CONNECT, SERVER_INFO, FRAME, KEEP_ALIVE = 1510, 0, 1, 7, 10
ALIVE_S, SILENT_S = 1.0, 3.0


class Server(NamedTuple):
    """What a server states about its stream. group: of the multicast, "" for unicast."""

    version: tuple[int, int]
    ticks_hz: float
    port: int
    group: str


class Body(NamedTuple):
    """Pose of a rigid body in the capture: its origin, m, and the rotation from its axes to those of the capture."""

    origin: np.ndarray
    rotation: Rotation


def server_of(message: bytes) -> Server:
    """Return what is stated in the answer to a request to connect."""
    number, _ = struct.unpack_from("<HH", message)
    if number != SERVER_INFO or len(message) < 283:
        raise ValueError("no answer of a NatNet server of version 3.0 or later")
    major, minor = message[264], message[265]
    ticks_hz, port, is_multicast = struct.unpack_from("<QH?", message, 268)
    return Server((major, minor), float(ticks_hz), port, socket.inet_ntoa(message[279:283]) if is_multicast else "")


def bodies_of(message: bytes, version: tuple[int, int]) -> dict[int, Body]:
    """Return the rigid bodies of a frame that are tracked, by their streaming IDs."""
    at, head = 8, 8 if version >= (4, 1) else 4  # from 4.1 on the section's size follows its count

    def count() -> int:
        nonlocal at
        n = int(struct.unpack_from("<i", message, at)[0])
        at += head
        return n

    for _ in range(count()):  # sets of markers: a name and positions
        at = message.index(b"\0", at) + 1
        at += 4 + 12 * struct.unpack_from("<i", message, at)[0]
    unlabelled = count()
    at += 12 * unlabelled
    found = {}
    for _ in range(count()):
        number, *pose, _, state = struct.unpack_from("<i3f4ffh", message, at)
        at += 38
        if state & 1:
            found[number] = Body(np.array(pose[:3]), Rotation.from_quat(pose[3:]))
    return found


def age_of(message: bytes, server: Server) -> float:
    """Return the age of a frame when it was sent, s: from the middle of the exposure, by the server's clock."""
    precise = 8 if server.version >= (4, 1) else 0  # seconds and their fraction, by another clock
    exposed, _, sent = struct.unpack_from("<QQQ", message, len(message) - 30 - precise)
    return (sent - exposed) / server.ticks_hz


def pose_of(chaser: Body, target: Body) -> list[float]:
    """Return the value of the sensor: the chaser's origin in H, m, and the rotation vector from H to c, rad."""
    to_h = target.rotation.inv()
    return [*to_h.apply(chaser.origin - target.origin), *(to_h * chaser.rotation).as_rotvec()]


def connect(commands: socket.socket, address: str) -> Server:
    """Ask the server at ``address`` for its stream."""
    request = struct.pack("<HH256s4B4B", CONNECT, 264, b"Ping", 4, 1, 0, 0, 4, 1, 0, 0)
    commands.sendto(request, (address, COMMANDS))
    commands.settimeout(SILENT_S)
    while True:
        message = commands.recv(65536)
        if message[:2] == struct.pack("<H", SERVER_INFO):
            return server_of(message)


def stream_of(server: Server, local: str) -> socket.socket:
    """Return the socket on which frames arrive. local: address of this computer in the network of the cameras."""
    stream = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    stream.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    stream.bind(("", server.port))
    if server.group:
        joined = socket.inet_aton(server.group) + socket.inet_aton(local)
        stream.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, joined)
    return stream


def main() -> None:
    """Pass poses on until interrupted."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("server", help="address of the computer with Motive")
    parser.add_argument("--chaser", type=int, required=True, help="streaming ID of the chaser's rigid body")
    parser.add_argument("--target", type=int, required=True, help="streaming ID of the target's")
    parser.add_argument("--port", type=int, default=5005, help="of the sensor")
    parser.add_argument("--local", default="0.0.0.0", help="address of this computer in the network of the cameras")
    parser.add_argument("--sigma-m", type=float, default=0.0005, help="standard deviation of a position per axis")
    parser.add_argument("--sigma-rad", type=float, default=0.002, help="of a rotation")
    given = parser.parse_args()
    covariance = np.diag([given.sigma_m**2] * 3 + [given.sigma_rad**2] * 3).tolist()
    commands = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    try:
        server = connect(commands, given.server)
    except (OSError, ValueError) as error:
        sys.exit(f"{given.server}: {error or 'no answer'}: is streaming switched on in Motive?")
    print(f"{given.server}: NatNet {server.version[0]}.{server.version[1]}, {server.group or 'unicast'}:{server.port}")
    sockets, alive_s = [commands, stream_of(server, given.local)], time.monotonic()
    while True:
        for each in select.select(sockets, [], [], ALIVE_S)[0]:
            message, received_s = each.recv(65536), time.monotonic()
            if message[:2] != struct.pack("<H", FRAME):
                continue
            found = bodies_of(message, server.version)
            if given.chaser in found and given.target in found:
                value = pose_of(found[given.chaser], found[given.target])
                measured_s = received_s - age_of(message, server)
                pose = {"t_s": measured_s, "value": value, "covariance": covariance}
                commands.sendto(json.dumps(pose).encode(), ("127.0.0.1", given.port))
        if not server.group and time.monotonic() - alive_s > ALIVE_S:
            commands.sendto(struct.pack("<HH", KEEP_ALIVE, 0), (given.server, COMMANDS))
            alive_s = time.monotonic()


if __name__ == "__main__":
    main()
