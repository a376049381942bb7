"""Bugs planted in plug-ins: what the program reports of each, and how long that takes.

    python -m tests.support.planted_bugs [--wall] [NAME ...]

writes a package with the bug, runs it, and prints exit code, time and last line of each. ``HIL``: folder of another
version of the program to run.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Final, NamedTuple

from tests.support import example_driver
from tests.support.run_settings import NEAR, UNHURRIED, typed

KINDS: Final = {
    "raise": "raise ValueError('planted')",
    "thread": "threading.Thread(target=self.broken).start()",
    "none": "return None",
    "shape": "return replace(super().read(now_s), position=np.zeros(2))",
    "exit": "sys.exit(3)",
    "_exit": "os._exit(3)",
    "kill": "os.kill(os.getpid(), 9)",
    "segfault": "ctypes.string_at(0)",
    "hang": "while True: time.sleep(0.01)",
}
"""Code of a bug, of one line."""
IMPORTS: Final = """
import ctypes, os, sys, threading, time
from dataclasses import replace
import numpy as np
"""
DRIVER: Final = f"""{IMPORTS}
from acme_rails.driver import AcmeRails

class PlantedRails(AcmeRails):
    calls = 0
    def broken(self):
        raise ValueError("planted")
    def open(self, now_s):
        pass  # driver.open
        super().open(now_s)
    def read(self, now_s):
        self.calls += 1
        if self.calls >= 300:
            pass  # driver.read
        return super().read(now_s)
    def send(self, position, rate, now_s):
        pass  # driver.send
        return super().send(position, rate, now_s)
    def stop(self, now_s):
        pass  # driver.stop
        super().stop(now_s)
    def close(self):
        pass  # driver.close
        super().close()
"""
EMULATOR: Final = f"""{IMPORTS}
from acme_rails.emulator import AcmeEmulator

class PlantedEmulator(AcmeEmulator):
    calls = 0
    def broken(self):
        raise ValueError("planted")
    def start(self):
        pass  # emulator.start
        return super().start()
    def _advance(self):
        self.calls += 1
        if self.calls >= 500:
            pass  # emulator.run
        super()._advance()
"""
VMU: Final = f"""{IMPORTS}
from hil.drivers.vmu.driver import Rs422Vmu

class PlantedVmu(Rs422Vmu):
    calls = 0
    def broken(self):
        raise ValueError("planted")
    def poll(self, now_s):
        self.calls += 1
        if self.calls >= 300:
            pass  # vmu.poll
        return super().poll(now_s)
"""
GNC: Final = f"""{IMPORTS}

class PlantedGnc:
    calls = 0
    def broken(self):
        raise ValueError("planted")
    def step(self, inp):
        self.calls += 1
        if self.calls >= 20:
            pass  # gnc.step
        return None
"""
ESTIMATOR: Final = f"""{IMPORTS}
from hil.vmu.unit import VisionUnit

class PlantedEstimator(VisionUnit):
    calls = 0
    def broken(self):
        raise ValueError("planted")
    def solve(self, left, right, t_s):
        self.calls += 1
        if self.calls >= 8:
            pass  # estimator.solve
        return super().solve(left, right, t_s)

def make(geometry, settings):
    return PlantedEstimator(geometry)
"""
SENSOR: Final = """
import hil
from hil.maths import stack

class PlantedSensor(hil.SensorModule):
    kind = "planted_range"
    components = (hil.Component("range_m", "m", "distance"),)
    settings = (hil.Setting("sigma_m", 0.01, "m", 1e-6, 1.0, "noise"),)
    faults = {"no_sample": "nothing is unseen"}

    @staticmethod
    def measure(settings, truth, out):
        if truth.t_s > 1.0:
            pass  # sensor.measure
        out.sample.value[0] = truth.r_CT_H[0]
        out.sample.covariance[0, 0] = settings.sigma_m**2

    @staticmethod
    def innovate(settings, estimate, out):
        out.value[0] = out.sample.value[0] - estimate.r_CT_H[0]
        out.h[0, 0] = 1.0
"""
PROCEDURE: Final = f"""{IMPORTS}
import hil

def broken():
    raise ValueError("planted")

if __name__ == "__main__":
    settings = dict(word.split("=", 1) for word in sys.argv[2:])
    with hil.Bench(sys.argv[1], "scheme-1", overrides={{"rig.host.time": "lock_step"}}) as bench:
        bench.arm()
        pass  # procedure.body
        print(bench.start(until=1.0).stop, file=sys.stderr)
"""
ENTRY: Final = """
from dataclasses import replace
from acme_rails.entry import ENTRY as ACME
from hil.config.tables.driver_registry import WireKey
from hil.drivers.vmu.entry import ENTRY as VMU_ENTRY

RAILS = replace(ACME, name="planted", driver="planted.driver:PlantedRails", emulator="planted.emulator:PlantedEmulator",
                wires=[WireKey("planted.port", "serial")])
