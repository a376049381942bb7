"""Answers out of a stream of bytes: transcripts, and mutated ones by the million."""

from __future__ import annotations

import struct
from collections.abc import Iterator

import numpy as np
import pytest
from pymodbus.framer import FramerRTU

from hil.config.load import load_rig
from hil.config.tables.rail_map import RailMap
from hil.drivers.rails.codec import DriveIdentity, RegisterMap, State, Status
from hil.drivers.rails.frames import (
    READ,
    READ_WRITE,
    WRITE,
    WRITE_ONE,
    Expected,
    ModbusFrame,
    ResponseMatcher,
    measure_rtu,
    new_counters,
    split,
)

DRIVE_MAP = RegisterMap(RailMap())
FLOAT_MAP = RegisterMap(load_rig("emulated-rtu").value.rails.map)
ECHO = 0x2A
STATE = State(Status.READY | Status.ENABLED, 0, ECHO, 1.25, 0.0)
DEVICE = 11
GARBAGE = bytes.fromhex("00ff0b17000b03fa010101")  # with two beginnings of longer answers


def with_check_sum(body: bytes) -> bytes:
    return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")


def serial_answer(registers: list[int], function: int = READ_WRITE, device: int = DEVICE) -> bytes:
    body = bytes([device, function, 2 * len(registers)]) + struct.pack(f">{len(registers)}H", *registers)
    return with_check_sum(body)


def tcp_answer(registers: list[int], transaction: int, function: int = READ_WRITE, device: int = DEVICE) -> bytes:
    body = bytes([device, function, 2 * len(registers)]) + struct.pack(f">{len(registers)}H", *registers)
    return struct.pack(">HHH", transaction, 0, len(body)) + body


def state_of(map_: RegisterMap, echo: int = ECHO) -> list[int]:
    return map_.encode_state(State(STATE.status, 0, echo, STATE.position_m, 0.0))


def expected(map_: RegisterMap, transaction: int = 0, echo: int = ECHO) -> Expected:
    assert map_.echo_at is not None
    return Expected(DEVICE, READ_WRITE, map_.state.count, transaction, (map_.echo_at, echo))


def sieve(is_tcp: bool, awaited: Expected | None) -> ResponseMatcher:
    made = ResponseMatcher(is_tcp, new_counters())
    made.await_(awaited)
    return made


def test_serial_answer_of_the_modbus_manual_is_read() -> None:
    data = bytes.fromhex("11 03 06 ae41 5652 4340 49ad")  # three registers of device 0x11
    assert split(data, measure_rtu) == (11, [data], 0)
    found = sieve(False, Expected(0x11, READ, 3)).feed(data)
    assert found == (11, ModbusFrame(0x11, READ, (0xAE41, 0x5652, 0x4340)))


@pytest.mark.parametrize(
    ("function", "body", "written"),
    [
        (WRITE_ONE, "0001 0003", (1, 3)),  # examples of the MODBUS application protocol V1.1b3, sections 6.6 and 6.12
        (WRITE, "0001 0002", (1, 2)),
    ],
)
def test_answers_to_writes_of_the_modbus_specification_are_read(
    function: int, body: str, written: tuple[int, int]
) -> None:
    pdu = bytes([0x11, function]) + bytes.fromhex(body)
    serial, tcp = with_check_sum(pdu), struct.pack(">HHH", 9, 0, len(pdu)) + pdu
    for is_tcp, data in ((False, serial), (True, tcp)):
        transaction = 9 if is_tcp else 0
        wanted = Expected(0x11, function, 2, transaction, written=written)
        assert sieve(is_tcp, wanted).feed(data) == (len(data), ModbusFrame(0x11, function, written, 0, transaction))
        other = sieve(is_tcp, Expected(0x11, function, 2, transaction, written=(written[0], written[1] + 1)))
        assert other.feed(data) == (len(data), None)
        assert other.counters["late"] == 1


@pytest.mark.parametrize("cut", range(1, 11))
def test_serial_answer_that_is_not_complete_is_waited_for(cut: int) -> None:
    data = bytes.fromhex("11 03 06 ae41 5652 4340 49ad")
    awaiting = sieve(False, Expected(0x11, READ, 3))
    assert awaiting.feed(data[:cut]) == (0, None)
    assert awaiting.feed(data)[1] is not None
    assert awaiting.counters["protocol_errors"] == 0


