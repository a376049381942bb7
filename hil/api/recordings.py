"""Recordings: ``hil.open``, the recorded run, and its replay through another GNC."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

from hil.api.jobs import Overrides, Settings, named_as_argument, settings_of
from hil.api.results import Run, RunData
from hil.config.gnc_override import with_other_gnc
from hil.config.scenario import Scenario
from hil.core.messages import Event
from hil.errors import BadInput
from hil.gnc_backends.python_object import PythonGnc, PythonObjectGnc
from hil.recording.read import Recorded, load
from hil.recording.replay import Difference, Replayed, replay
from hil.report.summary import navigation_errors, summary_of
from hil.safety.alarms import Alarm
from hil.setup.gnc_setup import backend_setup

_ALARM_FIELDS = {field.name for field in fields(Alarm)}


def open_recording(path: str | Path) -> Recording:
    """Return the run recorded at ``path`` (``*.mcap`` of ``hil run --record``).

    Recordings of earlier versions and truncated ones can be read; of those the intact part. Raises BadInput for a file
    that is no recording or cannot be read.
    """
    return Recording(load(Path(path)))


class Recording(Run):
    """A recorded run: the interface of a run, and its replay.

    summary: as recorded; of a run that broke off, the numbers of its cycles. intact: the file has its end and no
    damage. recorded: content of the file.
    """

    def __init__(self, recorded: Recorded) -> None:
        data = RunData(
            recorded.scenario,
            recorded.rig,
            recorded.cycles,
            summary_of(recorded),
            [Event(n["t_s"], n["name"], n["message"]) for n in recorded.log if n["kind"] == "event"],
            _alarms(recorded),
            recorded.portions,
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

    def replay(self, overrides: Overrides | None = None, gnc: str | Path | PythonGnc | None = None) -> Replay:
        """Return the results of the present GNC for the recorded IMU samples and poses: an open loop.

        overrides: keys of ``gnc`` and ``requirements`` to values, as for ``hil.run``. gnc: TOML file with other
        ``[gnc...]`` tables, a scenario whose GNC is used, or an object with ``step(input)``. Raises BadInput.
        """
        with named_as_argument():
            return replay_with(self, gnc, settings_of(overrides))

    def _source(self) -> str:
        return str(self.path)


class Replay:
    """Result of a replay.

    differences: one entry per field of the GNC's records that differs, bit by bit, from the recording; identical: none
    differs, and the events are the same. navigation: errors of the estimate, by the keys of the summary, under
    ``recorded`` and ``replayed``. run: the recorded run with the GNC's new records. changed: whether the GNC is another
    one than the recorded; result: cycles, differences and events of the replay.
    """

    def __init__(self, recording: Recording, scenario: Scenario, changed: bool, found: Replayed) -> None:
        self.recording = recording
        self.scenario = scenario
        self.changed = changed
        self.result = found
        recorded = recording.history[: len(found.rows)]
        self.navigation = {"recorded": navigation_errors(recorded), "replayed": navigation_errors(found.rows)}
        numbers = recording.summary | {"navigation": self.navigation["replayed"]}
        self.run = Recording(replace(recording.recorded, cycles=found.rows, scenario=scenario, summary=numbers))

    @property
    def identical(self) -> bool:
        """Whether the GNC's records and events are those of the recording, bit by bit."""
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
            return f"<Replay identical, {len(self.result.rows)} cycles>"
        return f"<Replay {len(self.differences)} fields differ, {len(self.result.rows)} cycles>"


def replay_with(recording: Recording, gnc: str | Path | PythonGnc | None, settings: Settings) -> Replay:
    """Return the replay with another GNC and ``key=value`` settings. Raises BadInput.

    gnc: a file or scenario; or an object, which a run of such an object needs.
    """
    recorded, scenario = recording.recorded, recording.recorded.scenario
    name = recording.summary.get("gnc", {}).get("python")
    changed, backend = gnc is not None or bool(settings), None
    if isinstance(gnc, PythonGnc):
        changed, backend = bool(settings), PythonObjectGnc(gnc, backend_setup(scenario))
    elif name is not None and not changed:
        text = f"its GNC was the Python object {name}: give one, hil.open(...).replay(gnc=...), or other settings"
        raise BadInput.single(str(recorded.path), "gnc", text)
    if changed:
        file = str(gnc) if isinstance(gnc, str | Path) else None
        scenario = with_other_gnc(scenario, str(recorded.path), file, settings).value
    return Replay(recording, scenario, changed, replay(recorded, scenario, backend))


def _alarms(recorded: Recorded) -> list[Alarm]:
    """Return the alarms of the summary; of a run that broke off, those of the log, as far as it has them."""
    if recorded.summary is not None:
        return [Alarm(**{k: v for k, v in a.items() if k in _ALARM_FIELDS}) for a in recorded.summary.get("alarms", ())]
    return [Alarm(n["bench_s"], n["name"], "", "", "", n["message"]) for n in recorded.log if n["kind"] == "alarm"]
