"""The page and its websocket: who may come in, what a page says, and what it is sent."""

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

from hil.console.client import Client
from hil.console.message import pack
from hil.console.service import ConsoleService

PAGE: Final = Path(__file__).parent / "page"
TICK_S: Final = 0.05
_HELLO_WALL_S: Final = 5.0
_WRONG_TOKEN_WALL_S: Final = 0.5  # a guess costs this
_REFUSED: Final = 4401
_TEXT_AT_MOST: Final = 4096
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob:; style-src 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-cache",
}


def make_app(desk: ConsoleService, token: str | None, hosts: frozenset[str] | None) -> FastAPI:
    """Return the application. token: what a page must know, None for no token. hosts: names that a browser may call
    this console by, None for any: on loopback they keep other people's pages from reaching it through a name."""

    @asynccontextmanager
    async def life(_: FastAPI) -> AsyncIterator[None]:
        ticking = asyncio.create_task(_keep_ticking(desk, news))
        ticking.add_done_callback(_end_with_a_defect)
        yield
        ticking.cancel()
        with suppress(asyncio.CancelledError):
            await ticking
        await desk.close()

    news = asyncio.Condition()
    app = FastAPI(lifespan=life, docs_url=None, redoc_url=None, openapi_url=None)

    @app.middleware("http")
    async def _guard(request: Any, go_on: Any) -> Any:
        if not _is_called_by(request, hosts):
            from fastapi.responses import PlainTextResponse

            return PlainTextResponse("hil console: unknown host name\n", status_code=421)
        response = await go_on(request)
        response.headers.update(_HEADERS)
        return response

    @app.get("/")
    async def _page() -> FileResponse:
        return FileResponse(PAGE / "index.html")

    @app.websocket("/ws")
    async def _talk(socket: WebSocket) -> None:
        await _serve_page(socket, desk, token, hosts, news)

    app.mount("/page", StaticFiles(directory=PAGE), name="page")
    return app


async def _keep_ticking(desk: ConsoleService, news: asyncio.Condition) -> None:
    while True:
        desk.tick()
        async with news:
            news.notify_all()
        await asyncio.sleep(TICK_S)


def _end_with_a_defect(ticking: asyncio.Task[None]) -> None:
    """End a console that does not tick any more: the loop hears nothing of it by now, and acts as its rig says."""
    if not ticking.cancelled() and (defect := ticking.exception()) is not None:
        traceback.print_exception(defect)
        signal.raise_signal(signal.SIGINT)


async def _serve_page(
    socket: WebSocket, desk: ConsoleService, token: str | None, hosts: frozenset[str] | None, news: asyncio.Condition
) -> None:
    """Let one page in, or tell it why not; then feed it and do what it asks for until it goes."""
    await socket.accept()
    client = await _let_in(socket, token, hosts)
    if client is None:
        return
    desk.clients.append(client)
    desk.changed()
    works = [asyncio.create_task(_feed(socket, desk, client, news)), asyncio.create_task(_listen(socket, desk, client))]
    try:
        await asyncio.wait(works, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for work in works:
            work.cancel()
        ends = await asyncio.gather(*works, return_exceptions=True)
        desk.clients.remove(client)
        desk.changed()
    for end in ends:
        if isinstance(end, Exception) and not isinstance(end, (WebSocketDisconnect, RuntimeError)):
            raise end  # a defect: the page is disconnected and the server's log tells


async def _let_in(socket: WebSocket, token: str | None, hosts: frozenset[str] | None) -> Client | None:
    """Return the client that said hello properly; None, with the reason told, for any other."""
    if not (_is_called_by(socket, hosts) and _is_own_page(socket)):
        await _turn_away(socket, "this console is not to be used from another site's page")
        return None
    try:
        hello = json.loads(await asyncio.wait_for(socket.receive_text(), _HELLO_WALL_S))
        key, name, given = (str(hello.get(field, "")) for field in ("key", "name", "token"))
    except (TimeoutError, ValueError, AttributeError, KeyError, WebSocketDisconnect):
        await _turn_away(socket, 'the first message must be {"key": ..., "name": ..., "token": ...}')
        return None
    if token is not None and not hmac.compare_digest(given.encode(), token.encode()):
        await asyncio.sleep(_WRONG_TOKEN_WALL_S)
        await _turn_away(socket, "wrong token" if given else "this console wants a token")
        return None
    if len(key) < 16:
        await _turn_away(socket, "key: at least 16 characters, by chance")
        return None
    return Client(key, name.strip()[:24] or "somebody")


async def _turn_away(socket: WebSocket, why: str) -> None:
    with suppress(WebSocketDisconnect, RuntimeError):
        await socket.send_text(json.dumps({"refused": why}))
        await socket.close(_REFUSED, why)


async def _feed(socket: WebSocket, desk: ConsoleService, client: Client, news: asyncio.Condition) -> None:
    """Send the newest state whenever there is news; a page that reads slowly gets fewer messages, none that is old."""
    while True:
        async with news:
            await news.wait()
        if not client.behind:
            client.sent += 1
            await socket.send_bytes(pack(*desk.news_for(client)))


async def _listen(socket: WebSocket, desk: ConsoleService, client: Client) -> None:
    while True:
        text = await socket.receive_text()
        try:
            message = json.loads(text) if len(text) <= _TEXT_AT_MOST else None
        except ValueError:
            message = None
        if not isinstance(message, dict):
            await socket.send_text(json.dumps({"answer": None, "ok": False, "text": "not a JSON object, or too long"}))
            continue
        desk.heard(client, message.get("got"))
        if message.get("do") == "beat":
            continue
        answer = await desk.obey(client, message)
        if message.get("id") is not None or not answer["ok"]:
            await socket.send_text(json.dumps({"answer": message.get("id"), **answer}))


def _is_called_by(connection: HTTPConnection, hosts: frozenset[str] | None) -> bool:
    """Return whether the browser calls this console by one of its names: other names may be made to point here."""
    return hosts is None or connection.url.hostname in hosts


def _is_own_page(socket: WebSocket) -> bool:
    """Return whether the page that connects came from here; programs that are no browser name no page."""
    origin = socket.headers.get("origin")
    return origin is None or origin.partition("://")[2] == socket.headers.get("host")
