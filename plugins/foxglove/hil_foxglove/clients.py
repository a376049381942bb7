"""Clients in Foxglove, on the side of the console: their process, their requests and what they get to see.

A request of a client is executed as that of a page: the same lease, the same checks, the same answers. As the
protocol has no authentication, and pages of other sites can connect to this computer, the command is given only for the
console's code. A panel cannot send back when the bench was seen, as a page does: an order without ``seen_s`` counts if
it repeats two digits that were sent at most 5 s before, which no message held by the network does.
"""

from __future__ import annotations

import asyncio
import importlib.util
import json
import secrets
import socket
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

from hil.config.load import configs_folder
from hil.core.child_process import ChildProcess
from hil.core.operator_commands import ANSWER_S, FreshDigits
from hil.errors import BadInput
from hil.parts.console.lease import RequestRejected
from hil.parts.console.live_view import Client
from hil.parts.console.service import WITHOUT_COMMAND, ConsoleService
from hil.parts.console.session_process import SessionProcess
from hil.parts.console.strangers import GuessLimiter
from hil_foxglove.server import OPTION

_PACKET: Final = 1 << 16
_READY_WALL_S: Final = 30.0
_BENCH_PERIOD_S: Final = 0.1
_EXIT_WALL_S: Final = 1.0
_CLIENTS_MAX: Final = 64
_NAME_MAX: Final = 24
_ADDRESS: Final = "foxglove"


