"""``hil dss``: the bench for a GNC in another process or on another computer."""

from __future__ import annotations

import signal
import sys
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from rich.console import Console

from hil.cli.options import File, Flag, Group, RunOptions, Seconds, refuse, refuse_wires_in_use
from hil.cli.output import notices, say
from hil.errors import BadInput

if TYPE_CHECKING:
    from hil.core.operator_commands import TerminalOperator
    from hil.loop.runner import Runner
    from hil.loop.session_parts import SessionParts
    from hil.parts.links.udp import Address

_RUN_DEFAULTS = RunOptions()


@dataclass(frozen=True)
class GncLinkOptions:
    """Options of the link to the GNC."""

    listen: str | None = None
    """Address and port on which the bench waits for a GNC; 127.0.0.1:24500 unless --gnc is given."""
    gnc: str | None = None
    """Address and port of the GNC, the only peer that is accepted; instead of --listen."""
    lock_step: Flag = False
    """Each cycle waits for the reply of the GNC; on a mock or emulated rig the trajectory is that of hil run."""
    wait: Seconds = 60.0
    """Wall-clock time to wait for a GNC, s."""
    key_file: str | None = None
    """Key of the link, the same file on both computers; default: this user's own key, made when needed."""
    resume_by_gnc: Flag = False
    """After a loss of the GNC, its return ends the hold, without an operator; on mock and emulated rigs only."""


_LINK_DEFAULTS = GncLinkOptions()


def dss(
    scenario: str,
    /,
    *,
    rig: str = "mock",
    options: Group[RunOptions] = _RUN_DEFAULTS,
    link_options: Group[GncLinkOptions] = _LINK_DEFAULTS,
    json: File = None,
    record: str | None = None,
) -> int:
    """Run the bench, with dynamics and vision unit, for a GNC in another process or on another computer.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file.
    rig
        mock, emulated, or the path of a rig file; gnc_link in it sets the reaction to missing replies.
    json
        File for the numbers of the run, - for standard output.
    record
        Folder for the recording and its catalogue; see hil recordings list.
    """
    lock_step = link_options.lock_step
    bind, peer = link_addresses("--listen", link_options.listen, "--gnc", link_options.gnc)
    refuse_wires_in_use(rig, options.settings)

    from hil.api.jobs import IN_LOCK_STEP, loaded_rig, loaded_scenario, make_job, other_gnc_problems

    loaded, bench = loaded_scenario(scenario, options.settings), loaded_rig(rig, options.settings)
    if lock_step and bench.value.kind == "emulated":
        bench = loaded_rig(rig, (*options.settings, *IN_LOCK_STEP))
    refuse(other_gnc_problems(loaded, bench))
    is_mock = bench.value.kind == "mock"
    if is_mock and lock_step and options.speed != 1.0:
        text = f"{options.speed:g}: in lock-step a mock rig does not run in real time: omit --speed"
        raise BadInput.single("--speed", "", text)
    if link_options.resume_by_gnc and bench.value.kind == "hardware":
        text = "a bench of hardware moves again by an act of its operator alone: type resume"
        raise BadInput.single("--resume-by-gnc", "", text)
    console = notices()

    from hil.api.runs import RunRequest
    from hil.cli.run import run_and_print
    from hil.cli.warm_up import compile_kernels_with_notice
    from hil.core.operator_commands import AutoResumeOperator
    from hil.parts.links.authentication import link_key
    from hil.parts.links.mirror import mirror_to
    from hil.parts.links.udp import shown
    from hil.parts.links.udp_gnc import gnc_link, make_udp_gnc
    from hil.session import build

    paced = is_mock and not lock_step
    job = replace(make_job(loaded, bench, options.seed, options.duration, options.speed), paced=paced)
    link = gnc_link(f"hil dss {loaded.value.name}", bind, peer, link_key(link_options.key_file))
    try:
        with console.status("checking that the rig can follow the scenario"):
            build.check(job)
        compile_kernels_with_notice(job, console)
        period_s = None if job.waits_for_all else loaded.value.step_s / options.speed
        backend = make_udp_gnc(loaded.value, link, bench.value.gnc_link, lock_step, period_s)
        where = f"the GNC at {shown(peer)}" if peer else f"a GNC on {shown(link.address)}"
        say(f"waiting for {where}", console, "dim")
        say(f"flown by {backend.connect(link_options.wait)}", console, "dim")
        operator: AutoResumeOperator | TerminalOperator | None = None
        if bench.value.gnc_link.on_loss == "hold":
            operator = AutoResumeOperator() if link_options.resume_by_gnc else _at_terminal(console)

        def attach(runner: Runner) -> None:
            if isinstance(operator, AutoResumeOperator):
                operator.mode = lambda: runner.safety.modes.mode

        def prepare(parts: SessionParts) -> None:
            mirror_to(link, parts, bench.value.telemetry_cycles(loaded.value.step_s))
            parts.on_built.append(attach)

        def link_stats() -> dict[str, Any]:
            return {"gnc_link": backend.stats.as_json()}

        job = replace(job, make_backend=lambda _: backend)
        request = RunRequest(job, rig, record, operator=operator, prepare=prepare, link_stats=link_stats)
        return run_and_print(request, console, json)
    finally:
        link.close("the bench has ended")


def _at_terminal(console: Console) -> TerminalOperator | None:
    """Return the operator at the standard input, None if that is closed."""
    from hil.core.operator_commands import TerminalOperator

    try:
        descriptor = sys.stdin.fileno()
    except (AttributeError, OSError, ValueError):
        return None
    signal.signal(signal.SIGTTIN, signal.SIG_IGN)  # a job in the background is not suspended
    return TerminalOperator(descriptor, lambda text: say(text, console))


def link_addresses(
    listen_option: str, listen: str | None, peer_option: str, peer: str | None
) -> tuple[Address | None, Address | None]:
    """Return the address to listen on, or the only peer: one of both; by default this computer's own address."""
    from hil.frmn.wire import PORT
    from hil.parts.links.udp import LOOPBACK, parse_address

    if listen is not None and peer is not None:
        raise BadInput.single(peer_option, "", f"{peer}: give this or {listen_option}, not both")
    if peer is not None:
        address = parse_address(peer_option, peer, PORT)
        if address[1] == 0:
            raise BadInput.single(peer_option, "", f"{peer}: must name a port")
        return None, address
    return parse_address(listen_option, listen if listen is not None else LOOPBACK, PORT), None
