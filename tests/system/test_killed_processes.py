"""kill -9 and kill -STOP of each process of a running bench: the axes stand soon after, whichever it was."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.config.rig import RAIL_NAMES, Rig
from hil.core.clock import WallClock
from hil.parts.emulation.emulated_devices import EmulatedDevices
from tests.support.run_settings import typed

pytestmark = pytest.mark.wires

MOVING = (
    "initial.position_m=[2.0, -0.12, 0.12]",
    "rig.rails.x.park_m=2.0",
    "rig.rails.y.park_m=-0.12",
    "rig.rails.z.park_m=0.12",
)
GENEROUS_S = 1.0
"""Longest time to a standstill that is asserted; what it takes on a quiet computer is printed (pytest -s)."""


@dataclass
class Bench:
    """Emulated drives that outlive the controller, and the controller's processes by name."""

    emulated: EmulatedDevices
    clock: WallClock
    controller: subprocess.Popen[str]
    pids: dict[str, int]

    def speed(self) -> float:
        """Return the fastest axis' speed, m/s or rad/s."""
        rates = [self.emulated.board.read(device, self.clock.now_s())[1] for device in ("rails", "turntable")]
        return float(np.abs(rates).max())

    def times_to_stop(self, limit_s: float) -> tuple[float | None, float | None]:
        """Return when the rails began to brake and when all axes stood, s from now; None where they did not."""
        begun, speed = time.monotonic(), self.rails_speed()
        braking = None
        while (now := time.monotonic() - begun) < limit_s:
            if braking is None and self.rails_speed() < speed - 0.005:
                braking = now
            if self.speed() < 2e-3:
                return now if braking is None else braking, now  # a busy computer saw the end alone
            time.sleep(0.0005)
        return braking, None

    def wait_for_speed(self, least_mps: float) -> None:
        """Wait until the bench moves: thrusters fire in pulses, and so its speed varies around each limit."""
        end = time.monotonic() + 20.0
        while self.speed() <= least_mps:
            assert time.monotonic() < end, "the bench did not move"
            time.sleep(0.005)

    def rails_speed(self) -> float:
        return float(np.linalg.norm(self.emulated.board.read("rails", self.clock.now_s())[1]))


def lab_file(path: Path, wired: Rig) -> str:
    """Write a rig of hardware on the wires of the emulated one."""
    assert wired.rails.modbus
    assert wired.turntable.cia402
    assert wired.vmu.rs422
    assert wired.io
    rails = "".join(f"{name} = {{ port = {getattr(wired.rails.modbus, name).port} }}\n" for name in RAIL_NAMES)
    path.write_text(
        'extends = "emulated"\nname = "lab"\nkind = "hardware"\nsign_off.waived = true\n'
        f"[rails.modbus]\n{rails}"
        f'[turntable.cia402]\nchannel = "{wired.turntable.cia402.channel}"\n'
        '[vmu]\nclock = "own"\n'
        f'[vmu.rs422]\nport = "{wired.vmu.rs422.port}"\n'
        + (f"[io]\nport = {wired.io.port}\n" if wired.has_io else '[io]\ndriver = "none"\n')
        + '[host]\nrequire_realtime = false\non_overrun = "log"\n'
    )
    return str(path)


@contextmanager
def running(folder: Path, *settings: str) -> Iterator[Bench]:
    """Yield a bench on the approach."""
    clock = WallClock()
    with EmulatedDevices(
        load_scenario("scheme-1", MOVING).value, load_rig("emulated", (*MOVING, *settings)).value, clock, 0
    ) as emulated:
        wired, _ = emulated.wait_ready()
        rig = lab_file(folder / "lab.toml", wired)
        command = [sys.executable, "-m", "hil", "run", "scheme-1", "--rig", rig]
        command += typed(*MOVING, *settings)
        process = subprocess.Popen(
            command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, start_new_session=True
        )
        try:
            assert process.stderr is not None
            pids = {"loop": process.pid}
            while ("watchdog" if wired.has_io else "I/O") not in pids:
                line = process.stderr.readline()
                assert line, "the controller ended before it ran"
                if found := re.match(r"(I/O|watchdog) process (\d+)", line):
                    pids[found[1]] = int(found[2])
            bench = Bench(emulated, clock, process, pids)
            end = time.monotonic() + 60.0
            moving_since = None
            while moving_since is None or time.monotonic() - moving_since < 1.5:  # past placing, on the approach
                assert time.monotonic() < end, "the bench did not move"
                assert process.poll() is None, process.stderr.read()
                if not 0.02 < bench.speed() < 0.1:
                    moving_since = None
                elif moving_since is None:
                    moving_since = time.monotonic()
                time.sleep(0.005)
            yield bench
        finally:
            for pid in pids.values():
                with_pid = Path(f"/proc/{pid}")
                if with_pid.exists():
                    os.kill(pid, signal.SIGCONT)
            process.kill()
            process.communicate()


@pytest.mark.parametrize(
    "how",
    [pytest.param(signal.SIGKILL, id="killed"), pytest.param(signal.SIGSTOP, id="hanging", marks=pytest.mark.slow)],
)
@pytest.mark.parametrize(
    "who", ["loop", pytest.param("I/O", marks=pytest.mark.slow), pytest.param("watchdog", marks=pytest.mark.slow)]
)
def test_the_axes_stand_after_a_process_has_died(tmp_path: Path, who: str, how: signal.Signals) -> None:
    with running(tmp_path) as bench:
        bench.wait_for_speed(0.02)
        os.kill(bench.pids[who], how)
        speed = bench.rails_speed()
        braking_s, stood_s = bench.times_to_stop(GENEROUS_S)
        assert braking_s is not None
        assert stood_s is not None
        print(  # noqa: T201
            f"{who} {how.name}: {1e3 * speed:.0f} mm/s, brakes after {1e3 * braking_s:.0f} ms, "
            f"stands after {1e3 * stood_s:.0f} ms"
        )
        if who == "loop" and how is signal.SIGKILL:
            bench.controller.wait()
            end = time.monotonic() + 5.0
            while time.monotonic() < end and any(_lives(pid) for pid in bench.pids.values()):
                time.sleep(0.01)
            assert not [name for name, pid in bench.pids.items() if _lives(pid)]
        if who != "loop":
            _, err = bench.controller.communicate(timeout=30.0)
            assert bench.controller.returncode == 3
            assert f"{who} process" in err.splitlines()[-1] or "safe torque off" in err.splitlines()[-1]


@pytest.mark.parametrize(
    "number", [pytest.param(n, marks=pytest.mark.slow) for n in (signal.SIGHUP, signal.SIGQUIT, signal.SIGINT)]
)
def test_a_signal_to_all_processes_of_the_terminal_is_a_safe_stop(tmp_path: Path, number: signal.Signals) -> None:
    with running(tmp_path) as bench:
        bench.wait_for_speed(0.02)
        os.killpg(bench.pids["loop"], number)
        braking_s, stood_s = bench.times_to_stop(GENEROUS_S)
        assert braking_s is not None
        assert stood_s is not None
        print(f"{number.name}: stands after {1e3 * stood_s:.0f} ms")  # noqa: T201
        _, err = bench.controller.communicate(timeout=30.0)
        assert bench.controller.returncode == 3
        assert err.splitlines()[-1] == "safe stop: stopped by the operator"


def _lives(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False
