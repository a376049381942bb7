"""URL ``lockstep://PATH``: a serial port whose bytes are counted in the running event loop of a bench in lock-step."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import Any

from hil.parts.emulation.counted_serial import CountedSerial
from hil.parts.emulation.lock_step_asyncio import LockStepEventLoop


def serial_class_for_url(url: str) -> tuple[str, Any]:
    """Return the path of the port and what makes its object, which is not open yet (called by pyserial)."""
    loop = asyncio.get_running_loop()
    assert isinstance(loop, LockStepEventLoop)
    return url.partition("://")[2], partial(CountedSerial, loop.clock, wires=loop.wires)