@pytest.mark.parametrize("is_tcp", [False, True])
def test_answer_behind_garbage_is_found_at_once(is_tcp: bool) -> None:
    registers = state_of(DRIVE_MAP)
    good = tcp_answer(registers, 7) if is_tcp else serial_answer(registers)
    finder = sieve(is_tcp, expected(DRIVE_MAP, 7 if is_tcp else 0))
    used, frame = finder.feed(GARBAGE + good)
    assert used == len(GARBAGE + good)
    assert frame is not None
    assert finder.counters["protocol_errors"] == 1


@pytest.mark.parametrize("cut", range(25))
def test_answer_behind_the_echo_of_its_request_is_found(cut: int) -> None:
    body = struct.pack(">BBHHHHB6H", DEVICE, READ_WRITE, 0, DRIVE_MAP.state.count, 100, 6, 12, *range(6))
    echoed, good = with_check_sum(body), serial_answer(state_of(DRIVE_MAP))
    finder, waiting, frame = sieve(False, expected(DRIVE_MAP)), b"", None
    for part in (echoed[:cut], echoed[cut:] + good[:5], good[5:]):
        assert frame is None
        used, frame = finder.feed(waiting + part)
        waiting = (waiting + part)[used:]
    assert frame is not None
    assert frame.registers == tuple(state_of(DRIVE_MAP))


@pytest.mark.parametrize("is_tcp", [False, True])
@pytest.mark.parametrize(
    "changed",
    [{"device": 12}, {"function": READ}, {"registers": [1, 2, 3]}, {"echo": ECHO + 1}, {"transaction": 6}],
    ids=lambda changed: next(iter(changed)),
)
def test_sound_answer_to_another_request_is_not_taken(is_tcp: bool, changed: dict[str, object]) -> None:
    if "transaction" in changed and not is_tcp:
        pytest.skip("a serial line has no transactions")
    registers = changed.get("registers") or state_of(DRIVE_MAP, changed.get("echo", ECHO))  # type: ignore[arg-type]
    function, device = changed.get("function", READ_WRITE), changed.get("device", DEVICE)
    if is_tcp:
        data = tcp_answer(registers, changed.get("transaction", 7), function, device)  # type: ignore[arg-type]
    else:
        data = serial_answer(registers, function, device)  # type: ignore[arg-type]
    finder = sieve(is_tcp, expected(DRIVE_MAP, 7 if is_tcp else 0))
    assert finder.feed(data) == (len(data), None)
    assert finder.counters["late"] == 1
    assert finder.expect is not None


def test_answer_that_comes_twice_is_taken_once() -> None:
    data = serial_answer(state_of(DRIVE_MAP))
    finder = sieve(False, expected(DRIVE_MAP))
    used, frame = finder.feed(data + data)
    assert (used, frame is not None) == (2 * len(data), True)
    finder.await_(expected(DRIVE_MAP, echo=ECHO + 1))
    assert finder.feed(data) == (len(data), None)
    assert finder.counters["duplicates"] == 2


def test_refusal_of_the_request_is_its_answer() -> None:
    found = sieve(False, expected(DRIVE_MAP)).feed(with_check_sum(bytes([DEVICE, READ_WRITE | 0x80, 2])))
    assert found == (5, ModbusFrame(DEVICE, READ_WRITE | 0x80, (), 2))


def mutations(count: int, seed: int) -> Iterator[tuple[np.random.Generator, int]]:
    generator = np.random.default_rng(seed)
    for kind in generator.integers(0, 5, count):
        yield generator, int(kind)


def mutated(data: bytes, generator: np.random.Generator, kind: int) -> bytes:
    """Flip bits, cut, insert, replace a stretch, or send something else."""
    at = int(generator.integers(len(data)))
    if kind == 0:
        changed = bytearray(data)
        for place in generator.integers(0, len(data), int(generator.integers(1, 5))):
            changed[place] ^= 1 << int(generator.integers(8))
        return bytes(changed)
    noise = generator.bytes(int(generator.integers(1, 12)))
    if kind == 1:
        return data[:at]
    if kind == 2:
        return data[:at] + noise + data[at:]
    if kind == 3:
        return data[:at] + noise + data[at + len(noise) :]
    return generator.bytes(int(generator.integers(1, 40)))


def found_again(finder: ResponseMatcher, rest: bytes, sound: bytes) -> ModbusFrame:
    """Return the answer that is taken when two sound ones follow ``rest``."""
    for _ in range(2):
        used, frame = finder.feed(rest + sound)
        if frame is not None:
            return frame
        rest = (rest + sound)[used:]
    raise AssertionError(f"lost behind {rest.hex()}")


