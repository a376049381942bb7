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
import socket
import struct
import sys
import time

import numpy as np

from hil.maths import quat
from hil.parts.tracker.frames import BodyPose
from hil.parts.tracker.link import NatNetClient

COMMANDS = 1510


def pose_of(chaser: BodyPose, target: BodyPose) -> list[float]:
    """Return the value of the sensor: the chaser's origin in H, m, and the rotation vector from H to c, rad."""
    assert chaser.q is not None
    assert target.q is not None
    rotation = np.empty(3)
    quat.rotation_between(chaser.q, target.q, rotation)
    return [*quat.transform(target.q, chaser.position - target.position), *rotation]


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
    try:
        client = NatNetClient((given.server, COMMANDS), given.local, time.monotonic)
    except (OSError, ValueError, struct.error) as error:
        sys.exit(f"{given.server}: {error or 'no response'}: is streaming switched on in Motive?")
    server, out = client.server, socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    print(f"{given.server}: NatNet {server.version[0]}.{server.version[1]}, {server.group or 'unicast'}:{server.port}")
    while True:
        for frame in client.read():
            if given.chaser in frame.bodies and given.target in frame.bodies:
                value = pose_of(frame.bodies[given.chaser], frame.bodies[given.target])
                pose = {"t_s": frame.received_s - frame.age_s, "value": value, "covariance": covariance}
                out.sendto(json.dumps(pose).encode(), ("127.0.0.1", given.port))


if __name__ == "__main__":
    main()
