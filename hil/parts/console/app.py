"""Web application of the console: the page, and its websocket with authentication, requests and updates."""

from __future__ import annotations

import asyncio
import hmac
import json
import signal
import traceback
from collections.abc import AsyncIterator, Coroutine, Sequence
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI, WebSocket, WebSocketDisconnect
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from starlette.requests import HTTPConnection

from hil.core.files import parse_json
from hil.core.operator_keys import OperatorKey, new_challenge, new_key
from hil.parts.console.lease import RequestRejected
from hil.parts.console.live_view import Client
from hil.parts.console.message import pack
from hil.parts.console.service import ConsoleService
from hil.parts.console.strangers import Access, FairSlots, GuessLimiter
from hil.parts.console.viewers import Viewer

PAGE: Final = Path(__file__).parent / "page"
TICK_S: Final = 0.05
_REQUEST_PERIOD_S: Final = 0.01  # of one client; a page sends a few per second
_HELLO_TIMEOUT_WALL_S: Final = 5.0
_REFUSED: Final = 4401
_TOO_LATE: Final = 4408  # the page connects again
_LONGEST_TEXT: Final = 4096
_LONGEST_NAME: Final = 24
_LONGEST_KEY: Final = 256
_STRANGERS_MAX: Final = 16  # sockets whose first message is awaited
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob:; style-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


def make_app(
    service: ConsoleService,
    access: Access,
    hosts: frozenset[str] | None,
    viewers: Sequence[Viewer] = (),
) -> FastAPI:
    """Return the application. access: what is required of each client. hosts: host names accepted in requests,
    None for any; on loopback they prevent access by other sites' pages through a rebound name. viewers: served by
    ``service`` as well."""

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        for viewer in viewers:
            viewer.attach(service)
        ticking = asyncio.create_task(_keep_ticking(service, updated, viewers))
        ticking.add_done_callback(_exit_on_error)
        yield
        ticking.cancel()
        with suppress(asyncio.CancelledError):
            await ticking
        await service.close()

    updated = asyncio.Condition()
    authenticator = Authenticator(access, hosts, service)
    app = FastAPI(lifespan=life, docs_url=None, redoc_url=None, openapi_url=None)

    @app.middleware("http")
    async def _check_host(request: Any, call_next: Any) -> Any:
        if not _is_known_host(request, hosts):
            from fastapi.responses import PlainTextResponse

            return PlainTextResponse("hil console: unknown host name\n", status_code=421)
        response = await call_next(request)
        response.headers.update(_HEADERS)
        return response

    @app.get("/")
    async def _page() -> FileResponse:
        return FileResponse(PAGE / "index.html")

    @app.websocket("/ws")
    async def _websocket(socket: WebSocket) -> None:
        await _serve_client(socket, service, authenticator, updated)

    app.mount("/page", StaticFiles(directory=PAGE), name="page")
    return app


async def _keep_ticking(service: ConsoleService, updated: asyncio.Condition, viewers: Sequence[Viewer]) -> None:
    while True:
        service.tick()
        for viewer in viewers:
            viewer.tick()
        async with updated:
            updated.notify_all()
        await asyncio.sleep(TICK_S)


def _exit_on_error(ticking: asyncio.Task[None]) -> None:
    """End a console whose tick has failed: the loop receives no messages then, and reacts as its rig requires."""
    if not ticking.cancelled() and (error := ticking.exception()) is not None:
        traceback.print_exception(error)
        signal.raise_signal(signal.SIGINT)


_UNKNOWN: Final = new_key("unknown")
"""Checked for an operator without a key, so that the answer takes as long as for a wrong proof."""


