"""Parts: built-in ones and other packages', and one line for each that cannot be used."""

from __future__ import annotations

from importlib.metadata import EntryPoint

import numpy as np
import pytest

from hil.core import part
from hil.core.part import InstalledPart, Part, PartCommand, Parts, PartSink, joined, provided
from hil.errors import BadInput
from hil.loop.outcome import Outcome
from hil.loop.session_parts import PartResult, SessionParts

OURS = InstalledPart(
    Part(
        name="tracker",
        summary="Laser tracker.",
        commands={"track": PartCommand("hil.cli.track:track", "Track.")},
        tables=("rig.tracker",),
        provides={"rig.tracker.driver=at960": "math:sqrt"},
    ),
    "1.0",
    "hil",
)
ROBOT = Part(name="robot", summary="Robot.", commands={"robot": PartCommand("acme.cli:robot", "Move.")})
SECOND = Part(name="laser", summary="Laser.", commands={"track": PartCommand("acme.cli:track", "Track.")})
TWICE = Part(
    name="twice", summary="Two sinks.", sinks={name: PartSink(9, "/same", "S", "m:F") for name in ("one", "other")}
)
TRACKER = Part(name="tracker", summary="Another.")
NUMBER = 3


def point(name: str, value: str) -> EntryPoint:
    """Return an entry point that names something in this module."""
    return EntryPoint(name, f"{__name__}:{value}", part.GROUP)


def test_part_of_another_package_is_no_different_from_a_built_in_one() -> None:
    found = joined([OURS], [point("robot", "ROBOT")])
    assert [*found.usable] == ["tracker", "robot"]
    assert found.usable["robot"].part is ROBOT
    assert found.problems == []


@pytest.mark.parametrize(
    ("name", "value", "line"),
    [
        ("robot", "MISSING", "cannot be imported: AttributeError"),
        ("robot", "NUMBER", "is of type int, expected Part"),
        ("arm", "ROBOT", "declares part robot, expected arm"),
        ("tracker", "TRACKER", "name tracker is that of part tracker of package hil: the part is left out"),
        ("twice", "TWICE", "declares topic /same twice: the part is left out"),
        ("laser", "SECOND", "command track is that of part tracker of package hil: the part is left out"),
    ],
)
def test_part_that_cannot_be_used_is_one_line_and_leaves_the_others(name: str, value: str, line: str) -> None:
    found = joined([OURS], [point(name, value)])
    assert [*found.usable] == ["tracker"]
    (problem,) = found.problems
    assert line in problem
    assert "\n" not in problem


def test_what_the_core_needs_is_found_by_the_setting_that_needs_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(part, "parts", lambda: Parts({"tracker": OURS}, ["part robot: cannot be imported"]))
    assert provided("rig.tracker.driver=at960")(4.0) == 2.0
    text = "lab.toml: rig.kind=emulated: needs a part that is not installed, see hil list parts; part robot: cannot be"
    with pytest.raises(BadInput, match=text):
        provided("rig.kind=emulated", "lab.toml")


def test_run_has_no_verdict_if_rows_of_a_part_are_in_no_recording() -> None:
    rows = [PartResult("near", {}, {"near_samples": np.zeros(1)}), PartResult("monitor", {}, {"portions": np.zeros(1)})]
    parts = SessionParts(results=[lambda _, result=result: result for result in rows])
    near, monitor = parts.results_of(Outcome(np.zeros(0), "completed"))
    assert near.withheld == "part near: rows near_samples: no sinks= of a Part declares them"
    assert monitor.withheld == ""
