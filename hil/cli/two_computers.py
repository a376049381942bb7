"""``hil dss`` and ``hil gnc``: the loop split in two processes, on one computer or on two."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from rich.console import Console

from hil.cli.output import check_json_path, write_json
from hil.cli.run import check_options, fly
from hil.cli.warm_up import compile_kernels_with_notice
from hil.config.load import load_rig, load_scenario
from hil.core.operator_commands import AutoResumeOperator
from hil.errors import BadInput, Problem
from hil.frmn.udp import LOOPBACK, Address, parse_address, shown
from hil.frmn.wire import PORT
from hil.loop.runner import Runner


def dss_command(
    scenario_name: str,
    rig_name: str,
    seed: int,
    duration_s: float | None,
    settings: Sequence[str],
    speed: float,
    listen: str | None,
    gnc: str | None,
    lock_step: bool,
    wait_s: float,
    json_path: str | None,
    record: str | None,
) -> int:
    """Do ``hil dss``; return its exit code. Raises BadInput before anything is started."""
    check_options(seed, duration_s, speed, json_path)
    _check_wait(wait_s)
    bind, peer = _addresses("--listen", listen, "--gnc", gnc)
    scenario, rig = load_scenario(scenario_name, settings), load_rig(rig_name, settings)
    if scenario.value.gnc.library is not None:
        text = "the GNC is at the other end of the link: hil run flies with a library"
        raise BadInput.single(scenario.where("gnc.library"), "gnc.library", text)
    if rig.value.flight_computer.command_words != "none":
        wire = rig.value.flight_computer.command_words
        text = f'"{wire}": the GNC is at the other end of the UDP link; use hil run with a flight computer'
        raise BadInput.single(rig.where("flight_computer.command_words"), "rig.flight_computer.command_words", text)
    if rig.value.kind == "mock" and lock_step and speed != 1.0:
        text = f"{speed:g}: in lock-step a mock rig has no wall clock: leave --speed away"
        raise BadInput.single("--speed", "", text)
    console = Console(stderr=True)

    from hil.gnc_backends.udp import gnc_link
    from hil.session import build
    from hil.setup.udp_backend import mirror_of, remote_gnc

    length_s = scenario.value.duration_s if duration_s is None else duration_s
    paced = rig.value.kind == "mock" and not lock_step
    job = build.Job(scenario, rig, seed, length_s, speed, paced=paced)
    link = gnc_link(f"hil dss {scenario.value.name}", bind, peer)
    try:
        with console.status("checking that the rig can follow the scenario"):
            build.check(job)
        compile_kernels_with_notice(job, console)
        on_the_wall = paced or rig.value.kind != "mock"
        period_s = scenario.value.step_s / speed if on_the_wall else None
        seat = remote_gnc(scenario.value, link, rig.value.gnc_link, lock_step, period_s)
        where = f"the GNC at {shown(peer)}" if peer else f"a GNC on {shown(link.address)}"
        console.print(f"waiting for {where}", style="dim", highlight=False, soft_wrap=True)
        console.print(f"flown by {seat.connect(wait_s)}", style="dim", highlight=False, soft_wrap=True, markup=False)
        operator = AutoResumeOperator() if rig.value.gnc_link.on_loss == "hold" else None

        def attach(runner: Runner) -> None:
            runner.loop.telemetry = mirror_of(runner, link)
            if operator is not None:
                operator.mode = lambda: runner.safety.modes.mode

        def account() -> dict[str, Any]:
            return {"gnc_link": seat.account.as_json()}

        return fly(
            replace(job, seat=lambda _: seat), rig_name, console, json_path, record, {}, operator, attach, account
        )
    finally:
        link.close("the bench has ended")


def gnc_command(
    scenario_name: str,
    dss: str | None,
    listen: str | None,
    settings: Sequence[str],
    wait_s: float,
    json_path: str | None,
) -> int:
    """Do ``hil gnc``; return its exit code. Raises BadInput before anything is started."""
    problems = check_json_path("--json", json_path)
    if problems:
        raise BadInput(problems)
    _check_wait(wait_s)
    bind, peer = _addresses("--listen", listen, "--dss", dss)
    if bind is not None and listen is None:  # nothing was said: the bench on this computer
        bind, peer = None, (LOOPBACK, PORT)
    scenario = load_scenario(scenario_name, settings)
    console = Console(stderr=True)

    from hil.core.realtime import RealTime, no_garbage_collection
    from hil.processes.gnc_server import GncServer, gnc_side

    def tell(text: str) -> None:
        console.print(text, style="dim", highlight=False, soft_wrap=True, markup=False)

    link = gnc_side(f"hil gnc {scenario.value.name}", bind, peer)
    try:
        with console.status("compiling the kernels, where this computer has not yet"):
            computer = GncServer(scenario.value, link, tell)
        tell(f"ready on {shown(link.address)}" + (f", the bench is at {shown(peer)}" if peer else ""))
        with RealTime() as realtime, no_garbage_collection(), realtime.realtime_priority():
            flight = computer.serve(wait_s)
    finally:
        link.close("the GNC has ended")
    for complaint in link.complaints:
        tell(complaint)
    tell(f"{flight.steps} steps, {flight.bridged} bridged: {flight.end}")
    if json_path is not None:
        write_json(flight.as_json(link), json_path)
    return 0


def _addresses(
    listen_option: str, listen: str | None, peer_option: str, peer: str | None
) -> tuple[Address | None, Address | None]:
    """Return where to listen and who alone is spoken with: one of both; with neither this computer's own address."""
    if listen is not None and peer is not None:
        raise BadInput.single(peer_option, "", f"{peer}: give this or {listen_option}, not both")
    if peer is not None:
        found = parse_address(peer_option, peer, PORT)
        if found[1] == 0:
            raise BadInput.single(peer_option, "", f"{peer}: must name a port")
        return None, found
    return parse_address(listen_option, listen if listen is not None else LOOPBACK, PORT), None


def _check_wait(wait_s: float) -> None:
    if not (math.isfinite(wait_s) and wait_s > 0.0):
        raise BadInput([Problem("--wait", "", f"{wait_s:g}: must be a time above 0 s")])