VMU = replace(VMU_ENTRY, name="planted", driver="planted.vmu:PlantedVmu")
"""
FILES: Final = {"driver": DRIVER, "emulator": EMULATOR, "vmu": VMU, "gnc": GNC, "estimator": ESTIMATOR, "entry": ENTRY,
                "sensor": SENSOR, "procedure": PROCEDURE}  # fmt: skip
POINTS: Final = """[hil.drivers]
rails.planted = planted.entry:RAILS
vmu.planted = planted.entry:VMU
[hil.pose_estimators]
planted = planted.estimator:make
[hil.sensors]
planted_range = planted.sensor:PlantedSensor
"""
RIG: Final = """extends = "emulated"
name = "planted"
rails.driver = "planted"
rails.planted.baud = 460800
vmu.driver = "planted"
host.lock_step_timeout_s = 2.0
"""
BUGS: Final = (
    "driver.open raise", "driver.read raise", "driver.send raise", "driver.stop raise", "driver.read thread",
    "driver.read shape", "driver.read none", "driver.read exit", "driver.read _exit", "driver.read kill",
    "driver.read segfault", "driver.read hang", "emulator.start none", "emulator.run raise", "emulator.run thread",
    "emulator.run _exit", "emulator.run segfault", "emulator.run hang", "vmu.poll raise", "vmu.poll none",
    "vmu.poll kill", "vmu.poll hang", "gnc.step raise", "gnc.step shape", "gnc.step thread", "gnc.step exit",
    "gnc.step segfault", "gnc.step hang", "estimator.solve raise", "estimator.solve none", "estimator.solve kill",
    "estimator.solve hang", "sensor.measure raise", "procedure.body raise", "procedure.body thread",
    "procedure.body exit",
)  # fmt: skip


class Reported(NamedTuple):
    """What the program reported of a bug. seconds: until its end. line: the last one of stderr. names: the bug."""

    code: int
    seconds: float
    line: str
    names: bool
    log: str


def plant(folder: Path, bug: str) -> Path:
    """Write the package with the bug into ``folder``; return the file that has it."""
    place, kind = bug.split()
    example_driver.install(folder)
    package = folder / "planted"
    package.mkdir()
    info = folder / "planted-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: planted\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(POINTS)
    code = KINDS[kind]
    if (place, kind) == ("gnc.step", "shape"):
        code = "return {'force': np.zeros(2), 'torque': np.zeros(3)}"
    if place.startswith("procedure"):
        code = code.replace("self.", "")
    (package / "__init__.py").write_text("")
    for name, text in FILES.items():
        planted = re.sub(rf"pass  # {re.escape(place)}$", code, text, flags=re.MULTILINE)
        (package / f"{name}.py").write_text(planted)
    (folder / "rig.toml").write_text(RIG)
    return package / f"{place.partition('.')[0]}.py"


def line_of(file: Path, bug: str) -> int:
    """Return the line of the bug in its file."""
    lines, original = file.read_text().splitlines(), FILES[file.stem].splitlines()
    return next(number for number, (a, b) in enumerate(zip(lines, original, strict=True), 1) if a != b)


def run(folder: Path, bug: str, wall: bool = False) -> Reported:
    """Plant the bug, run it, and return what was reported. wall: by the wall clock instead of in lock-step."""
    file = plant(folder, bug)
    place, kind = bug.split()
    what = place.partition(".")[0]
    settings = [*NEAR, *UNHURRIED]
    if what == "gnc":
        settings.append(f"gnc.control.backend={file}:PlantedGnc")
    if what == "estimator":
        settings += ["rig.vmu.estimator=planted", "vmu.source=rendered", "rig.vmu.driver=rs422"]
    if what == "sensor":
        settings.append("sensors.planted.kind=planted_range")
    options = ["--rig", str(folder / "rig.toml"), "--duration", "4", *([] if wall else ["--lock-step"])]
    command = [sys.executable, "-m", "hil", "run", "scheme-1", *options, *typed(*settings)]
    if what == "procedure":
        command = [sys.executable, "-m", "planted.procedure", str(folder / "rig.toml"), *settings]
    path = os.pathsep.join((str(folder), *filter(None, (os.environ.get("HIL"), *sys.path))))
    begun_s = time.monotonic()
    done = subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, cwd=folder,
        env={**os.environ, "PYTHONPATH": path}, start_new_session=True,
    )  # fmt: skip
    try:
        log = done.communicate(timeout=60.0)[1]
    except subprocess.TimeoutExpired:
        os.killpg(done.pid, 9)
        log = done.communicate()[1] + "\n(did not end within 60 s)"
    seconds = time.monotonic() - begun_s
    lines = [line for line in log.splitlines() if line.strip()] or [""]
    names = f"{file.name}, line {line_of(file, bug)}" in lines[-1] or f'{file.name}", line {line_of(file, bug)}' in log
    if kind == "kill":
        names = "SIGKILL" in lines[-1]
    if kind in ("none", "shape", "thread"):  # the line where the method begins, or that of the thread
        names = f"({file.name}, line " in lines[-1]
    if place.startswith("procedure"):  # Python's own traceback follows the line
        names = any(f"({file.name}, line {line_of(file, bug) if kind != 'thread' else ''}" in line for line in lines)
    return Reported(done.returncode, seconds, lines[-1], names, log)


def main() -> None:
    """Print a row per bug."""
    words = sys.argv[1:]
    wall = "--wall" in words
    chosen = [bug for bug in BUGS if not (names := [w for w in words if w != "--wall"]) or any(n in bug for n in names)]
    for bug in chosen:
        with tempfile.TemporaryDirectory() as folder:
            told = run(Path(folder), bug, wall)
        mark = "ok " if told.names else "NOT"
        print(f"{mark} {bug:24} {told.code:4} {told.seconds:5.1f} s  {told.line}", flush=True)  # noqa: T201
        if "-v" in os.environ.get("VERBOSE", ""):
            print(told.log)  # noqa: T201


if __name__ == "__main__":
    main()
