"""Lock-step in one process: the test's thread is the loop, other threads are participants."""

from __future__ import annotations

import asyncio
import os
import threading
import time
from collections.abc import Callable, Coroutine, Iterator
from contextlib import suppress

import pytest

from hil.core.clock import Order
from hil.errors import LinkTimeout
from hil.parts.emulation.lock_step import LockStepClock, LockStepConductor

HOUR_S = 3600.0


@pytest.fixture
def clock() -> Iterator[LockStepConductor]:
    made = LockStepConductor(grid_s=0.02, timeout_s=5.0)
    try:
        yield made
    finally:
        made.close()


def run(clock: LockStepClock, until_s: float, **threads: tuple[Order, Callable[[], object]]) -> None:
    """Start the threads by name and let bench time pass."""
    for name, (order, target) in threads.items():
        clock.start_thread(target, name, order)
    clock.sleep_until(until_s)


def test_time_jumps_to_the_next_work_and_stands_while_it_is_done(clock: LockStepConductor) -> None:
    seen: list[float] = []

    def work() -> None:
        for _ in range(3):
            clock.sleep(HOUR_S)
            before_s = clock.now_s()
            time.sleep(0.02)  # takes as long as it takes
            assert clock.now_s() == before_s
            seen.append(before_s)

    begun_s = time.monotonic()
    run(clock, 10.0 * HOUR_S, work=(Order.DRIVERS, work))
    assert seen == [HOUR_S, 2.0 * HOUR_S, 3.0 * HOUR_S]
    assert time.monotonic() - begun_s < 5.0


def test_participants_with_work_at_the_same_time_do_it_in_their_order(clock: LockStepConductor) -> None:
    seen: list[str] = []

    def each(name: str, pause_s: float) -> Callable[[], None]:
        def work() -> None:
            for k in range(1, 21):
                clock.sleep_until(0.01 * k)
                time.sleep(pause_s)
                seen.append(name)

        return work

    run(clock, 1.0, slow=(Order.AXES, each("axes", 2e-3)), fast=(Order.IO, each("io", 0.0)))
    assert seen == ["axes", "io"] * 20


def test_set_event_wakes_its_participant_at_the_same_time(clock: LockStepConductor) -> None:
    event, seen = clock.event(), list[float]()

    def wait() -> None:
        assert not event.wait(0.5)
        assert event.wait(HOUR_S)
        seen.append(clock.now_s())

    clock.start_thread(wait, "waits")
    clock.sleep_until(1.25)
    event.set()
    clock.sleep_until(2.0)
    assert seen == [1.25]


def test_bytes_are_work_at_the_time_at_which_they_were_sent_however_late_the_line_is(clock: LockStepConductor) -> None:
    inlet, outlet = os.pipe()
    device, driver = clock.wire("line", 0), clock.wire("line", 1)
    seen: list[tuple[float, bytes]] = []

    def read() -> None:
        while len(seen) < 2:
            if driver.wait(inlet, HOUR_S):
                seen.append((clock.now_s(), driver.read(inlet, 100)))

    def send() -> None:
        clock.sleep_until(1.0)
        device.sending(6)
        threading.Timer(0.05, os.write, (outlet, b"abc")).start()  # the kernel delivers in parts, later
        threading.Timer(0.10, os.write, (outlet, b"def")).start()
        clock.sleep_until(1.5)
        device.write(outlet, b"g")

    run(clock, 2.0, read=(Order.DRIVERS, read), send=(Order.AXES, send))
    assert seen == [(1.0, b"abcdef"), (1.5, b"g")]


def test_time_out_of_a_wire_is_bench_time(clock: LockStepConductor) -> None:
    inlet, _ = os.pipe()
    wire, seen = clock.wire("line", 1), list[tuple[bool, float]]()
    run(clock, HOUR_S, read=(Order.DRIVERS, lambda: seen.append((wire.wait(inlet, 60.0), clock.now_s()))))
    assert seen == [(False, 60.0)]


def test_requests_over_tcp_are_answered_in_no_time_and_connections_end_where_they_were_closed(
    clock: LockStepConductor,
) -> None:
    seen: list[tuple[float, bytes]] = []
    port: list[int] = []

    async def serve() -> None:
        async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            while data := await reader.read(100):
                await asyncio.sleep(0.25)
                writer.write(data.upper())
                if data == b"bye":
                    writer.close()
                    return

        server = await asyncio.start_server(answer, "127.0.0.1", 0)
        port.append(server.sockets[0].getsockname()[1])
        await asyncio.sleep(50.0)
        server.close()

    async def ask() -> None:
        await asyncio.sleep(1.0)
        reader, writer = await asyncio.open_connection("127.0.0.1", port[0])
        for word in (b"one", b"two", b"bye"):
            writer.write(word)
            seen.append((asyncio.get_running_loop().time(), await reader.read(100)))
        seen.append((asyncio.get_running_loop().time(), await reader.read(100)))
        writer.close()

    def in_loop(main: Callable[[], Coroutine[None, None, None]]) -> Callable[[], None]:
        def work() -> None:
            with asyncio.Runner(loop_factory=clock.new_event_loop) as runner:
                runner.run(main())

        return work

    run(clock, 100.0, serve=(Order.AXES, in_loop(serve)), ask=(Order.DRIVERS, in_loop(ask)))
    assert seen == [(1.0, b"ONE"), (1.25, b"TWO"), (1.5, b"BYE"), (1.75, b"")]


def test_participant_that_does_not_do_its_part_is_named_and_left_out() -> None:
    clock, ended = LockStepConductor(grid_s=0.02, timeout_s=0.3), threading.Event()

    def hang() -> None:
        clock.sleep_until(1.0)
        ended.wait(30.0)

    clock.start_thread(hang, "hangs")
    try:
        with pytest.raises(LinkTimeout, match=r"loop hangs: has not done its part at 1\.000000 s of bench time"):
            clock.sleep_until(2.0)
    finally:
        ended.set()
        with suppress(OSError):
            clock.close()


def test_thread_that_ends_delays_no_other(clock: LockStepConductor) -> None:
    thread = clock.start_thread(lambda: clock.sleep(1.0), "short")
    clock.join(thread, 10.0)
    assert clock.now_s() == 1.0
    clock.sleep_until(5.0)
    assert clock.now_s() == 5.0
