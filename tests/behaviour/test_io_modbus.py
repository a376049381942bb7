"""The coupler's driver against its emulator when the wire or the coupler fails, and against bytes that mean nothing."""

from __future__ import annotations

import asyncio
import random
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from itertools import pairwise
from types import SimpleNamespace

import pytest
from pymodbus.exceptions import ConnectionException
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ModbusPDU

from hil.config.tables.io import Io
from hil.core.clock import WallClock
from hil.core.messages import IoInputs, IoOutputs
from hil.drivers.io.codec import Function, LineMap
from hil.drivers.io.coupler import Coupler
from hil.drivers.io.driver import ModbusIo
from hil.errors import DeviceError, DriveFault, LinkLost, LinkTimeout, ProtocolError
from hil.parts.emulation.digital_io import IDENTITY, IoEmulator

pytestmark = pytest.mark.wires

TIMEOUT_S = 0.4


def config(**changes: object) -> Io:
    return Io.model_validate({"driver": "modbus", "timeout_s": TIMEOUT_S, "pump_timeout_s": 0.5} | changes)


@dataclass
class Desk:
    """An emulator in a thread, and a driver that is open and keeps the chain closed."""

    clock: WallClock
    emulator: IoEmulator
    io: ModbusIo
    chain: list[tuple[bool, float]] = field(default_factory=list)

    def run_until_something_is_wrong(self, longest_s: float) -> tuple[str, float]:
        """Pulse and read as the loop does; return what came first and after how long, s; "" for nothing."""
        start_s = self.clock.now_s()
        while (now_s := self.clock.now_s()) - start_s < longest_s:
            self.io.pulse(now_s)
            try:
                inputs = self.io.read(now_s)
            except DeviceError as error:
                return f"{type(error).__name__}: {error}", now_s - start_s
            if not inputs.estop_closed or not inputs.chain_closed:
                return f"inputs: {inputs[1:]}", now_s - start_s
            time.sleep(0.01)
        return "", longest_s


@contextmanager
def _desk() -> Iterator[Desk]:
    clock, stop = WallClock(), threading.Event()
    told: list[tuple[bool, float]] = []
    emulator = IoEmulator(config(), clock, lambda chain, t_s: told.append((chain.closed, t_s)))
    port = int(emulator.start()["io"].rpartition(":")[2])
    thread = threading.Thread(target=emulator.run, args=(stop,))
    thread.start()
    io = ModbusIo(config(port=port), clock)
    try:
        io.open(clock.now_s())
        give_up_s = time.monotonic() + 10.0
        for k in range(10**6):
            io.pulse(clock.now_s())
            io.write(IoOutputs(k % 20 > 4, b"\1"), clock.now_s())
            if io.read(clock.now_s()).chain_closed:
                break
            assert time.monotonic() < give_up_s
            time.sleep(0.02)
        yield Desk(clock, emulator, io, told)
    finally:
        io.close()
        stop.set()
        thread.join(5.0)
        emulator.close()


@pytest.fixture
def desk() -> Iterator[Desk]:
    with _desk() as made:
        yield made


def test_a_clean_line_trips_nothing(desk: Desk) -> None:
    assert desk.run_until_something_is_wrong(2.0)[0] == ""


@pytest.mark.parametrize(
    ("fault", "value", "words"),
    [
        ("drop", 1.0, ("io: no answer",)),
        ("drop", 0.3, ("io: no answer", "inputs:")),
        ("delay", 1.0, ("io: no answer",)),
        ("corrupt", 1.0, ("ProtocolError: io", "LinkLost: io", "LinkTimeout: io", "inputs:")),
        ("freeze", None, ("ProtocolError: io: output charge pump reads",)),
        ("link_down", None, ("LinkTimeout: io: no answer", "inputs:")),
        ("estop", None, ("inputs: (False",)),
    ],
)
def test_every_fault_is_noticed_and_opens_the_chain(
    desk: Desk, fault: str, value: float | None, words: tuple[str, ...]
) -> None:
    desk.emulator.faults.on(fault, value=value)
    seen, _ = desk.run_until_something_is_wrong(10.0)
    assert any(word in seen for word in words), seen
    desk.io.close()  # as the runner does
    give_up_s = time.monotonic() + 10.0
    while desk.chain[-1][0]:
        assert time.monotonic() < give_up_s
        time.sleep(0.01)


def test_answers_that_come_twice_do_no_harm(desk: Desk) -> None:
    desk.emulator.faults.on("duplicate")
    assert desk.run_until_something_is_wrong(2.0)[0] == ""


def test_chain_opens_within_ten_milliseconds_of_the_button(desk: Desk) -> None:
    desk.chain.clear()
    pressed_s = desk.clock.now_s()
    desk.emulator.faults.on("estop")
    desk.run_until_something_is_wrong(5.0)
    give_up_s = time.monotonic() + 5.0
    while not (opened := [t_s for closed, t_s in desk.chain if not closed]):
        assert time.monotonic() < give_up_s
        time.sleep(0.01)
    looks = [t_s for _, t_s in desk.chain if t_s <= opened[0]]
    longest_pause_s = max([0.0, *(b - a for a, b in pairwise(looks))])
    assert opened[0] - pressed_s <= 0.010 + 2.0 * longest_pause_s  # a busy machine looks at the relay less often


def test_a_dead_coupler_is_a_lost_link(desk: Desk) -> None:
    desk.emulator._loop.call_soon_threadsafe(desk.emulator.port.disconnect)
    seen, _ = desk.run_until_something_is_wrong(10.0)
    assert seen.startswith("LinkLost: io: ")
    assert "closed the connection" in seen


