"""Server of the console: address, token and web server."""

from __future__ import annotations

import ipaddress
import socket
import stat
import time
from collections.abc import Callable
from pathlib import Path
from typing import Final

from hil.config.load import shipped
from hil.console.session import Choice
from hil.core.files import KIB, read_text
from hil.errors import BadInput, Problem

_TOKEN_BYTES: Final = 4 * KIB
_SHORTEST_TOKEN: Final = 16
_LOOPBACK_NAMES: Final = ("localhost", "127.0.0.1", "::1")


def read_token(path: str) -> str:
    """Return the token in the file at ``path``; raises BadInput if it is invalid or readable by other users."""
    option = "--token-file"
    try:
        token = read_text(Path(path), _TOKEN_BYTES).strip()
        mode = Path(path).stat().st_mode
    except (BadInput, OSError) as error:
        raise BadInput.single(option, "", str(error)) from error
    if stat.S_IMODE(mode) & 0o077:
        raise BadInput.single(
            option, "", f"{path}: readable by other users, mode {stat.S_IMODE(mode):o}: chmod 600 {path}"
        )
    if len(token) < _SHORTEST_TOKEN:
        text = f"{path}: {len(token)} characters, at least {_SHORTEST_TOKEN}: openssl rand -hex 16 > {path}"
        raise BadInput.single(option, "", text)
    return token


def is_loopback(host: str) -> bool:
    """Return whether ``host`` is reachable only from this computer."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def listen(host: str, port: int, token: str | None) -> socket.socket:
    """Return a listening socket; raises BadInput on failure, or for a remotely reachable address without a token."""
    problems = []
    if not 0 <= port <= 65535:
        problems.append(Problem("--port", "", f"{port}: allowed 0 to 65535, 0 for any free port"))
    if not is_loopback(host) and token is None:
        text = f"{host}: reachable from other computers: give --token-file, or use 127.0.0.1"
        problems.append(Problem("--host", "", text))
    if problems:
        raise BadInput(problems)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise BadInput.single("--port", "", f"{host}:{port}: cannot listen: {error.strerror or error}") from error


def serve(choice: Choice, listener: socket.socket, host: str, token: str | None, log: Callable[[str], None]) -> None:
    """Serve the page until Ctrl-C (KeyboardInterrupt); an open session is stopped first."""
    import uvicorn

    from hil.console.app import make_app
    from hil.console.service import ConsoleService

    scenarios = [*dict.fromkeys([choice.scenario, *shipped("scenarios")])]
    rigs = [*dict.fromkeys([choice.rig, *shipped("rigs")])]
    service = ConsoleService(choice, scenarios, rigs, time.monotonic, log)
    service.warm_up()
    hosts = frozenset({host, *_LOOPBACK_NAMES}) if is_loopback(host) else None
    config = uvicorn.Config(
        make_app(service, token, hosts),
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=65536,
        ws_per_message_deflate=False,
        ws_ping_interval=5.0,
        ws_ping_timeout=10.0,
        timeout_graceful_shutdown=1,
    )
    uvicorn.Server(config).run(sockets=[listener])
