"""Frames of text by a frame file: round trip, streams, datagrams, damage, files that contradict themselves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_frame
from hil.core.messages import PoseFrame
from hil.drivers.vmu.codecs import frame_codec
from hil.errors import BadInput
from hil.maths import quat

FILE = """
name = "lab-text"
rotation = "t_to_v"
quaternion_order = "wxyz"
sigma_position_m = 0.001
sigma_angle_deg = 0.1
fields = [
  { name = "counter" }, { name = "time", scale = 1e-3 }, { name = "position", scale = 1e-3 },
  { name = "quaternion" }, { name = "ignore" }, { name = "status" },
]
checksum.kind = "xor8"
text = { start = "$POSE,", separator = "," }
"""
Written = Callable[[str], str]


@pytest.fixture
def written(tmp_path: Path) -> Written:
    """Return what writes a frame file and returns its path."""

    def write(text: str) -> str:
        (tmp_path / "frame.toml").write_text(text)
        return str(tmp_path / "frame.toml")

    return write


def pose(counter: int) -> PoseFrame:
    q = quat.from_rotation_vector(np.array([0.01, -0.02, 0.03]))
    return PoseFrame(counter, 12.375, 0.0, np.array([0.1, -0.2, 3.25]), q, np.diag([1e-6] * 3 + [3e-6] * 3))


def test_a_pose_passes_through_a_line_with_all_its_digits(written: Written) -> None:
    codec = frame_codec(written(FILE))
    line = codec.encode(pose(7))
    assert line.startswith(b"$POSE,7,12375.0,100.0,-200.0,3250.0,")
    (decoded,) = codec.decoder().feed(line, 12.5)
    assert decoded.pose is not None
    assert (decoded.counter, decoded.t_s, decoded.pose.received_s) == (7, 12.375, 12.5)
    np.testing.assert_allclose(decoded.pose.t_v, [0.1, -0.2, 3.25], rtol=1e-15)
    np.testing.assert_allclose(decoded.pose.q_vt, pose(7).q_vt, atol=1e-15)


def test_line_in_the_shipped_file_is_a_frame_of_it() -> None:
    (line,) = [each[4:] for each in Path(load_frame("text").source).read_text().splitlines() if "POSE,7" in each]
    (decoded,) = frame_codec("text").decoder().feed(line.encode() + b"\n", 12.5)
    assert decoded.pose is not None
    assert (decoded.counter, decoded.t_s, decoded.pose.t_v.tolist()) == (7, 12.36, [0.012, -0.031, 4.402])


def test_file_that_is_edited_is_read_again(written: Written) -> None:
    first = frame_codec(written(FILE)).encode(pose(7))
    assert frame_codec(written(FILE.replace("$POSE", "$VMU"))).encode(pose(7)) != first


def test_lines_are_found_in_a_stream_and_damage_is_counted(written: Written) -> None:
    codec = frame_codec(written(FILE))
    lines = [codec.encode(pose(k)) for k in range(3)]
    damaged = lines[1].replace(b"3250", b"3251")
    decoder, counters = codec.decoder(), []
    for byte in b"garbage\r\n" + lines[0] + damaged + b"$POSE,1*%02X\n" % 0 + lines[2]:
        counters += [frame.counter for frame in decoder.feed(bytes((byte,)), 13.0)]
    assert counters == [0, 2]
    assert decoder.crc_errors == 2
    assert decoder.skipped_bytes == len("garbage")


def test_a_datagram_may_have_no_end_of_line(written: Written) -> None:
    codec = frame_codec(written(FILE.replace('checksum.kind = "xor8"', 'checksum.kind = "none"')))
    data = codec.encode(pose(4)).rstrip()
    assert codec.decoder().feed(data, 13.0) == []
    assert [frame.counter for frame in codec.decoder(of_datagrams=True).feed(data, 13.0)] == [4]


def test_a_tracked_body_may_be_anywhere(written: Written) -> None:
    codec = frame_codec(written(FILE))
    behind = PoseFrame(1, 1.0, 0.0, np.array([1.0, 0.0, -0.5]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6) * 1e-6)
    assert codec.decoder().feed(codec.encode(behind), 1.0) == []
    assert len(codec.decoder(by_camera=False).feed(codec.encode(behind), 1.0)) == 1


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ('text = { start = "$POSE,", separator = "," }', "", "sync, byte_order: are missing"),
        ('name = "counter"', 'name = "counter", type = "u32"', "counter: not of frames of text"),
        ("rotation", 'sync = "A5"\nrotation', "sync: not of frames of text"),
        ("xor8", "crc32", 'checksum.kind "crc32": of frames of text allowed are none, xor8'),
    ],
)
def test_a_file_that_contradicts_itself_is_refused(written: Written, old: str, new: str, text: str) -> None:
    with pytest.raises(BadInput, match=text):
        load_frame(written(FILE.replace(old, new, 1)))


def test_a_binary_frame_must_give_its_types(tmp_path: Path, written: Written) -> None:
    binary = (Path(__file__).parents[3] / "configs/frames/euler-mm.toml").read_text()
    with pytest.raises(BadInput, match="fields: counter: type is missing"):
        load_frame(written(binary.replace(', type = "u8"', "", 1)))
