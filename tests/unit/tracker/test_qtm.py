"""Real-time protocol of Qualisys: packets by their published layout, and our own."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.maths import quat
from hil.parts.tracker import qtm
from hil.parts.tracker.frames import BodyPose

NAMES = ["chaser", "target"]


def test_six_d_residual_component_is_read_in_metres_and_seconds() -> None:
    rotation = Rotation.from_rotvec([0.2, -0.4, 0.7])
    by_columns = rotation.as_matrix().T.reshape(9)
    bodies = struct.pack("<Ihh", 2, 0, 0)
    bodies += struct.pack("<3f9ff", 1000.0, -2000.0, 500.0, *by_columns, 0.3)
    bodies += struct.pack("<13f", *[float("nan")] * 13)  # not tracked
    other = struct.pack("<II", 12, 3) + bytes(4)
    content = struct.pack("<qII", 2_500_000, 77, 2) + other + struct.pack("<II", 8 + len(bodies), 11) + bodies
    frame = qtm.frame_of(content, NAMES, 3.0)
    assert list(frame.bodies) == ["chaser"]
    pose = frame.bodies["chaser"]
    assert pose.position == pytest.approx([1.0, -2.0, 0.5])
    assert pose.q is not None
    np.testing.assert_allclose(quat.to_matrix(pose.q).T, rotation.as_matrix(), atol=1e-6)
    assert (frame.stamp_s, pose.error_m) == pytest.approx((2.5, 3e-4))


def test_own_server_sends_what_the_client_reads_in_any_pieces() -> None:
    pose = BodyPose(np.array([1.0, -2.0, 0.5]), quat.from_rotation_vector(np.array([0.2, -0.4, 0.7])), 2e-4)
    sent = qtm.parameters(NAMES) + qtm.frame_message(7, 12.5, NAMES, {"target": pose}) + qtm.command("Ok")
    splitter = qtm.PacketSplitter()
    packets = [packet for n in range(0, len(sent), 11) for packet in splitter.feed(sent[n : n + 11])]
    assert [kind for kind, _ in packets] == [qtm.XML, qtm.DATA, qtm.COMMAND]
    assert qtm.names_of(packets[0][1]) == NAMES
    frame = qtm.frame_of(packets[1][1], NAMES, 1.0)
    assert list(frame.bodies) == ["target"]
    assert frame.bodies["target"].position == pytest.approx(pose.position, abs=1e-6)
    assert frame.bodies["target"].q == pytest.approx(pose.q, abs=1e-6)


def test_sizes_and_declarations_of_a_hostile_server_are_refused() -> None:
    with pytest.raises(OSError, match="packet of 4 bytes"):
        list(qtm.PacketSplitter().feed(qtm.HEAD.pack(4, 1)))
    with pytest.raises(ValueError, match="declarations"):
        qtm.names_of(b'<!DOCTYPE x [<!ENTITY a "b">]><x>&a;</x>')
    with pytest.raises(ValueError, match="component of 0 bytes"):
        qtm.frame_of(struct.pack("<qII", 0, 1, 1) + struct.pack("<II", 0, 3), NAMES, 0.0)
