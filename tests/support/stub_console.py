"""A console whose session is a stub: it answers each message at once, and keeps what it was sent."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import uvicorn

from hil.core.messages import CYCLE, Homing
from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from hil.parts.console.app import make_app
from hil.parts.console.service import ConsoleService
from hil.parts.console.session import Choice
from hil.parts.console.session_state import SessionState, bench_description
from hil.parts.console.status import MODES, empty_status
from hil.parts.console.strangers import Access
from hil.parts.console.tuner import Tuner

FAULTS = {"rails": {"kinds": {"stuck": {"of_axis": True, "value": "s", "default": 1.0}}, "axes": ["x", "y", "z"]}}
OPEN = Access()
CHOICE = Choice(scenario="scheme-1", rig="mock")


class StubSession:
    """A session that is open in ``mode``; orders that its mode allows are taken once they are confirmed."""

    ready, ended, pid, file, rings = True, False, 0, "", {}

    def __init__(self, service: ConsoleService) -> None:
        self.mode = Mode.RUNNING
        self.orders: list[str] = []
        self.sent: list[dict[str, Any]] = []
        self._number = 0
        job = CHOICE.job()
        service.state = SessionState(bench_description(job.rig.value, job.scenario.value), "")
        service.view.begin(job)
        service.tuner = Tuner(job)
        service.faults.menu, service.faults.on = FAULTS, {"rails": "none"}
        service.session = self  # type: ignore[assignment]
        service.changed()

    async def ask(self, **message: Any) -> str:
        return str((await self.request(**message))["text"])

    async def request(self, **message: Any) -> dict[str, Any]:
        self.sent.append(message)
        word = message.get("order")
        if word is None:
            return {"text": ""}
        command = OperatorCommand(word)
        if self.mode not in command.modes:
            return {"text": f"bench: cannot {word} in {self.mode.value}"}
        if command.question and not message.get("confirmed"):
            return {"text": "", "ask": command.question, "mode": self.mode.value}
        self.orders.append(word)
        return {"text": ""}

    def send(self, **message: Any) -> bool:
        self.sent.append(message)
        return True

    def read_status(self) -> tuple[int, np.ndarray]:
        self._number += 1
        status = empty_status()
        status["mode"], status["homing"] = MODES.index(self.mode), Homing.DONE
        return self._number, status

    def read_rows(self, ring: str = "telemetry") -> np.ndarray:
        return np.empty(0, CYCLE)

    def read_pictures(self) -> list[np.ndarray]:
        return []

    def read_recording(self) -> None:
        return None

    def poll_exit(self) -> None:
        pass

    def interrupt(self) -> None:
        self.orders.append("interrupt")

    async def close(self) -> None:
        pass


@contextmanager
def stub_console(access: Access = OPEN) -> Iterator[tuple[str, ConsoleService, StubSession]]:
    """Serve a console with an open stub in a thread; give its address, its service and the stub."""
    loop = asyncio.new_event_loop()
    service = ConsoleService(CHOICE, ["scheme-1", "scheme-2"], ["mock", "emulated"], loop.time)
    service.lease.timeout_s = 60.0
    stub = StubSession(service)
    listener = socket.create_server(("127.0.0.1", 0))
    config = uvicorn.Config(
        make_app(service, access, None), log_level="error", ws="websockets-sansio", timeout_graceful_shutdown=1
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=lambda: loop.run_until_complete(server.serve([listener])), daemon=True)
    thread.start()
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}", service, stub
    finally:
        server.should_exit = True
        thread.join(10.0)
        loop.close()