class Authenticator:
    """Authenticates clients: see ``make_app``. Bounds those that have not authenticated, fairly among addresses."""

    def __init__(self, access: Access, hosts: frozenset[str] | None, service: ConsoleService) -> None:
        self._hosts = hosts
        self._service = service
        self._operators = access.operators
        self._strangers: FairSlots[asyncio.Event] = FairSlots(_STRANGERS_MAX)
        self._guesses = GuessLimiter(access.token) if access.token is not None else None

    async def admit(self, socket: WebSocket) -> Client:
        """Return the client of a valid first message.

        Raises RequestRejected, TimeoutError if none comes in time, as through a network that stalls, or
        WebSocketDisconnect.
        """
        if not (_is_known_host(socket, self._hosts) and _is_own_page(socket)):
            raise RequestRejected("this console rejects pages of other sites")
        address = socket.client.host if socket.client is not None else ""
        displaced, challenge = asyncio.Event(), new_challenge()
        required = "key" if self._operators else "token" if self._guesses else ""
        await socket.send_text(json.dumps({"challenge": challenge, "required": required}))
        if (oldest := self._strangers.enter(displaced, address)) is not None:
            oldest.set()
        try:
            hello = _table(await _before(displaced, _receive_text(socket)))
        finally:
            self._strangers.leave(displaced)
        if hello is None:
            text = 'the first message must be {"key": ..., "name": ..., "token": ...}, or with operator and proof'
            raise RequestRejected("too many clients: try again" if displaced.is_set() else text)
        key, name, given, device = (str(hello.get(field, "")) for field in ("key", "name", "token", "device"))
        page, origin = str(hello.get("page", ""))[:_LONGEST_KEY], (address, device[:_LONGEST_KEY])
        if self._operators:
            client = self._operator(hello, challenge, socket.headers.get("host", ""), origin)
            client.page = page
            return client
        if self._guesses is not None:
            if not given:
                raise RequestRejected("this console requires a token")
            self._guesses.check(given, address, self._service.wall_s())
        if not 16 <= len(key) <= _LONGEST_KEY:
            raise RequestRejected("key: at least 16 random characters")
        return Client(key, plain_name(name) or "unnamed", origin=origin, page=page)

    def _operator(self, hello: dict[str, Any], challenge: str, host: str, origin: tuple[str, str]) -> Client:
        """Return the client of an operator who proves a key; raise RequestRejected.

        A key is accepted at one computer and browser at a time: a copy of it elsewhere is turned away while it is in
        use, and both places are logged.
        """
        operator, client, proof = (str(hello.get(field, "")) for field in ("operator", "key", "proof"))
        key = self._operators.get(operator)
        expected = (key or _UNKNOWN).proof(challenge, host, client)
        if not hmac.compare_digest(proof.encode(errors="replace"), expected.encode()) or key is None:
            raise RequestRejected("this console requires the key of an operator: choose its file")
        if key.addresses and origin[0] not in key.addresses:
            return self._turn_away(key, f"is not accepted from {origin[0]}, only from {', '.join(key.addresses)}")
        elsewhere = next((c for c in self._service.clients if c.key_id == key.id and c.origin != origin), None)
        if elsewhere is not None:
            at = f"{elsewhere.origin[0]}{'' if elsewhere.origin[0] != origin[0] else ' by another browser'}"
            return self._turn_away(key, f"was refused from {origin[0]}: it is in use at {at}")
        return Client(key.id, key.name, key.id, key.rights, origin)

    def _turn_away(self, key: OperatorKey, text: str) -> Client:
        self._service.log(f"the key of {key.name} {text}; if that is a copy, replace the key")
        raise RequestRejected(f"the key of {key.name} {text}")


async def _before(event: asyncio.Event, message: Coroutine[Any, Any, str]) -> str:
    """Return ``message``; "" if ``event`` comes before. Raises TimeoutError if neither comes in time."""
    waiting = [asyncio.ensure_future(message), asyncio.ensure_future(event.wait())]
    try:
        done, _ = await asyncio.wait(waiting, timeout=_HELLO_TIMEOUT_WALL_S, return_when=asyncio.FIRST_COMPLETED)
        if not done:
            raise TimeoutError
        return str(waiting[0].result()) if waiting[0].done() else ""
    finally:
        for each in waiting:
            each.cancel()


