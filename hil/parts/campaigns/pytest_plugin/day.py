"""Results of one day of a test campaign in a folder: ``day.json``, from which all its pages are made.

The file is written after each test, so that a day that is interrupted can be resumed. A test has one result per rig;
a later result replaces an earlier one.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final
from xml.etree import ElementTree

from hil.core.files import parse_json, read_text, write_text
from hil.errors import BadInput, one_line
from hil.parts.campaigns.campaign import write_evidence
from hil.parts.campaigns.pytest_plugin.day_page import day_page
from hil.parts.campaigns.pytest_plugin.results import FAILED, PASSED, SKIPPED, CampaignTest
from hil.parts.campaigns.requirements_page import EvidenceRow, requirements_verdict, steps_text

DAY_FILE: Final = "day.json"
PAGE: Final = "day.html"
_DAY_BYTES: Final = 1 << 27


class Day:
    """A day in ``folder``. setups: what identifies each rig, by its label. Raises BadInput for an unreadable file."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.setups: dict[str, dict[str, str]] = {}
        self._tests: dict[tuple[str, str], CampaignTest] = {}
        path = folder / DAY_FILE
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput.single("--results", "", f"{folder}: cannot be made: {error.strerror}") from error
        if not path.is_file():
            return
        try:
            content = parse_json(read_text(path, _DAY_BYTES))
            self.setups = dict(content["setups"])
            for table in content["tests"]:
                test = CampaignTest.of_json(table)
                self._tests[test.test, test.rig] = test
        except (ValueError, TypeError, KeyError) as error:
            raise BadInput.single(str(path), "", f"is no day of a campaign: {one_line(str(error), 200)}") from error

    @property
    def tests(self) -> list[CampaignTest]:
        """All results, in the order of the first ones."""
        return list(self._tests.values())

    def begin(self, rig: str, setup: dict[str, str]) -> None:
        """Take the set-up of the rig on which tests follow."""
        self.setups[rig] = setup
        self._write()

    def add(self, table: dict[str, Any]) -> None:
        """Take the result of a test, as ``CampaignTest.as_json``."""
        test = CampaignTest.of_json(table)
        self._tests[test.test, test.rig] = test
        self._write()

    def has_passed(self, test: str, rig: str, digest: str) -> bool:
        """Whether ``test`` has passed on ``rig``, and nothing has changed since."""
        previous = self._tests.get((test, rig))
        return previous is not None and previous.outcome == PASSED and previous.digest == digest

    def evidence(self) -> list[EvidenceRow]:
        """Return the rows of all tests."""
        return [EvidenceRow(**row) for test in self.tests for row in test.evidence]

    def write_pages(self) -> None:
        """Write the page of the day, JUnit XML, and the requirements of which a test is evidence."""
        rows = self.evidence()
        if rows:
            sources = {rig: ", ".join(setup.values()) for rig, setup in self.setups.items()}
            write_evidence(self.folder, f"the test campaign {self.folder.name}", sources, rows)
        (self.folder / "junit.xml").write_text(self.junit(), encoding="utf-8")
        page = day_page(self.folder, self.setups, self.tests, rows)
        (self.folder / PAGE).write_text(page, encoding="utf-8")

    def summary_lines(self) -> list[str]:
        """Return a line for each rig, one for the requirements, and one for the page."""
        lines = []
        for rig in self.setups:
            outcomes = [test.outcome for test in self.tests if test.rig == rig]
            counts = ", ".join(f"{outcomes.count(o)} {o}" for o in (PASSED, FAILED, SKIPPED) if o in outcomes)
            lines.append(f"{rig}: {counts or 'no test'}")
        if rows := self.evidence():
            lines.append(f"{requirements_verdict(rows).upper()} requirements: {steps_text(rows)}")
        return [*lines, f"results in {self.folder / PAGE}"]

    def junit(self) -> str:
        """Return JUnit XML with a suite per rig."""
        top = ElementTree.Element("testsuites", name=f"test campaign {self.folder.name}")
        for rig in self.setups:
            _suite(top, rig, [test for test in self.tests if test.rig == rig])
        ElementTree.indent(top)
        return '<?xml version="1.0" encoding="utf-8"?>\n' + ElementTree.tostring(top, encoding="unicode") + "\n"

    def _write(self) -> None:
        content = {"setups": self.setups, "tests": [test.as_json() for test in self.tests]}
        write_text(json.dumps(content, indent=1) + "\n", self.folder / DAY_FILE)


def _suite(top: ElementTree.Element, rig: str, tests: Sequence[CampaignTest]) -> None:
    outcomes = [test.outcome for test in tests]
    suite = ElementTree.SubElement(
        top,
        "testsuite",
        name=rig,
        tests=str(len(tests)),
        failures=str(outcomes.count(FAILED)),
        errors="0",
        skipped=str(outcomes.count(SKIPPED)),
        time=f"{sum(test.wall_s for test in tests):.3f}",
    )
    for test in tests:
        file, _, name = test.test.partition("::")
        group = f"{rig}.{file.removesuffix('.py').replace('/', '.')}"
        case = ElementTree.SubElement(suite, "testcase", classname=group, name=name, time=f"{test.wall_s:.3f}")
        properties = [("requirement", row["id"]) for row in test.evidence] + [
            ("run", f"{run.scenario}, seed {run.seed}, {run.stop}") for run in test.runs
        ]
        if properties:
            listed = ElementTree.SubElement(case, "properties")
            for key, value in properties:
                ElementTree.SubElement(listed, "property", name=key, value=value)
        if test.outcome != PASSED:
            tag = "failure" if test.outcome == FAILED else "skipped"
            ElementTree.SubElement(case, tag, message=test.message)
