"""Bound on the connections of the web server, fair among the addresses that they come from."""

from __future__ import annotations

import asyncio
from typing import Any

from uvicorn.protocols.http.auto import AutoHTTPProtocol

from hil.parts.console.strangers import FairSlots


def bounded_http(most: int) -> type[asyncio.Protocol]:
    """Return uvicorn's protocol with at most ``most`` connections: a new one displaces the oldest of the address that
    has most of them. Connections that have become websockets do not count."""
    slots: FairSlots[Any] = FairSlots(most)

    class BoundedHttp(AutoHTTPProtocol):  # type: ignore[misc, valid-type]
        def connection_made(self, transport: Any) -> None:
            super().connection_made(transport)
            peer = transport.get_extra_info("peername")
            displaced = slots.enter(self, peer[0] if isinstance(peer, tuple) else "")
            if displaced is not None:
                displaced.transport.abort()

        def connection_lost(self, exc: Exception | None) -> None:
            slots.leave(self)
            super().connection_lost(exc)

        def handle_websocket_upgrade(self, *arguments: Any) -> None:
            slots.leave(self)
            super().handle_websocket_upgrade(*arguments)

    return BoundedHttp
