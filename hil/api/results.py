"""Results of a run: verdict, numbers and records, as a notebook needs them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.alarms import Alarm
from hil.core.clock import utc_ns
from hil.core.fields import record_dtype
from hil.core.files import write_text
from hil.core.messages import ARRIVAL, CYCLE, Array, Event, with_thrusters
from hil.core.part import imported, part_sinks, provided
from hil.core.public import public
from hil.core.sensor_records import SENSOR_ARRIVAL
from hil.errors import BadInput
from hil.loop.compiled.run_stats import counted
from hil.loop.outcome import Outcome
from hil.report.consistency import NO_NEES, Nees, nees_of
from hil.report.limits import why_of
from hil.report.results import RunResults
from hil.report.summary import limits_of
from hil.report.verdict import Verdict, verdict_of
from hil.sensors.vision_unit import columns as vmu_columns
from hil.session.assembly import Job

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from hil.recording.read import Recorded

_GROUPS: Final = tuple(name for name in CYCLE.names or () if CYCLE[name].names)


class RecordGroup:
    """Records of one kind, one row per cycle, pose or portion.

    Each field is an attribute, an array whose first axis is the row: ``truth.r_CT_H`` (n, 3), ``navigation.valid``
    (n,). SI units; the unit is in the name or in the table of records of the reference, frames in its page on frames.
    ``t_s``: time of the run of each row, (n,), s. ``records``: all fields as a structured array, (n,).
    """

    def __init__(self, records: np.ndarray, t_s: Array) -> None:
        self.records = records
        self.t_s = t_s

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields."""
        return self.records.dtype.names or ()

    def __getattr__(self, name: str) -> np.ndarray:
        if name == "records" or name not in self.fields:
            raise AttributeError(f"no field {name!r}; this group has {', '.join(self.fields)}")
        values: np.ndarray = self.records[name]
        return values

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a field by its name."""
        values: np.ndarray = getattr(self, name)
        return values

    def __len__(self) -> int:
        return len(self.records)

    def __dir__(self) -> list[str]:
        return sorted({*super().__dir__(), *self.fields})

    def __repr__(self) -> str:
        return f"<{len(self)} records: {', '.join(self.fields)}>"


@dataclass(frozen=True)
class RunData:
    """Content of a run.

    history: (n,) of CYCLE. of_parts: rows that parts have added, by the names of their sinks. sensor_arrivals: (n,) of
    SENSOR_ARRIVAL.
    """

    scenario: Scenario
    rig: Rig
    history: np.ndarray
    summary: dict[str, Any]
    events: list[Event]
    alarms: list[Alarm]
    of_parts: Mapping[str, np.ndarray]
    sensor_arrivals: np.ndarray = field(default_factory=lambda: np.zeros(0, SENSOR_ARRIVAL))


class Run:
    """A run that has ended, or the part of it up to a hold.

    scenario, rig: as run. summary: the numbers of ``hil run --json``, by its keys. history: (n,) of CYCLE, all records
    of the GNC's cycles. events: what happened, by the time of the run. alarms: trips, by bench time.
    """

    def __init__(self, data: RunData, as_recorded: Callable[[], Recorded]) -> None:
        self.scenario = data.scenario
        self.rig = data.rig
        self.history = data.history
        self.summary = data.summary
        self.events = data.events
        self.alarms = data.alarms
        self._of_parts = data.of_parts
        self.as_recorded = as_recorded
        """Returns the run in the form of a recording that was read."""

    @property
    def accepted(self) -> bool:
        """Whether a complete run without abort has passed all parts of the verdict that its scenario requires."""
        return bool(self.summary["accepted"])

    @property
    def passed(self) -> bool:
        """Whether Table III holds in the whole ready phase of a complete run without abort."""
        return bool(self.summary["passed"])

    @property
    def ready_time_s(self) -> float | None:
        """Time of the run at which the ready phase begins, s; None if never."""
        time_s: float | None = self.summary["ready_time_s"]
        return time_s

    @cached_property
    def verdict(self) -> Verdict:
        """Ready phase and largest deviations of the truth in it, (3,) per row of Table III: m, m/s, deg, deg/s."""
        return verdict_of(self._counted.ready, self.scenario.requirements)

    @cached_property
    def _counted(self) -> np.record:
        return counted(self.history, self.scenario, self.rig)

    def to_pandas(self) -> Any:
        """Return a DataFrame of all records, one row per cycle, indexed by time, s. Raises BadInput without pandas."""
        from hil.api import frames

        return frames.to_pandas(self._fitted, self.t_s)

    def to_polars(self) -> Any:
        """Return a polars DataFrame of all records, one row per cycle. Raises BadInput without polars."""
        from hil.api import frames

        return frames.to_polars(self._fitted, self.t_s)

    def to_xarray(self) -> Any:
        """Return a Dataset of all records: time as index, axes by name, units. Raises BadInput without xarray."""
        from hil.api import frames

        return frames.to_xarray(self._fitted, self.t_s)

    def why(self) -> dict[str, Any]:
        """Return the first violated limit as ``text``, ``alarms_before`` it, and all ``limits`` by their margins."""
        summary = self.summary
        if "limits" not in summary:  # a recording of an earlier version
            outcome = Outcome(self.history, self.stop, alarms=self.alarms)
            summary = summary | limits_of(outcome, self._counted, RunResults.of(summary), self.scenario)
        return why_of(summary)

    @property
    def stop(self) -> str:
        """``completed``, or why the run ended earlier."""
        return str(self.summary["stop"])

    @property
    def t_s(self) -> Array:
        """Time of the run at each cycle of the GNC, (n,), s."""
        times: Array = self.history["t_s"]
        return times

    @property
    def truth(self) -> RecordGroup:
        """Simulated chaser, target and orbit, per cycle."""
        return self._group("truth")

    @property
    def imu(self) -> RecordGroup:
        """Samples of the virtual IMU, per cycle."""
        return self._group("imu")

    @property
    def pose(self) -> RecordGroup:
        """Poses that navigation received: the newest of each cycle in which any arrived; ``t_s``: exposure."""
        poses = vmu_columns.poses(self.history)
        return RecordGroup(poses, poses["t_s"])

    @property
    def navigation(self) -> RecordGroup:
        """Estimate with its standard deviations, per cycle."""
        return self._group("navigation")

    @property
    def reference(self) -> RecordGroup:
        """Reference of the guidance, per cycle."""
        return self._group("reference")

    @property
    def supervision(self) -> RecordGroup:
        """Margins and aborts of the approach monitor, per cycle."""
        return self._group("supervision")

    @property
    def command(self) -> RecordGroup:
        """Demands and thrusters, per cycle."""
        return self._group("command")

    @property
    def setpoint(self) -> RecordGroup:
        """Setpoints sent to rails and turntable, per cycle."""
        return self._group("setpoint")

    @property
    def feedback(self) -> RecordGroup:
        """Encoders of rails and turntable, per cycle."""
        return self._group("feedback")

    @property
    def cycles(self) -> RecordGroup:
        """Fields of the cycle itself: times on the wires, lateness, NEES."""
        own = [name for name in CYCLE.names or () if name not in _GROUPS]
        return RecordGroup(self.history[own], self.t_s)

    @property
    def sensors(self) -> dict[str, RecordGroup]:
        """Samples of each further sensor, by its name, in the order of their arrival.

        Of each component, as the module declares them, ``NAME``, ``sigma_NAME`` and ``innovation_NAME``, the innovation
        over its standard deviation; ``t_s``, ``received_s``, ``cycle``, ``nis``, and ``result``, as of SENSOR_ARRIVAL.
        """
        from hil.recording import schema  # slow import

        recorded = self.as_recorded()
        flat = recorded.sensor_arrivals.view(schema.flat_dtype(SENSOR_ARRIVAL))
        groups = {}
        for name, table, _ in schema.sensor_tables(flat, recorded.files.get(schema.SENSORS_FILE, "{}")):
            fields = [(column, values.dtype) for column, values in table.items()]
            groups[name] = RecordGroup(np.rec.fromarrays([*table.values()], dtype=fields), table["t_s"])
        return groups

    @property
    def portions(self) -> RecordGroup:
        """Results of the docking monitor, one row per portion; empty without one."""
        return self.rows_of("portions")

    @public
    def rows_of(self, name: str) -> RecordGroup:
        """Return the rows that a part has added, by the name of their sink; empty if the run has none of them.

        Raises BadInput if no installed part has such rows.
        """
        sink = part_sinks().get(name)
        if sink is None or not sink.topic:
            names = ", ".join(each for each, sink in part_sinks().items() if sink.topic)
            raise BadInput.single("rows_of", name, f"no such rows of a part, known are {names or 'none'}")
        rows = self._of_parts.get(name, np.zeros(0, record_dtype(imported(sink.fields))))
        return RecordGroup(rows, rows["t_s"])

    @public
    def show(self, explain: bool = False) -> None:
        """Print the verdict and the key numbers, as ``hil run``. explain: with what each line means."""
        from rich.console import Console  # slow imports

        from hil.report.section import sections_of
        from hil.report.table import render

        render(RunResults.of(self.summary), self.verdict, self.scenario.requirements, Console(), explain)
        for section in sections_of(self.summary):
            print("\n".join(section.text()))  # noqa: T201

    @public
    def plot(self, name: Literal["ready", "trajectory", "errors", "attitude", "nees", "thrusters"] = "ready") -> Figure:
        """Return a figure of matplotlib. Raises BadInput.

        - ``ready``: the truth against the ready state (bench paper figures 6 and 7).
        - ``trajectory``: path, position and velocity in H.
        - ``errors``: errors of the estimate of position and velocity, with 3 sigma.
        - ``attitude``: angles, and error of the estimate with 3 sigma.
        - ``nees``: NEES of both filters at each pose, with its bounds.
        - ``thrusters``: openings of each thruster.
        """
        from hil.report.plots import PLOTS  # slow import

        self._require_cycles()
        if name == "nees":
            self.nees()
        return PLOTS[name](self.history, self.scenario, self.verdict)

    @public
    def nees(self, probability: float = 0.95) -> Nees:
        """Return the NEES of both filters at each pose, with its bounds. Raises BadInput.

        probability: with which a single value of a consistent filter is within the bounds.
        """
        if not 0.0 < probability < 1.0:
            raise BadInput.single("probability", "", f"{probability:g}: must be above 0 and below 1")
        nees = nees_of(self.history, self.scenario.chaser.planar, probability)
        if not len(nees.t_s):
            raise BadInput.single(self._source(), "", f"has no NEES: {NO_NEES}")
        return nees

    @public
    def report(self, path: str | Path) -> None:
        """Write a self-contained HTML page with verdict, figures and numbers to ``path``. Raises BadInput."""
        write_report([self], path)

    @public
    def to_parquet(self, path: str | Path) -> None:
        """Write all cycles to ``path``, one column per number (``truth.r_CT_H[0]``). Raises BadInput."""
        provided("table of cycles")(self.history, self._thrusters, Path(path))

    @property
    def _thrusters(self) -> int:
        return len(self.scenario.chaser.thrusters.position_m)

    @property
    def _fitted(self) -> np.ndarray:
        """All records, of the thrusters only those that the vehicle has."""
        return with_thrusters(self.history, self._thrusters)

    def _group(self, name: str) -> RecordGroup:
        return RecordGroup(self._fitted[name], self.t_s)

    def _source(self) -> str:
        return str(self)

    def _require_cycles(self) -> None:
        if not len(self.history):
            raise BadInput.single(self._source(), "", "no cycle is recorded")

    def __repr__(self) -> str:
        ready = "never ready" if self.ready_time_s is None else f"ready at {self.ready_time_s:.2f} s"
        verdict = "accepted" if self.accepted else "not accepted"
        name = f"{self.summary['scenario']} on {self.summary['rig']}, seed {self.summary['seed']}"
        name += f", case {case}" if (case := self.summary.get("case")) is not None else ""
        return f"<{type(self).__name__} {name}: {verdict}, {ready}, {self.stop}>"

    def _repr_html_(self) -> str:
        """Return verdict and figure for a notebook."""
        from hil.report import html
        from hil.report.figures import svg_address

        word = "PASS" if self.accepted else "FAIL"
        text = f"<p><b>{word}</b> {escape(repr(self)[1:-1])}</p>"
        return text + html.image("truth against the ready state", svg_address(self.plot())) if len(self.t_s) else text


def run_of(
    job: Job, rig: str, outcome: Outcome, summary: dict[str, Any], of_parts: Mapping[str, np.ndarray] | None = None
) -> Run:
    """Return the results of a run of this process. rig: its name. of_parts: rows that parts have added."""
    scenario, of_rig = job.scenario.value, job.rig.value
    events, alarms = outcome.events, outcome.alarms
    data = RunData(scenario, of_rig, outcome.history, summary, events, alarms, of_parts or {}, outcome.sensor_arrivals)
    ended_ns = utc_ns()
    return Run(data, lambda: _recorded(job, rig, data, ended_ns))


def _recorded(job: Job, rig: str, data: RunData, ended_ns: int) -> Recorded:
    from hil.recording.header import header_of  # slow imports
    from hil.recording.read import Recorded

    header = header_of(job, rig, f"{data.scenario.name}, not recorded", ended_ns)
    log = [_log_entry("event", e.t_s, None, e.source, e.text) for e in data.events]
    log += [_log_entry("alarm", None, a.t_s, a.device, a.text) for a in data.alarms]
    return Recorded(
        path=Path(header.run["run"]),
        run=dict(header.run),
        end={},
        scenario=data.scenario,
        rig=data.rig,
        cycles=data.history,
        arrivals=np.zeros(0, ARRIVAL),
        log=log,
        summary=data.summary,
        intact=True,
        files=dict(header.files),
        sensor_arrivals=data.sensor_arrivals,
        of_parts=data.of_parts,
    )


def _log_entry(kind: str, t_s: float | None, bench_s: float | None, name: str, message: str) -> dict[str, Any]:
    return {"kind": kind, "t_s": t_s, "bench_s": bench_s, "cycle": -1, "name": name, "message": message}


def write_report(runs: Sequence[Run], path: str | Path) -> None:
    """Write the report of one run, or a comparison of several, to ``path``: completely or not at all.

    Raises BadInput if the path does not end in .html or cannot be written, or for a run without a cycle.
    """
    from hil.report import page  # slow import of matplotlib

    target = Path(path)
    if target.suffix.lower() not in (".html", ".htm"):
        raise BadInput.single(str(path), "", "must end in .html")
    for run in runs:
        run._require_cycles()
    if not target.absolute().parent.is_dir():
        raise BadInput.single(str(path), "", "cannot be written: no such folder")
    write_text(page.report([run.as_recorded() for run in runs]), target)
