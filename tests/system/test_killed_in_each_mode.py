"""Loop, I/O process and watchdog, killed and stopped (-STOP), in each mode of an attended bench.

Within a bound the safety chain opens, the axes stand, and the gravity-loaded one has not dropped.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.clock import WallClock
from hil.parts.emulation.emulated_devices import EmulatedDevices
from tests.system.test_killed_processes import lab_file

pytestmark = [pytest.mark.wires, pytest.mark.slow]

SETTINGS = (
    "initial.position_m=[2.0, -0.12, 0.12]",
    "rig.rails.x.park_m=1.2",
    'rig.rails.y.encoder="incremental"',
    "rig.rails.y.park_m=-0.9",
    "rig.rails.z.park_m=0.12",
)
CHAIN_OPEN_S, STANDS_S = 0.3, 1.3  # 0.05 s of silence, the relay; a ramp from 0.25 m/s; a busy computer
DROP_M = 0.002
STANDING_MPS = 2e-3
MODES = ("standby", "homing", "jogging", "placing", "armed", "running", "hold", "parking", "safe-stop")


class Bench:
    """Emulated drives, and the attended controller on them."""

    def __init__(self, emulated: EmulatedDevices, clock: WallClock, lab: str, settings: Sequence[str]) -> None:
        self.emulated, self._clock = emulated, clock
        command = [sys.executable, "-m", "tests.support.attended_controller", lab, *settings]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True, start_new_session=True)
        self.pids = {"loop": self.process.pid}
        self.modes = ["off"]
        self.alarms: list[str] = []
        threading.Thread(target=self._listen, daemon=True).start()

    def _listen(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            if found := re.match(r"(I/O|watchdog) process (\d+)", line):
                self.pids[found[1]] = int(found[2])
            elif line.startswith("alarm "):
                self.alarms.append(line[6:].strip())
            elif line.startswith("mode "):
                self.modes.append(line.split()[1])

    def order(self, line: str) -> None:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def wait(self, mode: str) -> None:
        end = time.monotonic() + 60.0
        while self.modes[-1] != mode:
            assert time.monotonic() < end, f"{mode} not reached: {self.modes}"
            if self.modes[-1] == "safe-stop" and self.alarms:
                raise StoppedBeforeError("; ".join(self.alarms))
            assert self.process.poll() is None, self.modes
            time.sleep(0.002)

    def speed(self) -> float:
        rates = [self.emulated.board.read(device, self._clock.now_s())[1] for device in ("rails", "turntable")]
        return float(np.abs(rates).max())

    def rail_rates(self) -> np.ndarray:
        """Return the rates of the rails, m/s."""
        return self.emulated.board.read("rails", self._clock.now_s())[1]

    def z(self) -> tuple[float, float]:
        """Return position, m, and rate, m/s, of the gravity-loaded axis."""
        position, rate = self.emulated.board.read("rails", self._clock.now_s())
        return float(position[2]), float(rate[2])

    def has_torque(self) -> bool:
        return self.emulated.board.read_chain(self._clock).torque

    def bring_to(self, mode: str) -> None:
        """Lead the bench into ``mode``, its axes in motion if it is one of motion."""
        self.wait("standby")
        if mode != "standby":
            self.order("home")
            self.wait("homing")
        if mode not in ("standby", "homing"):
            self.wait("standby")
        if mode == "jogging":
            self.order("jog rails.x 1")
        elif mode == "parking":
            self.order("park")
        elif mode not in ("standby", "homing"):
            self.order("arm")
        if mode == "safe-stop":  # in the middle of the ramp
            self.wait("placing")
            time.sleep(1.2)
            self.order("stop")
            time.sleep(0.15)
            return
        if mode in ("armed", "running", "hold"):
            self.wait("armed")
            if mode != "armed":
                self.order("start")
                self.wait("running")
                time.sleep(1.5)
        if mode == "hold":
            self.order("hold")
        self.wait(mode)
        if mode == "standby":
            time.sleep(0.5)
        if mode in ("homing", "jogging", "placing", "parking"):
            time.sleep(0.4)


class StoppedBeforeError(Exception):
    """The bench stopped before the test began: the computer paused for longer than a time-out."""


@contextmanager
def bench(folder: Path, bring_to: Callable[[Bench], None], settings: Sequence[str] = SETTINGS) -> Iterator[Bench]:
    """Yield a bench that ``bring_to`` has led; another one, twice at most, if the computer stopped it meanwhile."""
    with ExitStack() as stack:
        for last in (False, False, True):
            made = stack.enter_context(started(folder, settings))
            try:
                bring_to(made)
                if not made.has_torque():
                    raise StoppedBeforeError("; ".join(made.alarms) or "the relay has opened")
                break
            except StoppedBeforeError as stopped:
                print(f"stopped before the test: {stopped}")  # noqa: T201
                if last:
                    raise
                stack.close()
        yield made


@contextmanager
def started(folder: Path, settings: Sequence[str]) -> Iterator[Bench]:
    clock = WallClock()
    scenario, rig = load_scenario("scheme-1", settings).value, load_rig("emulated", settings).value
    with EmulatedDevices(scenario, rig, clock, 0) as emulated:
        wired, _ = emulated.wait_ready()
        made = Bench(emulated, clock, lab_file(folder / "lab.toml", wired), settings)
        try:
            yield made
        finally:
            for pid in made.pids.values():
                if Path(f"/proc/{pid}").exists():
                    os.kill(pid, signal.SIGCONT)
            made.process.kill()
            made.process.communicate()


def stop_times(made: Bench, limit_s: float = 5.0) -> tuple[float | None, float | None]:
    """Return after which times, s, the axes stand, and have no torque; None if not within ``limit_s``."""
    begun = time.monotonic()
    stands = opened = None
    while (now := time.monotonic() - begun) < limit_s and (stands is None or opened is None):
        if opened is None and not made.has_torque():
            opened = now
        if stands is None and made.speed() < STANDING_MPS:
            stands = now
        time.sleep(0.0005)
    return stands, opened


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hanging"])
@pytest.mark.parametrize("who", ["loop", "I/O", "watchdog"])
@pytest.mark.parametrize("mode", MODES)
def test_the_chain_opens_and_nothing_moves_or_drops(tmp_path: Path, mode: str, who: str, how: signal.Signals) -> None:
    with bench(tmp_path, lambda made: made.bring_to(mode)) as made:
        (z_m, z_mps), speed = made.z(), made.speed()
        os.kill(made.pids[who], how)
        stands, opened = stop_times(made, 4.0)
        time.sleep(0.3)
        drop_m = z_m - made.z()[0]
        assert opened is not None
        assert stands is not None
        print(  # noqa: T201
            f"{mode:9} {who:8} {how.name}: {1e3 * speed:4.0f} mm/s, torque off {1e3 * opened:4.0f} ms, "
            f"stands {1e3 * stands:4.0f} ms, z drop {1e3 * drop_m:+.2f} mm"
        )
        assert opened < CHAIN_OPEN_S
        assert stands < STANDS_S
        if abs(z_mps) < 1e-3:  # else it brakes
            assert abs(drop_m) < DROP_M
