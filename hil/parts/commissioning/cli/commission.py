"""``hil commission``: from the emergency stop to a slow dry run, and a rig file with the sign-off."""

from __future__ import annotations

import datetime
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from rich.console import Console

from hil.cli.options import Axes, Flag, Group, Integer, Positive, Settings, TomlFile, refuse, refuse_wires_in_use
from hil.cli.output import base_of, chosen_axes, say
from hil.core.files import write_text
from hil.core.operator_commands import FreshDigits, confirmed
from hil.core.part import provided
from hil.errors import BadInput, Problem

if TYPE_CHECKING:
    from hil.config.load import Loaded
    from hil.config.rig import Rig

_SIGNED, _FAILED = 0, 1


@dataclass(frozen=True)
class SignOffOptions:
    """Options of the sign-off and of the proof test."""

    out: TomlFile = None
    """Rig file (*.toml) to write: it extends this rig by the sign-off that a run on hardware requires."""
    operator: str | None = None
    """Operator's name; prompted for if omitted."""
    operator_key: str | None = None
    """The operator's key file, by hil operators add: the sign-off has its name, and is sealed with it."""
    date: str | None = None
    """Date of the sign-off, 2026-03-01; default: today."""
    proof_test: Flag = False
    """Only test emergency stop, safety chain and brakes; writes the record that the preflight of hardware requires."""
    due_days: Integer = 90
    """Days until the next proof test."""

    def problems(self) -> list[Problem]:
        """Return a problem for each option that cannot be used."""
        from hil.checks.signed_record import DUE_DAYS_MAX  # slow imports

        problems = []
        if self.operator is not None and not self.operator.strip():
            problems.append(Problem("--operator", "", "is empty, give a name"))
        if self.operator is not None and self.operator_key is not None:
            problems.append(Problem("--operator", "", "not together with --operator-key: the key has a name"))
        if self.date is not None and not _is_day(self.date):
            problems.append(Problem("--date", "", f"{self.date}: must look like 2026-03-01"))
        if self.proof_test and self.out is not None:
            problems.append(Problem("--proof-test", "", "signs no rig: not together with --out"))
        if not 1 <= self.due_days <= DUE_DAYS_MAX:
            problems.append(Problem("--due-days", "", f"{self.due_days}: allowed 1 to {DUE_DAYS_MAX}"))
        return problems


_UNSIGNED = SignOffOptions()


