"""A closed terminal, a user without privileges, a clock that is set, a slow disk: the page on failing surroundings."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import select
import shutil
import subprocess
import sys
import termios
import time
from pathlib import Path

import pytest

from hil.cli.main import BAD_INPUT, FAILED, SAFE_STOPPED
from hil.core.realtime import FIFO, MEMORY
from hil.recording.read import load
from tests.support.run_settings import NEAR, UNHURRIED, typed

pytestmark = [pytest.mark.wires, pytest.mark.slow]

HIL = (sys.executable, "-m", "hil")
EMULATED = ("run", "scheme-1", "--rig", "emulated", *typed(*NEAR, *UNHURRIED))
UNPRIVILEGED = (
    "setpriv",
    "--bounding-set=-all",
    "--inh-caps=-all",
    "prlimit",
    "--rtprio=0",
    "--nice=0",
    "--memlock=65536",
)
HARDWARE = """
extends = "emulated"
kind = "hardware"
sign_off.waived = true
rails.modbus.x.port = 1
rails.modbus.y.port = 2
rails.modbus.z.port = 3
turntable.cia402.channel = "/dev/null"
vmu.rs422.port = "/dev/null"
io.port = 4
"""
STEPPED = r"""
#define _GNU_SOURCE
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>
/* The wall clock is an hour ahead and an hour behind in turn, from one half of a second to the next. */
int clock_gettime(clockid_t clock, struct timespec *t) {
    struct timespec now;
    int found = syscall(SYS_clock_gettime, clock, t);
    if (clock == CLOCK_REALTIME) {
        syscall(SYS_clock_gettime, CLOCK_MONOTONIC, &now);
        t->tv_sec += now.tv_nsec < 500000000 ? 3600 : -3600;
    }
    return found;
}
"""
STALLED = r"""
#define _GNU_SOURCE
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <unistd.h>
/* The disk stalls once under the recording, in its 20th write, for STALL_S seconds; synchronising always takes two. */
static int is_recording(int fd) {
    char link[64] = "/proc/self/fd/", path[4096];
    char *end = link + strlen(link);
    int digits = 0;
    for (int n = fd; n > 0 || digits == 0; n /= 10) digits++;
    end[digits] = 0;
    for (int n = fd, i = digits - 1; i >= 0; n /= 10, i--) end[i] = '0' + n % 10;
    long length = syscall(SYS_readlink, link, path, sizeof path);
    return length > 5 && strncmp(path + length - 5, ".mcap", 5) == 0;
}
ssize_t write(int fd, const void *bytes, size_t n) {
    static int writes = 0;
    if (fd > 2 && is_recording(fd) && ++writes == 20) sleep(atoi(getenv("STALL_S")));
    return syscall(SYS_write, fd, bytes, n);
}
int fdatasync(int fd) {
    sleep(2);
    return syscall(SYS_fdatasync, fd);
}
"""


def test_closed_terminal_is_a_safe_stop_with_a_whole_recording(tmp_path: Path) -> None:
    terminal, inside = pty.openpty()

    def take_terminal() -> None:
        os.setsid()
        fcntl.ioctl(inside, termios.TIOCSCTTY, 0)
        termios.tcsetwinsize(inside, (40, 120))

    command = [*HIL, *EMULATED, "--record", str(tmp_path)]
    streams = {"stdin": inside, "stdout": inside, "stderr": inside}
    with subprocess.Popen(command, **streams, preexec_fn=take_terminal) as process:
        os.close(inside)
        try:
            shown, end_s = b"", time.monotonic() + 120.0
            while b"watchdog process" not in shown:
                assert time.monotonic() < end_s, shown
                if select.select([terminal], [], [], 1.0)[0]:
                    shown += os.read(terminal, 4096)
            time.sleep(5.0)
            os.close(terminal)
            assert process.wait(30.0) == SAFE_STOPPED
        finally:
            process.kill()
    (file,) = tmp_path.glob("*.mcap")
    recorded = load(file)
    assert recorded.intact
    assert recorded.end is not None
    assert recorded.end["stop"] == "stopped by the operator"


@pytest.mark.skipif(shutil.which("setpriv") is None, reason="no setpriv on this computer")
def test_user_without_privileges_runs_emulated_rigs_and_is_refused_hardware(tmp_path: Path) -> None:
    out = tmp_path / "run.json"
    command = [*UNPRIVILEGED, *HIL, *EMULATED, "--duration", "2", "--json", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == FAILED, done.stderr  # two seconds are too short to be ready
    found = json.loads(out.read_text())
    assert found["stop"] == "completed"
    assert {each["name"] for each in found["timing"]["privileges"] if not each["granted"]} >= {FIFO, MEMORY}
    lab = tmp_path / "lab.toml"
    lab.write_text(HARDWARE)
    command = [*UNPRIVILEGED, *HIL, "run", "scheme-1", "--rig", str(lab)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == BAD_INPUT
    assert "rig.host.require_realtime: true, but" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this computer")
def test_steps_of_the_wall_clock_do_not_disturb_the_loop(tmp_path: Path) -> None:
    out, preload = tmp_path / "run.json", preloaded(STEPPED, tmp_path)
    look = "import time; a = [(time.sleep(0.1), time.time())[1] for _ in range(12)]; print(max(a) - min(a) > 7000)"
    done = subprocess.run([sys.executable, "-c", look], capture_output=True, text=True, env=preload, check=True)
    assert done.stdout == "True\n"
    command = [*HIL, *EMULATED, "--duration", "6", "--record", str(tmp_path), "--json", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=preload, check=False)
    found = json.loads(out.read_text())
    assert (done.returncode, found["stop"], found["faults"], found["alarms"]) == (FAILED, "completed", [], [])
    print(f"cycles {found['timing']['cycles']}, lateness, us: {found['timing']['lateness_us']}")  # noqa: T201
    assert found["timing"]["cycles"] == 301
    assert found["timing"]["lateness_us"]["max"] < 1e6
    (file,) = tmp_path.glob("*.mcap")
    assert load(file).intact


def preloaded(source: str, folder: Path) -> dict[str, str]:
    """Return an environment in which the functions of ``source``, in C, come before those of the system's library."""
    file, library = folder / "preloaded.c", folder / "preloaded.so"
    file.write_text(source)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(library), str(file)], check=True, capture_output=True)
    return os.environ | {"LD_PRELOAD": str(library)}


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this computer")
@pytest.mark.parametrize(("stall_s", "axes_hz", "loses"), [(3, 50, False), (12, 250, True)])  # room: 41 s and 8 s
def test_a_disk_that_stalls_under_a_run_does_not_disturb_it(
    tmp_path: Path, stall_s: int, axes_hz: int, loses: bool
) -> None:
    out = tmp_path / "run.json"
    environment = preloaded(STALLED, tmp_path) | {"STALL_S": str(stall_s)}
    command = [*HIL, *EMULATED, *typed(f"rig.bench.axes_rate_hz={axes_hz}"), "--duration", "18"]
    command += ["--record", str(tmp_path), "--json", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180, env=environment, check=False)
    found = json.loads(out.read_text())
    print(f"lateness, us: {found['timing']['lateness_us']}")  # noqa: T201
    assert (found["stop"], found["faults"], found["timing"]["cycles"]) == ("completed", [], 901), done.stderr
    assert found["timing"]["lateness_us"]["max"] < 1e6
    dropped = found["recording"]["dropped"]
    (file,) = tmp_path.glob("*.mcap")
    recorded = load(file)
    assert recorded.intact
    assert len(recorded.cycles) == 901
    assert (dropped > 0) == loses
    assert (f"{dropped} messages arrived too fast" in found["recording"]["problem"]) == loses
    assert subprocess.run([*HIL, "replay", str(file)], capture_output=True, check=False).returncode == 0
