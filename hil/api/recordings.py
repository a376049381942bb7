"""Recordings: ``hil.open``, the recorded run, and its replay through another GNC."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack

import numpy as np

from hil.api.jobs import BackendArguments, Overrides, Settings, named_as_argument, own_backends, settings_of
from hil.api.results import Run, RunData
from hil.api.runs import raise_user_error
from hil.config.gnc_override import with_other_gnc
from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.core.alarms import Alarm
from hil.core.messages import Event, new
from hil.core.own_code import trusting
from hil.core.public import public
from hil.errors import BadInput
from hil.gnc_backends.backend import OwnBackends
from hil.gnc_backends.backend_registry import NO_BACKENDS, named
from hil.gnc_backends.base import GncBackend
from hil.gnc_backends.python_backend import PythonGnc
from hil.loop.compiled.run_stats import NAVIGATION_SUMS, count_navigation_of_rows
from hil.params.ready import SETTLED_S
from hil.recording.read import Recorded, RowBatch, load, load_without_rows, row_batches
from hil.recording.replay import Difference, Replayed, replay
from hil.report.summary import summary_of
from hil.report.verdict_parts import navigation_numbers
from hil.session.assembly import make_backend

_ALARM_FIELDS = {field.name for field in fields(Alarm)}


@public
def open_recording(path: str | Path, trust_code: bool = False) -> Recording:
    """Return the run recorded at ``path`` (``*.mcap`` of ``hil run --record``).

    Recordings of earlier versions and truncated ones can be read as far as intact. Raises BadInput for a file
    that is no recording or cannot be read. trust_code: whether its replay may load libraries, Python files and FMUs
    that the recording alone names.
    """
    if (Path(path) / "campaign.json").is_file():
        raise BadInput.single(str(path), "", "is the folder of a campaign: hil.open_campaign opens it")
    return Recording(load(Path(path)), trust_code)


class Recording(Run):
    """A recorded run: the interface of a run, and its replay.

    summary: as recorded; of a run that broke off, the numbers of its cycles. intact: the file has its end and no
    damage. recorded: content of the file.
    """

    def __init__(self, recorded: Recorded, trust_code: bool = False) -> None:
        self._trust_code = trust_code
        data = RunData(
            recorded.scenario,
            recorded.rig,
            recorded.cycles,
            summary_of(recorded),
            [Event(n["t_s"], n["name"], n["message"]) for n in recorded.log if n["kind"] == "event"],
            _alarms(recorded),
            recorded.of_parts,
            recorded.sensor_arrivals,
        )
        super().__init__(data, lambda: recorded)
        self.recorded = recorded

    @property
    def path(self) -> Path:
        """File of the recording."""
        return self.recorded.path

    @property
    def intact(self) -> bool:
        """Whether the file has its end and no damage."""
        return self.recorded.intact

    @public
    def replay(
        self,
        overrides: Overrides | None = None,
        gnc: str | Path | PythonGnc | None = None,
        trust_code: bool = False,
        **backends: Unpack[BackendArguments],
    ) -> Replay:
        """Return the results of the present GNC for the recorded IMU samples and poses: an open loop.

        overrides: keys of ``gnc`` and ``requirements`` to values, as for ``hil.run``. gnc: TOML file with other
        ``[gnc...]`` tables, a scenario whose GNC is used, or an object with ``step(input)``. backends: ``navigation=``
        and ``control=`` as for ``hil.run``; a recorded object is needed again. trust_code: load what the recording
        alone names; without it a library, Python file or FMU is loaded only if it is given here.

        Raises BadInput, and what an object raises.
        """
        with named_as_argument():
            named, own = own_backends(**backends)
            with trusting(trust_code or self._trust_code):
                return Replay(self, gnc, (*settings_of(overrides), *named), own)

    def _source(self) -> str:
        return str(self.path)


class Replay:
    """Result of a replay.

    differences: one entry per field of the GNC's records that differs, bit by bit, from the recording; identical: none
    differs, and the events are the same. navigation: errors of the estimate, by the keys of the summary, under
    ``recorded`` and ``replayed``. run: the recorded run with the GNC's new records. changed: whether the GNC is another
    one than the recorded; result: cycles, differences and events of the replay.
    """

    def __init__(
        self,
        recording: Recording,
        gnc: str | Path | PythonGnc | None,
        settings: Settings,
        own: OwnBackends = NO_BACKENDS,
    ) -> None:
        kept: list[np.ndarray] = []
        replayed = _replayed(recording.recorded, gnc, settings, None, lambda _, now: kept.append(now), own)
        self.recording, self.scenario, self.changed, self.result, self.navigation = recording, *replayed
        recorded, rows = recording.recorded, np.concatenate(kept) if kept else recording.history[:0]
        numbers = recording.summary | {"navigation": self.navigation["replayed"]}
        self.run = Recording(replace(recorded, cycles=rows, scenario=self.scenario, summary=numbers))

    @property
    def identical(self) -> bool:
        """Whether the GNC's records and events equal the recorded ones bit by bit."""
        return self.result.identical

    @property
    def differences(self) -> list[Difference]:
        """Fields that differ: name, number of cycles, first and largest difference, SI."""
        return self.result.differences

    @property
    def ended(self) -> str:
        """Why fewer cycles were replayed than recorded, "" if all were."""
        return self.result.ended

    def __repr__(self) -> str:
        if self.identical:
            return f"<Replay identical, {self.result.cycles} cycles>"
        return f"<Replay {len(self.differences)} fields differ, {self.result.cycles} cycles>"


