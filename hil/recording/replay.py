"""Replay: the recorded inputs once more through today's GNC, laid beside what was recorded, bit by bit.

The loop stays open: the IMU and the poses are those of the recorded flight, whatever the GNC commands now.
"""

from __future__ import annotations

import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from hil.config.live_tunable import value_of
from hil.config.scenario import Scenario
from hil.core.messages import CYCLE, MAX_POSES, POSE
from hil.errors import BadInput, BenchError
from hil.gnc_backends.base import GncBackend
from hil.gnc_backends.builtin import BuiltinGnc
from hil.loop.cycle import CycleData
from hil.params import gnc as gnc_params
from hil.recording.read import Recorded
from hil.recording.schema import flat_fields
from hil.setup.assembly import make_backend
from hil.setup.live_tuning import with_setting

COMPARED: Final = ("navigation", "nees_position", "nees_attitude", "reference", "supervision", "command")
"""What the GNC writes, in the order in which it does."""


@dataclass(frozen=True)
class Difference:
    """A field that differs. cycles: in how many; first_*: of the first such cycle; sizes: largest |difference| of its
    components, None where only one of both is a number."""

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
    """What came out. rows: (n,) of CYCLE, the recorded ones with what the GNC wrote now; ended: why fewer than were
    recorded, "" where all. missing_events, new_events: (t_s, source, text) of before and of now alone."""

    rows: np.ndarray
    ended: str
    differences: list[Difference] = field(default_factory=list)
    missing_events: list[tuple[float, str, str]] = field(default_factory=list)
    new_events: list[tuple[float, str, str]] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        return not (self.differences or self.missing_events or self.new_events or self.ended)


class _Poses:
    """The poses of one cycle, as they arrived."""

    def __init__(self, arrivals: np.ndarray) -> None:
        self.poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
        self.arrived = 0
        self._by_cycle: dict[int, list[int]] = defaultdict(list)
        for i, cycle in enumerate(arrivals["cycle"].tolist()):
            self._by_cycle[cycle].append(i)
        self._arrivals = arrivals["pose"]

    def take(self, cycle: int) -> int:
        """Bring those of ``cycle``; return how many."""
        found = self._by_cycle.get(cycle, [])[:MAX_POSES]
        for place, i in enumerate(found):
            self.poses[place] = self._arrivals[i]
        self.arrived = len(found)
        return self.arrived


def replay(recorded: Recorded, scenario: Scenario) -> Replayed:
    """Return what the GNC of ``scenario`` makes of the recorded inputs, and where that differs from the recording.

    What was changed in flight is changed again at the same cycle, but for keys that ``scenario`` has otherwise than the
    recording: these stay as ``scenario`` has them. Raises BadInput where the scenario's step is another, or nothing was
    recorded.
    """
    if not len(recorded.cycles):
        raise BadInput.single(str(recorded.path), "", "no cycle is recorded: there is nothing to replay")
    gnc, poses, orders = make_backend(scenario), _Poses(recorded.arrivals), _orders(recorded)
    settings = _Settings(recorded, scenario)
    rows = recorded.cycles.copy()
    now = CycleData()
    done, ended = 0, ""
    with _seated(gnc):
        for k, row in enumerate(recorded.cycles):
            ended = _gap(row, k, scenario.step_s, poses.take(k))
            if not ended:
                _give_orders(gnc, orders.get(k, ()))
                settings.give(gnc, k)
                ended = _cycle(gnc, poses, row, now)
            if ended:
                break
            for name in COMPARED:
                rows[k][name] = now.row[name][0]
            done = k + 1
        if not ended and recorded.end is not None and _went_to_its_end(recorded, scenario):
            gnc.finish(float(rows["t_s"][-1]), now.supervision)
    found = Replayed(rows[:done], ended)
    found.differences = list(_differences(recorded.cycles[:done], rows[:done]))
    found.missing_events, found.new_events = _events(recorded, gnc, done)
    return found


@contextmanager
def _seated(gnc: GncBackend) -> Iterator[None]:
    gnc.open(0.0)
    try:
        yield
    finally:
        gnc.close()


def _cycle(gnc: GncBackend, poses: _Poses, row: np.void, now: CycleData) -> str:
    """Run the lines of ``run_cycle`` that are the GNC's, from recorded inputs; return why it cannot go on."""
    now.row["truth"], now.row["imu"] = row["truth"], row["imu"]
    try:
        gnc.step(float(row["t_s"]), now, poses)
    except BenchError as fault:
        return f"{fault}: the replay ends there"
    now.nees_position[0], now.nees_attitude[0] = gnc.consistency(now.truth, now.imu)
    return ""


