"""A test campaign in one pytest run: the rig, the operator, and what each test leaves for the page of the day."""

from __future__ import annotations

import datetime
import importlib.metadata
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import pytest

from hil.api.jobs import load_rig
from hil.api.results import Run
from hil.api.runs import run as run_scenario
from hil.config.motion_digest import motion_digest
from hil.config.rig import Rig
from hil.core.build_info import build_info
from hil.core.clock import utc_text
from hil.errors import BadInput, BenchError
from hil.parts.campaigns.api.bench import Bench
from hil.parts.campaigns.campaign import scenario_digest
from hil.parts.campaigns.pytest_plugin.conditions import RunConditions, conditions_of, digest_of_test, requirements_of
from hil.parts.campaigns.pytest_plugin.day import DAY_FILE, Day
from hil.parts.campaigns.pytest_plugin.operator_terminal import OperatorTerminal
from hil.parts.campaigns.pytest_plugin.options import option_of
from hil.parts.campaigns.pytest_plugin.procedure_bench import ProcedureBench, completed
from hil.parts.campaigns.pytest_plugin.results import FAILED, PASSED, SKIPPED, CampaignRun, CampaignTest
from hil.parts.campaigns.requirements_page import NOT_VERIFIED, VERIFIED, EvidenceRow
from hil.report.comparison import key_numbers
from hil.report.results import RunResults

_RUNS: Final = pytest.StashKey[list[Run]]()
_EVIDENCE: Final = pytest.StashKey[list[EvidenceRow]]()
_OUTCOME: Final = pytest.StashKey[tuple[str, str]]()
_STARTED: Final = pytest.StashKey[str]()
_LONGEST_MESSAGE: Final = 500


