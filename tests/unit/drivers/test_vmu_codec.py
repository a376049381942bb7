"""The vision unit's frames: literal transcripts, and streams damaged in every way."""

from __future__ import annotations

import random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hil.core.messages import POSITION_ONLY, PoseFrame
from hil.drivers.vmu.codec import STATUS_NO_POSE, Decoded, ReportedIdentity
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.frame_codec import FrameDecoder

HIL = frame_codec()
FRAME_BYTES, HEADER = HIL.size, HIL.sync
encode, encode_status, encode_identity = HIL.encode, HIL.encode_status, HIL.encode_identity

# Put together field by field by other code than the codec, CRC by shifting bits.
TRANSCRIPT = bytes.fromhex(
    "eb 90 11 9b"
    "07 00 00 00"
    "00 17 11 00 00 00 00 00"
    "00 00 00 00 00 00 d0 3f 00 00 00 00 00 00 e0 bf 00 00 00 00 00 00 08 40"
    "00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 e0 bf 00 00 00 00 00 00 e0 3f 00 00 00 00 00 00 e0 3f"
    "00 00 80 3a 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 b9 00 00 00 00"
    "00 00 80 3a 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00"
    "00 00 80 3a 00 00 00 00 00 00 00 00 00 00 00 00"
    "00 00 80 38 00 00 00 00 00 00 00 00"
    "00 00 80 38 00 00 00 00"
    "00 00 80 38"
    "3f 1d 00"
    "00 cf"
)


def pose(counter: int = 0, t_s: float = 1.12, **changes: object) -> PoseFrame:
    covariance = np.diag([2.0**-10] * 3 + [2.0**-14] * 3)
    covariance[0, 4] = covariance[4, 0] = -(2.0**-13)
    content: dict[str, object] = {
        "t_v": np.array([0.25, -0.5, 3.0]),
        "q_vt": np.array([0.5, -0.5, 0.5, 0.5]),
        "covariance": covariance,
        "leds_left": 0x3F,
        "leds_right": 0x1D,
    }
    return PoseFrame(counter=counter, t_s=t_s, received_s=0.0, **(content | changes))  # type: ignore[arg-type]


def counters_of(frames: list[Decoded]) -> list[int]:
    return [frame.counter for frame in frames]


def test_frame_is_encoded_to_the_transcript() -> None:
    assert encode(pose(counter=7)) == TRANSCRIPT


def test_transcript_is_decoded_to_its_numbers() -> None:
    (decoded,) = FrameDecoder(HIL).feed(TRANSCRIPT, 1.25)
    assert decoded.status == 0
    frame = decoded.pose
    assert frame is not None
    assert (frame.counter, frame.t_s, frame.received_s) == (7, 1.12, 1.25)
    assert frame.t_v.tolist() == [0.25, -0.5, 3.0]
    assert frame.q_vt.tolist() == [0.5, -0.5, 0.5, 0.5]
    np.testing.assert_array_equal(frame.covariance, pose().covariance)
    assert (frame.leds_left, frame.leds_right) == (0x3F, 0x1D)


def test_every_place_of_the_covariance_survives_the_wire() -> None:
    half = np.arange(36.0).reshape(6, 6) / 64.0
    covariance = half + half.T + 4.0 * np.eye(6)
    (decoded,) = FrameDecoder(HIL).feed(encode(pose(covariance=covariance)), 0.0)
    assert decoded.pose is not None
    np.testing.assert_array_equal(decoded.pose.covariance, covariance)


def test_frame_cut_into_single_bytes_is_received_with_its_last_byte() -> None:
    decoder = FrameDecoder(HIL)
    found = [frame for i in range(FRAME_BYTES) for frame in decoder.feed(TRANSCRIPT[i : i + 1], float(i))]
    assert [frame.pose and frame.pose.received_s for frame in found] == [FRAME_BYTES - 1.0]
    assert decoder.skipped_bytes == 0


def test_frame_without_a_pose_is_distinguished_from_a_broken_one() -> None:
    decoder = FrameDecoder(HIL)
    (decoded,) = decoder.feed(encode_status(9, 2.0, STATUS_NO_POSE), 2.1)
    assert decoded == Decoded(9, 2.0, STATUS_NO_POSE, None)
    assert decoder.invalid == 0


