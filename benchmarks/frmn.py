"""Round trips and lateness of mailboxes between two processes at 1 kHz, compared with pyzmq and a plain UDP ping.

python benchmarks/frmn.py [--seconds 10] [--rounds 3] [--rate-hz 1000] [--namespaces] [--only LINE...]

One process sends GNC_INPUT_3 (1056 bytes with its header) at the rate and the other replies at once with GNC_OUTPUT
(272 bytes). Four rows, interleaved round by round: mailboxes over the product's link; the same bytes by two bare UDP
sockets; by pyzmq PAIR sockets over TCP (omitted if pyzmq is not installed); and ``hil dss`` with ``hil gnc``
themselves, free-running at the rate, including lateness and the GNC's computation. --namespaces: the
sides are in two network namespaces joined by a veth pair (needs root), otherwise on 127.0.0.1.
"""

from __future__ import annotations

import argparse
import importlib.util
import os
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.core.clock import WallClock
from hil.core.gnc_records import GNC_INPUT_3, GNC_OUTPUT, GNC_SETUP
from hil.core.realtime import RealTime, no_garbage_collection
from hil.frmn.mailboxes import Role
from hil.loop.rate_keeper import WallClockRate
from hil.parts.links.link import Link
from hil.parts.links.udp_gnc import gnc_link, make_udp_gnc
from hil.session import build
from hil.session.warm_up import warm_up

THERE, BACK = 32 + GNC_INPUT_3.itemsize, 32 + GNC_OUTPUT.itemsize
PORTS = {"link": 24701, "plain": 24702, "pyzmq": 24703, "loop": 24704}
SILENCE_S = 1.0


@dataclass
class Hosts:
    """Location of the two sides: addresses, and prefix of the far side's command."""

    here: str = "127.0.0.1"
    there: str = "127.0.0.1"
    before: tuple[str, ...] = ()


@dataclass
class Trips:
    """Of one row: round trips and lateness, us, missing replies."""

    trips_us: list[np.ndarray]
    late_us: list[np.ndarray]
    missing: int = 0

    def row(self, name: str) -> str:
        trips, late = np.concatenate(self.trips_us), np.concatenate(self.late_us)
        if not len(trips):
            return f"| {name} | 0 | | | | {self.missing} | | |"
        p50, p99, largest = np.percentile(trips, [50.0, 99.0, 100.0])
        late_50, late_99 = np.percentile(late, [50.0, 99.0])
        return (
            f"| {name} | {len(trips)} | {p50:.0f} | {p99:.0f} | {largest:.0f} | {self.missing} "
            f"| {late_50:.1f} | {late_99:.1f} |"
        )


def ping(rate_hz: float, count: int, send: Callable[[int], None], receive: Callable[[], int | None], to: Trips) -> None:
    """Send at the rate, receive replies until the next deadline; ``receive`` returns the number of a reply, or None."""
    sent_ns, back_ns, late = np.zeros(count, np.int64), np.zeros(count, np.int64), np.zeros(count)
    period_ns = round(1e9 / rate_hz)
    with RealTime() as real_time, no_garbage_collection(), real_time.realtime_priority():
        rate = WallClockRate(WallClock(), 1.0 / rate_hz)
        rate.restart()
        for k in range(count):
            late[k] = rate.wait().lateness_s
            sent_ns[k] = time.monotonic_ns()
            send(k)
            give_up_ns = sent_ns[k] + period_ns * 7 // 10
            while time.monotonic_ns() < give_up_ns:
                number = receive()
                if number is not None and 0 <= number < count and not back_ns[number]:
                    back_ns[number] = time.monotonic_ns()
                    if number == k:
                        break
    there = back_ns > 0
    to.trips_us.append(1e-3 * (back_ns - sent_ns)[there])
    to.late_us.append(1e6 * late)
    to.missing += int(count - there.sum())