class CampaignSession:
    """Rig and results of one pytest run. rig_name: as given. day: None if no results are written.

    operator: at a hardware rig, None at any other.
    """

    def __init__(self, rig_name: str, in_lock_step: bool, day: Day | None, terminal: str, who: str | None) -> None:
        self.rig_name, self.day = rig_name, day
        self.rig: Rig = load_rig(rig_name)
        self._rig_settings: dict[str, Any] = {}
        if self.rig.kind == "emulated":
            self._rig_settings = {"rig.host.time": "lock_step" if in_lock_step else "wall_clock"}
            self.rig = load_rig(rig_name, self._rig_settings)
        self.label = Path(rig_name).stem
        if self.rig.kind == "emulated":
            self.label += f", {'lock-step' if in_lock_step else 'wall clock'}"
        self._terminal = OperatorTerminal(terminal, rig_name) if self.rig.kind == "hardware" else None
        self._operator, self._trip = who or "", ""
        self._digest = motion_digest(self.rig)
        self._shared: dict[str, Run] = {}

    @classmethod
    def of(cls, config: pytest.Config) -> CampaignSession:
        """Return the session of a pytest run. Raises BadInput."""
        name = option_of(config, "--rig")
        is_worker = hasattr(config, "workerinput")
        day = Day(_folder(config)) if name is not None else None
        lock_step = not option_of(config, "--wall-clock")
        who = option_of(config, "--operator")
        session = cls(str(name or "mock"), lock_step, day, str(option_of(config, "--operator-terminal")), who)
        if session.rig.kind == "hardware" and (is_worker or config.getoption("numprocesses", None)):
            raise BadInput.single("--rig", "", f"{name}: is hardware, which runs one test at a time: omit -n")
        if day is not None and not is_worker:
            day.begin(session.label, session._setup())
        return session

    def _setup(self) -> dict[str, str]:
        rig, build = self.rig, build_info()
        signed = rig.sign_off
        return {
            "rig": self.rig_name,
            "kind": rig.kind,
            "time": {"mock": "simulated"}.get(rig.kind, rig.host.time.replace("_", " ")),
            "motion digest": self._digest,
            "sign-off": "-" if signed is None or signed.digest is None else f"{signed.by}, {signed.date}",
            "operator": self._operator or "-",
            "host": f"{platform.node()}, {platform.platform()}",
            "hil": f"{build.version}, commit {build.commit}",
            "python": platform.python_version(),
            "packages": ", ".join(
                f"{n} {importlib.metadata.version(n)}" for n in ("numpy", "numba", "scipy", "pytest")
            ),
        }

    def has_passed(self, item: pytest.Item) -> bool:
        """Whether ``item`` has passed on this rig on the day that is resumed, and nothing has changed since."""
        return self.day is not None and self.day.has_passed(item.nodeid, self.label, digest_of_test(item, self._digest))

    def run(self, item: pytest.Item) -> Run:
        """Return the run of the item's scenario, of an earlier test with the same one. Raises BenchError for a trip."""
        given = conditions_of(item)
        if given.key in self._shared:
            self._note_run(item, self._shared[given.key])
        else:
            self._confirm(item)
            run = run_scenario(given.scenario, self.rig_name, given.seed, **self._options(given))
            self._note_run(item, run)
            self._shared[given.key] = run
            self._park(run, given)
        return completed(self._shared[given.key])

    @contextmanager
    def bench(self, item: pytest.Item) -> Iterator[ProcedureBench]:
        """Give the bench of a test; afterwards it is at its start, or safe if it has tripped. Raises BenchError."""
        given = conditions_of(item)
        self._confirm(item)
        bench = ProcedureBench(self.rig_name, given.scenario, given.seed, **self._options(given))
        bench.require(*(limit for _, _, limit in requirements_of(item) if limit is not None))
        item.stash[_BENCH] = bench
        parked = False
        try:
            with bench:
                yield bench
                parked = bench.return_to_start()
        finally:
            if bench.result is not None and len(bench.result.history):
                self._note_run(item, bench.result)
            if not parked:
                self._park(bench.result, given)
        bench.raise_unseen_trip()

    def _park(self, run: Run | None, given: RunConditions) -> None:
        """Move a hardware rig to its park position, unless a trip has stopped it: its cause must be removed first."""
        self._trip = "" if run is None or not run.summary["faults"] else str(run.stop)
        try:
            if run is not None:
                completed(run)
        except BenchError as trip:
            self._trip = str(trip)
            return
        if self.rig.kind == "hardware":
            settings = {key: value for key, value in given.settings.items() if key != "faults"}
            with Bench(self.rig_name, given.scenario, overrides=settings) as bench:
                bench.home()
                bench.park()

    def _confirm(self, item: pytest.Item) -> None:
        """Let the operator of a hardware rig confirm the next motion; skip the test otherwise."""
        if self._terminal is None:
            return
        if not self._operator:
            self._operator = (self._terminal.line("Operator's name: ") or "").strip()
            if self.day is not None:
                self.day.begin(self.label, self._setup())
        if self._trip:
            self._terminal.show(f"The bench was stopped: {self._trip}")
            if not self._terminal.ask("Is the cause removed?"):
                pytest.skip("the operator has not confirmed that the cause of the stop is removed")
        self._terminal.show(f"Next test: {item.nodeid}")
        question = "The axes will move. Is the bench clear of people, and the emergency stop in your hand?"
        if not self._operator or not self._terminal.ask(question):
            pytest.skip("the operator has not confirmed that the bench is clear")

    def _options(self, given: RunConditions) -> dict[str, Any]:
        """Return the arguments that a run and a bench of the same conditions share."""
        record = None if self.day is None else self.day.folder / "recordings"
        return {"overrides": given.settings | self._rig_settings, "gnc": given.gnc, "record": record}

    def _note_run(self, item: pytest.Item, run: Run) -> None:
        item.stash.setdefault(_RUNS, []).append(run)

    def check_requirements(self, item: pytest.Item) -> None:
        """Check the limits of the test's requirements on its runs; a violated one fails the test."""
        bench = item.stash.get(_BENCH, None)
        runs = [*item.stash.get(_RUNS, []), *([bench.latest] if bench is not None and bench.latest is not None else [])]
        limits = [limit for _, _, limit in requirements_of(item) if limit is not None]
        rows = [limit.check(run) for limit in limits for run in runs]
        item.stash[_EVIDENCE] = [row._replace(evidence=f"{item.nodeid}: {row.evidence}") for row in rows]
        if limits and not runs:
            pytest.fail(f"{limits[0].id}: no run, on which the requirement could be verified", pytrace=False)
        for row in rows:
            if not row.verified:
                pytest.fail(f"{row.id}: {row.text}: {row.result}, {row.status}", pytrace=False)

    def complete(self, item: pytest.Item, call: pytest.CallInfo[None], report: Any) -> None:
        """Shorten the text of errors of bench and input to their lines; attach the test's result to its last report."""
        if call.when == "setup":
            item.stash[_STARTED] = utc_text()
        error = call.excinfo.value if call.excinfo is not None else None
        if report.failed and isinstance(error, BenchError | BadInput):
            report.longrepr = str(error)
        outcome, _ = item.stash.get(_OUTCOME, (PASSED, ""))
        if outcome == PASSED and not report.passed:
            item.stash[_OUTCOME] = (SKIPPED if report.skipped else FAILED, _message(report, error))
        if call.when == "teardown" and self.day is not None:
            report.hil_test = self._result(item, report).as_json()

    def _result(self, item: pytest.Item, report: Any) -> CampaignTest:
        outcome, message = item.stash.get(_OUTCOME, (PASSED, ""))
        rows: list[EvidenceRow] = [*item.stash.setdefault(_EVIDENCE, [])]
        runs = item.stash.get(_RUNS, [])
        status = VERIFIED if outcome == PASSED else NOT_VERIFIED
        ran = "; ".join(f"{run.summary['scenario']}, seed {run.summary['seed']}, {run.stop}" for run in runs)
        identifiers = {row.id for row in rows}
        for identifier, text, _ in requirements_of(item) if outcome != SKIPPED else ():
            if identifier not in identifiers:
                evidence = f"{item.nodeid} on {self.label}: {ran or 'no run'}"
                result = message or "the test has passed"
                rows.append(EvidenceRow(identifier, text, self.rig.kind, "test", evidence, result, None, status))
        started = item.stash.get(_STARTED, utc_text())
        wall_s = (_moment(utc_text()) - _moment(started)).total_seconds()
        document = (getattr(getattr(item, "obj", None), "__doc__", None) or "").strip()
        return CampaignTest(
            item.nodeid,
            document.splitlines()[0] if document else "",
            self.label,
            self.rig.kind,
            outcome,
            message,
            started,
            max(wall_s, float(report.duration)),
            digest_of_test(item, self._digest),
            [self._stored(run) for run in runs],
            [row.as_json() for row in rows],
        )

    def _stored(self, run: Run) -> CampaignRun:
        file = (run.summary.get("recording") or {}).get("file", "")
        assert self.day is not None
        return CampaignRun(
            str(run.summary["scenario"]),
            int(run.summary["seed"]),
            run.accepted,
            run.stop,
            dict(key_numbers(RunResults.of(run.summary))),
            [{key: asdict(alarm)[key] for key in ("t_s", "priority", "text")} for alarm in run.alarms],
            str(Path(file).relative_to(self.day.folder)) if file else "",
            scenario_digest(run.scenario),
        )


_BENCH: Final = pytest.StashKey[ProcedureBench]()


def _moment(text: str) -> datetime.datetime:
    return datetime.datetime.fromisoformat(text)


def _message(report: Any, error: BaseException | None) -> str:
    if report.skipped and isinstance(report.longrepr, tuple):
        return str(report.longrepr[2]).removeprefix("Skipped: ")
    text = str(error) if error is not None else str(report.longrepr)
    return (text.strip().splitlines() or [type(error).__name__])[0][:_LONGEST_MESSAGE]


def _folder(config: pytest.Config) -> Path:
    """Return the folder of the day: ``--results``; the latest one to resume; else today's."""
    given = option_of(config, "--results")
    if given is not None:
        return Path(given)
    top = config.rootpath / str(config.getini("hil_results"))
    if option_of(config, "--resume"):
        days = sorted(path.parent for path in top.glob(f"*/{DAY_FILE}"))
        if not days:
            raise BadInput.single("--resume", "", f"{top}: holds no day that could be resumed")
        return days[-1]
    return top / datetime.datetime.now().astimezone().date().isoformat()
