"""Web application of the console: the page, and its websocket with authentication, requests and updates."""

from __future__ import annotations

import asyncio
import hmac
import json
import signal
import traceback
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI, WebSocket, WebSocketDisconnect
from fastapi.responses import FileResponse
from fastapi.staticfiles import StaticFiles
from starlette.requests import HTTPConnection

from hil.console.live_view import Client
from hil.console.message import pack
from hil.console.service import ConsoleService
from hil.core.files import parse_json

PAGE: Final = Path(__file__).parent / "page"
TICK_S: Final = 0.05
_HELLO_TIMEOUT_WALL_S: Final = 5.0
_WRONG_TOKEN_DELAY_WALL_S: Final = 0.5
_REFUSED: Final = 4401
_LONGEST_TEXT: Final = 4096
_LONGEST_NAME: Final = 24
_LONGEST_KEY: Final = 256
_CLIENTS_MAX: Final = 32
_STRANGERS_MAX: Final = 16  # sockets without a valid first message, at a time
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob:; style-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


def make_app(service: ConsoleService, token: str | None, hosts: frozenset[str] | None) -> FastAPI:
    """Return the application. token: required of each client, None for none. hosts: host names accepted in requests,
    None for any; on loopback they prevent access by other sites' pages through a rebound name."""

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        ticking = asyncio.create_task(_keep_ticking(service, updated))
        ticking.add_done_callback(_exit_on_error)
        yield
        ticking.cancel()
        with suppress(asyncio.CancelledError):
            await ticking
        await service.close()

    updated = asyncio.Condition()
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
        await _serve_client(socket, service, token, hosts, updated)

    app.mount("/page", StaticFiles(directory=PAGE), name="page")
    return app


async def _keep_ticking(service: ConsoleService, updated: asyncio.Condition) -> None:
    while True:
        service.tick()
        async with updated:
            updated.notify_all()
        await asyncio.sleep(TICK_S)


def _exit_on_error(ticking: asyncio.Task[None]) -> None:
    """End a console whose tick has failed: the loop receives no messages then, and reacts as its rig requires."""
    if not ticking.cancelled() and (error := ticking.exception()) is not None:
        traceback.print_exception(error)
        signal.raise_signal(signal.SIGINT)


async def _serve_client(
    socket: WebSocket,
    service: ConsoleService,
    token: str | None,
    hosts: frozenset[str] | None,
    updated: asyncio.Condition,
) -> None:
    """Authenticate one client; then send updates and execute its requests until it disconnects."""
    await socket.accept()
    if service.strangers >= _STRANGERS_MAX or len(service.clients) >= _CLIENTS_MAX:
        await _reject(socket, "too many clients: try again")
        return
    service.strangers += 1
    try:
        client = await _authenticate(socket, token, hosts)
    finally:
        service.strangers -= 1
    if client is None:
        return
    service.clients.append(client)
    service.changed()
    tasks = [
        asyncio.create_task(_send_updates(socket, service, client, updated)),
        asyncio.create_task(_receive(socket, service, client)),
    ]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        results = await asyncio.gather(*tasks, return_exceptions=True)
        service.clients.remove(client)
        service.changed()
    for result in results:
        if isinstance(result, Exception) and not isinstance(result, (WebSocketDisconnect, RuntimeError)):
            raise result  # an internal error: the client is disconnected and the server logs it


async def _authenticate(socket: WebSocket, token: str | None, hosts: frozenset[str] | None) -> Client | None:
    """Return the client of a valid first message; else send the reason and return None."""
    if not (_is_known_host(socket, hosts) and _is_own_page(socket)):
        await _reject(socket, "this console rejects pages of other sites")
        return None
    try:
        hello = _table(await asyncio.wait_for(_receive_text(socket), _HELLO_TIMEOUT_WALL_S))
        if hello is None:
            raise ValueError
        key, name, given = (str(hello.get(field, "")) for field in ("key", "name", "token"))
    except (TimeoutError, ValueError, WebSocketDisconnect):
        await _reject(socket, 'the first message must be {"key": ..., "name": ..., "token": ...}')
        return None
    if token is not None and not hmac.compare_digest(given.encode(errors="replace"), token.encode()):
        await asyncio.sleep(_WRONG_TOKEN_DELAY_WALL_S)
        await _reject(socket, "wrong token" if given else "this console requires a token")
        return None
    if not 16 <= len(key) <= _LONGEST_KEY:
        await _reject(socket, "key: at least 16 random characters")
        return None
    return Client(key, plain_name(name) or "unnamed")


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
    while True:
        message = _table(await _receive_text(socket))
        if message is None:
            await socket.send_text(json.dumps({"answer": None, "ok": False, "text": "not a JSON object, or too long"}))
            continue
        service.refresh(client, message.get("got"))
        if message.get("do") == "beat":
            continue
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
