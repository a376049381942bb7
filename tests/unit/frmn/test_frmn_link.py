"""Two sides of a link: who is taken, what is counted, what is refused with words; clocks and sequence numbers."""

from __future__ import annotations

import itertools
import math
import socket
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from hil.core.gnc_records import GNC_INPUT_3, GNC_OUTPUT, GNC_SETUP
from hil.errors import BadInput
from hil.frmn import wire
from hil.frmn.mailboxes import MAILBOXES, Role
from hil.frmn.wire import DatagramKind
from hil.parts.links.authentication import TAG_BYTES
from hil.parts.links.link import Arrival, Link
from hil.parts.links.link_statistics import ClockOffset, DatagramStats
from hil.parts.links.udp import Address, parse_address
from tests.unit.frmn.test_frmn_wire import good_ones, nonsense

LOCAL: Address = ("127.0.0.1", 0)
THERE: Address = ("127.0.0.1", 5)
ELSEWHERE: Address = ("127.0.0.1", 6)


@pytest.fixture
def bench() -> Iterator[Link]:
    link = Link(Role.DSS, "bench", ("gnc.setup", "gnc.input"), ("gnc.output",), LOCAL)
    yield link
    link.close()


@pytest.fixture
def gnc(bench: Link) -> Iterator[Link]:
    link = Link(Role.GNC, "gnc", ("gnc.output",), ("gnc.setup", "gnc.input"), None, bench.address)
    yield link
    link.close()


def until(happens: Callable[[], object], *links: Link) -> None:
    """Let ``links`` speak until ``happens``."""
    give_up_s = time.monotonic() + 5.0
    while not happens():
        assert time.monotonic() < give_up_s
        for link in links:
            link.service()
            link.poll()
        time.sleep(0.001)


def joined(bench: Link, gnc: Link) -> None:
    until(lambda: bench.joined, bench, gnc)
    bench.send("gnc.setup", np.zeros(1, MAILBOXES["gnc.setup"].dtype))
    until(lambda: gnc.joined, gnc)


def hello(writer: int, offers: tuple[str, ...] = ("gnc.output",), role: Role = Role.GNC) -> bytes:
    return wire.pack(DatagramKind.HELLO, wire.hello_payload(role, "other", offers, ("gnc.input",)), writer, 1, 0.0)


def output(writer: int, sequence: int, cycle: int = 0) -> bytes:
    record = np.zeros(1, GNC_OUTPUT)
    record["cycle"] = cycle
    return wire.pack(DatagramKind.CELL, record.tobytes(), writer, sequence, 0.0, MAILBOXES["gnc.output"])


def test_cells_arrive_once_in_order_with_the_writers_time(bench: Link, gnc: Link) -> None:
    joined(bench, gnc)
    record = np.zeros(1, GNC_INPUT_3)
    for cycle in range(5):
        record["cycle"] = cycle
        bench.send("gnc.input", record)
    time.sleep(0.01)
    arrivals = gnc.poll()
    assert [int(arrival.record["cycle"][0]) for arrival in arrivals] == list(range(5))
    now_s = time.monotonic()
    assert all(now_s - 1.0 < arrival.time_s <= arrival.received_s <= now_s for arrival in arrivals)
    assert bench.peer is not None
    assert bench.peer.hello is not None
    assert bench.peer.hello.name == "gnc"


@pytest.mark.parametrize("wants", [("gnc.setup", "gnc.input"), ("gnc.setup", "gnc.input", "gnc.orbit")])
def test_orbit_follows_the_setup_to_a_side_that_wants_it(bench: Link, wants: tuple[str, ...]) -> None:
    setup, found = np.zeros(1, GNC_SETUP), {}
    setup["scenario"], setup["eccentricity"], setup["tumbles"] = b"mine", 0.05, 1
    gnc = Link(Role.GNC, "gnc", ("gnc.output",), wants, None, bench.address)
    try:
        until(lambda: bench.peer is not None and bench.peer.hello is not None, bench, gnc)
        bench.send_setup(setup)
        time.sleep(0.01)
        found = {arrival.name: arrival.record[0] for arrival in gnc.poll()}
    finally:
        gnc.close()
    assert set(found) == set(wants) - {"gnc.input"}
    assert found["gnc.setup"]["scenario"] == b"mine"
    if "gnc.orbit" in wants:
        assert (found["gnc.orbit"]["eccentricity"], found["gnc.orbit"]["tumbles"]) == (0.05, 1)


