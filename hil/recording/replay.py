"""Replay: recorded inputs through today's GNC, compared with the recording bit by bit.

The loop is open: IMU samples and poses are those of the recorded run, whatever the GNC commands now.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Final

import numpy as np

from hil.config.live_tunable import value_of
from hil.config.scenario import Scenario
from hil.core.gnc_records import GncHealth
from hil.core.messages import CYCLE, MAX_POSES, POSE
from hil.errors import BadInput, BenchError
from hil.gnc_backends.base import GncBackend
from hil.gnc_backends.builtin import BuiltinGnc
from hil.loop.core_memory import CycleData
from hil.loop.runner import COMPLETED
from hil.maths.limits import finite_or_none
from hil.params import gnc as gnc_params
from hil.recording.read import Recorded, RowBatch
from hil.recording.schema import flat_fields
from hil.session.assembly import make_backend
from hil.session.live_tuning import with_setting

COMPARED: Final = ("navigation", "nees_position", "nees_attitude", "reference", "supervision", "command")
"""Records that the GNC writes, in this order."""


@dataclass(frozen=True)
class Difference:
    """A field that differs. cycles: number of cycles; first_*: of the first of them; sizes: largest |difference| of
    its components, None if only one of both is finite."""

    field: str
    cycles: int
    first_cycle: int
    first_s: float
    first_size: float | None
    largest: float | None
    largest_s: float

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


@dataclass
class Replayed:
    """Result of a replay. cycles: number of replayed ones, of ``recorded``; ended: why fewer than were recorded, "" if
    all. missing_events, new_events: (t_s, source, text) only in the recording or the replay."""

    cycles: int
    recorded: int
    ended: str
    differences: list[Difference] = field(default_factory=list)
    missing_events: list[tuple[float, str, str]] = field(default_factory=list)
    new_events: list[tuple[float, str, str]] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        return not (self.differences or self.missing_events or self.new_events or self.ended)


class _Poses:
    """Poses of one cycle, in order of arrival."""

    def __init__(self) -> None:
        self.poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
        self.arrived = 0

    def begin(self, arrivals: np.ndarray) -> None:
        """Use ``arrivals`` (n,) of ARRIVAL for the next cycles."""
        self._by_cycle: dict[int, list[int]] = defaultdict(list)
        for i, cycle in enumerate(arrivals["cycle"].tolist()):
            self._by_cycle[cycle].append(i)
        self._arrivals = arrivals["pose"]

    def load(self, cycle: int) -> int:
        """Load the poses of ``cycle``; return their number."""
        indices = self._by_cycle.get(cycle, [])[:MAX_POSES]
        for k, i in enumerate(indices):
            self.poses[k] = self._arrivals[i]
        self.arrived = len(indices)
        return self.arrived


class _SensorArrivals:
    """Samples of further sensors of one cycle."""

    def begin(self, arrivals: np.ndarray, first: int, cycles: int) -> None:
        """Use ``arrivals`` (n,) of SENSOR_ARRIVAL for ``cycles`` cycles from ``first`` on."""
        self._arrivals, self._begin = arrivals, first
        self._first = np.searchsorted(arrivals["cycle"], np.arange(first, first + cycles + 1))

    def load(self, k: int, gnc: GncBackend) -> None:
        """Give the arrivals of cycle ``k`` to ``gnc``."""
        if len(self._arrivals):
            i = k - self._begin
            gnc.set_sensor_arrivals(self._arrivals[self._first[i] : self._first[i + 1]])


class _Samples:
    """Samples of the IMU of one cycle: those recorded, or the one in the row of the cycle."""

    def begin(self, samples: np.ndarray, first: int, cycles: int) -> None:
        """Use ``samples`` (n,) of IMU_SAMPLE for ``cycles`` cycles from ``first`` on."""
        self._samples, self._begin = samples, first
        self._first = np.searchsorted(samples["cycle"], np.arange(first, first + cycles + 1))

    def load(self, k: int, now: CycleData) -> str:
        """Write the samples of cycle ``k`` to ``now``; return why it cannot be replayed, "" if it can."""
        i = k - self._begin
        n, samples = len(now.samples), self._samples[self._first[i] : self._first[i + 1]]
        if n == 1 or k == 0:  # the first cycle has none before it
            return ""
        if len(samples) != n:
            text = f"cycle {k} had {n} samples of the IMU, of which {len(samples)} are in the recording"
            return f"{text}: the replay ends there"
        now.samples[:] = samples["imu"]
        return ""


def replay(
    recorded: Recorded,
    scenario: Scenario,
    backend: GncBackend | None = None,
    batches: Iterable[RowBatch] | None = None,
    keep: Callable[[np.ndarray, np.ndarray], None] = lambda original, now: None,
) -> Replayed:
    """Compare the results of ``backend``, or of the GNC of ``scenario``, for the recorded inputs with the recorded.

    batches: rows of the recording, unless ``recorded`` has them. keep: receives the recorded rows of each batch, (n,)
    of CYCLE, as far as they are replayed, and the same with the GNC's new results. Changes of settings during the run
    are repeated at the same cycle, except for keys whose value in ``scenario`` differs from the recording. Raises
    BadInput if the scenario's step differs or no cycle was recorded.
    """
    gnc = backend or make_backend(scenario)
    loop, sums = _OpenLoop(recorded, scenario, gnc), _Differences(recorded.absent)
    read, last_s = 0, 0.0
    with _opened(gnc):
        for batch in [recorded.as_batch()] if batches is None else batches:
            read += len(batch.cycles)
            rows = loop.run(batch)
            original = batch.cycles[: len(rows)]
            if len(rows):
                last_s = float(rows["t_s"][-1])
                sums.add(original, rows)
                keep(original, rows)
        if not read:
            raise BadInput.single(str(recorded.path), "", "no cycle is recorded: there is nothing to replay")
        if not loop.ended and recorded.end is not None and _is_complete(recorded, scenario, read):
            gnc.finish(last_s, loop.now.supervision)
    replayed = Replayed(loop.cycles, read, loop.ended, sums.differences())
    replayed.missing_events, replayed.new_events = _events(recorded, gnc, last_s)
    return replayed


class _OpenLoop:
    """The GNC on recorded inputs, batch by batch. ``ended``: why no further cycle is replayed, "" if one can be."""

    def __init__(self, recorded: Recorded, scenario: Scenario, gnc: GncBackend) -> None:
        self.cycles = 0
        self.ended = ""
        self.now = CycleData(scenario.imu_samples)
        self._gnc, self._step_s = gnc, scenario.step_s
        self._poses, self._samples, self._sensors = _Poses(), _Samples(), _SensorArrivals()
        self._orders, self._settings = _orders(recorded), _Settings(recorded, scenario)
        self._on: np.ndarray | None = None  # thrusters that were commanded in the cycle before

    def run(self, batch: RowBatch) -> np.ndarray:
        """Return the rows of the batch with the new results, as many as could be replayed."""
        rows = batch.cycles.copy()
        self._poses.begin(batch.arrivals)
        self._samples.begin(batch.imu_samples, self.cycles, len(rows))
        self._sensors.begin(batch.sensor_arrivals, self.cycles, len(rows))
        for i, row in enumerate(batch.cycles):
            if self.ended or self._end(row):
                return rows[:i]
            for name in COMPARED:
                rows[i][name] = self.now.row[name][0]
            self._on = row["command"]["on"]
            self.cycles += 1
        return rows

    def _end(self, row: np.void) -> str:
        """Replay the next cycle, recorded as ``row``; return why it cannot be, "" if it could."""
        k, now = self.cycles, self.now
        self.ended = _gap(row, k, self._step_s, self._poses.load(k)) or self._samples.load(k, now)
        if not self.ended:
            _send_orders(self._gnc, self._orders.get(k, ()))
            self._settings.apply(self._gnc, k)
            self._sensors.load(k, self._gnc)
            if self._on is not None:  # the IMU has measured what was commanded then, not what the replay would command
                now.row["command"]["on"] = self._on
            self.ended = _cycle(self._gnc, self._poses, row, now)
        return self.ended


@contextmanager
def _opened(gnc: GncBackend) -> Iterator[None]:
    gnc.open(0.0)
    try:
        yield
    finally:
        gnc.close()


def _cycle(gnc: GncBackend, poses: _Poses, row: np.void, now: CycleData) -> str:
    """Run the GNC's stages of ``run_cycle`` on recorded inputs; return why the replay ends, "" if it continues."""
    now.row["truth"], now.row["imu"] = row["truth"], row["imu"]
    gnc.set_monitor_disagrees(bool(int(row["navigation"]["health"]) & GncHealth.MONITOR_DISAGREES))
    disagrees = bool(int(row["navigation"]["health"]) & GncHealth.BENCH_DISAGREES)
    gnc.set_bench_check(row["bench_off"], row["bench_breach"], disagrees)
    gnc.set_monitor_bound(float(row["monitor_bound_m"]), float(row["monitor_bound_s"]))
    try:
        gnc.step(float(row["t_s"]), now, poses)
    except BenchError as fault:
        return f"{fault}: the replay ends there"
    now.nees_position[0], now.nees_attitude[0] = gnc.consistency(now.truth, now.imu)
    return ""


