"""CiA 402 on the wire: literal frames, from CiA 301 and CiA 402-2."""

from __future__ import annotations

import math

import pytest

from hil.config.rig import Cia402
from hil.core.messages import Homing
from hil.drivers.can_port import SerialFrames, encode_serial
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import DriveState
from hil.drivers.turntable.cia402.units import Units
from hil.errors import FaultKind
from hil.parts.emulation.cia402_drive import EmulatedCia402Drive
from hil.parts.emulation.cia402_objects import ObjectDictionary

COUNTS_PER_TURN = 10_000_000


def emulated_drive(node_id, axis):
    return EmulatedCia402Drive(node_id, axis, ObjectDictionary(Cia402(), node_id, 500))


class Axis:
    """An axis that only remembers its commands."""

    def __init__(self) -> None:
        self.told: list[tuple[int, int, float]] = []
        self.has_torque = False
        self.brakes = 0
        self.known = Homing.DONE
        self.switch = 0
        self.in_motion = False
        self.without_torque = False
        self.lost = False
        self.windows: list[tuple[float, int]] = []

    def feedback(self) -> tuple[int, int]:
        return 123456, -789

    def follow(self, target: int, velocity_offset: int, watchdog_s: float) -> None:
        self.told.append((target, velocity_offset, watchdog_s))

    def brake(self) -> None:
        self.brakes += 1

    def enable(self) -> None:
        self.has_torque = True

    def disable(self) -> None:
        self.brake()
        self.has_torque = False

    def home(self) -> None:
        self.known = Homing.UNDER_WAY

    def homing(self) -> Homing:
        return self.known

    def moving(self) -> bool:
        return self.in_motion

    def limit(self) -> int:
        return self.switch

    def torque_off(self) -> bool:
        return self.without_torque

    def astray(self) -> bool:
        return self.lost

    def clear_astray(self) -> None:
        self.lost = False

    def window(self) -> tuple[int, int]:
        return 1000, 50

    def set_window(self, counts: float, time_out_ms: int) -> None:
        self.windows.append((counts, time_out_ms))


def test_setpoint_is_target_and_velocity_offset_little_endian():
    assert codec.encode_setpoint(2_500_000, -10_000).hex(" ") == "a0 25 26 00 f0 d8 ff ff"


def test_feedback_is_position_and_velocity():
    assert codec.decode_feedback(bytes.fromhex("40 e2 01 00 eb fc ff ff")) == (123456, -789)


def test_feedback_of_wrong_length_is_reported():
    with pytest.raises(ValueError, match="6 bytes instead of 8: 40 e2 01 00 eb fc"):
        codec.decode_feedback(bytes.fromhex("40 e2 01 00 eb fc"))


def test_quarter_turn_is_a_quarter_of_the_counts():
    assert Units(COUNTS_PER_TURN / math.tau, None).counts(math.pi / 2) == 2_500_000


@pytest.mark.parametrize(
    ("statusword", "state"),
    [
        (0x0000, DriveState.NOT_READY),
        (0x0250, DriveState.SWITCH_ON_DISABLED),
        (0x0231, DriveState.READY),
        (0x0233, DriveState.SWITCHED_ON),
        (0x1237, DriveState.ENABLED),
        (0x0217, DriveState.QUICK_STOP_ACTIVE),
        (0x021F, DriveState.FAULT_REACTION),
        (0x0218, DriveState.FAULT),
    ],
)
def test_statusword_shows_the_state(statusword, state):
    assert codec.state_of(statusword) is state


def test_emergency_names_the_fault():
    code = codec.decode_emergency(bytes.fromhex("10 32 05 00 00 00 00 00"))
    assert codec.fault_text(code) == "fault 0x3210 (DC link over-voltage)"


def test_fault_without_a_name_keeps_its_number():
    assert codec.fault_text(0xFF17) == "fault 0xFF17 (not in the profile's table)"


@pytest.mark.parametrize(
    ("request_frame", "reply"),
    [
        ("40 00 10 00 00 00 00 00", "43 00 10 00 92 01 02 00"),  # device type: profile 402
        ("40 64 60 00 00 00 00 00", "43 64 60 00 40 e2 01 00"),  # position actual
        ("2f 60 60 00 08 00 00 00", "60 60 60 00 00 00 00 00"),  # mode 8
        ("2f 60 60 00 03 00 00 00", "80 60 60 00 30 00 09 06"),  # profile velocity: out of range
        ("40 34 12 00 00 00 00 00", "80 34 12 00 00 00 02 06"),  # no such object
        ("40 18 10 09 00 00 00 00", "80 18 10 09 11 00 09 06"),  # no such sub-index
        ("2b 41 60 00 00 00 00 00", "80 41 60 00 02 00 01 06"),  # statusword is read only
        ("2b 7a 60 00 00 00 00 00", "80 7a 60 00 10 00 07 06"),  # target has four bytes
        ("a0 00 10 00 00 00 00 00", "80 00 10 00 01 00 04 05"),  # block transfer is not served
    ],
)
def test_drive_serves_sdo_as_in_cia_301(request_frame, reply):
    drive = emulated_drive(1, Axis())
    assert drive.on_frame(0x601, bytes.fromhex(request_frame), 0.0) == [(0x581, bytes.fromhex(reply))]


