"""Code of plug-ins that raises, or returns what it may not: one line with device, class, file and line."""

from __future__ import annotations

import json
import logging
import re
import sys
import threading

import numpy as np
import pytest

from hil.core import plug_ins
from hil.core.plug_ins import (
    Calls,
    Stack,
    call,
    is_debugged,
    is_of,
    is_users,
    method_text,
    place_in,
    plug_in_error,
    wrong_return,
)
from hil.errors import LinkLost, PlugInError


class Device:
    """A driver of a user's own."""

    def __init__(self) -> None:
        self.parts = [Link()]

    def read(self, now_s: float) -> float:
        return now_s / 0.0

    def leave(self) -> None:
        sys.exit(3)

    def lose(self) -> None:
        raise LinkLost("rails", "unplugged")

    def compare(self) -> None:
        np.zeros(3).reshape(2)

    def parse(self) -> None:
        json.loads("{")


class Link:
    def exchange(self) -> None:
        raise OSError("no\nline")


def test_what_a_method_raises_is_named_with_device_class_file_and_line(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR, "hil"), pytest.raises(PlugInError) as caught:
        call("rails", Device().read, 1.0)
    line = Device.read.__code__.co_firstlineno + 1
    text = f"rails: Device.read raised ZeroDivisionError: float division by zero (test_plug_ins.py, line {line})"
    assert str(caught.value) == text
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    assert "Traceback" in caplog.text


@pytest.mark.parametrize(
    ("method", "text"),
    [
        ("leave", "Device.leave raised SystemExit: 3"),
        ("compare", "Device.compare raised ValueError: cannot reshape array of size 3 into shape (2,)"),
        ("parse", "Device.parse raised JSONDecodeError: Expecting property name"),
    ],
)
def test_the_line_is_the_user_s_not_that_of_a_library(method: str, text: str) -> None:
    with pytest.raises(PlugInError, match=re.escape(text)) as caught:
        call("rails", getattr(Device(), method))
    assert "(test_plug_ins.py, line " in str(caught.value)


def test_an_error_of_the_bench_passes_unchanged() -> None:
    with pytest.raises(LinkLost, match=r"^rails: unplugged$"):
        call("rails", Device().lose)


def test_text_of_an_error_is_one_line() -> None:
    with pytest.raises(PlugInError, match=r"Link\.exchange raised OSError: no line \(") as caught:
        call("rails", Link().exchange)
    assert "\n" not in str(caught.value)


def test_an_error_of_a_thread_is_of_the_device_whose_object_raised_it() -> None:
    device, other = Device(), Device()
    with pytest.raises(OSError, match="line") as caught:
        device.parts[0].exchange()
    assert is_of(device, caught.value)
    assert not is_of(other, caught.value)


def test_a_wrong_return_names_the_method_and_where_it_begins() -> None:
    line = Device.read.__code__.co_firstlineno
    text = f"rails: Device.read returned None, expected AxisFeedback (test_plug_ins.py, line {line})"
    assert str(wrong_return("rails", Device().read, "None, expected AxisFeedback")) == text


def test_calls_under_way_are_noted_until_they_return(monkeypatch: pytest.MonkeyPatch) -> None:
    noted: list[str] = []
    monkeypatch.setattr(plug_ins, "_calls", [Calls(noted.append)])
    with pytest.raises(LinkLost):
        call("rails", Device().lose)
    assert noted == [f"rails {method_text(Device().lose)}", ""]


def test_files_of_users_are_those_of_neither_the_program_nor_libraries() -> None:
    assert is_users(__file__)
    assert is_users("/home/lab/driver.py")
    assert not is_users(plug_ins.__file__)
    assert not is_users(json.__file__)
    assert not is_users(str(np.__file__))
    assert not is_users("<frozen importlib._bootstrap>")


STACK = """chatter
Thread 0x00007f01 (most recent call first):
  File "{library}", line 5 in wait
  File "{library}", line 1 in run

Current thread 0x00007f02 (most recent call first):
  File "{library}", line 629 in wait
  File "/lab/driver.py", line 44 in exchange
"""


def test_a_stack_names_the_line_of_a_plug_in() -> None:
    text = STACK.format(library=threading.__file__)
    assert place_in(Stack(text)) == "in exchange (driver.py, line 44)"
    assert place_in(Stack(text.replace("/lab/driver.py", json.__file__))) == ""
    assert len(Stack(text, current=True)) == 1
    waits = text.replace(f'{threading.__file__}", line 629', f'{plug_ins.__file__}", line 1')
    assert place_in(Stack(waits)) == "in exchange (driver.py, line 44)"
    assert place_in(Stack(waits), waits_count=False) == ""
    assert not Stack(text).is_debugged


def test_a_debugger_of_python_is_seen_in_a_stack() -> None:
    assert Stack(STACK.format(library="/usr/lib/python3.11/pdb.py")).is_debugged
    assert is_debugged(["/x/debugpy/_vendored/pydevd/pydevd.py"])


def test_plug_in_error_keeps_a_device_error() -> None:
    lost = LinkLost("rails", "gone")
    assert plug_in_error("vmu", lost) is lost
