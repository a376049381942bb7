"""Hooks and fixtures of the pytest plugin, by which a test campaign runs on any rig.

pytest imports this module in each of its runs, of other projects too: it imports its options alone before a test
uses a fixture or an option of it, and adds its options after those of all others, none that exists already.
"""

from __future__ import annotations

from collections.abc import Generator, Iterator, Sequence
from contextlib import suppress
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

import pytest

from hil.parts.campaigns.pytest_plugin.options import OPTIONS, attribute, option_of

if TYPE_CHECKING:
    from hil.api.results import Run
    from hil.config.rig import Rig
    from hil.parts.campaigns.pytest_plugin.campaign_session import CampaignSession
    from hil.parts.campaigns.pytest_plugin.day import Day
    from hil.parts.campaigns.pytest_plugin.procedure_bench import ProcedureBench

_VALUED: Final = {name for name, attributes in OPTIONS.items() if "metavar" in attributes}
_MARKERS: Final = (
    "requirement(id, text=...): the test is evidence for a requirement; or requirement(hil.RunRequirement(...))",
    "scenario(name, seed=0, overrides=None, faults=None, gnc=None): what `bench` and `run` fly",
)


@pytest.hookimpl(wrapper=True)
def pytest_load_initial_conftests(
    early_config: pytest.Config, parser: pytest.Parser, args: Sequence[str]
) -> Iterator[None]:
    """Add the options when those of all plugins and conftest files are known; their values are no test files."""
    values = {value for option, value in pairwise(args) if option in _VALUED}
    options = early_config.known_args_namespace
    options.file_or_dir = [name for name in options.file_or_dir if name not in values]
    yield
    group = parser.getgroup("hil", "test campaign on a bench (hil)")
    for name, attributes in OPTIONS.items():
        with suppress(Exception):  # a name of another plugin or of a conftest file stays with it
            group.addoption(name, dest=attribute(name), **attributes)
    with suppress(ValueError):
        parser.addini("hil_scenario", "scenario of tests without a scenario marker", default="scheme-1")
        parser.addini("hil_results", "folder in which each day of a test campaign has one", default="results")


@pytest.hookimpl
def pytest_configure(config: pytest.Config) -> None:
    """Register the markers; with ``--rig`` begin or resume the day."""
    for marker in _MARKERS:
        config.addinivalue_line("markers", marker)
    if option_of(config, "--rig") is not None and not (config.option.help or config.option.collectonly):
        day = session_of(config).day
        if day is not None and not hasattr(config, "workerinput"):
            config.pluginmanager.register(DayReporter(day))
        return
    for option in ("--resume", "--wall-clock", "--results"):
        if option_of(config, option):
            raise pytest.UsageError(f"{option}: needs --rig")


_SESSION: Final = pytest.StashKey["CampaignSession"]()


def session_of(config: pytest.Config) -> CampaignSession:
    """Return the campaign's session, made at its first use. Raises pytest.UsageError."""
    if _SESSION not in config.stash:
        from hil.errors import BadInput
        from hil.parts.campaigns.pytest_plugin.campaign_session import CampaignSession

        try:
            config.stash[_SESSION] = CampaignSession.of(config)
        except BadInput as error:
            raise pytest.UsageError(str(error)) from None
    return config.stash[_SESSION]


def _active(config: pytest.Config) -> CampaignSession | None:
    return config.stash.get(_SESSION, None)


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Check the markers; with ``--resume`` deselect the tests that have passed."""
    if any(item.get_closest_marker("requirement") or item.get_closest_marker("scenario") for item in items):
        from hil.errors import BadInput
        from hil.parts.campaigns.pytest_plugin.conditions import check_markers

        try:
            check_markers(items)
        except BadInput as error:
            raise pytest.UsageError(str(error)) from None
    if (session := _active(config)) is not None and option_of(config, "--resume"):
        passed = [item for item in items if session.has_passed(item)]
        items[:] = [item for item in items if item not in passed]
        config.hook.pytest_deselected(items=passed)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Check the requirements on runs after the test."""
    yield
    if (session := _active(item.config)) is not None:
        session.check_requirements(item)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Give a stop of the bench or an invalid input its one line; attach runs and evidence to the last report."""
    report = yield
    if (session := _active(item.config)) is not None:
        session.complete(item, call, report)
    return report


class DayReporter:
    """Hooks of the process that writes the results: each test when it has ended, the pages at the end."""

    def __init__(self, day: Day) -> None:
        self._day = day

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Store the results of a test, also of another process of pytest-xdist."""
        if (entry := getattr(report, "hil_test", None)) is not None:
            self._day.add(entry)

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self) -> None:
        """Write the pages of the day."""
        self._day.write_pages()

    def pytest_terminal_summary(self, terminalreporter: Any) -> None:
        """Print where the results are."""
        terminalreporter.section("test campaign", sep="-")
        for line in self._day.summary_lines():
            terminalreporter.write_line(line)


@pytest.fixture(scope="session")
def rig(pytestconfig: pytest.Config) -> Rig:
    """The rig on which the tests run, checked: mock without ``--rig``."""
    return session_of(pytestconfig).rig


@pytest.fixture
def run(request: pytest.FixtureRequest) -> Run:
    """The run of the test's scenario on the rig, from start to end; tests with equal scenario and seed share it.

    A trip ends the test with the alarm as its message.
    """
    return session_of(request.config).run(request.node)


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[ProcedureBench]:
    """The bench with the test's scenario, its devices open, in standby: ``hil.Bench``.

    After the test the bench returns to its start. A trip ends the test with the alarm as its message, and leaves the
    bench safe: ``start`` and ``resume`` raise BenchError, which a test of a fault expects by ``pytest.raises``.
    """
    with session_of(request.config).bench(request.node) as opened:
        yield opened
