"""Requirements and their evidence: one self-contained page as in a verification control document, and JUnit XML.

The columns are those of ECSS-E-ST-10-02C, annex B: requirement, method, level of the evidence, result, status. The
level is the step of the rig: mock, emulated, hardware.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from itertools import groupby
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree

from hil.report import html

Requirement = Mapping[str, Any]
"""Result of a requirement, by the keys of a campaign's ``summary.json``."""
STEPS: Final = ("mock", "emulated", "hardware")
_HEAD: Final = ("id", "requirement", "step", "method", "evidence", "result", "margin", "status")
VERIFIED, OPEN, NOT_VERIFIED = "verified", "open", "not verified"
"""States of a requirement in a step."""
_MISSING: Final = {
    "mock": "no campaign or run",
    "emulated": "no run with drivers and wires in real time",
    "hardware": "no run on the rig",
}


class EvidenceRow(NamedTuple):
    """Evidence of one step for a requirement. method: "analysis" by a campaign, or "test" by a run.

    text: wording with the limit. status: ``VERIFIED``, ``OPEN`` or why it is not verified.
    """

    id: str
    text: str
    step: str
    method: str
    evidence: str
    result: str
    margin: float | None
    status: str

    @property
    def verified(self) -> bool:
        """Whether the requirement is verified in this step."""
        return self.status == VERIFIED

    def as_json(self) -> dict[str, Any]:
        """Return the row by the keys of ``requirements.json``."""
        return self._asdict()


def campaign_rows(requirements: Iterable[Requirement], identity: Mapping[str, Any]) -> list[EvidenceRow]:
    """Return the evidence of a campaign. identity: of the campaign, as in its folder."""
    of = f"seed {identity.get('seed', '-')}, digest {identity.get('digest', '-')}"
    return [
        EvidenceRow(
            each["id"],
            f"{each['text']} ({limit_text(each)})",
            "mock",
            "analysis",
            f"{each['cases']} cases, {of}",
            result_text(each),
            each["margin"],
            each["verdict"],
        )
        for each in requirements
    ]


def run_row(judged: Requirement, step: str, evidence: str, value: float | None) -> EvidenceRow:
    """Return the evidence of a run for a requirement of a campaign. value: of its outcome, None without one."""
    text = f"{judged['text']} ({limit_text(judged)})"
    if value is None:
        return EvidenceRow(judged["id"], text, step, "test", evidence, "outcome not reached", None, NOT_VERIFIED)
    margin = judged["limit"] - value if judged["side"] == "at most" else value - judged["limit"]
    status = VERIFIED if margin >= 0.0 else NOT_VERIFIED
    return EvidenceRow(judged["id"], text, step, "test", evidence, f"{judged['column']} {value:.5g}", margin, status)


def with_open_steps(rows: Sequence[EvidenceRow]) -> list[EvidenceRow]:
    """Return ``rows`` sorted by requirement, in their first order, and step, with an open row for each missing step."""
    order = list(dict.fromkeys(row.id for row in rows))
    steps = []
    for identifier in order:
        own = [row for row in rows if row.id == identifier]
        for step in STEPS:
            there = [row for row in own if row.step == step]
            steps += there or [EvidenceRow(identifier, own[0].text, step, "-", _MISSING[step], "-", None, OPEN)]
    return steps


def requirements_page(scenario: str, sources: Mapping[str, Any], rows: Sequence[EvidenceRow]) -> str:
    """Return the page of ``rows``. sources: what identifies the evidence, as the campaign's identity."""
    verdict = requirements_verdict(rows)
    body = [
        html.heading(1, f"Requirements of {scenario}"),
        html.paragraph(verdict.upper(), f"verdict {verdict}"),
        html.paragraph(steps_text(rows)),
        html.paragraph(
            "Analysis: Monte Carlo simulation of the closed loop, judged by order statistics (NASA TP-2010-216447); a "
            "case without the outcome is a failure. It holds for independent cases: dispersions of a Latin hypercube "
            "or of Sobol's sequence are not, which makes the bounds approximate. Test: one run, whose outcome is "
            "compared with the limit; it shows the limit in that run, not the probability."
        ),
        requirements_table(rows),
        html.heading(2, "Evidence"),
        html.table(("source", "identification"), [(key, str(value)) for key, value in sources.items()], words=True),
    ]
    return html.page(f"Requirements of {scenario}", body)


def requirements_table(rows: Sequence[EvidenceRow]) -> str:
    """Return the table of ``rows``, with an open row for each missing step."""
    return html.table(_HEAD, _cells(with_open_steps(rows)), words=True)


