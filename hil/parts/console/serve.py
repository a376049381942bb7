"""Server of the console: address, token and web server."""

from __future__ import annotations

import asyncio
import ipaddress
import logging
import socket
import ssl
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from hil.config.load import shipped
from hil.core.files import KIB, MIB, check_regular, read_private_text
from hil.errors import BadInput, Problem
from hil.parts.console.session import Choice
from hil.parts.console.strangers import Access, FairSlots
from hil.parts.console.viewers import Viewer

_CERTIFICATE_BYTES: Final = MIB
_CONNECTIONS_MAX: Final = 128
_HTTP_MAX: Final = 64  # of them without a websocket
_TOKEN_BYTES: Final = 4 * KIB
_SHORTEST_TOKEN: Final = 16
_LOOPBACK_NAMES: Final = ("localhost", "127.0.0.1", "::1")


def read_token(path: str) -> str:
    """Return the token in the file at ``path``; raises BadInput if it is invalid or readable by other users."""
    option = "--token-file"
    try:
        token = read_private_text(Path(path), _TOKEN_BYTES).strip()
    except (BadInput, OSError) as error:
        raise BadInput.single(option, "", str(error)) from error
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


@dataclass(frozen=True)
class Tls:
    """Files of the server's certificate (PEM, with its chain) and of its private key."""

    certificate: str
    key: str

    def check(self) -> None:
        """Raise BadInput if the files are not a certificate and its key."""
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        for path in (self.certificate, self.key):
            check_regular(Path(path), _CERTIFICATE_BYTES)
        try:
            context.load_cert_chain(self.certificate, self.key, password="")
        except (OSError, ValueError) as error:
            reason = getattr(error, "reason", None) or str(error)
            text = f"{self.certificate}, {self.key}: not a certificate and its private key: {reason}"
            raise BadInput.single("--certificate", "", text) from error


def listen(host: str, port: int, access: Access, is_encrypted: bool) -> socket.socket:
    """Return a listening socket; raises BadInput on failure, or for an address that is reachable from other computers
    without keys of operators, or without encryption. is_encrypted: by TLS, or by a tunnel in front of the server."""
    problems = []
    if not 0 <= port <= 65535:
        problems.append(Problem("--port", "", f"{port}: allowed 0 to 65535, 0 for any free port"))
    missing = [] if access.operators else ["--operators"]
    if not is_encrypted:
        missing.append("--certificate and --key (--behind-tunnel if a tunnel encrypts all connections)")
    if not is_loopback(host) and missing:
        text = f"{host}: reachable from other computers: give {', '.join(missing)}, or use 127.0.0.1"
        problems.append(Problem("--host", "", text))
    if problems:
        raise BadInput(problems)
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise BadInput.single("--port", "", f"{host}:{port}: cannot listen: {error.strerror or error}") from error


def serve(
    choice: Choice,
    listener: socket.socket,
    host: str,
    access: Access,
    log: Callable[[str], None],
    tls: Tls | None = None,
    viewers: Sequence[Viewer] = (),
) -> None:
    """Serve the page until Ctrl-C (KeyboardInterrupt); an open session is stopped first. viewers: served as well."""
    import uvicorn

    from hil.parts.console.app import make_app
    from hil.parts.console.service import ConsoleService

    scenarios = [*dict.fromkeys([choice.scenario, *shipped("scenarios")])]
    rigs = [*dict.fromkeys([choice.rig, *shipped("rigs")])]
    service = ConsoleService(choice, scenarios, rigs, time.monotonic, log)
    service.warm_up()
    # one line per client at most, and none from those that have not authenticated
    logging.getLogger("uvicorn.error").addFilter(lambda record: not str(record.msg).startswith("Invalid UTF-8"))
    hosts = frozenset({host, *_LOOPBACK_NAMES}) if is_loopback(host) else None
    config = uvicorn.Config(
        make_app(service, access, hosts, viewers),
        log_level="warning",
        access_log=False,
        ws="websockets-sansio",
        ws_max_size=65536,
        ws_per_message_deflate=False,
        ws_ping_interval=5.0,
        ws_ping_timeout=10.0,
        timeout_graceful_shutdown=1,
        ssl_certfile=tls.certificate if tls else None,
        ssl_keyfile=tls.key if tls else None,
        limit_concurrency=_CONNECTIONS_MAX,
        http=_bounded_http(_HTTP_MAX),
        proxy_headers=False,  # a client names no other address as its own
    )
    uvicorn.Server(config).run(sockets=[listener])


def _bounded_http(most: int) -> type[asyncio.Protocol]:
    """Return uvicorn's protocol with at most ``most`` connections: a new one displaces the oldest of the address that
    has most of them. Connections that have become websockets do not count."""
    from uvicorn.protocols.http.auto import AutoHTTPProtocol

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