async def _serve_client(
    socket: WebSocket, service: ConsoleService, authenticator: Authenticator, updated: asyncio.Condition
) -> None:
    """Authenticate one client; then send updates and execute its requests until it disconnects."""
    await socket.accept()
    try:
        client = await authenticator.admit(socket)
    except RequestRejected as error:
        await _reject(socket, str(error))
        return
    except TimeoutError:
        with suppress(WebSocketDisconnect, RuntimeError):
            await socket.close(_TOO_LATE, f"no first message within {_HELLO_TIMEOUT_WALL_S:g} s")
        return
    except WebSocketDisconnect:
        return
    service.admit(client)
    tasks = [
        asyncio.create_task(_send_updates(socket, service, client, updated)),
        asyncio.create_task(_receive(socket, service, client)),
        asyncio.create_task(client.displaced.wait()),
    ]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        results = await asyncio.gather(*tasks, return_exceptions=True)
        service.dismiss(client)
    if client.displaced.is_set():
        await _reject(
            socket, "displaced: another operator came, and this page had been idle for longer than all others"
        )
    for result in results:
        if isinstance(result, Exception) and not isinstance(result, (WebSocketDisconnect, RuntimeError)):
            raise result  # an internal error: the client is disconnected and the server logs it


def plain_name(name: str) -> str:
    """Return ``name`` for terminals, recordings and pages: printable characters of a valid encoding, 24 at most."""
    return "".join(c for c in name if c.isprintable()).strip()[:_LONGEST_NAME]


async def _receive_text(socket: WebSocket) -> str:
    """Return the next message, "" for one that is not text."""
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1000))
    return message.get("text") or ""


def _table(text: str) -> dict[str, Any] | None:
    """Return the JSON object in ``text``; None for anything else, for one that is too long or nested too deeply."""
    try:
        message = parse_json(text) if len(text) <= _LONGEST_TEXT else None
    except ValueError:
        return None
    return message if isinstance(message, dict) else None


async def _reject(socket: WebSocket, reason: str) -> None:
    """Send the reason and close the socket."""
    with suppress(WebSocketDisconnect, RuntimeError):
        await socket.send_text(json.dumps({"refused": reason}))
        await socket.close(_REFUSED, reason)


async def _send_updates(socket: WebSocket, service: ConsoleService, client: Client, updated: asyncio.Condition) -> None:
    """Send the newest state on each update; a slow client gets fewer messages, never outdated ones."""
    while True:
        async with updated:
            await updated.wait()
        if not client.congested:
            client.sent += 1
            await socket.send_bytes(pack(*service.update_for(client)))


async def _receive(socket: WebSocket, service: ConsoleService, client: Client) -> None:
    """Execute the requests of ``client``, at a bounded rate: a flood waits in its own connection."""
    while True:
        await asyncio.sleep(_REQUEST_PERIOD_S)
        message = _table(await _receive_text(socket))
        if message is None:
            await socket.send_text(json.dumps({"answer": None, "ok": False, "text": "not a JSON object, or too long"}))
            continue
        service.refresh(client, message.get("got"))
        if message.get("do") == "beat":
            if isinstance(message.get("sent_ms"), int | float):
                await socket.send_text(json.dumps({"beat": message["sent_ms"], "wall_s": service.wall_s()}))
            continue
        client.acted_s = service.wall_s()
        answer = await service.execute(client, message)
        if message.get("id") is not None or not answer["ok"]:
            await socket.send_text(json.dumps({"answer": message.get("id"), **answer}))


def _is_known_host(connection: HTTPConnection, hosts: frozenset[str] | None) -> bool:
    """Return whether the request names an accepted host: other names may be rebound to this address."""
    return hosts is None or connection.url.hostname in hosts


def _is_own_page(socket: WebSocket) -> bool:
    """Return whether the page was served by this console; programs other than browsers send no origin."""
    origin = socket.headers.get("origin")
    return origin is None or origin.partition("://")[2] == socket.headers.get("host")
