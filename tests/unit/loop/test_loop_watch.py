"""Watch over code of plug-ins in the loop's process: threads, kernels, and steps that do not return."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from types import SimpleNamespace

import pytest

from hil.errors import PlugInError
from hil.loop.loop_watch import LoopWatch, StepTimeout


def fail() -> None:
    raise ValueError("planted")


def sleep(_: object) -> None:
    time.sleep(20.0)


def compute(_: object) -> None:
    end_s = time.monotonic() + 20.0
    while time.monotonic() < end_s:
        pass


def caught(watch: LoopWatch, hang: Callable[[object], None]) -> list[BaseException]:
    """Return what ends a hang under the watch, in this thread."""
    ended: list[BaseException] = []
    with watch:
        try:
            hang(None)
        except StepTimeout as error:
            ended.append(error)
    return ended


def test_an_error_of_a_thread_ends_the_next_cycle() -> None:
    before = threading.excepthook
    with LoopWatch(lambda: 0, lambda: 60.0) as watch:
        watch.check()
        thread = threading.Thread(target=fail, name="poller")
        thread.start()
        thread.join()
        with pytest.raises(PlugInError, match=r"thread poller: fail raised ValueError: planted \(test_loop_watch.py"):
            watch.check()
    assert threading.excepthook is before


def test_an_error_of_a_sensor_s_kernel_ends_the_next_cycle() -> None:
    with LoopWatch(lambda: 0, lambda: 60.0) as watch:
        sys.unraisablehook(SimpleNamespace(object="<numba.core.cpu.CPUContext>", exc_value=ValueError("planted")))
        with pytest.raises(PlugInError, match="sensor: it raised ValueError: planted"):
            watch.check()


@pytest.mark.parametrize("hang", [sleep, compute])
def test_a_step_that_does_not_return_is_interrupted_where_it_stands(hang: Callable[[object], None]) -> None:
    begun_s = time.monotonic()
    assert len(caught(LoopWatch(lambda: 0, lambda: 0.3), hang)) == 1
    assert time.monotonic() - begun_s < 5.0


def test_in_another_thread_a_computing_step_is_interrupted() -> None:
    ended: list[BaseException] = []
    thread = threading.Thread(target=lambda: ended.extend(caught(LoopWatch(lambda: 0, lambda: 0.3), compute)))
    thread.start()
    thread.join(10.0)
    assert len(ended) == 1


def test_progress_and_a_debugger_hold_the_time_out(monkeypatch: pytest.MonkeyPatch) -> None:
    with LoopWatch(time.monotonic, lambda: 0.3):
        time.sleep(1.0)
    monkeypatch.setattr("hil.loop.loop_watch.is_debugged", lambda _: True)
    with LoopWatch(lambda: 0, lambda: 0.3):
        time.sleep(1.0)
