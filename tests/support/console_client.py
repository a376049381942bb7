"""``hil console`` as a process, and a client of its websocket that is no browser."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect

from hil.core.operator_keys import OperatorKey
from hil.parts.console.columns import INDEX
from hil.parts.console.message import unpack
from tests.support.run_settings import typed

_PATIENCE = {
    "rig.console.lease_s": "30",
    "rig.io.timeout_s": "10",
    "rig.io.pump_timeout_s": "5",
    "rig.safety.command_age_max_s": "10",
    **{f"rig.{device}.timeout_s": "10" for device in ("rails", "turntable", "vmu")},
    **{f"rig.{device}.lost_packets_max": "1e6" for device in ("rails", "turntable", "vmu")},
}
PATIENT = typed(*(f"{key}={value}" for key, value in _PATIENCE.items()))
"""For tests of the page: a browser that draws in software starves the threads that emulated wires go through."""


class Console:
    """A console that listens at ``address``, and its pages."""

    def __init__(self, address: str, process: subprocess.Popen[str], pages: ExitStack, scheme: str = "ws") -> None:
        self.address = address
        self._scheme = scheme
        self.process = process
        self._pages = pages

    def page(
        self, name: str, token: str = "", key: str | None = None, operator: OperatorKey | None = None, **options: Any
    ) -> Page:
        """Return a new page, open until the console ends. operator: key that it proves."""
        socket = connect(
            f"{self._scheme}://{self.address}/ws", max_size=None, open_timeout=60.0, close_timeout=0.1, **options
        )
        page = Page(self._pages.enter_context(socket))
        with suppress(ConnectionClosed):  # turned away at once: the reason is there to be read
            page.socket.send(json.dumps(hello(page.challenge(), self.address, key or name * 8, operator, name, token)))
        return page


def hello(challenge: str, host: str, key: str, operator: OperatorKey | None, name: str, token: str) -> dict[str, str]:
    """Return the first message of a client at ``host``."""
    if operator is None:
        return {"key": key, "name": name, "token": token}
    return {"key": key, "operator": operator.id, "proof": operator.proof(challenge, host, key)}


@contextmanager
def console(*arguments: str, record: Path | None = None) -> Iterator[Console]:
    """Start ``hil console`` on a free port; give it once it listens; it is ended by Ctrl-C. record: folder."""
    recording = ["--no-record"] if record is None else ["--record", str(record)]
    command = [sys.executable, "-m", "hil", "console", "--port", "0", *recording, *arguments]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True) as process, ExitStack() as pages:
        try:
            assert process.stderr is not None
            line = process.stderr.readline()
            found = re.match(r"console on http(s?)://(\S+)/", line)
            assert found, line + process.stderr.read()
            yield Console(found[2], process, pages, f"ws{found[1]}")
            process.send_signal(signal.SIGINT)
            process.communicate(timeout=30.0)
        finally:
            process.kill()


class Page:
    """One client; ``now``, ``page``, ``picture`` and ``rows`` are what came last, and all rows of the session."""

    def __init__(self, socket: ClientConnection) -> None:
        self.socket = socket
        self.now: dict[str, Any] = {}
        self.page: dict[str, Any] = {}
        self.rows = np.empty((0, len(INDEX)), "<f4")
        self.picture: dict[str, Any] = {}
        self.refused = ""
        self.first: dict[str, Any] = {}
        self.beats = True
        self._number = 0

    def challenge(self) -> str:
        """Return the challenge, which is the first message unless the client is turned away at once."""
        first = json.loads(self.socket.recv(10.0))
        if "challenge" not in first:
            self.first = first
        return str(first.get("challenge", ""))

    def take(self, timeout_s: float = 10.0) -> dict[str, Any] | None:
        """Take one message; return an answer, None for anything else."""
        if self.first:
            self.refused, first, self.first = self.first["refused"], self.first, {}
            return first
        try:
            message = self.socket.recv(timeout_s)
        except ConnectionClosed:
            return {"closed": True}
        if isinstance(message, str):
            told: dict[str, Any] = json.loads(message)
            self.refused = told.get("refused", "")
            return told
        header, rows, _ = unpack(message)
        self.now, self.page = header["now"], header.get("page", self.page)
        self.picture = header.get("picture", self.picture)
        self.rows = rows if header["first"] == 0 else np.concatenate([self.rows, rows])
        if self.beats:
            self.socket.send('{"do": "beat"}')
        return None

    def ask(self, do: str, **more: Any) -> dict[str, Any]:
        """Ask for something; return the answer."""
        self.look()
        self._number += 1
        seen = {"seen_s": self.now.get("wall_s"), "number": self._number}
        self.socket.send(json.dumps({"do": do, "id": self._number, **seen, **more}))
        while True:
            answer = self.take()
            if answer is not None:
                assert answer.get("answer") == self._number, answer
                return answer

    def look(self) -> None:
        """Take what has come, and one more update: the newest one."""
        if not self.beats:
            return
        with suppress(TimeoutError):
            while self.take(0.0) != {"closed": True}:
                pass
        with suppress(TimeoutError):
            self.take(1.0)

    def order(self, word: str) -> None:
        """Order something and confirm it; it must be taken."""
        answer = self.ask("order", order=word, confirmed=True)
        assert answer["ok"], answer

    def until(self, condition: Callable[[], bool], what: str, wall_s: float = 90.0) -> None:
        """Take messages until ``condition`` holds."""
        end_s = time.monotonic() + wall_s
        while not (self.now and condition()):
            assert time.monotonic() < end_s, f"{what} did not come: {self.now}, {self.page.get('log', [])[-5:]}"
            self.take()

    def until_mode(self, mode: str) -> None:
        self.until(lambda: self.now["mode"] == mode, mode)

    def start_run(self) -> None:
        """Open the bench, arm it and close the loop, with the command taken before."""
        assert self.ask("open", confirmed=True)["ok"]
        self.until_mode("standby")
        self.order("arm")
        self.until_mode("armed")
        self.order("start")
        self.until(lambda: self.now["mode"] == "running" and self.now["run_s"] > 0.5, "a run")

    def column(self, name: str) -> np.ndarray:
        """Return all values of one column."""
        values: np.ndarray = self.rows[:, INDEX[name]]
        return values

    def log(self) -> list[str]:
        return [line["text"] for line in self.page["log"]]
