"""What the guest of ``sims/rt_guest.sh`` runs: the product on a PREEMPT_RT kernel with CAN and a camera.

Each line is ``rt_guest: CHECK: result``; "rt_guest: passed" if all passed.
"""

from __future__ import annotations

import glob
import os
import platform
import subprocess
import sys
import threading
import time
from collections.abc import Callable

RESULTS: list[bool] = []


def check(name: str, run: Callable[[], str]) -> None:
    """Run one check and print its result, or why it failed."""
    begun_s = time.monotonic()
    try:
        text, fine = run(), True
    except Exception as error:
        text, fine = f"{type(error).__name__}: {error}", False
    RESULTS.append(fine)
    sys.stdout.write(f"rt_guest: {name}: {'ok' if fine else 'FAIL'}: {text} ({time.monotonic() - begun_s:.1f} s)\n")
    sys.stdout.flush()


def kernel() -> str:
    """Require a kernel with PREEMPT_RT."""
    with open("/sys/kernel/realtime") as file:
        assert file.read().strip() == "1"
    return f"{platform.release()} {platform.version()}"


def privileges() -> str:
    """Require SCHED_FIFO and locked memory, as a run does."""
    from hil.core.realtime import REAL_TIME, RealTime

    with RealTime() as realtime:
        assert all(realtime.granted(name) for name in REAL_TIME), [str(grant) for grant in realtime.grants]
        with realtime.realtime_priority():
            return f"policy {os.sched_getscheduler(0)}; " + "; ".join(map(str, realtime.grants))


def can() -> str:
    """Move a gimbal by the driver of CiA 402 drives over socketcan; the emulated drives are on the same vcan."""
    import numpy as np

    from hil.config.load import load_rig
    from hil.core.clock import WallClock
    from hil.drivers.turntable.cia402 import node, sdo, setup
    from hil.parts.emulation.shared_state import SharedAxisState

    # the processor may be emulated: wall-clock limits are longer, those of bench time by its clock
    sdo.REPLY_WALL_S, node._MODE_WALL_S, setup._RESET_WALL_S = 20.0, 60.0, 5.0
    settings = ('rig.turntable.cia402.interface="socketcan"', 'rig.turntable.cia402.channel="vcan0"')
    table = load_rig("emulated", (*settings, "rig.turntable.timeout_s=5.0")).value.turntable
    clock = WallClock(speed=0.02)
    board, ending = SharedAxisState.create(), threading.Event()
    emulator = table.make_emulator(clock, board)
    address = emulator.start()
    thread = threading.Thread(target=emulator.run, args=(ending,))
    thread.start()
    driver = table.make_driver(clock)
    try:
        driver.open(clock.now_s())
        start = driver.read(clock.now_s()).position
        goal, begun_s = start + np.array([0.0, 0.0, 0.02]), clock.now_s()
        while clock.now_s() - begun_s < 3.0:
            fraction = min(1.0, (clock.now_s() - begun_s) / 2.0)
            driver.send(start + fraction * (goal - start), np.zeros(3), clock.now_s())
            time.sleep(clock.wall_s(0.02))
        found = driver.read(clock.now_s()).position
        assert abs(found[2] - goal[2]) < 2e-3, found
        return f"{address}, yaw moved by {found[2] - start[2]:.4f} rad of 0.02"
    finally:
        driver.close()
        ending.set()
        thread.join()
        emulator.close()
        board.close()


def camera() -> str:
    """Read frames of the kernel's virtual camera."""
    import cv2

    (path, *_) = sorted(glob.glob("/dev/video*"))
    for path in sorted(glob.glob("/dev/video*")):
        capture = cv2.VideoCapture(path, cv2.CAP_V4L2)
        got, frame = capture.read()
        capture.release()
        if got:
            return f"{path}: frame of {frame.shape}"
    raise RuntimeError(f"no frame from {glob.glob('/dev/video*')}")


def preflight() -> str:
    """Run hil preflight on the mock rig."""
    command = [sys.executable, "-m", "hil", "preflight", "--json", "/tmp/preflight.json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    sys.stdout.write(done.stdout + done.stderr)
    assert done.returncode in (0, 1)
    line = next(line for line in done.stdout.splitlines() if "PREEMPT_RT" in line)
    assert "not PREEMPT_RT" not in line
    return f"exit {done.returncode}"


def main() -> None:
    for name in ("kernel", "privileges", "camera", "can", "preflight"):
        check(name, globals()[name])
    sys.stdout.write("rt_guest: passed\n" if all(RESULTS) else "rt_guest: failed\n")


if __name__ == "__main__":
    main()