def _gap(row: np.void, k: int, step_s: float, poses: int) -> str:
    """Return why cycle ``k`` cannot be replayed, "" if it can."""
    cycle = round(float(row["t_s"]) / step_s)
    if cycle != k:
        return f"cycles {k} to {cycle - 1} are not in the recording: the replay ends there"
    fresh = int(row["pose"]["fresh"])
    if poses != fresh:
        return f"cycle {k} had {fresh} poses, of which {poses} are in the recording: the replay ends there"
    return ""


def _orders(recorded: Recorded) -> dict[int, list[str]]:
    orders: dict[int, list[str]] = defaultdict(list)
    for entry in recorded.log:
        if entry["kind"] == "order":
            orders[entry["cycle"]].append(entry["message"])
    return orders


def _send_orders(gnc: GncBackend, orders: list[str] | tuple[()]) -> None:
    for order in orders:
        if order == "go":
            gnc.order_go()
        elif order == "abort":
            gnc.order_abort()


def follows(recorded: Recorded, scenario: Scenario, setting: str) -> bool:
    """Return whether the replay with ``scenario`` repeats ``setting``, key=value: its key has the recorded value."""
    key = setting.partition("=")[0]
    return value_of(recorded.scenario, key) == value_of(scenario, key)


class _Settings:
    """Settings changed during the run, by the cycle from which they act."""

    def __init__(self, recorded: Recorded, scenario: Scenario) -> None:
        self._source = str(recorded.path)
        self._scenario = scenario
        self._by_cycle: dict[int, list[str]] = defaultdict(list)
        for entry in recorded.log:
            if entry["kind"] == "setting" and follows(recorded, scenario, entry["message"]):
                self._by_cycle[entry["cycle"]].append(entry["message"])

    def apply(self, gnc: GncBackend, cycle: int) -> None:
        """Apply the changes before ``cycle`` to ``gnc``; an external GNC has no such settings."""
        if not isinstance(gnc, BuiltinGnc):
            return
        for setting in self._by_cycle.get(cycle, ()):
            self._scenario = with_setting(self._scenario, setting, self._source).value
            gnc.adjust(gnc_params.gnc(self._scenario))


