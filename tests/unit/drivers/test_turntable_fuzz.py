"""Mutated lines and frames through every decoder of the turntable.

No exception but the driver's own, nothing wrong accepted that its checksum could have refused, and back
in step after two frames at most. A million mutations each: ``pytest -m slow``.
"""

from __future__ import annotations

import math
import random
from types import SimpleNamespace

import pytest

from hil.config.load import load_protocol, load_rig
from hil.config.rig import Cia402
from hil.core.clock import WallClock
from hil.core.messages import Homing
from hil.drivers.can_port import SerialFrames, encode_serial
from hil.drivers.turntable.ascii.frames import BrokenLine
from hil.drivers.turntable.ascii.protocol import DEVICE, AsciiProtocol, CommandRefused
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.eds import SHIPPED, Eds
from hil.drivers.turntable.cia402.node import Node
from hil.drivers.turntable.cia402.sdo import PortNetwork
from hil.drivers.turntable.cia402.setup import DriveSetup
from hil.drivers.turntable.cia402.units import Units
from hil.errors import DeviceError, DriveFault
from hil.parts.emulation.cia402_drive import EmulatedCia402Drive
from hil.parts.emulation.cia402_objects import ObjectDictionary

FEW, MANY = 20_000, 1_000_000
COUNTS = [FEW, pytest.param(MANY, marks=[pytest.mark.slow, pytest.mark.timeout(3600)])]


def mutated(dice: random.Random, packet: bytes) -> bytes:
    """Return ``packet`` with one to three faults: bits flipped, bytes lost, put in, or repeated, an end cut off."""
    data = bytearray(packet)
    for _ in range(dice.randint(1, 3)):
        place = dice.randrange(len(data) or 1)
        kind = dice.randrange(6)
        if kind <= 1 and data:
            data[place] ^= 1 << dice.randrange(8)
        elif kind == 2:
            del data[place : place + dice.randint(1, 4)]
        elif kind == 3:
            data[place:place] = dice.randbytes(dice.randint(1, 4))
        elif kind == 4:
            data[place:place] = data[place : place + dice.randint(1, 8)]
        else:
            del data[place:]
    return bytes(data)


def independent_checksum(kind: str, covered: bytes) -> bytes:
    if kind == "xor8":
        total = 0
        for byte in covered:
            total ^= byte
        return b"%02X" % total
    crc = 0xFFFF
    for byte in covered:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x1021 if crc & 0x8000 else crc << 1) & 0xFFFF
    return b"%04X" % crc


def sample(dice: random.Random) -> dict:
    values = {("position", k): math.radians(dice.uniform(-60, 60)) for k in range(3)}
    values |= {("rate", k): math.radians(dice.uniform(-40, 40)) for k in range(3)}
    return values | {(name, k): dice.randrange(128) for name in ("status", "fault") for k in range(3)}


@pytest.mark.parametrize("count", COUNTS)
@pytest.mark.parametrize("direction", ["replies", "requests"])
@pytest.mark.parametrize("protocol", ["hil-ascii", "acu"])
def test_mutated_lines(protocol, direction, count):
    dialect, dice = AsciiProtocol(load_protocol(protocol).value), random.Random(7)
    line = dialect.lines["set"][0]
    axis = 1 if line.each_axis else DEVICE
    framing = getattr(dialect, direction)
    separator = dialect.protocol.checksum.separator.encode()

    def good() -> bytes:
        make = dialect.reply if direction == "replies" else dialect.request
        return make(dice.randrange(dialect.sequence_range), line, axis, sample(dice))

    def accept(text: bytes) -> None:
        """Take a line; whatever is taken must bear its own checksum."""
        try:
            if direction == "replies":
                dialect.decode_reply(framing.decode(text)[1], line, axis)
            else:
                dialect.decode_request(text)
        except (BrokenLine, CommandRefused):
            return
        covered, _, checksum = text[len(framing.start) :].rpartition(separator)
        assert checksum == independent_checksum(dialect.protocol.checksum.kind, covered)

    splitter = framing.splitter()
    first, second = good(), good()
    bodies = [packet[: -len(framing.end)] for packet in (first, second)]
    for k in range(count):
        if k % 100 == 0:
            first, second = good(), good()
            bodies = [packet[: -len(framing.end)] for packet in (first, second)]
        found = splitter.feed(mutated(dice, first) + first + second)
        assert found[-1] == bodies[1]
        for text in found:
            if text not in bodies:
                accept(text)


@pytest.mark.parametrize("count", COUNTS)
def test_mutated_frames_of_the_serial_can_wire(count):
    dice, cutter = random.Random(11), SerialFrames()
    for _ in range(count):
        frames = [(dice.randrange(0x800), dice.randbytes(dice.randrange(9))) for _ in range(3)]
        wire = [encode_serial(frame) for frame in frames]
        found = cutter.feed(mutated(dice, wire[0]) + b"".join(wire))
        if frames[-1] not in found:  # held back by what looks like the head of a frame, until more bytes come
            found += cutter.feed(bytes(20))
        assert frames[-1] in found
        assert all(identifier <= 0x7FF and len(data) <= 8 for identifier, data in found)


def raised_by(function, argument) -> DeviceError | None:
    try:
        function(argument)
    except DeviceError as error:
        return error
    return None