def test_position_alone_is_distinguished_from_a_pose() -> None:
    raw = bytearray(TRANSCRIPT)
    raw[-3:] = bytes.fromhex("02 42 ef")  # status, and CRC by shifting bits
    assert encode(pose(counter=7, status=POSITION_ONLY)) == bytes(raw)
    (decoded,) = FrameDecoder(HIL).feed(bytes(raw), 1.25)
    assert decoded.pose is not None
    assert (decoded.status, decoded.pose.status) == (POSITION_ONLY, POSITION_ONLY)
    assert decoded.pose.t_v.tolist() == [0.25, -0.5, 3.0]


@pytest.mark.parametrize("cut", [1, 3, 4, 80, FRAME_BYTES - 1])
def test_truncated_frame_does_not_take_the_next_one_with_it(cut: int) -> None:
    decoder = FrameDecoder(HIL)
    assert counters_of(decoder.feed(TRANSCRIPT[:cut] + encode(pose(8)), 0.0)) == [8]
    assert decoder.skipped_bytes == cut


def test_false_header_inside_a_broken_frame_does_not_swallow_good_frames() -> None:
    broken = bytearray(TRANSCRIPT)
    broken[20:24] = broken[156:160] = HEADER
    decoder = FrameDecoder(HIL)
    assert counters_of(decoder.feed(bytes(broken) + encode(pose(8)) + encode(pose(9)), 0.0)) == [8, 9]
    assert decoder.crc_errors == 3


def test_corrupted_length_is_not_trusted() -> None:
    broken = bytearray(TRANSCRIPT)
    broken[3] = 0xFF
    decoder = FrameDecoder(HIL)
    assert counters_of(decoder.feed(bytes(broken) + encode(pose(8)), 0.0)) == [8]
    assert decoder.skipped_bytes == FRAME_BYTES


def test_sync_pattern_as_content_passes_unharmed() -> None:
    counter = int.from_bytes(HEADER, "little")
    assert counters_of(FrameDecoder(HIL).feed(encode(pose(counter)) * 2, 0.0)) == [counter] * 2


@pytest.mark.parametrize("bit", [0, 7, 100, 8 * 155])
def test_every_flipped_bit_after_the_header_is_a_crc_error(bit: int) -> None:
    broken = bytearray(TRANSCRIPT)
    broken[4 + bit // 8] ^= 1 << bit % 8
    decoder = FrameDecoder(HIL)
    assert decoder.feed(bytes(broken), 0.0) == []
    assert (decoder.crc_errors, decoder.invalid) == (1, 0)


@pytest.mark.parametrize(
    "changes",
    [
        {"t_v": np.array([0.0, np.nan, 1.0])},
        {"t_v": np.array([0.0, np.inf, 1.0])},
        {"q_vt": np.array([0.0, 0.0, 0.0, 1.00001])},
        {"q_vt": np.zeros(4)},
        {"q_vt": np.array([1e200, 1e200, 0.0, 0.0])},
        {"covariance": np.diag([1.0, 1.0, 1.0, 1.0, 1.0, -1e-9])},
        {"covariance": np.diag([1.0, 1.0, np.inf, 1.0, 1.0, 1.0])},
        {"covariance": np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0])},
        {"covariance": np.diag([101.0, 1.0, 1.0, 1.0, 1.0, 1.0])},
        {"covariance": np.eye(6) + 1.1 * (np.eye(6, k=1) + np.eye(6, k=-1))},
        {"t_v": np.array([0.0, 0.0, 1e200])},
        {"t_v": np.array([90.0, 0.0, 90.0])},
        {"t_v": np.array([0.0, 0.0, -3.0])},
    ],
)
def test_impossible_content_is_refused(changes: dict[str, object]) -> None:
    decoder = FrameDecoder(HIL)
    assert decoder.feed(encode(pose(**changes)), 0.0) == []
    assert (decoder.invalid, decoder.crc_errors, decoder.skipped_bytes) == (1, 0, 0)