def _is_complete(recorded: Recorded, scenario: Scenario, cycles: int) -> bool:
    if recorded.end is not None and recorded.end.get("stop") == COMPLETED:
        return True
    return cycles == round(float(recorded.run["duration_s"]) / scenario.step_s) + 1


class _Differences:
    """Fields that differ, over all batches; those that the recording lacks are not compared."""

    def __init__(self, absent: frozenset[str]) -> None:
        names = [entry["name"] for entry in flat_fields(CYCLE)]
        self._names = [name for name in names if name.partition(".")[0] in COMPARED and name not in absent]
        self._found: dict[str, Difference] = {}
        self._cycles = 0

    def add(self, original: np.ndarray, now: np.ndarray) -> None:
        """Compare the recorded rows (n,) of the next cycles with the replayed ones."""
        for name in self._names:
            a, b = _field(original, name), _field(now, name)
            differs = (_bits(a) != _bits(b)).any(axis=1)
            if differs.any():
                self._add(_difference(name, original["t_s"], a, b, np.flatnonzero(differs)))
        self._cycles += len(original)

    def _add(self, new: Difference) -> None:
        new = replace(new, first_cycle=self._cycles + new.first_cycle)
        entry = self._found.setdefault(new.field, new)
        if entry is new:
            return
        is_larger = new.largest is not None and (entry.largest is None or new.largest > entry.largest)
        largest = new if is_larger else entry
        cycles = entry.cycles + new.cycles
        self._found[new.field] = replace(entry, cycles=cycles, largest=largest.largest, largest_s=largest.largest_s)

    def differences(self) -> list[Difference]:
        """Return them in the order of the fields."""
        return [self._found[name] for name in self._names if name in self._found]


def _difference(name: str, t_s: np.ndarray, original: np.ndarray, now: np.ndarray, where: np.ndarray) -> Difference:
    one_is_none = np.isnan(original[where]) != np.isnan(now[where])
    difference = np.abs(np.nan_to_num(now[where]) - np.nan_to_num(original[where]))
    sizes = np.where(one_is_none, math.inf, difference).reshape(len(where), -1).max(axis=1)
    largest = int(np.argmax(np.where(np.isfinite(sizes), sizes, -1.0)))
    return Difference(
        name,
        len(where),
        int(where[0]),
        float(t_s[where[0]]),
        finite_or_none(sizes[0]),
        finite_or_none(sizes[largest]),
        float(t_s[where[largest]]),
    )


def _field(rows: np.ndarray, name: str) -> np.ndarray:
    for part in name.split("."):
        rows = rows[part]
    return np.ascontiguousarray(rows).reshape(len(rows), -1)


def _bits(values: np.ndarray) -> np.ndarray:
    return values.view(np.int64)


def _events(
    recorded: Recorded, gnc: GncBackend, last_s: float
) -> tuple[list[tuple[float, str, str]], list[tuple[float, str, str]]]:
    """Return the events of approach and filters only in the recording, and those only in the replay."""
    now = Counter((event.t_s, event.source, event.text) for event in gnc.events())
    original = Counter(
        (entry["t_s"], entry["name"], entry["message"])
        for entry in recorded.log
        if entry["kind"] == "event" and entry["name"] != "bench" and entry["t_s"] <= last_s
    )
    return sorted((original - now).elements()), sorted((now - original).elements())
