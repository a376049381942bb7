"""Requests to the console, given at the newest update."""

from __future__ import annotations

from typing import Any

from hil.parts.console.live_view import Client
from hil.parts.console.service import ConsoleService


async def act(service: ConsoleService, client: Client, command: dict[str, Any]) -> dict[str, Any]:
    """Return the answer to ``command``, given at the present update."""
    return await service.execute(client, {"seen_s": service.wall_s(), "number": client.requests + 1, **command})