def _gap(row: np.void, k: int, step_s: float, poses: int) -> str:
    """Return why cycle ``k`` cannot be replayed, "" where it can."""
    found = round(float(row["t_s"]) / step_s)
    if found != k:
        return f"cycles {k} to {found - 1} are not in the recording: the replay ends there"
    fresh = int(row["pose"]["fresh"])
    if poses != fresh:
        return f"cycle {k} had {fresh} poses, of which {poses} are in the recording: the replay ends there"
    return ""


def _orders(recorded: Recorded) -> dict[int, list[str]]:
    found: dict[int, list[str]] = defaultdict(list)
    for note in recorded.notes:
        if note["kind"] == "order":
            found[note["cycle"]].append(note["message"])
    return found


def _give_orders(gnc: GncBackend, orders: list[str] | tuple[()]) -> None:
    for order in orders:
        if order == "go":
            gnc.order_go()
        elif order == "abort":
            gnc.order_abort()


def follows(recorded: Recorded, scenario: Scenario, setting: str) -> bool:
    """Return whether the replay with ``scenario`` does ``setting``, key=value, again: its key is as it was recorded."""
    key = setting.partition("=")[0]
    return value_of(recorded.scenario, key) == value_of(scenario, key)


class _Settings:
    """What was changed in flight, by the cycle from which it acts."""

    def __init__(self, recorded: Recorded, scenario: Scenario) -> None:
        self._source = str(recorded.path)
        self._scenario = scenario
        self._by_cycle: dict[int, list[str]] = defaultdict(list)
        for note in recorded.notes:
            if note["kind"] == "setting" and follows(recorded, scenario, note["message"]):
                self._by_cycle[note["cycle"]].append(note["message"])

    def give(self, gnc: GncBackend, cycle: int) -> None:
        """Change in ``gnc`` what was changed before ``cycle``; one of the user's own has none of our settings."""
        if not isinstance(gnc, BuiltinGnc):
            return
        for setting in self._by_cycle.get(cycle, ()):
            self._scenario = with_setting(self._scenario, setting, self._source).value
            gnc.adjust(gnc_params.gnc(self._scenario))


def _went_to_its_end(recorded: Recorded, scenario: Scenario) -> bool:
    return len(recorded.cycles) == round(float(recorded.run["duration_s"]) / scenario.step_s) + 1


def _differences(before: np.ndarray, now: np.ndarray) -> Iterator[Difference]:
    for place in flat_fields(CYCLE):
        name = place["name"]
        if name.partition(".")[0] not in COMPARED:
            continue
        a, b = _field(before, name), _field(now, name)
        differs = (_bits(a) != _bits(b)).any(axis=1)
        if differs.any():
            yield _difference(name, before["t_s"], a, b, np.flatnonzero(differs))


def _difference(name: str, t_s: np.ndarray, before: np.ndarray, now: np.ndarray, where: np.ndarray) -> Difference:
    one_is_none = np.isnan(before[where]) != np.isnan(now[where])
    apart = np.abs(np.nan_to_num(now[where]) - np.nan_to_num(before[where]))
    sizes = np.where(one_is_none, math.inf, apart).reshape(len(where), -1).max(axis=1)
    largest = int(np.argmax(np.where(np.isfinite(sizes), sizes, -1.0)))
    return Difference(
        name,
        len(where),
        int(where[0]),
        float(t_s[where[0]]),
        _finite(sizes[0]),
        _finite(sizes[largest]),
        float(t_s[where[largest]]),
    )


def _field(rows: np.ndarray, name: str) -> np.ndarray:
    for part in name.split("."):
        rows = rows[part]
    return np.ascontiguousarray(rows).reshape(len(rows), -1)


def _bits(values: np.ndarray) -> np.ndarray:
    return values.view(np.int64)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _events(
    recorded: Recorded, gnc: GncBackend, done: int
) -> tuple[list[tuple[float, str, str]], list[tuple[float, str, str]]]:
    """Return the events of approach and filters that are in the recording alone, and those of now alone."""
    last_s = float(recorded.cycles["t_s"][done - 1]) if done else 0.0
    now = Counter((event.t_s, event.source, event.text) for event in gnc.events())
    before = Counter(
        (note["t_s"], note["name"], note["message"])
        for note in recorded.notes
        if note["kind"] == "event" and note["name"] != "bench" and note["t_s"] <= last_s
    )
    return sorted((before - now).elements()), sorted((now - before).elements())