def test_heartbeats_measure_the_offset_of_the_clocks(bench: Link, gnc: Link) -> None:
    joined(bench, gnc)
    until(lambda: bench.clock.known and gnc.clock.known, bench, gnc)
    assert abs(bench.clock.offset_s) <= bench.clock.round_trip_s / 2.0  # one host: one clock
    assert abs(gnc.clock.offset_s) <= gnc.clock.round_trip_s / 2.0


def test_of_several_exchanges_that_with_the_least_round_trip_counts() -> None:
    clock = ClockOffset()
    assert math.isnan(clock.offset_s)
    clock.add(10.0, 110.4, 110.5, 10.6)  # 0.4 s there, 0.1 s back
    clock.add(11.0, 111.01, 111.02, 11.03)
    clock.add(12.0, 112.3, 112.3, 12.35)
    assert (clock.offset_s, clock.round_trip_s) == pytest.approx((100.0, 0.02))
    clock.add(13.0, math.nan, 1.0, 13.1)
    clock.add(13.0, 113.0, 113.5, 13.1)  # a round trip below zero is none
    assert clock.offset_s == pytest.approx(100.0)


def test_bench_without_a_peer_sends_nothing(bench: Link) -> None:
    assert not bench.send("gnc.input", np.zeros(1, GNC_INPUT_3))


def test_last_datagram_counts_although_the_port_is_closed_after_it(bench: Link, gnc: Link) -> None:
    joined(bench, gnc)
    bench.close("the run is over")
    gnc.send(
        "gnc.output", np.zeros(1, MAILBOXES["gnc.output"].dtype)
    )  # meets the closed port before the disconnect is read
    time.sleep(0.05)
    gnc.poll()
    gnc.poll()
    assert gnc.peer is not None
    assert gnc.peer.gone == "the run is over"


def test_closed_port_of_the_other_side_is_noticed_by_the_next_poll(bench: Link, gnc: Link) -> None:
    joined(bench, gnc)
    gnc._socket.close()  # as when its process is killed
    bench.send("gnc.input", np.zeros(1, GNC_INPUT_3))
    until(lambda: bench.peer is not None and bench.peer.gone, bench)
    assert bench.peer is not None
    assert bench.peer.gone == "its port is closed"
    assert not bench.alive(time.monotonic())


def test_error_of_a_closed_port_does_not_hide_datagrams_of_another_side(bench: Link, gnc: Link) -> None:
    joined(bench, gnc)
    gnc._socket.close()
    other = Link(Role.GNC, "other", ("gnc.output",), ("gnc.input",), None, bench.address)

    def speak() -> bool:
        for _ in range(5):
            bench._socket.send(b"into the void", gnc.address)
        return bench.joined == 2

    until(speak, bench, other)
    other.close()


def test_disconnect_ends_the_other_side(bench: Link, gnc: Link) -> None:
    joined(bench, gnc)
    gnc.close("enough")
    until(lambda: bench.peer is not None and bench.peer.gone, bench)
    assert bench.peer is not None
    assert bench.peer.gone == "enough"


