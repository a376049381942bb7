"""``hil commission``: from the emergency stop to a slow dry run, and a rig file that is signed off."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from datetime import date, datetime
from pathlib import Path
from typing import Final

from rich.console import Console

from hil.checks.compatibility import flight_problems
from hil.cli.output import base_of, check_rig_path
from hil.cli.warm_up import compile_kernels_with_notice
from hil.config.load import Loaded, load_rig, load_scenario
from hil.config.rig import BENCH_AXES, Rig
from hil.errors import BadInput, Problem

_SIGNED, _FAILED = 0, 1
_YES: Final = {"y", "yes"}
_NO: Final = {"n", "no"}


def commission_command(
    rig_name: str,
    axes: Sequence[str],
    out_path: str | None,
    by: str | None,
    day: str | None,
    ends: bool,
    unattended: bool,
    scenario_name: str,
    settings: Sequence[str],
    speed: float,
) -> int:
    """Do ``hil commission``; return its exit code. Raises BadInput before anything is started."""
    _check_options(axes, out_path, by, day, settings, speed)
    scenario, rig = load_scenario(scenario_name, settings), load_rig(rig_name, settings)
    _check_rig(rig, unattended)

    from hil.commission.auto_operator import AutoOperator
    from hil.commission.prompt import OperatorPrompt, ScriptedPrompt, StepFailed
    from hil.commission.sign_off import as_toml, signed_before
    from hil.commission.steps import Commissioning, CommissioningPlan
    from hil.session import build

    job = build.Job(scenario, rig, 0, scenario.value.step_s, speed)
    console = Console(stderr=True)
    with console.status("checking that the rig can follow the scenario"):
        build.check_rig(job)
        if problems := flight_problems(scenario, rig):
            raise BadInput(problems)
    compile_kernels_with_notice(job, console)
    prompt: OperatorPrompt = ScriptedPrompt(show=_show(Console())) if unattended else Terminal(Console())
    before = signed_before(rig.value)
    chosen = [k for k, name in enumerate(BENCH_AXES) if name in axes or not axes]
    others = [k for k, name in enumerate(BENCH_AXES) if name in before]
    who = by or ("nobody (--yes)" if unattended else _asked_name())
    if rig.value.kind == "hardware" and not prompt.ask(
        "The axes will move. Is the bench clear of people, and the emergency stop in your hand?"
    ):
        return _failed("nothing was moved", console)
    with build.wired_bench(
        job, lambda text: console.print(text, style="dim", highlight=False, soft_wrap=True)
    ) as bench:
        emulated = AutoOperator(bench.board, bench.addresses) if bench.board is not None else None
        button = emulated if emulated is not None and rig.value.has_io else None
        true_position = emulated.position if emulated is not None else None
        plan = CommissioningPlan(chosen, others, ends)
        steps = Commissioning(bench.runner(), rig.value, prompt, plan, button, true_position)
        try:
            findings = steps.run()
        except StepFailed as failure:
            return _failed(str(failure), console)
    if out_path is None:
        prompt.show("all steps passed; nothing was written, because there is no --out")
        return _SIGNED
    text = as_toml(findings, rig.value, base_of(rig_name, out_path), who, day or _today())
    Path(out_path).write_text(text, encoding="utf-8")
    left = [name for k, name in enumerate(BENCH_AXES) if k not in chosen and k not in others]
    prompt.show(
        f"{out_path}: {len(chosen)} axes signed, left: {', '.join(left)}"
        if left
        else f"{out_path}: the rig is signed off"
    )
    return _SIGNED


def _failed(text: str, console: Console) -> int:
    console.print(text, style="red", highlight=False, soft_wrap=True, markup=False)
    console.print("not signed", style="red", highlight=False)
    return _FAILED


def _check_options(
    axes: Sequence[str], out_path: str | None, by: str | None, day: str | None, settings: Sequence[str], speed: float
) -> None:
    problems = [
        Problem("--axis", "", f"{a}: unknown, give {', '.join(BENCH_AXES)}") for a in axes if a not in BENCH_AXES
    ]
    if not (math.isfinite(speed) and speed > 0.0):
        problems.append(Problem("--speed", "", f"{speed:g}: must be above 0"))
    if by is not None and not by.strip():
        problems.append(Problem("--by", "", "is empty, give a name"))
    if day is not None and not _is_day(day):
        problems.append(Problem("--date", "", f"{day}: must look like 2026-03-01"))
    if out_path is not None:
        changed = [text for text in settings if text.startswith("rig.")]
        advice = "a sign-off holds for the rig file as it stands, write it into that"
        problems += [Problem("--set", text, f"not together with --out: {advice}") for text in changed]
    problems += check_rig_path("--out", out_path)
    if problems:
        raise BadInput(problems)


def _is_day(text: str) -> bool:
    with suppress(ValueError):
        return re.fullmatch(r"\d{4}-\d{2}-\d{2}", text) is not None and bool(date.fromisoformat(text))
    return False


def _today() -> str:
    return datetime.now().astimezone().date().isoformat()


def _check_rig(rig: Loaded[Rig], unattended: bool) -> None:
    """Raise BadInput where there is nothing to commission, or nobody to look."""
    if rig.value.kind == "mock":
        raise BadInput.single(rig.where("kind"), "rig.kind", '"mock": there are no devices to commission')
    if rig.value.kind == "hardware" and unattended:
        raise BadInput.single("--yes", "", f"{rig.value.name} is hardware: somebody must look at it and answer")


def _asked_name() -> str:
    with suppress(EOFError):
        if name := Console().input("Your name, for the sign-off: ").strip():
            return name
    raise BadInput.single("--by", "", "is missing: somebody must look at the bench and sign")


def _show(console: Console) -> Callable[[str], None]:
    return lambda text: console.print(text, highlight=False, soft_wrap=True, markup=False)


class Terminal:
    """Prompt of a technician at a terminal."""

    def __init__(self, console: Console) -> None:
        self._console = console

    def show(self, text: str) -> None:
        """Print a line."""
        self._console.print(text, highlight=False, soft_wrap=True, markup=False)

    def ask(self, question: str) -> bool:
        """Ask until the answer is y or n; no at the end of the input."""
        with suppress(EOFError):
            while True:
                self._console.print(f"{question} [y/n] ", end="", highlight=False, soft_wrap=True, markup=False)
                answer = self._console.input().strip().lower()
                if answer in _YES | _NO:
                    return answer in _YES
        return False
