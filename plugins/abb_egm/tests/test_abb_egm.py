"""EGM: messages as the generated code of ``egm.proto`` writes them, and the modes of the emulated controller."""

from __future__ import annotations

import numpy as np
import pytest

from hil_abb_egm import codec, wire
from hil_abb_egm.codec import Posture, RobotState

SENSOR = bytes.fromhex(
    "0a07080710e807180312380a36"
    "09000000000000f03f090000000000000040090000000000000840"
    "090000000000001040090000000000001440090000000000001840"
)
"""EgmSensor of protobuf 7.36: header 7, 1000, CORRECTION; planned joints 1 to 6 deg."""


def test_answer_is_that_of_the_generated_code() -> None:
    joints = np.radians([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    number, posture = codec.decode_answer(SENSOR)
    assert number == 7
    assert len(codec.encode_answer(7, 1000, posture)) == len(SENSOR)
    assert posture.joints_rad == pytest.approx(joints)
    assert posture.position_m is None


def test_state_is_read_as_it_was_written() -> None:
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    pose = Posture(np.array([1.0, -2.0, 0.5]), turn, np.linspace(-1.0, 1.0, 6))
    state = codec.decode_state(codec.encode_state(RobotState(2**32 - 1, 4000, pose, pose, 1, 3, 2)))
    assert (state.number, state.tm_ms, state.motors, state.mci, state.rapid) == (2**32 - 1, 4000, 1, 3, 2)
    assert state.feedback.position_m == pytest.approx(pose.position_m)
    assert state.planned.axes == pytest.approx(turn)
    assert state.feedback.joints_rad == pytest.approx(pose.joints_rad)


def test_attitudes_are_inverted() -> None:
    draws = np.random.default_rng(5)
    for _ in range(200):
        axes = np.linalg.qr(draws.normal(size=(3, 3)))[0]
        axes *= np.linalg.det(axes)
        sent = codec.encode_answer(1, 0, Posture(np.zeros(3), axes, None))
        assert codec.decode_answer(sent)[1].axes == pytest.approx(axes, abs=1e-12)


def test_packed_doubles_are_read_too() -> None:
    packed = wire.message([(1, np.arange(6.0).tobytes())])
    assert wire.doubles(wire.fields_of(packed), 1) == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]


@pytest.mark.parametrize("data", [b"", b"\x0a", b"\x0a\xff\x01", b"\xff" * 12, b"\x0b\x00", b"\x0a\x02\x08"])
def test_damaged_message_is_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match=r".+"):
        codec.decode_state(data)
