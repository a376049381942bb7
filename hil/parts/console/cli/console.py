"""``hil console``: the operator's page of a session at the bench."""

from __future__ import annotations

import datetime
import importlib.util
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from hil.cli.options import Flag, Group, Integer, Names, OptionalInteger, RunOptions
from hil.errors import BadInput

if TYPE_CHECKING:
    from hil.parts.console.viewers import ViewerOption

_NEEDED = ("fastapi", "uvicorn", "websockets")


@dataclass(frozen=True)
class ServerOptions:
    """Options of the web server."""

    host: str = "127.0.0.1"
    """Address to listen on. Any but this computer's own requires a token and a certificate."""
    port: Integer = 8765
    """Port; 0 takes any free one."""
    token_file: str | None = None
    """File with the token that a page must send, readable by its owner only; for pages on this computer."""
    operators: str | None = None
    """File with the operators' keys and rights, by hil operators add: each page proves the key of its operator."""
    certificate: str | None = None
    """File of the server's certificate (PEM): pages use https. Required to listen on other addresses."""
    key: str | None = None
    """File of the certificate's private key."""
    behind_tunnel: Flag = False
    """Listen on other addresses without a certificate: a tunnel (ssh -L, WireGuard) encrypts all connections."""

    @property
    def tls(self) -> tuple[str, str] | None:
        """Certificate and key. Raises BadInput if only one of them is given."""
        if self.certificate is not None and self.key is not None:
            return self.certificate, self.key
        if self.certificate is not None or self.key is not None:
            raise BadInput.single("--key" if self.key is None else "--certificate", "", "is missing: give both")
        return None


@dataclass(frozen=True)
class ViewerOptions:
    """Live viewers in addition to the page."""

    foxglove: OptionalInteger = None
    """Port on this computer at which Foxglove connects, 0 for any free one: live topics, settings, services."""
    viewer: Names = ()
    """Port of the viewer of an installed part, as NAME=PORT."""

    def asked(self) -> list[ViewerOption]:
        """Return the viewers. Raises BadInput."""
        from hil.parts.console.viewers import ViewerOption, viewer_option

        own = [] if self.foxglove is None else [ViewerOption("--foxglove", "foxglove", self.foxglove)]
        return [*own, *map(viewer_option, self.viewer)]


_SERVER_DEFAULTS, _RUN_DEFAULTS, _NO_VIEWERS = ServerOptions(), RunOptions(), ViewerOptions()


def console(
    *,
    server: Group[ServerOptions] = _SERVER_DEFAULTS,
    rig: str = "emulated",
    scenario: str = "scheme-1",
    options: Group[RunOptions] = _RUN_DEFAULTS,
    on_loss: Literal["hold", "continue", "stop"] | None = None,
    record: str = "recordings",
    no_record: Flag = False,
    live: Group[ViewerOptions] = _NO_VIEWERS,
) -> int:
    """Serve the page that displays and commands a session at the bench, until Ctrl-C.

    Parameters
    ----------
    rig
        mock, emulated, or the path of a rig file: preselected on the page.
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file: preselected on the page.
    on_loss
        Reaction of the loop when the operator's page is lost while the bench moves, instead of the rig's
        console.on_loss.
    record
        Folder for the recordings, one file per session, and their catalogue.
    no_record
        Do not record.
    """
    missing = [name for name in _NEEDED if importlib.util.find_spec(name) is None]
    if missing:
        raise BadInput.single("hil console", "", f"{', '.join(missing)} missing: pip install 'hil-bench[console]'")

    from hil.core.operator_keys import read_operators
    from hil.parts.console.serve import Tls, listen, read_token, serve
    from hil.parts.console.service import NEEDS_KEYS
    from hil.parts.console.session import Choice
    from hil.parts.console.strangers import Access
    from hil.parts.console.viewers import opened_viewers

    overridden = () if on_loss is None else (f"rig.console.on_loss={on_loss}",)
    choice = Choice(
        scenario=scenario,
        rig=rig,
        seed=options.seed,
        duration_s=options.duration,
        speed=options.speed,
        settings=(*options.settings, *overridden),
        record=None if no_record else str(Path(record).absolute()),
        operators=None if server.operators is None else str(Path(server.operators).absolute()),
    )
    host, token_file = server.host, server.token_file
    if token_file is not None and server.operators is not None:
        raise BadInput.single("--token-file", "", "not together with --operators: their keys replace the token")
    access = Access(
        None if token_file is None else read_token(token_file),
        {} if server.operators is None else read_operators(server.operators),
    )
    if choice.job().rig.value.console.second_person and not access.operators:
        raise BadInput.single("--operators", "", f"is missing: {NEEDS_KEYS}")
    tls = None if server.tls is None else Tls(*server.tls)
    if tls is not None:
        tls.check()
    with ExitStack() as stack:
        viewers, lines = stack.enter_context(opened_viewers(live.asked(), access, _log))
        listener = stack.enter_context(listen(host, server.port, access, tls is not None or server.behind_tunnel))
        shown = f"[{host}]" if ":" in host else host
        for line in (f"console on {'https' if tls else 'http'}://{shown}:{listener.getsockname()[1]}/", *lines):
            _say(line)
        try:
            serve(choice, listener, host, access, _log, tls, viewers)
        except KeyboardInterrupt:
            _say("console closed")
    return 0


def _log(text: str) -> None:
    _say(f"{datetime.datetime.now().astimezone():%H:%M:%S} {text}")


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)  # noqa: T201