def commission(
    rig: str = "emulated",
    *,
    axis: Axes = (),
    sign_off: Group[SignOffOptions] = _UNSIGNED,
    limits: Flag = False,
    yes: Flag = False,
    scenario: str = "scheme-1",
    settings: Settings = (),
    speed: Positive = 1.0,
) -> int:
    """Take a rig from its emergency stop, one axis at a time, to a slow dry run, and sign it off.

    Parameters
    ----------
    rig
        emulated, or the path of a rig file.
    axis
        rails.x, turntable.yaw ...; may be given more than once. By default all that have a drive, one after the other.
    limits
        Also approach both ends of each axis' travel.
    yes
        Answer every question with yes, on emulated rigs only.
    scenario
        Gives the cycle of the bench and the start pose of the dry run.
    speed
        Simulation speed relative to real time, on an emulated rig.
    """
    problems = sign_off.problems()
    if sign_off.proof_test and (axis or limits):
        problems.append(Problem("--proof-test", "", "moves no axis: not together with --axis and --limits"))
    if sign_off.out is not None:
        changed = [text for text in settings if text.startswith("rig.")]
        advice = "a sign-off is valid for the rig file as it is: write the setting into that file"
        problems += [Problem("--set", text, f"not together with --out: {advice}") for text in changed]
    refuse(problems)
    refuse_wires_in_use(rig, settings)

    from hil.checks.compatibility import check_plan
    from hil.checks.signed_record import write_proof
    from hil.cli.warm_up import compile_kernels_with_notice
    from hil.config.load import load_rig, load_scenario
    from hil.config.rig import BENCH_AXES
    from hil.core.operator_keys import OperatorKey, read_key
    from hil.drivers.remote.io_layout import WATCHDOG
    from hil.parts.commissioning.prompt import OperatorPrompt, ScriptedPrompt, StepFailed
    from hil.parts.commissioning.sign_off import as_toml, signed_before
    from hil.parts.commissioning.steps import Commissioning, CommissioningPlan, Findings
    from hil.session import build

    loaded, loaded_rig = load_scenario(scenario, settings), load_rig(rig, settings)
    _check_rig(loaded_rig, yes)
    job = build.Job(loaded, loaded_rig, 0, loaded.value.step_s, speed)
    console = Console(stderr=True)
    with console.status("checking that the rig can follow the scenario"):
        build.check_rig(job)
        refuse(check_plan(loaded, loaded_rig))
    compile_kernels_with_notice(job, console)
    prompt: OperatorPrompt = ScriptedPrompt(show=_show(Console())) if yes else Terminal(Console())
    earlier = signed_before(loaded_rig.value)
    chosen = chosen_axes(axis, loaded_rig)
    others = [k for k, name in enumerate(BENCH_AXES) if name in {*earlier, *loaded_rig.value.undriven}]
    key = None if sign_off.operator_key is None else read_key(sign_off.operator_key)
    who: OperatorKey | str = key or sign_off.operator or ("unattended (--yes)" if yes else _asked_name())
    if loaded_rig.value.kind == "hardware" and not prompt.ask(
        "The axes will move. Is the bench clear of people, and the emergency stop in your hand?"
    ):
        return _failed("nothing was moved", console)
    with build.wired_bench(
        job, lambda text: console.print(text, style="dim", highlight=False, soft_wrap=True)
    ) as bench:
        make = provided("rig.kind=emulated: operator") if bench.board is not None else lambda *_: None
        emulated = make(bench.board, bench.addresses)
        button = emulated if emulated is not None and loaded_rig.value.has_io else None
        true_position = emulated.position if emulated is not None else None
        plan = CommissioningPlan(chosen, others, limits)
        steps = Commissioning(
            bench.runner(), loaded_rig.value, prompt, plan, button, true_position, bench.pids.get(WATCHDOG)
        )
        try:
            findings = Findings(proved=steps.prove()) if sign_off.proof_test else steps.run()
        except StepFailed as failure:
            return _failed(str(failure), console)
    proved = rig if sign_off.proof_test else sign_off.out
    if proved is not None and loaded_rig.value.kind == "hardware":
        file = write_proof(proved, time.time(), sign_off.due_days, findings.proved, who)
        prompt.show(f"{file}: proof test passed, the next is due in {sign_off.due_days} days")
    if sign_off.proof_test:
        return _SIGNED
    if sign_off.out is None:
        prompt.show("all steps passed; nothing was written, because there is no --out")
        return _SIGNED
    day = sign_off.date or datetime.datetime.now().astimezone().date().isoformat()
    text = as_toml(findings, loaded_rig.value, base_of(rig, sign_off.out), who, day)
    write_text(text, sign_off.out)
    unsigned = [name for k, name in enumerate(BENCH_AXES) if k not in chosen and k not in others]
    prompt.show(
        f"{sign_off.out}: {len(chosen)} axes signed, left: {', '.join(unsigned)}"
        if unsigned
        else f"{sign_off.out}: the rig is signed off"
    )
    return _SIGNED


def _failed(text: str, console: Console) -> int:
    say(text, console, "red")
    console.print("not signed", style="red", highlight=False)
    return _FAILED


def _is_day(text: str) -> bool:
    with suppress(ValueError):
        return re.fullmatch(r"\d{4}-\d{2}-\d{2}", text) is not None and bool(datetime.date.fromisoformat(text))
    return False


def _check_rig(rig: Loaded[Rig], unattended: bool) -> None:
    """Raise BadInput if there is nothing to commission, or no operator at a hardware rig."""
    if rig.value.kind == "mock":
        raise BadInput.single(rig.where("kind"), "rig.kind", '"mock": there are no devices to commission')
    if rig.value.kind == "hardware" and unattended:
        raise BadInput.single("--yes", "", f"{rig.value.name} is hardware: an operator must watch the bench and answer")


def _asked_name() -> str:
    with suppress(EOFError):
        if name := Console().input("Your name, for the sign-off: ").strip():
            return name
    raise BadInput.single("--operator", "", "is missing: an operator must watch the bench and sign")


def _show(console: Console) -> Callable[[str], None]:
    return lambda text: say(text, console)


class Terminal:
    """Operator at a terminal, who types yes, with the digits of the question, or no; without standard input no."""

    def __init__(self, console: Console, digits: FreshDigits | None = None) -> None:
        self._console = console
        self._digits = FreshDigits() if digits is None else digits

    def show(self, text: str) -> None:
        """Print a line."""
        say(text, self._console)

    def ask(self, question: str) -> bool:
        """Ask until the answer is yes or no, see ``confirmed``."""
        return confirmed(question, self._line, self.show, self._digits)

    def _line(self, prompt: str) -> str | None:
        self._console.print(prompt, end="", highlight=False, soft_wrap=True, markup=False)
        with suppress(EOFError):
            return self._console.input()
        return None