class FileReplay(NamedTuple):
    """Result of ``replay_file``: as in ``Replay``; ``recorded`` is without rows."""

    recorded: Recorded
    scenario: Scenario
    changed: bool
    result: Replayed
    navigation: dict[str, dict[str, Any]]


def replay_file(path: Path, gnc: str | None, settings: Settings, trust_code: bool = False) -> FileReplay:
    """Return the replay of the recording at ``path`` in the memory of a batch of rows. Raises BadInput.

    trust_code: whether code that the recording alone names is loaded.
    """
    recorded = load_without_rows(path)
    batches = [load(path).as_batch()] if recorded.rewritten else row_batches(path)
    with trusting(trust_code):
        return FileReplay(recorded, *_replayed(recorded, gnc, settings, batches))


def _replayed(
    recorded: Recorded,
    gnc: str | Path | PythonGnc | None,
    settings: Settings,
    batches: Iterable[RowBatch] | None,
    keep: Callable[[np.ndarray, np.ndarray], None] = lambda original, now: None,
    own: OwnBackends = NO_BACKENDS,
) -> tuple[Scenario, bool, Replayed, dict[str, dict[str, Any]]]:
    """Return scenario, whether the GNC is another one, replay and errors of the estimate. Raises BadInput.

    gnc: a file or scenario; or an object, which a run of such an object needs. own: backends that are Python objects.
    """
    scenario = recorded.scenario
    name = (recorded.summary or {}).get("gnc", {}).get("python")
    changed = gnc is not None or bool(settings)
    backend: GncBackend | None = None
    if isinstance(gnc, PythonGnc):
        changed, backend = bool(settings), make_backend(scenario, OwnBackends(gnc=gnc))
    elif name is not None and not changed:
        text = f"its GNC was the Python object {name}: give one, hil.open(...).replay(gnc=...), or other settings"
        raise BadInput.single(str(recorded.path), "gnc", text)
    if changed:
        file = str(gnc) if isinstance(gnc, str | Path) else None
        scenario = with_other_gnc(scenario, str(recorded.path), file, settings).value
    if backend is None:
        scenario = named(Loaded(scenario, str(recorded.path), {}), own).value
        changed = changed or scenario.gnc != recorded.scenario.gnc
        backend = make_backend(scenario, own)
    errors = {which: new(NAVIGATION_SUMS) for which in ("recorded", "replayed")}

    def add(original: np.ndarray, now: np.ndarray) -> None:
        for which, rows in (("recorded", original), ("replayed", now)):
            count_navigation_of_rows(SETTLED_S, errors[which], rows.view(np.ndarray))
        keep(original, now)

    replayed = replay(recorded, scenario, backend, batches, add)
    raise_user_error(backend)
    return scenario, changed, replayed, {which: navigation_numbers(sums) for which, sums in errors.items()}


def _alarms(recorded: Recorded) -> list[Alarm]:
    """Return the alarms of the summary or, for a run that broke off, of the log."""
    if recorded.summary is not None:
        return [Alarm(**{k: v for k, v in a.items() if k in _ALARM_FIELDS}) for a in recorded.summary.get("alarms", ())]
    return [Alarm(n["bench_s"], n["name"], "", "", "", n["message"]) for n in recorded.log if n["kind"] == "alarm"]
