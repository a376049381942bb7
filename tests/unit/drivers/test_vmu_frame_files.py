"""Pose frames by a frame file, against bytes packed by hand."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_frame
from hil.core.messages import POSITION_ONLY, PoseFrame
from hil.drivers.vmu import codec
from hil.drivers.vmu.frame_codec import FrameCodec, FrameDecoder, euler_angles, rotation_of
from hil.errors import BadInput
from hil.maths import quat

# sync A5 5A, counter 07, status 01, time 000F4240 (100.0 s), position FF9C 0032 05DC (-100, 50, 1500 mm),
# euler 2328 0000 0000 (90 deg about z, then 0, 0), sigma 05 05 14 (0.5, 0.5, 2 mm), spare 00, CRC-16/Modbus 1508
TRANSCRIPT = bytes.fromhex("A55A 07 01 000F4240 FF9C003205DC 232800000000 050514 00 1508")


def euler_frame(**changes: object) -> PoseFrame:
    """Return the pose of TRANSCRIPT: turned by +90 deg about z, ``p_v = R p_t + t``."""
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    covariance = np.diag([5e-4, 5e-4, 2e-3, *[math.radians(0.1)] * 3]) ** 2
    return PoseFrame(7, 100.0, 100.1, np.array([-0.1, 0.05, 1.5]), quat.from_matrix(rotation), covariance)


def test_a_transcript_packed_by_hand_is_decoded() -> None:
    (decoded,) = FrameDecoder(FrameCodec(load_frame("euler-mm").value)).feed(b"\x00\xa5" + TRANSCRIPT, 100.1)
    expected = euler_frame()
    assert (decoded.counter, decoded.status) == (7, codec.STATUS_GOOD)
    assert decoded.t_s == pytest.approx(100.0)
    assert decoded.pose is not None
    np.testing.assert_allclose(decoded.pose.t_v, expected.t_v, atol=1e-12)
    np.testing.assert_allclose(quat.to_matrix(decoded.pose.q_vt), quat.to_matrix(expected.q_vt), atol=1e-12)
    np.testing.assert_allclose(decoded.pose.covariance, expected.covariance, rtol=1e-9)


def test_a_pose_is_encoded_as_the_transcript_packed_by_hand() -> None:
    assert FrameCodec(load_frame("euler-mm").value).encode(euler_frame()) == TRANSCRIPT


def test_file_without_a_status_for_a_position_sends_no_pose() -> None:
    frames = FrameCodec(load_frame("euler-mm").value)
    sent = frames.encode(replace(euler_frame(), status=POSITION_ONLY))
    assert sent == frames.encode_status(7, 100.0, codec.STATUS_NO_POSE)


@pytest.mark.parametrize("place", range(2, len(TRANSCRIPT)))
def test_a_damaged_byte_is_no_pose_and_the_next_frame_is_found(place: int) -> None:
    decoder = FrameDecoder(FrameCodec(load_frame("euler-mm").value))
    damaged = bytearray(TRANSCRIPT)
    damaged[place] ^= 0x10
    found = decoder.feed(bytes(damaged) + TRANSCRIPT + TRANSCRIPT, 100.1)
    assert len(found) == 2
    assert decoder.crc_errors >= 1


def test_counter_and_time_of_few_bits_are_continued_over_their_wrap() -> None:
    frames = FrameCodec(load_frame("euler-mm").value)
    decoder, times, counters = FrameDecoder(frames), [], []
    for k in range(600):
        pose = euler_frame()
        t_s = 429490.0 + 0.16 * k  # the time stamp wraps at 429496.7296 s
        data = frames.encode(PoseFrame(k, t_s, t_s, pose.t_v, pose.q_vt, pose.covariance))
        (decoded,) = decoder.feed(data, t_s + 0.05)
        times.append(decoded.t_s - t_s)
        counters.append(decoded.counter)
    assert counters == list(range(600))
    assert max(map(abs, times)) < 1e-4


@pytest.mark.parametrize("sequence", ["ZYX", "xyz", "XYZ", "ZXZ", "yxz"])
def test_euler_angles_of_every_kind_are_inverted(sequence: str) -> None:
    angles = np.array([0.3, 0.4, -0.5])
    np.testing.assert_allclose(euler_angles(rotation_of(angles, sequence), sequence), angles, atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('{ name = "counter", type = "u8" },', "", "fields: counter: missing"),
        ('name = "euler", type = "i16"', 'name = "quaternion", type = "i17"', "type"),
        ("sigma_angle_deg = 0.1", "", "sigma_angle_deg: is missing: the frame has neither sigma_angle nor covariance"),
        ('euler_sequence = "ZYX"', 'euler_sequence = "ZZX"', "euler_sequence ZZX: neighbouring axes must differ"),
        ('sync = "A5 5A"', 'sync = "A5 5"', "sync"),
    ],
)
def test_a_wrong_file_is_refused_with_the_key(tmp_path: Path, old: str, new: str, text: str) -> None:
    shipped = Path(load_frame("euler-mm").source).read_text()
    assert old in shipped
    path = tmp_path / "frame.toml"
    path.write_text(shipped.replace(old, new))
    with pytest.raises(BadInput) as refused:
        load_frame(str(path))
    assert text in str(refused.value)
    assert len(refused.value.problems) == 1
