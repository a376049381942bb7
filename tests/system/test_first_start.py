"""The first start, which compiles: it can be left at any moment."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest


@pytest.mark.slow
def test_ctrl_c_in_mid_compilation_ends_the_program_as_a_safe_stop(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hil", "run", "scheme-1"]
    environment = os.environ | {"HIL_CACHE_DIR": str(tmp_path)}
    with subprocess.Popen(command, env=environment, stderr=subprocess.PIPE, text=True) as process:
        try:
            assert process.stderr is not None
            assert "compiling" in process.stderr.readline()
            time.sleep(1.5)
            process.send_signal(signal.SIGINT)
            _, errors = process.communicate(timeout=10.0)
        finally:
            process.kill()
    assert process.returncode == 3
    assert errors.splitlines()[-1] == "stopped by the operator"
