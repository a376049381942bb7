"""An independent Modbus client, mbpoll (on libmodbus), reads the emulated rails of ``hil emulate``."""

from __future__ import annotations

import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

MBPOLL = shutil.which("mbpoll")
pytestmark = [
    pytest.mark.wires,
    pytest.mark.slow,
    pytest.mark.skipif(MBPOLL is None, reason="mbpoll is not installed (Debian: apt-get install mbpoll)"),
]


@contextmanager
def emulated(rig: str) -> Iterator[dict[str, str]]:
    """Run ``hil emulate``; give name -> address of its output."""
    command = [sys.executable, "-u", "-m", "hil", "emulate", "--rig", rig]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    addresses: dict[str, str] = {}
    try:
        for line in process.stdout:
            if "Ctrl-C" in line:
                break
            if found := re.match(r"(\S+) on (\S+) ", line):
                addresses[found[1]] = found[2]
        yield addresses
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(30.0)
        process.stdout.close()


def poll(*arguments: str) -> list[str]:
    """Return what mbpoll prints of the values of one poll, or its complaint."""
    assert MBPOLL is not None
    done = subprocess.run([MBPOLL, "-1", "-0", "-o", "3", *arguments], capture_output=True, text=True, timeout=60.0)
    if done.returncode:
        return [done.stderr.strip()]
    return re.findall(r"^\[\d+\]: \t(\S+)", done.stdout, re.MULTILINE)


def test_mbpoll_reads_the_drives_over_tcp() -> None:
    with emulated("emulated") as addresses:
        host, _, port = addresses["rails.x"].rpartition(":")

        def read(first: int, count: int, form: str) -> list[str]:
            return poll("-m", "tcp", "-p", port, "-a", "1", "-r", str(first), "-c", str(count), *form.split(), host)

        assert read(32, 3, "-t 4:hex") == ["0x4849", "0x4C52", "0x0100"]  # vendor and firmware 1.0
        assert read(16, 3, "-t 4:hex") == [
            "0x0048",
            "0x0007",
            "0x0000",
        ]  # homed; fault: safe torque off, the chain stays open; no exchange
        assert read(19, 2, "-t 4:int -B") == ["3000000", "0"]  # parked at 3 m, in um; at rest
        assert read(100, 1, "-t 4") == ["Read output (holding) register failed: Illegal data address"]


def test_mbpoll_reads_the_drives_over_a_serial_line() -> None:
    with emulated("emulated-rtu") as addresses:
        path = addresses["rails"]
        line = ["-m", "rtu", "-b", "230400", "-P", "none"]

        def read(device: int, first: int, count: int, form: str) -> list[str]:
            return poll(*line, "-a", str(device), "-r", str(first), "-c", str(count), "-t", form, path)

        assert read(12, 100, 2, "4:hex") == ["0x0ABC", "0x0203"]  # vendor and firmware 2.3
        assert read(11, 2000, 4, "4:hex") == [
            "0x1008",
            "0x0000",
            "0x5441",
            "0x0000",
        ]  # homed (bit 12); fault: safe torque off
        assert read(11, 2004, 1, "4:float") == ["3000"]  # parked at 3 m, in mm, low word first
        assert read(13, 2004, 1, "4:float") == ["0"]
        assert read(9, 2000, 1, "4") == ["Read output (holding) register failed: Connection timed out"]  # an unused id
