"""The product on Debian's PREEMPT_RT kernel in QEMU: CiA 402 over vcan, vivid, privileges, preflight.

``pytest -m slow tests/system/test_rt_guest.py`` as root; the processor is emulated: function is tested, not timing.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / "sims" / "rt_guest.sh"
NEEDED = ("qemu-system-x86_64", "busybox", "cpio", "depmod")


@pytest.mark.slow
@pytest.mark.skipif(
    os.geteuid() != 0 or not all(map(shutil.which, NEEDED)), reason="needs root, qemu-system-x86, busybox, cpio, kmod"
)
def test_the_guest_passes_all_its_checks() -> None:
    done = subprocess.run(
        [str(SCRIPT)],
        env=os.environ | {"PYTHON": sys.executable},
        capture_output=True,
        text=True,
        timeout=3000,
        check=False,
    )
    assert done.returncode == 0, done.stdout[-4000:]
    assert "rt_guest: passed" in done.stdout
