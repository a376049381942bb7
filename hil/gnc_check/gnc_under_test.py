"""The GNC that is checked: a shared library, or a program at the other end of a link."""

from __future__ import annotations

import time
from typing import Final, Protocol

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, GncMode, GncState
from hil.core.messages import new
from hil.errors import DeviceError, LinkTimeout
from hil.frmn.link import Arrival, Link
from hil.frmn.udp import shown
from hil.gnc_backends import library_call
from hil.gnc_backends.library_file import Instance, Library

_AGAIN_S: Final = 0.1  # from one setup that is not answered to the next
_PATIENCE_S: Final = 2.0  # for an answer; a datagram may be lost: it is sent again on the way
_RESEND_S: Final = 0.5


class GncUnderTest(Protocol):
    """Who is checked."""

    name: str
    modes: tuple[GncMode, ...]
    """Modes that it is told of before time runs."""

    def begin(self, setup: np.record) -> None:
        """Begin anew with ``setup`` (GNC_SETUP). Raises BadInput or BenchError."""

    def ask(self, told: np.record) -> tuple[np.record, float]:
        """Return GNC_OUTPUT, valid until the next call, and how long, s, the answer took. Raises BenchError."""

    def close(self) -> None:
        """Let go of it."""


class LibraryPartner:
    """A shared library, each time with a new instance. It is asked as in a run: while time runs or is held."""

    modes: tuple[GncMode, ...] = ()

    def __init__(self, path: str, source: str) -> None:
        self._library = Library(path, source)
        self.name = self._library.name
        self._instance: Instance | None = None
        self._output = new(GNC_OUTPUT)
        library_call.compile_step(new(GNC_INPUT), self._output)

    def begin(self, setup: np.record) -> None:
        """Make a new instance."""
        self.close()
        self._instance = self._library.open(setup)

    def ask(self, told: np.record) -> tuple[np.record, float]:
        """Call the library's step."""
        assert self._instance is not None
        begun_s = time.perf_counter()
        code = library_call.step(self._library.step_address, self._instance.address, told, self._output)
        took_s = time.perf_counter() - begun_s
        if code != 0:
            raise DeviceError(self.name, f"its step returned {code}")
        return self._output, took_s

    def close(self) -> None:
        """Let the library free the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None


class LinkPartner:
    """A program that speaks datagrams, see docs/protocols.md. It is told each mode, and set up anew for each case."""

    modes: tuple[GncMode, ...] = (GncMode.STANDBY, GncMode.ARMED)

    def __init__(self, link: Link, wait_s: float) -> None:
        self.name = "gnc"
        self._link = link
        self._wait_s = wait_s
        self._block = np.zeros(1, GNC_OUTPUT).view(np.recarray)

    def begin(self, setup: np.record) -> None:
        """Send ``setup`` until the GNC acknowledges it and works. Raises LinkTimeout that says where it waited."""
        give_up_s, sent_s = time.monotonic() + self._wait_s, -_AGAIN_S
        while True:
            self._link.service()
            now_s = time.monotonic()
            there = self._link.peer is not None or self._link.expects
            if there and now_s - sent_s >= _AGAIN_S:
                sent_s = now_s
                self._link.send("gnc.setup", setup)
            self._link.wait(_AGAIN_S / 2)
            for output in self._outputs():
                if output["cycle"] == -1 and output["state"] != GncState.STARTING:
                    self._settle()
                    return
            if now_s > give_up_s:
                raise LinkTimeout(self.name, f"none has answered {shown(self._link.address)} within {self._wait_s:g} s")

    def ask(self, told: np.record) -> tuple[np.record, float]:
        """Send ``told`` and wait for the next output. Raises LinkTimeout."""
        self._link.service()
        list(self._outputs())  # what came late belongs to nothing any more
        begun_s = resend_s = time.perf_counter()
        self._link.send("gnc.input", told)
        while True:
            self._link.wait(_RESEND_S)
            now_s = time.perf_counter()
            for output in self._outputs():
                self._block[0] = output
                return self._block[0], now_s - begun_s
            if now_s - begun_s > _PATIENCE_S:
                text = f"has not answered cycle {told.cycle} ({GncMode(told.mode).name}) for {_PATIENCE_S:g} s"
                raise LinkTimeout(self.name, text)
            if now_s - resend_s > _RESEND_S:
                resend_s = now_s
                self._link.send("gnc.input", told)

    def close(self) -> None:
        """Say goodbye."""
        self._link.close("the check is over")

    def _settle(self) -> None:
        """Let answers to setups that were sent twice come and go."""
        while self._link.wait(_AGAIN_S / 2):
            self._outputs()

    def _outputs(self) -> list[np.void]:
        return [self._output_in(arrival) for arrival in self._link.poll() if arrival.name == "gnc.output"]

    @staticmethod
    def _output_in(arrival: Arrival) -> np.void:
        output: np.void = arrival.record[0]
        return output


def check_link(bind: tuple[str, int] | None, peer: tuple[str, int] | None) -> Link:
    """Return a link of which this side plays the bench's part."""
    from hil.frmn.mailboxes import Role

    return Link(Role.DSS, "hil gnc check", ("gnc.setup", "gnc.input"), ("gnc.output",), bind, peer, _PATIENCE_S)
