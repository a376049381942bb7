"""Hostile files end a command with one line and exit code 2, in bounded time and memory."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.cli.main import BAD_INPUT, INCOMPLETE, PASSED, execute
from tests.support.hostile_files import GIB, Hostile, hostile

CPU_S = 5.0
IN_NORMAL_RUN = 11
"""Each how many-th input is part of the normal run, in process."""


def _fault(given: Hostile, code: int, stdout: str, stderr: str) -> str:
    """Return what is wrong with the end of a command, "" for nothing."""
    lines = [line for line in stderr.splitlines() if line.strip()]
    partly = {"export": INCOMPLETE, "recover": PASSED}.get(given.name.partition(": ")[0], BAD_INPUT)
    if code not in (BAD_INPUT, partly):
        return f"exit code {code}: {lines[-3:]}"
    if code == BAD_INPUT and not 1 <= len(lines) <= 21:
        return f"{len(lines)} lines"
    if any(not line.isprintable() for line in lines) or "Traceback" in stderr:
        return f"not printable: {lines[:3]}"
    return "" if len(stderr) < 50_000 else "long"


def test_hostile_files_are_refused_in_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    faults = []
    for given in list(hostile(tmp_path))[::IN_NORMAL_RUN]:
        began_s = time.process_time()
        code = execute(list(given.arguments))
        printed = capfd.readouterr()
        spent_s = time.process_time() - began_s
        fault = _fault(given, code, printed.out, printed.err) or ("" if spent_s < CPU_S else f"{spent_s:.1f} s")
        if fault:
            faults.append(f"{given.name}: {fault}")
    assert not faults, "\n".join(faults)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_each_hostile_file_is_refused_by_a_process_in_five_seconds_and_a_gigabyte(tmp_path: Path) -> None:
    faults, tried = [], 0
    for given in hostile(tmp_path):
        tried += 1
        arguments = [sys.executable, "-m", "hil", *given.arguments]
        with (tmp_path / "stdout").open("w+") as out, (tmp_path / "stderr").open("w+") as err:
            child = subprocess.Popen(arguments, stdin=subprocess.DEVNULL, stdout=out, stderr=err)
            give_up_s = time.monotonic() + 60.0
            while True:
                pid, status, used = os.wait4(child.pid, os.WNOHANG)
                if pid or time.monotonic() > give_up_s:
                    break
                time.sleep(0.02)
            if not pid:
                child.kill()
                os.wait4(child.pid, 0)
                faults.append(f"{given.name}: does not end")
                continue
            child.returncode = os.waitstatus_to_exitcode(status)
            out.seek(0)
            err.seek(0)
            fault = _fault(given, child.returncode, out.read(), err.read())
            spent_s, size = used.ru_utime + used.ru_stime, used.ru_maxrss * 1024
            if spent_s >= CPU_S or size >= GIB:
                fault = f"{fault} {spent_s:.1f} s, {size >> 20} MiB"
            if fault:
                faults.append(f"{given.name}: {fault}")
    assert tried >= 300
    assert not faults, f"{len(faults)} of {tried}\n" + "\n".join(faults)
