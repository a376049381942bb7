"""PTP between two network namespaces: two ptp4l of linuxptp, the offset in the preflight, a run refused beyond a limit.

``pytest -m slow tests/behaviour/test_ptp_namespaces.py`` as root, with Debian's linuxptp. The clocks are not corrected.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.config.load import load_rig, load_scenario
from hil.drivers.ptp import PtpStatus, read_status
from hil.errors import DeviceError
from hil.parts.wires.devices import check_clock, ptp_check

CONFIGURATION = """[global]
free_running 1
logAnnounceInterval -2
logSyncInterval -3
logMinDelayReqInterval -3
time_stamping software
uds_address {path}
"""
WAIT_S = 60.0

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.geteuid() != 0 or not shutil.which("ptp4l"), reason="needs root and linuxptp"),
]


def ip(*words: str) -> None:
    subprocess.run(["ip", *words], check=True, timeout=10)


@pytest.fixture
def sockets(tmp_path: Path) -> Iterator[tuple[str, str]]:
    """Give the management sockets of a master and of a clock that follows it, each in its own namespace."""
    spaces, names = (f"hil-m{os.getpid()}", f"hil-f{os.getpid()}"), (f"hm{os.getpid()}", f"hf{os.getpid()}")
    daemons: list[subprocess.Popen[bytes]] = []
    try:
        for space in spaces:
            ip("netns", "add", space)
        ip("link", "add", names[0], "type", "veth", "peer", "name", names[1])
        for number, (space, name) in enumerate(zip(spaces, names, strict=True), 1):
            ip("link", "set", name, "netns", space)
            ip("-n", space, "addr", "add", f"10.251.7.{number}/24", "dev", name)
            ip("-n", space, "link", "set", name, "up")
        for space, name, role in zip(spaces, names, (("--priority1", "10"), ("-s",)), strict=True):
            file = tmp_path / f"{name}.cfg"
            file.write_text(CONFIGURATION.format(path=tmp_path / name))
            command = ["ip", "netns", "exec", space, "ptp4l", "-f", str(file), "-i", name, *role]
            daemons.append(subprocess.Popen(command))
        yield str(tmp_path / names[0]), str(tmp_path / names[1])
    finally:
        for daemon in daemons:
            daemon.kill()
            daemon.wait()
        for space in spaces:
            subprocess.run(["ip", "netns", "del", space], check=False, timeout=10)


def synchronised(path: str) -> PtpStatus:
    """Return the status of a clock once it has measured its offset from a master."""
    end_s = time.monotonic() + WAIT_S
    while True:
        try:
            status = read_status(path)
            if status.grandmaster and status.path_delay_s > 0.0 and status.offset_s != 0.0:
                return status
        except DeviceError:
            pass
        assert time.monotonic() < end_s
        time.sleep(0.2)


def test_offset_is_measured_and_a_run_is_refused_beyond_the_limit(sockets: tuple[str, str], tmp_path: Path) -> None:
    status = synchronised(sockets[1])
    assert abs(status.offset_s) < 5e-3  # one clock: what is measured is the load of the computer
    assert read_status(sockets[0]).state == "master"

    def settings(limit_us: float) -> tuple[str, ...]:
        return f'rig.clock.ptp_socket="{sockets[1]}"', f"rig.clock.ptp_max_offset_us={limit_us}"

    fine = load_rig("emulated", settings(1e5))
    assert check_clock(load_scenario("scheme-1"), fine) == []
    assert ptp_check(fine.value.clock).passed is True
    strict = [word for setting in settings(1e-9) for word in ("--set", setting)]
    refused = subprocess.run(
        [sys.executable, "-m", "hil", "run", "scheme-1", "--rig", "emulated", "--duration", "1", *strict],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert refused.returncode == 2
    assert "rig.clock.ptp_max_offset_us" in refused.stderr
    assert "allowed 1e-09 us" in refused.stderr