def test_second_writer_is_refused_with_words_while_the_first_is_alive(bench: Link) -> None:
    bench.handle(hello(1), THERE, 0.0)
    assert bench.handle(output(1, 1), THERE, 0.1) is not None
    for _ in range(3):
        assert bench.handle(hello(2), ELSEWHERE, 0.2) is None
        assert bench.handle(output(2, 1), ELSEWHERE, 0.2) is None
    assert bench.handle(output(1, 2), THERE, 0.3) is not None
    assert bench.counters()["second_writer"] == 6
    assert list(bench.complaints) == [
        "127.0.0.1:6 is a second writer of the mailboxes of the gnc: 127.0.0.1:5 is alive",
        "127.0.0.1:6 is a second writer of gnc.output: 127.0.0.1:5 is alive",
    ]


def test_restarted_program_at_the_same_address_is_another_writer(bench: Link) -> None:
    bench.handle(hello(1), THERE, 0.0)
    assert bench.handle(output(2, 1), THERE, 0.5) is None
    assert bench.handle(hello(2), THERE, 1.6) is None
    assert bench.joined == 2
    assert bench.handle(output(2, 1), THERE, 1.7) is not None
    assert bench.handle(output(1, 3), THERE, 1.8) is None  # of the one before, from the depths of the network


def test_silent_writer_gives_way_to_another(bench: Link) -> None:
    bench.handle(hello(1), THERE, 0.0)
    bench.handle(hello(2), ELSEWHERE, 1.1)
    assert bench.joined == 2
    assert bench.peer is not None
    assert bench.peer.address == ELSEWHERE


def test_sender_without_a_hello_is_unknown(bench: Link) -> None:
    assert bench.handle(output(1, 1), THERE, 0.0) is None
    assert bench.counters()["unknown_sender"] == 1
    assert list(bench.complaints) == ["127.0.0.1:5 has sent no hello"]


def test_sender_from_another_address_than_the_expected_is_unknown() -> None:
    link = Link(Role.DSS, "bench", ("gnc.input",), ("gnc.output",), LOCAL, THERE)
    assert link.handle(output(1, 1), ELSEWHERE, 0.0) is None
    assert list(link.complaints) == ["127.0.0.1:6 is not 127.0.0.1:5, the expected address"]
    assert link.handle(output(1, 1), THERE, 0.0) is not None  # an expected answer counts as a hello
    link.close()


def test_cell_that_this_side_writes_is_refused_from_the_other(bench: Link) -> None:
    bench.handle(hello(1), THERE, 0.0)
    datagram = wire.pack(DatagramKind.CELL, bytes(GNC_INPUT_3.itemsize), 1, 1, 0.0, MAILBOXES["gnc.input"])
    assert bench.handle(datagram, THERE, 0.0) is None
    assert bench.counters()["second_writer"] == 1
    assert list(bench.complaints) == ["127.0.0.1:5 sends the mailbox gnc.input, but this side writes it"]


@pytest.mark.parametrize(
    ("datagram", "counter", "said"),
    [
        (b"GET / HTTP/1.1\r\n\r\n" + b" " * 32, "foreign", "sends datagrams of another protocol"),
        (output(1, 1)[:8] + b"\x09" + output(1, 1)[9:], "other_version", "uses version 9 of the protocol, here is "),
        (output(1, 1)[:-1] + b"\x01", "corrupt", "sends datagrams with a wrong checksum"),
        (hello(1, role=Role.DSS), "unknown_cell", "has role 1, expected 2"),
    ],
)
def test_unusable_datagrams_are_counted_and_reported_once(
    bench: Link, datagram: bytes, counter: str, said: str
) -> None:
    for _ in range(3):
        assert bench.handle(datagram, THERE, 0.0) is None
    assert bench.counters()[counter] == 3
    assert len(bench.complaints) == 1
    assert bench.complaints[0].startswith(f"127.0.0.1:5 {said}")


