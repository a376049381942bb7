"""What a session is made of besides its devices and stages, collected before its loop is built, whole."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

import numpy as np

from hil.config.rig import Rig
from hil.core.clock import BenchClock
from hil.core.operator_commands import Operator
from hil.core.part import part_sinks
from hil.core.realtime import SchedulingPolicy
from hil.errors import BenchError
from hil.frmn.ring import Telemetry
from hil.loop.motion_sequences import ProgressCallback
from hil.loop.outcome import Outcome
from hil.loop.sensor_stage import SampleSource

if TYPE_CHECKING:
    from hil.core.camera_images import ImageSink
    from hil.frmn.image_memory import ImageMemory


class RunSinks(Protocol):
    """Sinks of a recording by name, see ``hil.recording.sinks.RecordingSinks``."""

    def __getitem__(self, name: str) -> Telemetry: ...
    def attach(self, parts: SessionParts) -> None: ...
    def image_encoder(self, rig: Rig) -> ImageSink | None: ...
    def image_memory(self) -> ImageMemory | None: ...


class PartResult(NamedTuple):
    """Result of a part of a run. table: of the summary, with ``numbers``. rows: by the names of the part's sinks.

    withheld: why the run has no verdict, "" if the part has no reason.
    """

    table: str
    numbers: dict[str, Any]
    rows: Mapping[str, np.ndarray]
    withheld: str = ""


@dataclass
class SessionParts:
    """Connections of a session: its caller, its recording and its parts add to them, then the loop is built.

    operator: gives the commands; None: the run is unattended. on_progress: called periodically with the mode and the
    completed fraction. announce: receives a line for each process that is started. scheduling: of the loop's thread.
    frames_to_arm: poses required before the loop is closed. clock: bench time of a bench on wires, None in simulated
    time. bench: the bench on wires, with its processes; None in memory.
    """

    operator: Operator | None = None
    on_progress: ProgressCallback = lambda *_: None
    announce: Callable[[str], None] = lambda _: None
    scheduling: SchedulingPolicy | None = None
    frames_to_arm: int = 0
    clock: BenchClock | None = None
    bench: Any = None
    telemetry: Telemetry | None = None
    """Receives each cycle's row."""
    layers: list[Callable[[Telemetry], Telemetry]] = field(default_factory=list)
    """Each returns a receiver of the rows that passes them on to the given one; the last added is the first to get a
    row."""
    sinks: Mapping[str, Telemetry] = field(default_factory=dict)
    """Sinks of a recording by name; see ``hil.recording.sinks``."""
    sample_sources: list[SampleSource] = field(default_factory=list)
    """Sources of samples of further sensors."""
    imu: Any = None
    """Source of the rates of an IMU on a wire, None without one."""
    on_run_zero: list[Callable[[float], None]] = field(default_factory=list)
    """Called with the bench time of the run's time zero when it changes; nan while the run's time stops."""
    on_full: Callable[[np.ndarray], np.ndarray] | None = None
    """Receives the rows when no further one fits; returns the memory for the next ones."""
    meters: dict[str, Callable[[], dict[str, Any]]] = field(default_factory=dict)
    """Return, at the end, the numbers of ``Outcome.measured``."""
    before_open: list[Callable[[], None]] = field(default_factory=list)
    """Called before each opening of the devices; raise BenchError if the bench must not run."""
    before_motion: list[Callable[[float, np.record], bool]] = field(default_factory=list)
    """Called with bench time and FEEDBACK in each cycle of standby. They return True when they have compared the bench,
    which ARM waits for after each motion; raise BenchError if it must not move to the start of a run."""
    process_pauses: Callable[[], dict[str, float]] = dict
    """Returns the pauses by the host, s, of the processes that serve the devices."""
    process_failures: Callable[[BenchError], str | None] = lambda _: ""
    """Returns what has happened to processes of the bench, as an addition to the text of a fault: "" for nothing, None
    if it is to be asked again."""
    on_built: list[Callable[[Any], None]] = field(default_factory=list)
    """Called with the ``Runner`` before it starts."""
    controls: dict[str, Any] = field(default_factory=dict)
    """What an operator can set in a part while the session lasts, by name."""
    results: list[Callable[[Outcome], PartResult | None]] = field(default_factory=list)
    """Return the results of parts after the run; None without any."""

    def results_of(self, outcome: Outcome) -> list[PartResult]:
        """Return the results of all parts after the run: without a verdict if rows of one are in no recording."""
        results = [part_result for result in self.results if (part_result := result(outcome)) is not None]
        return [
            result._replace(withheld=f"part {result.table}: rows {name}: no sinks= of a Part declares them")
            if (name := ", ".join(result.rows.keys() - part_sinks().keys()))
            else result
            for result in results
        ]