def test_drive_is_enabled_step_by_step_and_only_then_follows():
    axis = Axis()
    drive = emulated_drive(1, axis)
    states = []
    drive.on_frame(0x601, bytes.fromhex("2f 60 60 00 08 00 00 00"), 0.0)  # cyclic synchronous position
    for controlword in (0x0F, 0x06, 0x0F, 0x0F, 0x02, 0x0F, 0x00):
        drive.on_frame(0x601, bytes((0x2B, 0x40, 0x60, 0, controlword, 0, 0, 0)), 0.0)
        states.append(drive.state)
    assert states == [
        DriveState.SWITCH_ON_DISABLED,
        DriveState.READY,
        DriveState.SWITCHED_ON,
        DriveState.ENABLED,
        DriveState.QUICK_STOP_ACTIVE,
        DriveState.QUICK_STOP_ACTIVE,  # only disable voltage leads out of a quick stop
        DriveState.SWITCH_ON_DISABLED,
    ]
    assert axis.told == [(0, 0, 0.5)]


def test_fault_is_reported_at_once_and_reset_on_the_rising_bit_only():
    drive = emulated_drive(2, Axis())
    assert drive.fail(0x7305) == [(0x82, bytes.fromhex("05 73 01 00 00 00 00 00"))]
    drive.on_frame(0x602, bytes.fromhex("2b 40 60 00 80 00 00 00"), 0.0)
    assert drive.state is DriveState.SWITCH_ON_DISABLED
    drive.fail(0x7305)
    drive.on_frame(0x602, bytes.fromhex("2b 40 60 00 80 00 00 00"), 0.0)
    assert drive.state is DriveState.FAULT


def test_serial_frame_is_what_python_can_writes():
    assert encode_serial((0x181, bytes(range(8)))).hex(" ") == (
        "aa 00 00 00 00 08 81 01 00 00 00 01 02 03 04 05 06 07 bb"
    )


def test_serial_frames_are_found_after_garbage_and_across_reads():
    wire = b"\xaa\x00noise" + encode_serial((0x080, b"")) + encode_serial((0x201, b"\xaa\xbb"))
    frames = SerialFrames()
    found = [frame for byte in wire for frame in frames.feed(bytes((byte,)))]
    assert found == [(0x080, b""), (0x201, b"\xaa\xbb")]


def homing_drive(known: Homing = Homing.NEEDED) -> tuple[EmulatedCia402Drive, Axis]:
    """Return an enabled drive in homing mode, and its axis."""
    axis = Axis()
    axis.known = known
    drive = emulated_drive(1, axis)
    drive.on_frame(0x601, bytes.fromhex("2f 60 60 00 06 00 00 00"), 0.0)
    for controlword in (0x06, 0x07, 0x0F):
        drive.on_frame(0x601, bytes((0x2B, 0x40, 0x60, 0, controlword, 0, 0, 0)), 0.0)
    return drive, axis


def statusword(drive: EmulatedCia402Drive) -> str:
    ((_, reply),) = drive.on_frame(0x601, bytes.fromhex("40 41 60 00 00 00 00 00"), 0.0)
    return reply.hex(" ")


def test_homing_begins_with_bit_4_and_the_statusword_reports_its_progress():
    drive, axis = homing_drive()
    assert statusword(drive) == "4b 41 60 00 37 06 00 00"  # enabled, at a stand, not homed
    drive.on_frame(0x601, bytes.fromhex("2b 40 60 00 1f 00 00 00"), 0.0)
    assert axis.known is Homing.UNDER_WAY
    assert statusword(drive) == "4b 41 60 00 37 02 00 00"
    axis.known, axis.in_motion = Homing.DONE, True
    assert statusword(drive) == "4b 41 60 00 37 12 00 00"  # homing attained, not at a stand yet
    axis.in_motion = False
    assert statusword(drive) == "4b 41 60 00 37 16 00 00"  # homing attained, target reached
    axis.known = Homing.FAILED
    assert statusword(drive) == "4b 41 60 00 37 26 00 00"  # homing error


@pytest.mark.parametrize(
    ("word", "found"),
    [(0x0237, Homing.UNDER_WAY), (0x1237, Homing.UNDER_WAY), (0x1637, Homing.DONE), (0x2237, Homing.FAILED)],
)
def test_statusword_in_homing_mode_is_read(word, found):
    assert codec.homing_of(word) is found