class FoxgloveClients:
    """Viewer of a console: the process of the server for Foxglove on ``port`` of this computer.

    Raises BadInput if it cannot listen, or the SDK is not installed.

    code: required of a client that takes the command, None if none may.
    """

    def __init__(self, port: int, code: str | None, log: Callable[[str], None]) -> None:
        if importlib.util.find_spec("foxglove") is None:
            raise BadInput.single(OPTION, "", "foxglove-sdk missing: pip install foxglove-sdk")
        if not 0 <= port <= 65535:
            raise BadInput.single(OPTION, "", f"{port}: allowed 0 to 65535, 0 for any free port")
        self._log = log
        self._guesses = GuessLimiter(code) if code is not None else None
        self._rights = "watch" if code is None else "command"
        self._clients: dict[int, Client] = {}
        self._digits: defaultdict[int, FreshDigits] = defaultdict(FreshDigits)
        self._tasks: set[asyncio.Task[None]] = set()
        self._session: SessionProcess | None = None
        self._page_seen = -1
        self._settings: list[dict[str, Any]] = []
        self._sent_s = 0.0
        self._channel, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._channel.setblocking(False)
        with there:
            configuration = {"port": port, "channel": there.fileno()}
            self._child = ChildProcess("foxglove", "hil_foxglove", configuration, (there.fileno(),), new_session=True)
        ready = self._child.wait_ready(_READY_WALL_S)
        if ready["problem"]:
            self.close()
            raise BadInput.single(OPTION, "", ready["problem"])
        self.address: str = ready["address"]

    @property
    def notes(self) -> list[str]:
        """Lines for the operator in addition to the address."""
        return [f"layout for it: {configs_folder() / 'foxglove' / 'layout.json'}"]

    def attach(self, service: ConsoleService) -> None:
        """Serve the clients by ``service``, in the present event loop."""
        self._service = service
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._channel, self._receive)

    def tick(self) -> None:
        """Send what has changed; called about 20 times per second."""
        if self._channel.fileno() < 0:
            return
        service, now_s = self._service, self._service.wall_s()
        session = service.session if service.session is not None and service.session.ready else None
        if session is not self._session and (
            self._send({"session": None}) if session is None else self._share(session)
        ):
            self._session = session
        if service.page_version != self._page_seen:
            self._page_seen = service.page_version
            settings = service.tuner.available() if service.tuner is not None and session is not None else []
            if settings != self._settings:
                self._settings = settings
                self._send({"settings": [{key: one[key] for key in ("key", "value")} for one in settings]})
        if now_s - self._sent_s >= _BENCH_PERIOD_S:
            self._sent_s = now_s
            self._send({"bench": self._bench(now_s)})

    def _bench(self, now_s: float) -> dict[str, Any]:
        service = self._service
        live = service.state.live(now_s)
        numbers = {name: live.get(name) for name in ("run_s", "bench_s", "rail_m", "gimbal_deg")}
        return {
            "wall_s": now_s,
            "mode": service.mode.value,
            "open": service.session is not None,
            "ready": self._session is not None,
            "holder": service.lease.name,
            **numbers,
            "overruns": live.get("overruns", 0),
            "hold_reason": service.state.hold_reason,
            "text": service.state.status_text,
            "alarms": [alarm["text"] for alarm in service.state.alarms if not alarm["acknowledged"]],
        }

    def _share(self, session: SessionProcess) -> bool:
        """Send the descriptors of the session's shared memory; return whether they were sent."""
        rings = {("cycles" if name == "telemetry" else name): ring for name, ring in session.rings.items()}
        shared = {name: ring.descriptor for name, ring in rings.items()}
        shared["run_time"] = session.run_time
        about = {
            "slots": {name: ring.slots for name, ring in rings.items()},
            "shared": list(shared),
            "clock": session.clock,
            "files": {"scenario.json": session.choice.job().scenario.value.model_dump_json()},
        }
        return self._send({"session": about}, list(shared.values()))

    def _send(self, message: dict[str, Any], descriptors: Sequence[int] = ()) -> bool:
        """Send one packet; return whether it was sent: a process that does not read misses it."""
        packet = json.dumps(message, allow_nan=False).encode()
        try:
            socket.send_fds(self._channel, [packet], list(descriptors))
        except OSError:
            return False
        return True

    def _receive(self) -> None:
        try:
            packet = self._channel.recv(_PACKET)
        except BlockingIOError:
            return
        except OSError:
            packet = b""
        if not packet:
            self._end()
            return
        message = json.loads(packet)
        if "alive" in message:
            self._keep(set(message["alive"]))
        if "call" in message:
            task = self._loop.create_task(self._answer(message))
            self._tasks.add(task)
            task.add_done_callback(self._tasks.discard)

    def _keep(self, alive: set[int]) -> None:
        """Renew the lease of clients that watch; forget the others, whose lease expires."""
        for number in [number for number in self._clients if number not in alive]:
            if not self._service.lease.held_by(self._clients[number]):
                del self._clients[number]
        for number in alive & set(self._clients):
            self._service.refresh(self._clients[number])

    async def _answer(self, message: dict[str, Any]) -> None:
        client = self._client(message["client"])
        reply = await self._execute(client, message["request"])
        self._send({"answer": message["call"], "reply": reply})

    def _client(self, number: int) -> Client:
        if number not in self._clients:
            while len(self._clients) >= _CLIENTS_MAX:
                del self._clients[next(iter(self._clients))]
            self._clients[number] = Client(secrets.token_hex(), f"Foxglove client {number}", rights=self._rights)
        return self._clients[number]

    async def _execute(self, client: Client, request: dict[str, Any]) -> dict[str, Any]:
        """Execute the request of a client, after its code if it asks for the command."""
        try:
            if request["do"] in ("take", "take_over"):
                if self._guesses is None:
                    return {"ok": False, "text": "Foxglove watches: operators have keys, take the command at a page"}
                self._guesses.check(str(request.pop("code", "")), _ADDRESS, self._service.wall_s())
                name = "".join(c for c in str(request.pop("name", "")) if c.isprintable()).strip()[:_NAME_MAX]
                client.name = name or client.name
        except RequestRejected as error:
            where = "the console prints it at its start, or has it in its token file"
            return {"ok": False, "text": f"code: wrong or missing ({error}): {where}"}
        if "seen_s" not in request and request.get("order") not in WITHOUT_COMMAND:
            if request["do"] == "jog":
                return {"ok": False, "text": "jog: seen_s is missing: wall_s of the newest message of /bench"}
            if request["do"] in ("order", "open", "adjust"):
                return await self._confirm(client, request)
        return await self._service.execute(client, {**request, "number": client.requests + 1})

    async def _confirm(self, client: Client, request: dict[str, Any]) -> dict[str, Any]:
        """Execute an order that repeats the digits sent last; ask for them if it has a question."""
        digits, typed = self._digits[client.number], str(request.pop("confirmed", ""))
        refusal = digits.refusal(typed) if typed else ""
        confirmed = {"confirmed": True} if typed and not refusal else {}
        answer = await self._service.execute(client, {**request, **confirmed, "number": client.requests + 1})
        if "ask" in answer:
            answer["text"] = refusal and f"not taken: the answer {refusal}"
            answer["ask"] += f" Send confirmed {digits.drawn()} within {ANSWER_S:g} s."
        return answer

    def _end(self) -> None:
        """Report that the process has ended; the console and its session continue."""
        self._loop.remove_reader(self._channel)
        self._channel.close()
        self._child.wait_end(_EXIT_WALL_S)
        how = self._child.exit_status() or "closed its channel"
        self._log(f"foxglove: its process {how}; console and bench continue{self._child.last_stderr()}")

    def close(self) -> None:
        """End the process. Idempotent."""
        if self._channel.fileno() >= 0:
            with suppress(AttributeError):
                self._loop.remove_reader(self._channel)
            self._channel.close()
        self._child.close(_EXIT_WALL_S)