def test_a_cancellation_that_is_lost_leaves_no_thread_behind(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(desk.io, "_cancel", lambda: None)
    thread = desk.io._thread
    assert thread is not None
    desk.io.close()
    desk.io.open(desk.clock.now_s())
    assert not thread.is_alive()


def test_a_coupler_of_the_wrong_make_is_refused(desk: Desk) -> None:
    desk.io.close()
    wire = {"port": desk.io._config.port}
    right = dict(zip(("vendor", "product", "revision"), IDENTITY, strict=True))
    io = ModbusIo(config(identity=right, **wire), desk.clock)
    io.open(desk.clock.now_s())
    io.close()
    io = ModbusIo(config(identity=right | {"revision": "2.0"}, **wire), desk.clock)
    with pytest.raises(ProtocolError, match=r"io: wrong coupler at .*: revision '1\.0', expected '2\.0'"):
        io.open(desk.clock.now_s())


def test_a_relay_that_does_not_open_is_refused(desk: Desk) -> None:
    desk.io.close()
    desk.emulator.coupler.relay = Welded()  # type: ignore[assignment]
    with pytest.raises(DriveFault, match=r"io: the safety chain is closed 0\.5 s after enable went off"):
        desk.io.open(desk.clock.now_s())


class Welded:
    """A relay whose contacts stick."""

    closed = True

    def update(self, *_: object) -> bool:
        return True

    def torque(self, t_s: float) -> bool:
        return True


def test_missing_server_is_reported() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        port = listener.getsockname()[1]
    with pytest.raises(LinkLost, match=rf"io: no connection to 127\.0\.0\.1:{port}"):
        ModbusIo(config(port=port), WallClock()).open(0.0)


class Babbler:
    """A coupler that answers with what ``answers`` makes of the right answer."""

    def __init__(self, answers: Callable[[bytes], bytes]) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        self._answers = answers
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection:
                try:
                    while request := connection.recv(300):
                        count = int.from_bytes(request[10:12], "big")
                        body = request[8:12] if request[7] == 15 else bytes(((count + 7) // 8,)) + b"\0\0\0\0"
                        body = body if request[7] == 15 else body[: 1 + (count + 7) // 8]
                        length = (2 + len(body)).to_bytes(2, "big")
                        connection.sendall(self._answers(request[:4] + length + request[6:8] + body))
                except OSError:
                    continue

    def close(self) -> None:
        self._listener.close()


def _read_until_it_fails(io: ModbusIo, clock: WallClock) -> None:
    io.open(clock.now_s())
    while True:
        assert isinstance(io.read(clock.now_s()), IoInputs)
        time.sleep(0.001)


def _fuzz(rounds: int, seed: int) -> None:
    """Feed mutated answers; the driver may report that the device failed, and nothing else."""
    rng = random.Random(seed)

    def mutated(right: bytes) -> bytes:
        if rng.random() < 0.5:
            return right
        raw = bytearray(right)
        for _ in range(rng.randrange(1, 4)):
            raw[rng.randrange(len(raw))] ^= rng.randrange(1, 256)
        raw = raw[: rng.randrange(1, len(raw) + 1)] if rng.random() < 0.2 else raw
        return bytes(raw + rng.randbytes(rng.randrange(20)) if rng.random() < 0.2 else raw)

    babbler = Babbler(mutated)
    clock = WallClock(speed=20.0)
    try:
        for _ in range(rounds):
            io = ModbusIo(config(port=babbler.port), clock)
            try:
                with pytest.raises((LinkLost, LinkTimeout, ProtocolError), match=r"^io: (?!the thread of the link)"):
                    _read_until_it_fails(io, clock)
            finally:
                io.close()
    finally:
        babbler.close()


def test_answers_that_mean_nothing_are_errors_of_the_device_and_nothing_else() -> None:
    _fuzz(25, seed=1)


@pytest.mark.slow
def test_a_million_mutated_answers_are_taken_whole_or_refused() -> None:
    """Modbus TCP has no checksum of its own (TCP has): a flipped input bit passes, a frame out of shape must not."""

    async def feed() -> tuple[int, int]:
        rng = random.Random(6)
        coupler = Coupler(config(port=1), LineMap(config()), 1e-6, WallClock())
        coupler._client = SimpleNamespace(connected=True)  # type: ignore[assignment]
        framer = FramerSocket(DecodePDU(False))
        right = bytes.fromhex("0007 0000 0004 01 02 01 03")
        raw = b""
        accepted = refused = 0

        async def read(*_: object, **__: object) -> ModbusPDU:
            try:
                _, pdu = framer.handleFrame(raw, 1, 7)
            except Exception as error:  # in the product asyncio hangs up on it
                raise ConnectionException(str(error)) from error
            if pdu is None:
                raise TimeoutError  # more would be waited for
            return pdu

        for _ in range(1_000_000):
            damaged = bytearray(right)
            for _ in range(rng.randrange(1, 4)):
                damaged[rng.randrange(len(damaged))] ^= rng.randrange(1, 256)
            raw = bytes(damaged[: rng.randrange(1, 11)] if rng.random() < 0.2 else damaged)
            try:
                found = await coupler._bits(Function.READ_INPUTS, read, range(2))
                accepted += 1
                assert set(found) == {0, 1}
                assert raw[:2] in (right[:2], b"\0\0"), raw.hex()  # pymodbus lets a transaction of 0 pass
                assert raw[2:4] + raw[6:8] == right[2:4] + right[6:8], raw.hex()
            except DeviceError:
                refused += 1
        return accepted, refused

    accepted, refused = asyncio.run(feed())
    assert accepted + refused == 1_000_000
    assert refused > 900_000


@pytest.mark.slow
def test_a_thousand_lives_of_the_driver_against_babble() -> None:
    _fuzz(1000, seed=2)
