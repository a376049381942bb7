"""``hil identify``: how late each axis is, measured, and a rig file that makes up for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from hil.cli.output import base_of, check_json_path, check_rig_path, write_json
from hil.cli.progress import Bar
from hil.cli.warm_up import compile_kernels_with_notice
from hil.commission.identification import AxisResult, Identification
from hil.config.load import Loaded, load_rig, load_scenario
from hil.config.rig import BENCH_AXES, Rig
from hil.errors import BadInput, Problem

_PASSED, _FAILED = 0, 1


def identify_command(
    rig_name: str,
    axes: Sequence[str],
    out_path: str | None,
    json_path: str | None,
    confirmed: bool,
    scenario_name: str,
    settings: Sequence[str],
    speed: float,
) -> int:
    """Do ``hil identify``; return its exit code. Raises BadInput before anything is started."""
    _check_options(axes, out_path, json_path, speed)
    scenario, rig = load_scenario(scenario_name, settings), load_rig(rig_name, settings)
    if rig.value.kind == "hardware" and not confirmed:
        raise BadInput.single(
            "--yes", "", f"{rig.value.name} is hardware and its axes will move: clear the bench, then add --yes"
        )

    from hil.session import build

    job = build.Job(scenario, rig, 0, scenario.value.step_s, speed)
    build.check_rig(job)
    console = Console(stderr=True)
    compile_kernels_with_notice(job, console)

    def announce(text: str) -> None:
        console.print(text, style="dim", highlight=False, soft_wrap=True)

    chosen = [k for k, name in enumerate(BENCH_AXES) if name in axes or not axes]
    with (
        Bar(console, "opening the axes") as bar,
        build.runner(job, lambda *_: None, announce) as runner,
        runner.axes_only() as sequencer,
    ):
        results = Identification(sequencer, bar.tell).measure(chosen)
    if json_path is not None:
        write_json(as_json(results, rig_name, scenario.value.step_s), json_path)
    if out_path is not None:
        Path(out_path).write_text(as_toml(results, rig_name, out_path, settings), encoding="utf-8")
    if json_path != "-":
        _print(results, rig, Console())
    return _PASSED if all(result.passed for result in results) else _FAILED


def _check_options(axes: Sequence[str], out_path: str | None, json_path: str | None, speed: float) -> None:
    problems = [
        Problem("--axis", "", f"{a}: unknown, give {', '.join(BENCH_AXES)}") for a in axes if a not in BENCH_AXES
    ]
    if not (math.isfinite(speed) and speed > 0.0):
        problems.append(Problem("--speed", "", f"{speed:g}: must be above 0"))
    problems += check_rig_path("--out", out_path)
    problems += check_json_path("--json", json_path)
    if problems:
        raise BadInput(problems)


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
    """Return a rig file that lays the leads over the rig they were measured on; axes that failed stay as they are."""
    lines = ["# Leads that make up for the delays of the axes, measured by hil identify."]
    lines += [f"# measured with --set {text}" for text in settings]
    lines += ["", f'extends = "{base_of(rig_name, out_path)}"']
    for result in results:
        if result.passed:
            lead = f"lead_s = {result.lead_s:.4f} # +- {1e3 * result.sweep.delay_sigma_s:.2f} ms"
            lines += ["", f"[{result.axis}]", lead]
        else:
            lines += ["", f"# {result.axis}: {result.reason}"]
    return "\n".join(lines) + "\n"


def _print(results: Sequence[AxisResult], rig: Loaded[Rig], console: Console) -> None:
    table = Table(
        title=f"Axes of {rig.value.name}",
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
            console.print(f"{result.axis}: {result.reason}", style="red", highlight=False, soft_wrap=True)
