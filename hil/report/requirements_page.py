"""Requirements and their evidence: one self-contained page as in a verification control document, and JUnit XML.

The columns are those of ECSS-E-ST-10-02C, annex B: requirement, method, level of the evidence, result, status.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any
from xml.etree import ElementTree

from hil.report import html

Requirement = Mapping[str, Any]
"""Result of a requirement, by the keys of a campaign's ``summary.json``."""

_HEAD = ("id", "requirement", "step", "evidence", "result", "margin", "status")
_OPEN = (("emulated", "drivers and wires in real time"), ("hardware", "the rig"))


def requirements_page(scenario: str, identity: Mapping[str, Any], found: Sequence[Requirement]) -> str:
    """Return the page of a campaign. identity: of the campaign, as in its folder."""
    verified = sum(each["verdict"] == "verified" for each in found)
    rows = [row for each in found for row in _rows(each, identity)]
    body = [
        html.heading(1, f"Requirements of {scenario}"),
        html.paragraph(
            f"{verified} of {len(found)} verified", f"verdict {'pass' if verified == len(found) else 'fail'}"
        ),
        html.paragraph(
            "Method: analysis by Monte Carlo simulation of the closed loop, judged by order statistics "
            "(NASA TP-2010-216447). A case without the outcome is a failure. The judgement holds for independent "
            "cases: dispersions of a Latin hypercube or of Sobol's sequence are not, which makes the bounds "
            "approximate. The steps on wires and on hardware are to be shown by recordings of those rigs."
        ),
        html.table(_HEAD, rows, words=True),
        html.heading(2, "Evidence"),
        html.table(("key", "value"), [(key, str(value)) for key, value in identity.items()], words=True),
    ]
    return html.page(f"Requirements of {scenario}", body)


def _rows(found: Requirement, identity: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return a row for each step of a requirement."""
    wording = f"{found['text']} ({limit_text(found)})"
    evidence = f"{found['cases']} cases, seed {identity.get('seed', '-')}, digest {identity.get('digest', '-')}"
    margin = "-" if found["margin"] is None else f"{found['margin']:.4g}"
    status = found["verdict"] if found["verdict"] == "verified" else f"fail: {found['verdict']}"
    rows: list[tuple[str, ...]] = [(found["id"], wording, "mock", evidence, result_text(found), margin, status)]
    return rows + [(found["id"], "", step, what, "-", "-", "open") for step, what in _OPEN]


def limit_text(found: Requirement) -> str:
    """Return limit, probability and risk of a requirement as text."""
    return (
        f"{found['column']} {found['side']} {found['limit']:g} in {100.0 * found['probability']:g} % of the cases, "
        f"consumer risk {100.0 * found['consumer_risk']:g} %"
    )


def result_text(found: Requirement) -> str:
    """Return the result of a requirement as text."""
    text = f"{found['failures']} of {found['cases']} failed"
    if found["verdict"] == "too few cases":
        return f"{text}, {found['cases_needed']} cases are needed"
    bound = "" if found["bound"] is None else f", tolerance bound {found['bound']:.5g}"
    return f"{text}, {found['allowed_failures']} allowed{bound}"


def junit(scenario: str, found: Sequence[Requirement]) -> str:
    """Return the requirements as the test cases of a JUnit suite."""
    failed = [each for each in found if each["verdict"] != "verified"]
    suite = ElementTree.Element(
        "testsuite", name=f"requirements of {scenario}", tests=str(len(found)), failures=str(len(failed)), errors="0"
    )
    for each in found:
        case = ElementTree.SubElement(suite, "testcase", classname=scenario, name=f"{each['id']}: {each['text']}")
        if each["verdict"] != "verified":
            failure = ElementTree.SubElement(case, "failure", message=f"{each['verdict']}: {result_text(each)}")
            failure.text = limit_text(each)
    ElementTree.indent(suite)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(suite, encoding="unicode") + "\n"
