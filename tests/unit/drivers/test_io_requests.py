"""Requests to a process that has ended: the loss is named, and closing the line loses nothing else."""

from __future__ import annotations

import socket

import pytest

from hil.core.clock import WallClock
from hil.drivers.remote.requests import IoRequests
from hil.errors import LinkLost


def test_line_to_a_process_that_has_ended_closes() -> None:
    here, there = socket.socketpair()
    requests = IoRequests(here, "IO", WallClock())
    there.close()
    with pytest.raises(LinkLost, match=r"^rails: IO process has ended"):
        requests.request("open", "rails")
    requests.close()
    requests.close()
    assert here.fileno() == -1
