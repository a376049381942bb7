"""NatNet: frames of all versions as published, our own, and what the example makes of them."""

from __future__ import annotations

import importlib.util
import struct
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.maths import quat
from hil.parts.tracker import natnet
from hil.parts.tracker.frames import BodyPose

FILE = Path(__file__).parents[3] / "examples/motion_capture/natnet_poses.py"
TICKS_HZ = 10_000_000
VERSIONS = [(3, 0), (3, 1), (4, 0), (4, 1), (4, 2)]


@pytest.fixture(scope="module")
def bridge() -> ModuleType:
    spec = importlib.util.spec_from_file_location("natnet_poses", FILE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def frame(bodies: list[tuple[int, list[float], list[float], int]], version: tuple[int, int]) -> bytes:
    """Return a frame of mocap data with two sets of markers, unlabelled markers, ``bodies`` and a labelled marker."""

    def section(n: int, content: bytes) -> bytes:
        return struct.pack("<i", n) + (struct.pack("<i", len(content)) if version >= (4, 1) else b"") + content

    markers = b"".join(name + b"\0" + struct.pack("<i6f", 2, *range(6)) for name in (b"chaser", b"all"))
    rows = b"".join(struct.pack("<i7ffh", n, *at, *q, 3e-4, tracked) for n, at, q, tracked in bodies)
    content = struct.pack("<i", 4711) + section(2, markers) + section(1, struct.pack("<3f", 1, 2, 3))
    content += section(len(bodies), rows) + section(0, b"")
    content += section(0, b"") if version >= (4, 1) else b""
    content += section(1, struct.pack("<i4fhf", 65537, 1, 2, 3, 0.014, 2, 1e-4)) + 2 * section(0, b"")
    content += struct.pack("<IIdQQQ", 0, 0, 12.5, 1_000_000, 1_020_000, 1_050_000)
    content += (struct.pack("<II", 7, 9) if version >= (4, 1) else b"") + struct.pack("<hi", 0, 0)
    return struct.pack("<HH", 7, len(content)) + content


@pytest.mark.parametrize("version", VERSIONS)
def test_pose_of_the_chaser_relative_to_the_target_and_its_age_are_read(
    bridge: ModuleType, version: tuple[int, int]
) -> None:
    rng = np.random.default_rng(7)
    of_target, of_chaser = Rotation.random(rng=rng), Rotation.random(rng=rng)
    r_H, at = np.array([-3.0, 0.2, -0.1]), np.array([1.0, 2.0, 0.5])
    poses = [(at, of_target), (at + of_target.apply(r_H), of_target * of_chaser)]
    rows = [(i + 1, list(where), list(turn.as_quat()), 1) for i, (where, turn) in enumerate(poses)]
    message = frame([(9, [0.0] * 3, [0.0, 0.0, 0.0, 1.0], 0), *rows], version)
    read = natnet.frame_of(message, natnet.NatNetInfo(version, TICKS_HZ, 1511, ""), 100.0)
    assert sorted(map(str, read.bodies)) == ["1", "2"]  # body 9 is not tracked
    value = bridge.pose_of(read.bodies[2], read.bodies[1])
    assert value[:3] == pytest.approx(r_H, abs=1e-6)
    q_CH = np.empty(4)
    quat.from_rotation_vector_into(np.array(value[3:]), q_CH)
    assert quat.to_matrix(q_CH) == pytest.approx(of_chaser.as_matrix().T, abs=1e-6)  # from H to c
    assert (read.stamp_s, read.age_s) == pytest.approx((0.1, 0.005))
    assert read.bodies[2].error_m == pytest.approx(3e-4)


def test_response_of_a_server_states_version_clock_and_where_frames_arrive() -> None:
    def response(is_multicast: bool) -> bytes:
        head = struct.pack("<HH256s4B4B", 1, 279, b"Motive", 3, 1, 0, 0, 4, 1, 0, 0)
        return head + struct.pack("<QH?4B", TICKS_HZ, 1511, is_multicast, 239, 255, 42, 99)

    assert natnet.server_of(response(True)) == ((4, 1), TICKS_HZ, 1511, "239.255.42.99")
    assert natnet.server_of(response(False)).group == ""
    with pytest.raises(ValueError, match=r"no response of a NatNet server"):
        natnet.server_of(struct.pack("<HH", 100, 0))


@pytest.mark.parametrize("version", VERSIONS)
def test_own_server_sends_what_the_client_reads(version: tuple[int, int]) -> None:
    server = natnet.NatNetInfo(version, float(TICKS_HZ), 1511, "239.255.42.99")
    assert natnet.server_of(natnet.server_info(server)) == server
    pose = BodyPose(np.array([1.0, -2.0, 0.5]), np.array([0.1, -0.2, 0.3, 0.9]), 2e-4)
    read = natnet.frame_of(natnet.frame_message(7, {4: pose}, server, (12.5, 12.504)), server, 1.0)
    assert read.bodies[4].position == pytest.approx(pose.position)
    assert read.bodies[4].q == pytest.approx(pose.q)
    assert (read.stamp_s, read.age_s) == pytest.approx((12.5, 0.004))


def test_cut_and_hostile_frames_are_errors_of_values() -> None:
    server = natnet.NatNetInfo((4, 1), float(TICKS_HZ), 1511, "")
    whole = frame([(1, [0.0] * 3, [0.0, 0.0, 0.0, 1.0], 1)], (4, 1))
    hostile = struct.pack("<HHi", 7, 0, 1) + struct.pack("<i", 2**31 - 1) * 4
    for message in (*(whole[:n] for n in range(8, 100, 7)), hostile):
        with pytest.raises((ValueError, struct.error)):
            natnet.frame_of(message, server, 0.0)