@settings(max_examples=300, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=400), st.just(TRANSCRIPT), st.just(HEADER), st.just(TRANSCRIPT[:90]))))
def test_any_bytes_are_survived_and_accounted_for(chunks: list[bytes]) -> None:
    decoder, whole = FrameDecoder(HIL), FrameDecoder(HIL)
    found = [frame for chunk in chunks for frame in decoder.feed(chunk, 0.0)]
    kept = sum(map(len, chunks)) - decoder.skipped_bytes - FRAME_BYTES * (len(found) + decoder.invalid)
    assert 0 <= kept < FRAME_BYTES
    assert len(found) >= sum(chunk == TRANSCRIPT for chunk in chunks) - 1  # a last one may still be waiting
    assert len(whole.feed(b"".join(chunks), 0.0)) == len(found)
    assert (whole.crc_errors, whole.skipped_bytes) == (decoder.crc_errors, decoder.skipped_bytes)


def test_good_frame_after_garbage_is_found_by_the_second_frame_at_the_latest() -> None:
    rng = random.Random(4)
    for _ in range(200):
        garbage = rng.choice((rng.randbytes(rng.randrange(400)), HEADER * rng.randrange(90), TRANSCRIPT[::-1]))
        decoder = FrameDecoder(HIL)
        assert counters_of(decoder.feed(garbage + encode(pose(1)) + encode(pose(2)), 0.0)) == [1, 2]


IDENTITY_TRANSCRIPT = bytes.fromhex(
    "eb 90 12 22"
    "61 63 6d 65 00 00 00 00 00 00 00 00 00 00 00 00"
    "56 4d 55 2d 30 30 30 37 00 00 00 00 00 00 00 00"
    "01 04"
    "60 37"
)


def test_identity_is_encoded_to_the_transcript_and_back() -> None:
    identity = ReportedIdentity("acme", "VMU-0007", "1.4")
    assert encode_identity(identity) == IDENTITY_TRANSCRIPT
    decoder = FrameDecoder(HIL)
    assert counters_of(decoder.feed(TRANSCRIPT + IDENTITY_TRANSCRIPT + encode(pose(8)), 0.0)) == [7, 8]
    assert decoder.identity == identity
    assert (decoder.skipped_bytes, decoder.crc_errors) == (0, 0)


def test_damaged_identity_is_no_identity() -> None:
    damaged = bytearray(IDENTITY_TRANSCRIPT)
    damaged[22] ^= 1
    decoder = FrameDecoder(HIL)
    assert counters_of(decoder.feed(bytes(damaged) + encode(pose(8)), 0.0)) == [8]
    assert (decoder.identity, decoder.crc_errors) == (None, 1)


@pytest.mark.parametrize("length", [0, 34, 154, 156, 255])
def test_frame_of_a_length_that_its_type_does_not_have_is_counted_as_such(length: int) -> None:
    broken = bytearray(TRANSCRIPT)
    broken[3] = length
    decoder = FrameDecoder(HIL)
    assert counters_of(decoder.feed(bytes(broken) + encode(pose(8)), 0.0)) == [8]
    assert (decoder.wrong_length, decoder.crc_errors, decoder.skipped_bytes) == (1, 0, FRAME_BYTES)


@pytest.mark.slow
def test_a_million_mutated_frames_hide_no_good_one() -> None:
    """Every thousandth frame is good and comes out at once. Of damaged ones one in 2^16 passes the CRC: about 15."""
    rng = random.Random(22)
    decoder = FrameDecoder(HIL)
    right = (TRANSCRIPT, TRANSCRIPT, TRANSCRIPT, IDENTITY_TRANSCRIPT)
    passed = 0
    for i in range(1_000_000):
        raw = bytearray(rng.choice(right))
        for _ in range(rng.randrange(1, 20)):
            place = rng.randrange(len(raw))
            raw[place] ^= rng.randrange(1, 256)
        if bytes(raw) in right:
            continue  # repaired by chance
        if rng.random() < 0.3:
            del raw[rng.randrange(len(raw)) :]
        if rng.random() < 0.1:
            place = rng.randrange(len(raw) + 1)
            raw[place:place] = rng.randbytes(rng.randrange(40))
        good = i % 1000 == 999
        found = decoder.feed(bytes(raw) + encode(pose(i)) * good, 0.0)
        if good:
            assert found, i
            assert (found[-1].counter, found[-1].pose is not None) == (i, True)
        passed += len(found) - good
    assert passed + decoder.invalid < 60
    assert decoder.crc_errors > 500_000
    assert decoder.wrong_length > 1000
