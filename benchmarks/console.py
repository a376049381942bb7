"""Lateness of the loop with and without clients at its console, alternating within one run.

python benchmarks/console.py [--rig emulated] [--clients 3] [--browser] [--rounds 4] [--seconds 15]

A session of scheme 1 is opened by a console as ``hil console`` serves it; clients connect for one interval,
leave for the next, and so on. --browser: the clients are pages in a headless Chromium, otherwise processes that read
all messages.
The clients run at niceness 10: they share this computer with emulated wires.
Lateness is the clock just after the loop's wait minus its deadline; the table has the cycles of the run by interval.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from typing import Any

import numpy as np
import uvicorn

from hil.config.load import shipped
from hil.loop.overrun_monitor import lateness_percentiles_us
from hil.parts.console.app import make_app
from hil.parts.console.columns import INDEX
from hil.parts.console.live_view import Client
from hil.parts.console.service import ConsoleService
from hil.parts.console.session import Choice
from hil.parts.console.strangers import Access

PATIENT = (
    "rig.vmu.timeout_s=10.0",
    "rig.vmu.lost_packets_max=1e6",
    "rig.rails.timeout_s=10.0",
    "rig.rails.lost_packets_max=1e6",
    "rig.turntable.timeout_s=10.0",
    "rig.turntable.lost_packets_max=1e6",
)
"""It is the loop that is measured: emulated wires go through kernel threads that a software renderer can starve."""
_SETTLE_S = 1.0  # omitted after each change: a starting client is not a watching one
_START_WALL_S = 20.0


def read_everything(address: str) -> None:
    """Run a client that reads all messages."""
    from websockets.sync.client import connect

    with connect(f"ws://{address}/ws", max_size=None) as line:
        line.send(json.dumps({"key": f"benchmark-{time.monotonic_ns()}", "name": "benchmark"}))
        print("connected", flush=True)
        for _ in line:
            line.send('{"do": "beat"}')


def browse(address: str, pages: int) -> None:
    """Run pages in a browser, each with a separate context."""
    from playwright.sync_api import sync_playwright

    path = shutil.which("chromium") or shutil.which("google-chrome")
    with sync_playwright() as p:
        browser = p.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        for _ in range(pages):
            page = browser.new_page(viewport={"width": 1280, "height": 720})
            page.add_init_script("localStorage.setItem('hil.name', 'benchmark')")
            page.goto(f"http://{address}/")
            page.wait_for_selector("body:not(.lost)", timeout=120_000)
        print("connected", flush=True)
        sys.stdin.readline()
        browser.close()


class Console:
    """Console in this process, separate from the loop, with access to its service."""

    def __init__(self, rig: str, duration_s: float) -> None:
        choice = Choice(
            scenario="scheme-1", rig=rig, duration_s=duration_s, settings=(*PATIENT, "rig.console.on_loss=continue")
        )
        self.service = ConsoleService(choice, shipped("scenarios"), [rig], time.monotonic)
        self.service.warm_up()
        listener = socket.create_server(("127.0.0.1", 0))
        self.address = f"127.0.0.1:{listener.getsockname()[1]}"
        config = uvicorn.Config(
            make_app(self.service, Access(), None),
            log_level="warning",
            ws="websockets-sansio",
            ws_per_message_deflate=False,
        )
        self._server = uvicorn.Server(config)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._serve, args=(listener,))
        self._client = Client("benchmark" * 2, "benchmark")
        self._thread.start()

    def _serve(self, listener: socket.socket) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._server.serve(sockets=[listener]))

    def obey(self, **command: Any) -> None:
        act = {"seen_s": self.service.wall_s(), "number": self._client.requests + 1, **command}
        asked = asyncio.run_coroutine_threadsafe(self.service.execute(self._client, act), self._loop)
        answer = asked.result(30.0)
        assert answer["ok"], answer

    def order(self, word: str, until: str) -> None:
        self.obey(do="take_over", confirmed=True)
        self.obey(do="order", order=word, confirmed=True)
        self.wait_for(until)

    def wait_for(self, mode: str) -> None:
        end_s = time.monotonic() + 180.0
        while self.service.state.mode.value != mode:
            lost = self.service.state.alarms or time.monotonic() > end_s
            assert not lost, f"{mode} did not come: {list(self.service.log_lines)[-3:]}"
            self._loop.call_soon_threadsafe(self.service.refresh, self._client)  # as a page does
            time.sleep(0.05)

    def run_s(self) -> float:
        newest = self.service.view.rows.newest
        return 0.0 if newest is None else float(newest[0])

    def close(self) -> None:
        self._server.should_exit = True
        self._thread.join()


def start(command: list[str]) -> subprocess.Popen[str]:
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def turns(console: Console, clients: int, kind: str, rounds: int, seconds: float) -> list[tuple[bool, float, float]]:
    """Connect and disconnect clients; return (with clients, begin, end) of each interval, time of the run."""
    found = []
    command = [sys.executable, __file__, kind, console.address, "--clients", str(clients)]
    for _ in range(rounds):
        for watched in (False, True):
            processes = 1 if kind == "--browse" else clients
            children = [start(command) for _ in range(processes if watched else 0)]
            for child in children:
                assert child.stdout is not None
                assert child.stdout.readline() == "connected\n"
            time.sleep(_SETTLE_S)
            begin_s = console.run_s()
            time.sleep(seconds)
            found.append((watched, begin_s, console.run_s()))
            for child in children:
                child.stdin.close() if kind == "--browse" and child.stdin else child.kill()
                child.wait()
            ended = console.service.state.ended
            assert ended is None, f"the session ended: {ended}"
    return found


def table(rows: np.ndarray, found: list[tuple[bool, float, float]], clients: int) -> None:
    t_s, lateness_s = rows[:, 0], rows[:, INDEX["lateness_us"]] * 1e-6
    print(f"\n{'clients':>8} {'cycles':>8} {'p50':>8} {'p99':>8} {'p99.9':>8} {'max':>9}   us")
    for watched in (False, True):
        chosen = np.zeros(len(rows), bool)
        for was_watched, begin_s, end_s in found:
            chosen |= (was_watched == watched) & (t_s >= begin_s) & (t_s < end_s)
        p = lateness_percentiles_us(lateness_s[chosen].astype(float))
        numbers = f"{p['p50']:8.1f} {p['p99']:8.1f} {p['p999']:8.1f} {p['max']:9.1f}"
        print(f"{clients if watched else 0:>8} {chosen.sum():>8} {numbers}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rig", default="emulated")
    parser.add_argument("--clients", type=int, default=3)
    parser.add_argument("--browser", action="store_true")
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--read", help=argparse.SUPPRESS)
    parser.add_argument("--browse", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.read or options.browse:
        os.nice(10)
    if options.read:
        return read_everything(options.read)
    if options.browse:
        return browse(options.browse, options.clients)
    whole_s = options.rounds * 2 * (options.seconds + _SETTLE_S + _START_WALL_S) + 10.0
    console = Console(options.rig, whole_s)
    try:
        console.obey(do="take")
        console.obey(do="open", confirmed=True)
        console.wait_for("standby")
        console.order("arm", "armed")
        console.order("start", "running")
        kind = "--browse" if options.browser else "--read"
        found = turns(console, options.clients, kind, options.rounds, options.seconds)
        table(console.service.view.rows.all(), found, options.clients)
    finally:
        console.close()
    return None


if __name__ == "__main__":
    main()