def test_side_of_another_version_receives_the_reason_for_its_refusal(bench: Link) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.settimeout(5.0)
        other.sendto(hello(1)[:8] + b"\x01" + hello(1)[9:], bench.address)
        until(lambda: bench.counters()["other_version"], bench)
        datagram = other.recv(2048)
        header = wire.unpack(datagram[:-TAG_BYTES])
        assert isinstance(header, wire.DatagramHeader)
        assert header.kind is DatagramKind.REFUSED
        assert wire.read_text(datagram[32:-TAG_BYTES]) == (1, "this side uses version 2 of the protocol")


def test_refusal_is_kept_for_later_queries(bench: Link, gnc: Link) -> None:
    joined(bench, gnc)
    second = Link(Role.GNC, "second", ("gnc.output",), ("gnc.input",), None, bench.address)
    until(lambda: second.refusal, bench, gnc, second)
    assert second.refusal is not None
    assert second.refusal[1].startswith("another gnc, 127.0.0.1:")
    second.close()


@pytest.mark.parametrize("order", list(itertools.permutations(range(4))))
def test_numbers_in_any_order_are_counted_right(order: tuple[int, ...]) -> None:
    tally = DatagramStats()
    tally.count(0)
    newest = 0
    for number in (1 + n for n in order):
        assert tally.count(number) == (number > newest)
        newest = max(newest, number)
        assert not tally.count(number)
    assert (tally.received, tally.lost, tally.duplicates) == (5, 0, 4)
    assert tally.reordered == sum(any(b > a for b in order[:i]) for i, a in enumerate(order))


def test_lost_numbers_are_counted_across_the_end_of_the_counter() -> None:
    tally = DatagramStats()
    for number in (2**32 - 2, 2**32 - 1, 1, 2):
        assert tally.count(number)
    assert (tally.received, tally.lost) == (4, 1)


def test_number_from_long_ago_is_no_news() -> None:
    tally = DatagramStats()
    tally.count(1)
    tally.count(1000)
    assert not tally.count(2)
    assert (tally.received, tally.lost, tally.duplicates) == (2, 998, 1)


@pytest.mark.parametrize("text", ["here:port", "127.0.0.1:70000", "127.0.0.1:-1", "no.such.host.invalid:1"])
def test_address_that_is_none_is_refused_in_a_line(text: str) -> None:
    with pytest.raises(BadInput, match=f"--dss: {text}: (must be HOST:PORT|unknown host)"):
        parse_address("--dss", text, 24500)


def test_address_may_omit_port_or_host() -> None:
    assert parse_address("--dss", "127.0.0.2", 24500) == ("127.0.0.2", 24500)
    assert parse_address("--listen", ":7", 24500) == ("127.0.0.1", 7)


def test_port_that_is_taken_is_refused_in_a_line(bench: Link) -> None:
    with pytest.raises(BadInput, match=r"--listen: 127\.0\.0\.1:\d+: cannot listen there: Address already in use"):
        Link(Role.DSS, "bench", (), (), bench.address)


def fuzz(link: Link, rng: np.random.Generator, many: int) -> int:
    """Give ``link`` nonsense from several senders; return how many cells came of it."""
    good, senders, cells = good_ones(), [(f"127.0.0.{n}", 9) for n in range(1, 9)], 0
    for k in range(many):
        arrival = link.handle(nonsense(rng, good), senders[rng.integers(8)], 1e-3 * k)
        if isinstance(arrival, Arrival):
            cells += 1
            assert arrival.name in link.datagram_stats
    return cells


def check_after_fuzz(link: Link) -> None:
    assert len(link.complaints) <= 64
    assert all(line.isprintable() for line in link.complaints)
    assert all(count >= 0 for count in link.counters().values())


def test_flood_of_nonsense_does_not_disturb(bench: Link, rng: np.random.Generator) -> None:
    fuzz(bench, rng, 10_000)
    check_after_fuzz(bench)


@pytest.mark.slow
def test_a_million_datagrams_of_nonsense_do_not_disturb(bench: Link, rng: np.random.Generator) -> None:
    assert fuzz(bench, rng, 1_000_000) > 0
    check_after_fuzz(bench)
