"""``hil explain``: why the cases of a campaign, one of them, or a recorded run fail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hil.cli.options import File, OptionalCase, refuse
from hil.cli.output import deliver, print_columns, say
from hil.errors import Problem

_ROWS = 12  # margins that are printed


def explain(source: str, /, *, case: OptionalCase = None, json: File = None) -> int:
    """Explain why cases of a campaign fail, or a recorded run: the first violated limit, its drivers and thresholds.

    Parameters
    ----------
    source
        Folder of a finished campaign, or a recording, *.mcap.
    case
        Number of a case: its margins, and the nearest case that passes.
    json
        File for the result, - for standard output.
    """
    problems = []
    is_run = not Path(source).is_dir()
    if is_run and case is not None:
        problems.append(Problem("--case", "", f"{source}: is no folder of a campaign"))
    if not Path(source).exists():
        problems.append(Problem("hil explain", "", f"{source}: does not exist: a campaign's folder or a recording"))
    refuse(problems)
    reasons = _of_run(source) if is_run else _of_campaign(Path(source), case)
    deliver(reasons, json, lambda: _print(reasons, is_run or case is not None))
    return 0


def _of_campaign(folder: Path, case: int | None) -> dict[str, Any]:
    from hil.parts.campaigns.explain import Cases, case_of, explain

    cases = Cases(folder)
    return (
        explain(cases.column, cases.names) if case is None else case_of(cases.table, case, cases.identity, str(folder))
    )


def _of_run(recording: str) -> dict[str, Any]:
    from hil.api.recordings import open_recording

    return open_recording(recording).why()


def _print(reasons: dict[str, Any], is_one: bool) -> None:
    if is_one:
        say(reasons["text"])
        if reasons["alarms_before"]:
            say(f"alarms before: {reasons['alarms_before']}")
        rows = [_margin_row(each) for each in reasons["limits"][:_ROWS]]
        print_columns(("limit", "least margin", "value", "allowed", "at, s", "largest term"), rows, left=(0, 5))
        _print_nearest(reasons.get("nearest"))
        if "command" in reasons:
            say(reasons["command"])
        return
    rate = reasons["accepted"]
    say(f"{rate['passed']} of {rate['runs']} cases are accepted, {100.0 * rate['rate']:.2f} %")
    for cause in reasons["causes"]:
        say(f"- {cause['text']}")
        _print_nearest(cause["nearest"], "  ")
    if reasons["nothing_found"] and reasons["failed"]:
        say("nothing found: no dispersed number predicts the failures better than chance")
    elif reasons["drivers"]:
        drivers = ", ".join(f"{row['name']} {row['importance']:.3f}" for row in reasons["drivers"])
        say(f"drivers of all failures, by loss of the score of {reasons['score']:.3f}: {drivers}")
    if text := false_alarms_text(reasons):
        say(text)


def false_alarms_text(why: dict[str, Any]) -> str:
    """Return the false alarms of a campaign by what was accused; "" without any. why: as in its summary."""
    alarms = [each for each in why["false_alarms"] if each["alarms"]]
    texts = ", ".join(f"{each['bit']} {each['alarms']} ({each['per_1000']:.3g} per 1000)" for each in alarms)
    return f"false alarms: {texts}" if alarms else ""


def _margin_row(each: dict[str, Any]) -> tuple[str, ...]:
    from hil.report.limits import shown

    numbers = ("-" if each[key] is None else shown(each[key], each["unit"]) for key in ("margin", "value", "allowed"))
    return (each["limit"], *numbers, "-" if each["at_s"] is None else f"{each['at_s']:.2f}", each["term"] or "")


def _print_nearest(nearest: dict[str, Any] | None, indent: str = "") -> None:
    if nearest is None:
        return
    parts = ", ".join(
        f"{each['name']} {each['here']:.4g} here, {each['value']:.4g} there" for each in nearest["differences"]
    )
    say(f"{indent}nearest case that passes: {nearest['case']}; {parts}")