def requirements_verdict(rows: Sequence[EvidenceRow]) -> str:
    """Return "fail" if a requirement is not verified in a step, "open" if a step has no evidence, else "pass"."""
    states = [state for states in _states(rows).values() for state in states]
    if NOT_VERIFIED in states:
        return "fail"
    return "open" if OPEN in states or not states else "pass"


def steps_text(rows: Sequence[EvidenceRow]) -> str:
    """Return how many requirements are verified, not verified and open in each step."""
    lines = []
    for step, states in _states(rows).items():
        counts = {state: states.count(state) for state in (VERIFIED, NOT_VERIFIED, OPEN)}
        lines.append(f"{step}: " + ", ".join(f"{number} {state}" for state, number in counts.items() if number))
    return "; ".join(lines)


def _states(rows: Sequence[EvidenceRow]) -> dict[str, list[str]]:
    """Return the states of the requirements in each step."""
    whole = _by_requirement(with_open_steps(rows))
    return {step: [_state([row for row in own if row.step == step]) for own in whole] for step in STEPS}


def _by_requirement(rows: Sequence[EvidenceRow]) -> list[list[EvidenceRow]]:
    return [list(own) for _, own in groupby(rows, key=lambda row: row.id)]


def _state(rows: Sequence[EvidenceRow]) -> str:
    """Return the state of a requirement in a step from all its evidence there."""
    states = {row.status for row in rows}
    return NOT_VERIFIED if states - {VERIFIED, OPEN} else OPEN if OPEN in states else VERIFIED


def _cells(rows: Sequence[EvidenceRow]) -> list[tuple[str, ...]]:
    cells: list[tuple[str, ...]] = []
    for own in _by_requirement(rows):
        for i, row in enumerate(own):
            margin = "-" if row.margin is None else f"{row.margin:.4g}"
            status = row.status if row.status in (VERIFIED, OPEN) else f"fail: {row.status}"
            named = (row.id, row.text) if i == 0 else ("", "")
            cells.append((*named, row.step, row.method, row.evidence, row.result, margin, status))
    return cells


def limit_text(judged: Requirement) -> str:
    """Return limit, probability and risk of a requirement as text."""
    return (
        f"{judged['column']} {judged['side']} {judged['limit']:g} in {100.0 * judged['probability']:g} % of the cases, "
        f"consumer risk {100.0 * judged['consumer_risk']:g} %"
    )


def result_text(judged: Requirement) -> str:
    """Return the result of a requirement as text."""
    text = f"{judged['failures']} of {judged['cases']} failed"
    if judged["verdict"] == "too few cases":
        return f"{text}, {judged['cases_needed']} cases are needed"
    bound = "" if judged["bound"] is None else f", tolerance bound {judged['bound']:.5g}"
    return f"{text}, {judged['allowed_failures']} allowed{bound}"


def junit(scenario: str, rows: Sequence[EvidenceRow]) -> str:
    """Return the rows as the test cases of a JUnit suite; open ones are skipped."""
    failed = [row for row in rows if row.status not in (VERIFIED, OPEN)]
    skipped = [row for row in rows if row.status == OPEN]
    suite = ElementTree.Element(
        "testsuite",
        name=f"requirements of {scenario}",
        tests=str(len(rows)),
        failures=str(len(failed)),
        errors="0",
        skipped=str(len(skipped)),
    )
    for row in rows:
        name = f"{row.id}: {row.text}"
        case = ElementTree.SubElement(suite, "testcase", classname=f"{scenario}.{row.step}", name=name)
        if row.status == OPEN:
            ElementTree.SubElement(case, "skipped", message=row.evidence)
        elif row.status != VERIFIED:
            failure = ElementTree.SubElement(case, "failure", message=f"{row.status}: {row.result}")
            failure.text = row.evidence
    ElementTree.indent(suite)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(suite, encoding="unicode") + "\n"


def evidence_json(scenario: str, sources: Mapping[str, Any], rows: Sequence[EvidenceRow]) -> dict[str, Any]:
    """Return the verdict and the rows, with those of open steps, by the keys of ``requirements.json``."""
    whole = [row.as_json() for row in with_open_steps(rows)]
    verdict = requirements_verdict(rows)
    return {"scenario": scenario, "verdict": verdict, "sources": dict(sources), "evidence": whole}


def evidence_files(scenario: str, sources: Mapping[str, Any], rows: Sequence[EvidenceRow]) -> dict[str, str]:
    """Return the page, the JUnit XML and the rows as JSON, by the names of their files."""
    content = evidence_json(scenario, sources, rows)
    return {
        "requirements.html": requirements_page(scenario, sources, rows),
        "requirements.xml": junit(scenario, rows),
        "requirements.json": json.dumps(content, indent=2) + "\n",
    }
