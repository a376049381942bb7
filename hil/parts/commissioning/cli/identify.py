"""``hil identify``: measured delay of each axis, and a rig file with leads that compensate it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from rich import box
from rich.console import Console
from rich.table import Table

from hil.cli.options import Axes, File, Flag, Positive, Settings, TomlFile, refuse_wires_in_use
from hil.cli.output import base_of, chosen_axes, say, write_json
from hil.cli.progress import ProgressBar
from hil.core.files import write_text
from hil.errors import BadInput

if TYPE_CHECKING:
    from hil.parts.commissioning.identification import AxisResult

_PASSED, _FAILED = 0, 1


def identify(
    rig: str = "emulated",
    *,
    axis: Axes = (),
    out: TomlFile = None,
    json: File = None,
    yes: Flag = False,
    scenario: str = "scheme-1",
    settings: Settings = (),
    speed: Positive = 1.0,
) -> int:
    """Move one axis at a time, a few millimetres or tenths of a degree, and measure its delay and bandwidth.

    Parameters
    ----------
    rig
        mock, emulated, or the path of a rig file.
    axis
        rails.x, turntable.yaw ...; may be given more than once. By default all that have a drive, one after the other.
    out
        Rig file (*.toml) to write: it extends this rig by the leads that compensate the delays.
    json
        File for the numbers, - for standard output.
    yes
        Confirm that the bench is clear (required for hardware rigs).
    scenario
        Gives the cycle of the bench, and the position of the axes of a mock rig.
    speed
        Simulation speed relative to real time, on an emulated rig.
    """
    refuse_wires_in_use(rig, settings)

    from hil.cli.warm_up import compile_kernels_with_notice
    from hil.config.load import load_rig, load_scenario
    from hil.parts.commissioning.identification import Identification
    from hil.session import build

    loaded, loaded_rig = load_scenario(scenario, settings), load_rig(rig, settings)
    if loaded_rig.value.kind == "hardware" and not yes:
        raise BadInput.single(
            "--yes", "", f"{loaded_rig.value.name} is hardware and its axes will move: clear the bench, then add --yes"
        )
    chosen = chosen_axes(axis, loaded_rig)
    job = build.Job(loaded, loaded_rig, 0, loaded.value.step_s, speed)
    build.check_rig(job)
    console = Console(stderr=True)
    compile_kernels_with_notice(job, console)

    with (
        ProgressBar(console, "opening the axes") as bar,
        build.runner(job, lambda *_: None, lambda text: say(text, console, "dim")) as runner,
        runner.axes_only() as sequencer,
    ):
        results = Identification(sequencer, bar.show).measure(chosen)
    write_json(as_json(results, rig, loaded.value.step_s), json)
    if out is not None:
        write_text(as_toml(results, rig, out, settings), out)
    if json != "-":
        _print(results, loaded_rig.value.name, Console())
    return _PASSED if all(result.passed for result in results) else _FAILED


def as_json(results: Sequence[AxisResult], rig_name: str, step_s: float) -> dict[str, Any]:
    """Return the numbers of ``hil identify --json``."""
    return {
        "rig": rig_name,
        "rate_hz": 1.0 / step_s,
        "passed": all(result.passed for result in results),
        "axes": {result.axis: _axis_as_json(result, step_s) for result in results},
    }


def _axis_as_json(result: AxisResult, step_s: float) -> dict[str, Any]:
    step, sweep = result.step, result.sweep
    return {
        "passed": result.passed,
        "reason": result.reason,
        "lead_s": result.lead_s,
        "lead_sigma_s": sweep.delay_sigma_s,
        "setpoint_to_encoder_ms": 1e3 * (sweep.delay_s + step_s),
        "bandwidth_hz": sweep.bandwidth_hz,
        "highest_frequency_hz": sweep.points[-1].frequency_hz,
        "residual": sweep.residual,
        "step": {
            "delay_s": step.delay_s,
            "delay_sigma_s": step.delay_sigma_s,
            "lag_s": step.lag_s,
            "lag_sigma_s": step.lag_sigma_s,
            "bandwidth_hz": step.bandwidth_hz,
            "bandwidth_sigma_hz": step.bandwidth_sigma_hz,
            "residual": step.residual,
        },
        "sweep": [
            {
                "frequency_hz": point.frequency_hz,
                "gain": point.gain,
                "phase_deg": math.degrees(point.phase_rad),
                "phase_sigma_deg": math.degrees(point.phase_sigma_rad),
                "residual": point.residual,
            }
            for point in sweep.points
        ],
    }


def as_toml(results: Sequence[AxisResult], rig_name: str, out_path: str, settings: Sequence[str] = ()) -> str:
    """Return a rig file that extends the measured rig by the leads; failed axes stay unchanged."""
    lines = ["# Leads that compensate the delays of the axes, measured by hil identify."]
    lines += [f"# measured with --set {text}" for text in settings]
    lines += ["", f'extends = "{base_of(rig_name, out_path)}"']
    for result in results:
        if result.passed:
            lead = f"lead_s = {result.lead_s:.4f} # +- {1e3 * result.sweep.delay_sigma_s:.2f} ms"
            lines += ["", f"[{result.axis}]", lead]
        else:
            lines += ["", f"# {result.axis}: {result.reason}"]
    return "\n".join(lines) + "\n"


def _print(results: Sequence[AxisResult], rig_name: str, console: Console) -> None:
    table = Table(
        title=f"Axes of {rig_name}",
        title_justify="left",
        box=box.SIMPLE_HEAD,
        collapse_padding=True,
        pad_edge=False,
    )
    table.add_column("axis", no_wrap=True)
    for column in ("delay\nms", "band-\nwidth Hz", "residual", "step: dead\ntime ms", "band-\nwidth Hz", ""):
        table.add_column(column, justify="right", no_wrap=True)
    for result in results:
        step, sweep = result.step, result.sweep
        beyond = f"> {sweep.points[-1].frequency_hz:g}"
        table.add_row(
            result.axis,
            f"{1e3 * sweep.delay_s:.2f} +- {1e3 * sweep.delay_sigma_s:.2f}",
            beyond if sweep.bandwidth_hz is None else f"{sweep.bandwidth_hz:.1f}",
            f"{100.0 * sweep.residual:.1f} %",
            f"{1e3 * step.delay_s:.1f} +- {1e3 * step.delay_sigma_s:.1f}",
            f"{step.bandwidth_hz:.1f}",
            "[green]ok[/]" if result.passed else "[red]fail[/]",
        )
    console.print(table)
    console.print(
        "delay: of the encoder behind the moment that a setpoint belongs to, with feed-forward (below zero: ahead "
        "of it); this is lead_s. Steps: without feed-forward, from the moment they are sent.",
        style="dim",
        highlight=False,
    )
    for result in results:
        if not result.passed:
            say(f"{result.axis}: {result.reason}", console, "red")