def ping_link(hosts: Hosts, rate_hz: float, count: int, to: Trips) -> None:
    """Ping by mailboxes."""
    link = Link(Role.DSS, "ping", ("gnc.setup", "gnc.input"), ("gnc.output",), (hosts.here, PORTS["link"]))
    with far_side("link", hosts):
        while not link.joined:
            link.service()
            link.poll()
            time.sleep(0.01)
        link.send("gnc.setup", np.zeros(1, GNC_SETUP))
        record = np.zeros(1, GNC_INPUT_3)

        def send(k: int) -> None:
            record["cycle"] = k
            link.send("gnc.input", record)

        def receive() -> int | None:
            for arrival in link.poll():
                return int(arrival.record["cycle"][0])
            return None

        ping(rate_hz, count, send, receive, to)
        link.close()


def ping_plain(hosts: Hosts, rate_hz: float, count: int, to: Trips) -> None:
    """Ping by two bare sockets."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as here, far_side("plain", hosts):
        here.bind((hosts.here, 0))
        here.connect((hosts.there, PORTS["plain"]))
        here.setblocking(False)
        payload = bytearray(THERE)

        def send(k: int) -> None:
            payload[:8] = k.to_bytes(8, "little")
            with suppress(OSError):
                here.send(payload)

        def receive() -> int | None:
            try:
                return int.from_bytes(here.recv(2048)[:8], "little")
            except OSError:
                return None

        while receive() is None:  # until the other side is there
            send(count)
            time.sleep(0.01)
        ping(rate_hz, count, send, receive, to)


def ping_pyzmq(hosts: Hosts, rate_hz: float, count: int, to: Trips) -> None:
    """Ping by pyzmq PAIR sockets over TCP."""
    import zmq

    here = zmq.Context.instance().socket(zmq.PAIR)
    here.bind(f"tcp://{hosts.here}:{PORTS['pyzmq']}")
    with far_side("pyzmq", hosts):
        payload = bytearray(THERE)
        here.recv()  # the other side is there

        def send(k: int) -> None:
            payload[:8] = k.to_bytes(8, "little")
            here.send(bytes(payload))

        def receive() -> int | None:
            try:
                return int.from_bytes(here.recv(zmq.NOBLOCK)[:8], "little")
            except zmq.Again:
                return None

        ping(rate_hz, count, send, receive, to)
    here.close(linger=0)


def ping_loop(hosts: Hosts, rate_hz: float, count: int, to: Trips) -> None:
    """Run scheme 1 on the mock rig with its GNC in the other process, its cycles paced to the rate."""
    settings = ("rig.gnc_link.timeout_cycles=10000",)
    scenario = load_scenario("scheme-1")
    step_s = scenario.value.step_s
    speed = rate_hz * step_s
    count = min(count, round(scenario.value.duration_s / step_s))
    job = build.Job(scenario, load_rig("mock", settings), 0, (count - 1) * step_s, speed, paced=True)
    warm_up(job)
    link = gnc_link("bench", (hosts.here, PORTS["loop"]), None)
    gnc = make_udp_gnc(scenario.value, link, job.rig.value.gnc_link, False, 1.0 / rate_hz)
    with far_side("loop", hosts):
        gnc.connect(120.0)
        with build.runner(replace(job, make_backend=lambda _: gnc)) as runner:
            outcome = runner.run()
    if outcome.faults:
        print(f"the run of the loop ended early: {outcome.stop}")
    to.trips_us.append(1e6 * np.array([trip for trip in gnc.stats._round_trips_s if trip == trip]))
    to.late_us.append(1e6 * outcome.history["lateness_s"])
    to.missing += gnc.stats.coasted + gnc.stats.closed
    link.close()


PINGS = {"link": ping_link, "plain": ping_plain, "pyzmq": ping_pyzmq, "loop": ping_loop}
NAMES = {
    "link": "cells by hil.parts.links.link",
    "plain": "plain UDP of the same size",
    "pyzmq": "pyzmq PAIR over TCP",
    "loop": "hil dss with hil gnc, running free",
}


def answer(line: str, here: str, there: str) -> None:
    """Run the far side of ``line`` until it times out."""
    with RealTime() as real_time, real_time.realtime_priority():
        _answers(line, here, there)


def _answers(line: str, here: str, there: str) -> None:
    if line == "link":
        link = Link(Role.GNC, "pong", ("gnc.output",), ("gnc.setup", "gnc.input"), None, (there, PORTS["link"]))
        record = np.zeros(1, GNC_OUTPUT)
        heard_s = time.monotonic() + 10.0
        while time.monotonic() - heard_s < SILENCE_S:
            link.wait(0.05)
            link.service()
            for arrival in link.poll():
                heard_s = time.monotonic()
                if arrival.name == "gnc.input":
                    record["cycle"] = arrival.record["cycle"]
                    link.send("gnc.output", record)
    elif line == "plain":
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as pong:
            pong.bind((here, PORTS["plain"]))
            pong.settimeout(10.0)
            while True:
                try:
                    datagram, sender = pong.recvfrom(2048)
                except TimeoutError:
                    return
                pong.sendto(datagram[:BACK], sender)
                pong.settimeout(SILENCE_S)
    elif line == "pyzmq":
        import zmq

        pong = zmq.Context.instance().socket(zmq.PAIR)
        pong.connect(f"tcp://{there}:{PORTS['pyzmq']}")
        pong.send(b"there")
        while pong.poll(10_000):
            pong.send(pong.recv()[:BACK])
    else:
        from hil.parts.links.cli.gnc import gnc

        gnc("scheme-1", dss=f"{there}:{PORTS['loop']}")


@contextmanager
def far_side(line: str, hosts: Hosts) -> Iterator[None]:
    """Run the far side of ``line`` in a separate process."""
    command = [*hosts.before, sys.executable, __file__, "--answer", line, hosts.there, hosts.here]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as process:
        try:
            yield
        finally:
            time.sleep(0.2)
            process.kill()


@contextmanager
def namespaces() -> Iterator[Hosts]:
    """Make a network namespace for the far side, joined to this one by a veth pair."""
    name, wires = f"hil-far-{os.getpid()}", (f"hiln{os.getpid()}", f"hilf{os.getpid()}")
    here, there = "10.78.0.1", "10.78.0.2"
    subprocess.run(["ip", "netns", "add", name], check=True)
    try:
        subprocess.run(["ip", "link", "add", wires[0], "type", "veth", "peer", wires[1], "netns", name], check=True)
        subprocess.run(["ip", "addr", "add", f"{here}/24", "dev", wires[0]], check=True)
        subprocess.run(["ip", "link", "set", wires[0], "up"], check=True)
        subprocess.run(["ip", "-n", name, "addr", "add", f"{there}/24", "dev", wires[1]], check=True)
        subprocess.run(["ip", "-n", name, "link", "set", wires[1], "up"], check=True)
        yield Hosts(here, there, ("ip", "netns", "exec", name))
    finally:
        subprocess.run(["ip", "netns", "del", name], check=False)


@contextmanager
def one_host() -> Iterator[Hosts]:
    """Both sides on this host."""
    yield Hosts()


def main() -> None:
    """Run all rows in turn, round by round; print the table."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--rate-hz", type=float, default=1000.0)
    parser.add_argument("--namespaces", action="store_true")
    parser.add_argument("--only", nargs="+", choices=list(PINGS), help="rows to run")
    parser.add_argument("--answer", nargs=3, metavar=("LINE", "HERE", "THERE"), help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.answer:
        answer(*given.answer)
        return
    lines = [line for line in (given.only or PINGS) if line != "pyzmq" or importlib.util.find_spec("zmq")]
    if "pyzmq" not in lines and not given.only:
        print("pyzmq is not installed: its line is left out (pip install pyzmq)")
    tallies = {line: Trips([], []) for line in lines}
    with namespaces() if given.namespaces else one_host() as hosts:
        for _ in range(given.rounds):
            for line in lines:
                PINGS[line](hosts, given.rate_hz, round(given.seconds * given.rate_hz), tallies[line])
    where = "two network namespaces, veth" if given.namespaces else "one host, loopback"
    print(f"{THERE} bytes there, {BACK} back, at {given.rate_hz:g} Hz, {where}; times in us")
    print("| line | trips | p50 | p99 | max | missing | lateness p50 | p99 |")
    print("|---|---|---|---|---|---|---|---|")
    for line in lines:
        print(tallies[line].row(NAMES[line]))


if __name__ == "__main__":
    main()
