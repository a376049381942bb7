"""Tests by the wall clock on a computer that pauses: what a pause has failed is repeated, and at last undecided."""

from __future__ import annotations

from typing import Any

import pytest
from _pytest.runner import call_and_report

from tests.support.pauses import Pause, Pauses

LIMIT_S = 0.02
"""A pause beyond this one can lose packets of emulated wires, whose cycle takes 10 to 20 ms."""
TRIES = 3
MOST_UNDECIDED = 3


class WiresTests:
    """Plugin of pytest: repeats a test marked ``wires`` that fails if the computer paused for longer than its limit.

    The limit is ``LIMIT_S`` or that of the marker, ``@pytest.mark.wires(limit_s=0.05)``. A test that each of three
    tries fails so is undecided: neither passed nor failed. More than ``MOST_UNDECIDED`` fail the run.
    """

    def __init__(self, pauses: Pauses | None = None) -> None:
        self._pauses = pauses or Pauses()
        self._undecided: list[str] = []
        self._repeated: list[str] = []

    def pytest_runtest_protocol(self, item: pytest.Item, nextitem: pytest.Item | None) -> bool | None:
        """Run a test marked ``wires``, repeatedly if need be."""
        if (marker := item.get_closest_marker("wires")) is None:
            return None
        item.ihook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for report in self._reports(item, nextitem, marker.kwargs.get("limit_s", LIMIT_S)):
            item.ihook.pytest_runtest_logreport(report=report)
        item.ihook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        return True

    def _reports(self, item: pytest.Item, nextitem: pytest.Item | None, limit_s: float) -> list[pytest.TestReport]:
        """Return the reports of the last try, with what the tries before it have met."""
        pauses: list[str] = []
        while True:
            self._pauses.begin()
            reports = _run(item, nextitem)
            failed = [report for report in reports if report.failed]
            pause = self._pause_of(failed)
            if pause is None or pause.duration_s <= limit_s:
                break
            pauses.append(str(pause))
            if len(pauses) == TRIES:
                _make_undecided(failed, f"pauses of {', '.join(pauses)}, of which {1e3 * limit_s:.0f} ms are the limit")
                return reports
        reports[0].repeated_after = pauses
        if failed and pause is not None:
            failed[0].sections.append(("longest pause of the computer", str(pause)))
        return reports

    def _pause_of(self, failed: list[pytest.TestReport]) -> Pause | None:
        """Return the longest pause of a try; none of one that has passed, or that has taken minutes."""
        if not failed or any("from pytest-timeout" in report.longreprtext for report in failed):
            return None
        try:
            return self._pauses.longest()
        except (TimeoutError, OSError) as error:
            failed[0].sections.append(("pauses of the computer are not known", str(error)))
            return None

    @pytest.hookimpl(tryfirst=True)
    def pytest_report_teststatus(self, report: Any) -> tuple[str, str, str] | None:
        """Return the category of an undecided test, once for each test."""
        if (text := getattr(report, "undecided", None)) is None:
            return None
        return ("undecided", "U", "UNDECIDED") if text else ("", "", "")

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Collect what is undecided or repeated, in the process that reports."""
        if text := getattr(report, "undecided", ""):
            self._undecided.append(f"{report.nodeid}: {text}")
        if pauses := getattr(report, "repeated_after", ()):
            self._repeated.append(f"{report.nodeid}: pauses of {', '.join(pauses)}")

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print a line for each undecided and each repeated test, and their number."""
        for name, tests in (("repeated", self._repeated), ("undecided", self._undecided)):
            for line in tests:
                terminalreporter.write_line(f"{name.upper()} {line}")
            if tests:
                terminalreporter.write_line(f"{len(tests)} {name}: the computer paused", yellow=True)

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Fail a run with too many undecided tests."""
        if len(self._undecided) > MOST_UNDECIDED and session.exitstatus == pytest.ExitCode.OK:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED


def _run(item: Any, nextitem: pytest.Item | None) -> list[pytest.TestReport]:
    """Run a test once; if it fails, the fixtures of its module end with it: they may have suffered as well."""
    if not item._request:  # of a repeated test, as in _pytest.runner.runtestprotocol
        item._initrequest()
    reports = [call_and_report(item, "setup", log=False)]
    if reports[0].passed:
        reports.append(call_and_report(item, "call", log=False))
    kept = item.session if reports[-1].failed else nextitem
    reports.append(call_and_report(item, "teardown", log=False, nextitem=kept))
    item._request = False
    item.funcargs = None
    return reports


def _make_undecided(failed: list[pytest.TestReport], text: str) -> None:
    for report in failed:
        report.sections.append(("failure", report.longreprtext))
        report.longrepr = (str(report.fspath), report.location[1] or 0, f"undecided: {text}")
        report.outcome = "skipped"
        report.undecided = text if report is failed[0] else ""