def fuzz_serial(count: int) -> int:
    """Feed mutated answers, each followed by two sound ones; return how many wrong ones were taken."""
    wrong = 0
    good = {map_: serial_answer(state_of(map_)) for map_ in (DRIVE_MAP, FLOAT_MAP)}
    for generator, kind in mutations(count, 41):
        map_ = DRIVE_MAP if kind % 2 else FLOAT_MAP
        sound, finder = good[map_], sieve(False, expected(map_))
        broken = mutated(sound, generator, kind)
        used, frame = finder.feed(broken)
        if frame is not None:
            wrong += list(frame.registers) != state_of(map_)
            continue
        taken = found_again(finder, broken[used:], sound)
        wrong += list(taken.registers) != state_of(map_)
    return wrong


def fuzz_tcp(count: int) -> None:
    """Feed mutated answers; what is taken must belong to the request, and decode or be refused."""
    registers, awaited = state_of(FLOAT_MAP), expected(FLOAT_MAP, 7)
    sound = tcp_answer(registers, 7)
    for generator, kind in mutations(count, 42):
        finder = sieve(True, awaited)
        broken = mutated(sound, generator, kind)
        used, frame = finder.feed(broken)
        assert 0 <= used <= len(broken)
        if frame is None:
            found_again(finder, broken[used:], sound)
            continue
        assert awaited.is_answered_by(frame)
        if frame.exception or frame.function & 0x80:
            continue
        assert frame.registers[FLOAT_MAP.echo_at or 0] == ECHO
        decodes(FLOAT_MAP, frame.registers)


def decodes(map_: RegisterMap, registers: tuple[int, ...]) -> None:
    try:
        state = map_.decode_state(registers)
    except ValueError:
        return
    assert np.isfinite([state.position_m, state.rate_mps]).all()


def fuzz_blocks(count: int) -> None:
    """Decode words of chance, of any number, as state and identity."""
    generator = np.random.default_rng(43)
    for _ in range(count // 100):
        words = generator.integers(0, 1 << 16, 700).tolist()
        for at in range(100):
            for map_ in (DRIVE_MAP, FLOAT_MAP):
                size = map_.state.count if at % 4 else at % 13
                decodes(map_, tuple(words[at : at + size]))
                size = map_.identity.count if at % 4 else at % 7
                try:
                    identity = map_.decode_identity(words[at : at + size])
                except ValueError:
                    continue
                problem = map_.identity_problem(identity)
                assert problem or identity.vendor == map_.config.vendor


def test_mutated_serial_answers_are_not_taken() -> None:
    assert fuzz_serial(10_000) <= 1


def test_mutated_tcp_answers_belong_to_the_request_or_are_not_taken() -> None:
    fuzz_tcp(5_000)


def test_words_of_chance_decode_or_are_refused() -> None:
    fuzz_blocks(5_000)
    assert DRIVE_MAP.identity_problem(DriveIdentity(0, (1, 0))) is not None


@pytest.mark.slow
@pytest.mark.timeout(3000)
def test_a_million_mutated_answers() -> None:
    # A mutation that is itself a frame of the right length passes the 16-bit check sum once in 65536 times;
    # it must have kept device, function, length and echo as well.
    assert fuzz_serial(1_000_000) <= 16
    fuzz_tcp(1_000_000)
    fuzz_blocks(1_000_000)


@pytest.mark.parametrize("unit", [0, 255])
def test_response_of_a_tcp_device_without_unit_ids_is_taken_and_counted(unit: int) -> None:
    matcher = ResponseMatcher(True, new_counters(), Expected(7, READ, 1, transaction=5))
    frame = bytes.fromhex("0005 0000 0005") + bytes((unit, READ, 2, 0x12, 0x34))
    _, answer = matcher.feed(frame)
    assert answer is not None
    assert (answer.device_id, answer.registers) == (7, (0x1234,))
    assert matcher.counters["other_unit"] == 1


@pytest.mark.parametrize(("tcp", "unit"), [(True, 9), (False, 0)])
def test_response_of_another_unit_is_named(tcp: bool, unit: int) -> None:
    matcher = ResponseMatcher(tcp, new_counters(), Expected(7, READ, 1, transaction=5 if tcp else 0))
    body = bytes((unit, READ, 2, 0x12, 0x34))
    frame = bytes.fromhex("0005 0000 0005") + body if tcp else with_check_sum(body)
    assert matcher.feed(frame)[1] is None
    assert matcher.stranger == unit
