"""``hil gnc``: the GNC of a scenario in a process of its own; ``hil gnc header``: the C header for external GNCs."""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING

from cyclopts import App

from hil.cli.options import File, Flag, Seconds, Settings
from hil.cli.output import notices, say, write_json
from hil.errors import BadInput
from hil.parts.links.cli.dss import link_addresses

if TYPE_CHECKING:
    from hil.config.scenario import Scenario
    from hil.gnc_backends.backend import Backend
    from hil.parts.links.gnc_server import GncServer
    from hil.parts.links.link import Link

app = App(name="gnc")
app.command(
    "hil.parts.links.cli.gnc_check:gnc_check",
    name="check",
    help="Check an external GNC: latency, signs, units and order.",
)


@app.default
def gnc(
    scenario: str,
    /,
    *,
    dss: str | None = None,
    listen: str | None = None,
    settings: Settings = (),
    wait: Seconds = 60.0,
    json: File = None,
    key_file: str | None = None,
) -> int:
    """Run the GNC of a scenario for a bench in another process or on another computer, until the bench disconnects.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file. Its library or FMU replaces the built-in GNC.
    dss
        Address and port of the bench; 127.0.0.1:24500 unless --listen is given.
    listen
        Address and port on which the GNC waits for a bench (hil dss --gnc), instead of --dss.
    wait
        Wall-clock time to wait for a bench, at first and after it became silent, s.
    json
        File for the numbers of the GNC, - for standard output.
    key_file
        Key of the link, the same file on both computers; default: this user's own key, made when needed.
    """
    bind, peer = link_addresses("--listen", listen, "--dss", dss)

    from hil.config.load import load_scenario
    from hil.core.realtime import RealTime, no_garbage_collection
    from hil.frmn.wire import PORT
    from hil.gnc_backends.library import key_of, open_library
    from hil.parts.links.authentication import link_key
    from hil.parts.links.binary_gnc_server import BINARY_WANTS, OFFERS
    from hil.parts.links.gnc_server import gnc_side, wants_of
    from hil.parts.links.udp import LOOPBACK, shown

    if bind is not None and listen is None:  # by default the bench on this computer
        bind, peer = None, (LOOPBACK, PORT)
    loaded_scenario = load_scenario(scenario, settings)
    loaded = loaded_scenario.value
    for part, name in loaded.gnc.foreign.items():
        key, text = f"gnc.{part}.backend", "flies on the bench: hil gnc runs the built-in GNC or a whole one"
        raise BadInput.single(loaded_scenario.where(key), key, f'"{name}": {text}')
    library = open_library(loaded.gnc, loaded_scenario.where(key_of(loaded.gnc)))
    console = notices()

    def announce(text: str) -> None:
        say(text, console, "dim")

    mailboxes = {"wants": wants_of(loaded_scenario)} if library is None else {"offers": OFFERS, "wants": BINARY_WANTS}
    link = gnc_side(f"hil gnc {loaded.name}", bind, peer, link_key(key_file), **mailboxes)
    try:
        with console.status("compiling the kernels that are not cached"):
            server = _server(library, loaded, link, announce)
        announce(f"ready on {shown(link.address)}" + (f", the bench is at {shown(peer)}" if peer else ""))
        with RealTime() as realtime, no_garbage_collection(), realtime.realtime_priority():
            stats = server.serve(wait)
    finally:
        link.close("the GNC has ended")
    for complaint in link.complaints:
        announce(complaint)
    announce(f"{stats.steps} steps, {stats.bridged} bridged: {stats.end}")
    write_json(stats.as_json(link), json)
    return 0


def _server(library: Backend | None, scenario: Scenario, link: Link, announce: Callable[[str], None]) -> GncServer:
    """Return the server of the binary, or of the built-in GNC."""
    from hil.parts.links.binary_gnc_server import BinaryGncServer
    from hil.parts.links.gnc_server import GncServer

    if library is None:
        return GncServer(scenario, link, announce)
    return BinaryGncServer(library, scenario, link, announce)


@app.command(help="Print hil_gnc.h, the C header of the records between the bench and an external GNC.")
def header(*, folder: Flag = False, backends: Flag = False) -> int:
    """Print hil_gnc.h, the C header of the records between the bench and an external GNC.

    Parameters
    ----------
    folder
        Print the folder of the files, for -I of a C compiler.
    backends
        Print hil_backends.h, of backends of navigation and of control, instead.
    """
    from hil.gnc_backends.c_header import BACKENDS_HEADER_FILE, HEADER_FILE

    file = BACKENDS_HEADER_FILE if backends else HEADER_FILE
    sys.stdout.write(f"{file.parent}\n" if folder else file.read_text(encoding="utf-8"))
    return 0
