"""Bench and GNC in two processes while a stranger sends 1e5 odd datagrams to each: the loop is as late as without."""

from __future__ import annotations

import json
import random
import re
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from hil.recording.read import load
from tests.support.run_settings import NEAR, UNHURRIED, typed

pytestmark = [pytest.mark.wires, pytest.mark.slow, pytest.mark.timeout(300)]

DATAGRAMS = 100_000
DURATION_S = 50.0
QUIET_S = 10.0


def odd(dice: random.Random) -> bytes:
    """Return a datagram that resembles the link's, or does not."""
    body = bytearray(dice.randbytes(dice.choice((0, 8, 31, 32, 48, 200, 1472))))
    if dice.random() < 0.7:
        body[:4] = b"FRMN"
        if len(body) > 9:
            body[8], body[9] = dice.choice((1, 2, 2, 2, 9)), dice.randrange(8)
    return bytes(body)


class Stranger:
    """Sends the datagrams, in bursts of 50, at an even rate if this computer keeps it."""

    def __init__(self, to: tuple[str, int]) -> None:
        self._to = to
        self._thread = threading.Thread(target=self._send, daemon=True)
        self.sent = 0

    def start(self) -> None:
        self._thread.start()

    def _send(self) -> None:
        dice = random.Random(1)
        bursts = [[odd(dice) for _ in range(50)] for _ in range(200)]
        begun_s, spent_s = time.monotonic(), DURATION_S - 2.0 * QUIET_S - 8.0
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as own:
            while self.sent < DATAGRAMS:
                for datagram in bursts[self.sent // 50 % len(bursts)]:
                    own.sendto(datagram, self._to)
                self.sent += 50
                time.sleep(max(0.0, begun_s + spent_s * self.sent / DATAGRAMS - time.monotonic()))


def test_odd_datagrams_make_the_loop_no_later(tmp_path: Path) -> None:
    hil, out = [sys.executable, "-m", "hil"], tmp_path / "dss.json"
    settings = typed(*NEAR, *UNHURRIED, "rig.gnc_link.timeout_cycles=50")
    command = [*hil, "dss", "scheme-1", "--rig", "emulated", "--listen", "127.0.0.1:0", "--wait", "120", *settings]
    command += ["--duration", str(DURATION_S), "--record", str(tmp_path), "--json", str(out)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as dss:
        assert dss.stderr is not None
        gnc = None
        try:
            port = 0
            while gnc is None:
                line = dss.stderr.readline()
                assert line, "the bench ended"
                if found := re.search(r"127\.0\.0\.1:(\d+)", line):
                    port = int(found[1])
                    command = [*hil, "gnc", "scheme-1", "--dss", f"127.0.0.1:{port}", "--wait", "120"]
                    gnc = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            drain = threading.Thread(target=dss.stderr.read, daemon=True)
            drain.start()
            end_s = time.monotonic() + 120.0
            while not (files := list(tmp_path.glob("*.mcap"))) or files[0].stat().st_size < 100_000:
                assert time.monotonic() < end_s, "the run did not begin"
                assert dss.poll() is None
                time.sleep(0.1)
            time.sleep(QUIET_S)
            stranger = Stranger(("127.0.0.1", port))
            stranger.start()
            dss.wait(120.0)
        finally:
            for each in (dss, gnc):
                if each is not None:
                    each.kill()
                    each.wait()
    summary = json.loads(out.read_text())
    assert stranger.sent >= DATAGRAMS
    assert (summary["stop"], summary["alarms"]) == ("completed", [])
    (file,) = tmp_path.glob("*.mcap")
    cycles = load(file).cycles
    late_us, t_s = 1e6 * cycles["lateness_s"], cycles["t_s"]
    parts = {
        "without": (t_s > 1.0) & (t_s < QUIET_S),
        "with": (t_s > QUIET_S + 8.0) & (t_s < DURATION_S - QUIET_S - 4.0),
    }
    shown = {name: np.percentile(late_us[which], (50, 99, 100)).round().tolist() for name, which in parts.items()}
    link = summary["gnc_link"]
    print(f"lateness p50 p99 max, us: {shown}; {stranger.sent} datagrams; {link}")  # noqa: T201
    assert (link["lost"], link["coasted_cycles"]) == (0, 0)
    assert link["answers"] >= summary["timing"]["cycles"] - 1  # the first cycle has none
    assert shown["with"][1] < 2000.0