def test_heartbeat_comes_at_its_producer_time_and_shows_the_nmt_state():
    drive = emulated_drive(3, Axis())
    assert drive.advance(0.0) == []
    drive.on_frame(0x603, bytes.fromhex("2b 17 10 00 32 00 00 00"), 0.0)  # 50 ms
    assert drive.advance(0.0) == [(0x703, b"\x7f")]  # pre-operational
    assert drive.advance(0.04) == []
    drive.on_frame(0x000, b"\x01\x03", 0.04)
    assert drive.advance(0.05) == [(0x703, b"\x05")]  # operational
    drive.on_frame(0x000, b"\x02\x00", 0.06)
    assert drive.advance(0.11) == [(0x703, b"\x04")]  # stopped


def test_torque_that_the_safety_chain_takes_is_a_fault_by_name():
    drive, axis = homing_drive()
    axis.without_torque = True
    (frame,) = drive.advance(0.0)
    assert frame == (0x81, bytes.fromhex("41 54 01 00 00 00 00 00"))
    assert codec.fault_text(codec.decode_emergency(frame[1])) == "fault 0x5441 (safe torque off)"
    assert codec.fault_kind(codec.decode_emergency(frame[1])) is FaultKind.TORQUE_OFF
    assert codec.fault_kind(0x5442) is FaultKind.OTHER


def test_following_error_is_a_fault_by_name_and_its_reset_allows_torque_again():
    drive, axis = homing_drive()
    axis.lost = True
    (frame,) = drive.advance(0.0)
    assert codec.fault_text(codec.decode_emergency(frame[1])) == "fault 0x8611 (following error)"
    drive.on_frame(0x601, bytes.fromhex("2b 40 60 00 00 00 00 00"), 0.0)
    drive.on_frame(0x601, bytes.fromhex("2b 40 60 00 80 00 00 00"), 0.0)
    assert (axis.lost, drive.state) == (False, DriveState.SWITCH_ON_DISABLED)


def test_window_and_time_out_of_the_following_error_are_objects():
    axis = Axis()
    drive = emulated_drive(1, axis)
    window = drive.on_frame(0x601, bytes.fromhex("40 65 60 00 00 00 00 00"), 0.0)
    assert window == [(0x581, bytes.fromhex("43 65 60 00 e8 03 00 00"))]  # 1000 counts
    drive.on_frame(0x601, bytes.fromhex("23 65 60 00 10 27 00 00"), 0.0)
    drive.on_frame(0x601, bytes.fromhex("2b 66 60 00 14 00 00 00"), 0.0)
    drive.on_frame(0x601, bytes.fromhex("23 65 60 00 ff ff ff ff"), 0.0)  # switches the supervision off
    assert axis.windows == [(10_000, 50), (10_000, 20), (math.inf, 20)]


def test_string_longer_than_a_frame_comes_in_segments():
    drive = emulated_drive(1, Axis())
    requests = [
        "40 0a 10 00 00 00 00 00",
        "60 00 00 00 00 00 00 00",
        "70 00 00 00 00 00 00 00",
        "60 00 00 00 00 00 00 00",
    ]
    replies = [drive.on_frame(0x601, bytes.fromhex(request), 0.0)[0][1] for request in requests]
    assert replies[0].hex(" ") == "41 0a 10 00 12 00 00 00"  # 18 bytes
    assert [reply[0] for reply in replies[1:]] == [0x00, 0x10, 0x07]  # toggle bit; the last one holds 4 bytes
    assert b"".join(reply[1:] for reply in replies[1:]).rstrip(b"\0") == b"emulated drive 1.0"


def test_limit_switches_are_bits_of_the_digital_inputs():
    axis = Axis()
    axis.switch = -1
    drive = emulated_drive(1, axis)
    ((_, reply),) = drive.on_frame(0x601, bytes.fromhex("40 fd 60 00 00 00 00 00"), 0.0)
    assert reply.hex(" ") == "43 fd 60 00 01 00 00 00"
    assert [codec.limit_of(bits) for bits in (0, 1, 2, 4)] == [0, -1, 1, 0]


@pytest.mark.parametrize(("place", "byte"), [(0, 0xAB), (5, 9), (7, 0x09), (18, 0xBA)])
def test_serial_frame_whose_start_length_identifier_or_end_is_spoilt_is_skipped(place, byte):
    good = encode_serial((0x181, bytes(range(8))))
    spoilt = bytearray(good)
    spoilt[place] = byte
    cutter = SerialFrames()
    assert cutter.feed(bytes(spoilt) + good) == [(0x181, bytes(range(8)))]
    assert cutter.skipped_bytes == len(good)
