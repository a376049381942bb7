"""Signals that stop the program while it is in code that drops or replaces what their handlers raise."""

from __future__ import annotations

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.cli import main


def wait_after_a_drop() -> None:
    ctypes.CFUNCTYPE(None)(lambda: os.kill(os.getpid(), signal.SIGTERM))()
    time.sleep(5.0)


def test_interruption_that_a_callback_drops_is_raised_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(main, "_STOPPED", main.threading.Event())
    monkeypatch.setattr(sys, "unraisablehook", main._unraisable)
    before = {number: signal.signal(number, main._as_ctrl_c) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        with pytest.raises(KeyboardInterrupt):
            wait_after_a_drop()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert main._STOPPED.is_set()


@pytest.mark.parametrize(("stopped", "code"), [(True, main.SAFE_STOPPED), (False, main.DEFECT)])
def test_error_after_a_stop_is_its_consequence(
    stopped: bool, code: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(main, "_STOPPED", main.threading.Event())

    class Cut:
        def parse_args(self, *_: object, **__: object) -> None:
            if stopped:
                main._STOPPED.set()
            raise KeyError("of a compilation that was cut off")

    monkeypatch.setattr(main, "app", Cut())
    assert main.execute(["run"]) == code
    assert (capsys.readouterr().err == "stopped by the operator\n") == stopped


def test_program_that_is_terminated_while_it_compiles_ends_in_one_line(tmp_path: Path) -> None:
    """With an empty cache the first kernel is being compiled within seconds."""
    environment = os.environ | {"HIL_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "hil", "run", "scheme-1", "--duration", "0.1"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as run:
        time.sleep(6.0)
        run.send_signal(signal.SIGTERM)
        _, shown = run.communicate(timeout=60.0)
    assert run.returncode == main.SAFE_STOPPED, shown
    assert shown.splitlines()[-1] == "stopped by the operator"
    assert "Traceback" not in shown