class Drive:
    """An SDO partner that reports no errors."""

    has_velocity = True

    def has_error(self) -> bool:
        return False

    def statusword(self) -> int:
        return 0x1237

    def fault_code(self) -> int:
        return 0


class Clock:
    speed = 1.0

    def __init__(self) -> None:
        self.t_s = 0.0

    def now_s(self) -> float:
        return self.t_s

    host_s = now_s


@pytest.mark.parametrize("count", COUNTS)
def test_mutated_pdo_emergency_and_heartbeat_frames(count):
    config, clock, dice = load_rig("emulated").value.turntable, Clock(), random.Random(13)
    node = Node("turntable.roll", 1, config, config.roll, Cia402(), clock)
    node.setup = Drive()
    node.units = Units(Cia402().counts_per_turn / math.tau, Cia402().counts_per_turn / math.tau)
    node._allowed_s = (0.4, 0.4, 0.4)
    goods = {
        node.on_feedback: codec.encode_setpoint(1000, 50),
        node.on_status: bytes.fromhex("37 12 00 00 00 00"),
        node.on_emergency: codec.encode_emergency(0, 0),
        node.on_heartbeat: b"\x05",
    }
    farthest = 1000 + node.units.counts(math.radians(node._margin_deg) + 2 * node._rate_max * 0.01 * 4)
    for k in range(count):
        handler = dice.choice(list(goods))
        if k % 4 == 0:  # a good one, so that bursts are rare
            clock.t_s += 0.01
            node.answered = False
            if error := raised_by(node.on_feedback, goods[node.on_feedback]):  # the last of a burst of departures
                assert "implausible frames in a row" in str(error)
                node.reset(1000)
        node.answered = False
        error = raised_by(handler, mutated(dice, goods[handler])[:8])
        if isinstance(error, DriveFault):
            assert "has restarted" in str(error)  # the only thing that the drive is not asked to confirm
        if error is not None:
            assert str(error).startswith("turntable.roll")
            node.reset(1000)
        if node._position_s is not None:
            assert abs(node.position) <= farthest
        assert node.homing is Homing.DONE


def test_error_behind_a_warning_is_no_part_of_its_burst():
    config, clock = load_rig("emulated").value.turntable, Clock()
    node = Node("turntable.roll", 1, config, config.roll, Cia402(), clock)
    node.setup = Drive()
    clock.t_s = 1.0
    for _ in range(3):
        node.on_emergency(codec.encode_emergency(0x8210, 0))
    assert node.warnings == 1
    node.setup.has_error = lambda: True
    with pytest.raises(DriveFault, match="0x2310"):
        node.on_emergency(codec.encode_emergency(0x2310, 1))


class SpoiltPort:
    """Answers SDO requests as an emulated drive does, but not always as it should."""

    def __init__(self, dice: random.Random) -> None:
        axis = SimpleNamespace(
            window=lambda: (1000, 50), set_window=lambda *_: None, homing=lambda: Homing.NEEDED, moving=lambda: False
        )
        self.drive = EmulatedCia402Drive(1, axis, ObjectDictionary(Cia402(), 1, 500))
        self.drive._refresh = lambda: None
        self.dice = dice
        self.replies: list[bytes] = []

    def send(self, *frames: tuple[int, bytes]) -> None:
        replies = [reply for frame in frames for _, reply in self.drive.on_frame(*frame, 0.0)]
        self.replies = [mutated(self.dice, reply)[:8] for reply in replies] + replies

    def receive(self, wall_s: float) -> tuple[int, bytes] | None:
        return (0x581, self.replies.pop(0)) if self.replies else None


@pytest.mark.parametrize("count", COUNTS)
def test_mutated_sdo_replies(count, monkeypatch):
    monkeypatch.setattr("hil.drivers.turntable.cia402.sdo.REPLY_WALL_S", 0.0005)
    dice = random.Random(17)
    port = SpoiltPort(dice)
    port.drive.status = lambda now_s: []
    setup = DriveSetup(port, PortNetwork(port), 1, "turntable.roll", Eds(SHIPPED), lambda *_: None, WallClock())
    for _ in range(count // 10):  # ten mutated bytes a transfer
        index = dice.choice([codec.DEVICE_TYPE, codec.MODE_DISPLAY, codec.HEARTBEAT_PRODUCER, codec.FIRMWARE])
        error = raised_by(setup.text if index == codec.FIRMWARE else lambda i: setup.get(i, 1), index)
        assert error is None or str(error).startswith("turntable.roll")


@pytest.mark.parametrize("count", COUNTS)
def test_mutated_frames_to_the_emulated_drive(count):
    dice = random.Random(19)
    drive = SpoiltPort(dice).drive
    drive.status = lambda now_s: []
    drive._enter = lambda state: None
    goods = ["40 00 10 00 00 00 00 00", "2f 60 60 00 08 00 00 00", "23 00 1a 01 20 00 64 60", "2b 17 10 00 32 00 00 00"]
    for _ in range(count):
        request = mutated(dice, bytes.fromhex(dice.choice(goods)))[:8]
        for identifier, reply in drive.on_frame(dice.choice([0x601, 0x601, 0x000, 0x201, 0x301]), request, 0.0):
            assert identifier in (0x581, 0x701)
            assert len(reply) in (1, 8)
