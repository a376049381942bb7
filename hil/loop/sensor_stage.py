"""Further sensors as a stage of the cycle: modelled ones, and those whose samples come from elsewhere."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple, Protocol

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.config.tables.sensors import device_of
from hil.core import alarm_table as table
from hil.core.alarms import Alarm
from hil.core.kernel_record import kernel_record
from hil.core.messages import Array
from hil.core.sensor_records import SENSOR_ARRIVAL
from hil.dynamics.truth import rate_against_hill
from hil.frmn.ring import Telemetry
from hil.gnc_backends.base import GncBackend
from hil.loop import core
from hil.loop.core_memory import CoreMemory
from hil.params.sensors import MONITOR
from hil.safety.alarms import AlarmLog
from hil.sensors.measurement import deliver, is_any_due, log_arrivals, measure, put_sample

if TYPE_CHECKING:
    from hil.sensors.module import SensorKind

_SILENT_S: Final = 1.0  # after the last sample of a source


class SampleSource(Protocol):
    """A sensor whose samples arrive while the loop runs.

    name: of the device, for alarms. last_s: bench time of its last sample. failure: why its wire is gone, "" if not.
    refused: what could not be used, counted by reason.
    """

    refused: Counter[str]

    @property
    def name(self) -> str: ...
    @property
    def last_s(self) -> float: ...
    @property
    def failure(self) -> str: ...

    def poll(self, now_s: float, run_zero_s: float) -> np.ndarray:
        """Return what has arrived since the last call, (n,) of SENSOR_SAMPLE in the run's time; never waits.

        now_s: bench time. run_zero_s: bench time of the run's time zero.
        """

    def close(self) -> None:
        """Release the wire; may be called more than once."""


class SensorState(NamedTuple):
    """Present state of a sensor. measured_s: time of the run at which its newest sample was measured, nan for none.

    sigmas: its largest normalised innovation. state: 0 sound, 1 suspect, 2 a witness that disagrees.
    """

    measured_s: float
    sigmas: float
    state: int


class SensorStage:
    """Sensors of a loop by their names, in the order of its records.

    axes: returns the positions of rails and turntable, m and rad, that modelled ones see. sources: of those that are
    not modelled. alarms: receives an alarm of low priority for a source that is silent. sink: receives each sample that
    arrives, as a row of SENSOR_ARRIVAL. is_kept: keep these rows, unless the memory of the run must not grow.
    """

    def __init__(
        self,
        memory: CoreMemory,
        kinds: Mapping[str, SensorKind],
        axes: Callable[[], tuple[Array, Array]],
        sources: Sequence[SampleSource],
        alarms: AlarmLog,
        sink: Telemetry,
        is_kept: bool,
    ) -> None:
        self._memory, self._kinds, self._axes, self.sources = memory, dict(kinds), axes, list(sources)
        self._params, self._state = kernel_record(memory.params.sensors), memory.view("sensors")
        self._bench = kernel_record(memory.params.mock.bench)
        self.arrivals = kernel_record(memory.state.gnc.navigation.fusion.sensors)
        """SENSOR_FUSION_STATE: samples of the present cycle, and what became of them."""
        self._alarms, self.sink, self._is_kept = alarms, sink, is_kept
        self._kept = [np.zeros(0, SENSOR_ARRIVAL)]
        self._newest = dict.fromkeys(kinds, np.nan)
        self._sigmas = dict(self._newest)
        self._r, self._q, self._rate = np.empty(3), np.empty(4), np.empty(3)
        self._log = np.zeros(len(self.arrivals.arrival), SENSOR_ARRIVAL).view(np.recarray)

    def receive(self, t_s: float, now_s: float, run_zero_s: float, gnc: GncBackend) -> None:
        """Measure what is due at ``t_s`` of the run, and pass what has arrived on to the navigation.

        Witnesses are compared with the estimate of the cycle before; ``gnc`` receives what they have found.
        """
        if is_any_due(self._params, self._state, t_s):
            pose_of_axes(self._bench, *self._axes(), self._r, self._q)
            truth = self._memory.now.truth
            rate_against_hill(truth, self._rate)
            measure(self._params, self._state, t_s, truth, self._rate, self._r, self._q)
        for source in self.sources:
            for sample in source.poll(now_s, run_zero_s).view(np.recarray):
                put_sample(self._params, self._state, sample)
            self._watch(source, now_s)
        deliver(self._state, t_s, self.arrivals)
        gnc.set_sensor_arrivals(self.arrivals.arrival[: self.arrivals.arrived])
        core.compare_witnesses(self._memory.params, self._memory.state, t_s)
        gnc.set_monitor_disagrees(bool(self._memory.state.gnc.approach.monitor_disagrees))
        gnc.set_monitor_bound(float(self.arrivals.bound_m), float(self.arrivals.bound_s))

    def _watch(self, source: SampleSource, now_s: float) -> None:
        """Raise an alarm if ``source`` is silent: the navigation carries on without it, with a larger level."""
        silent_s = now_s - source.last_s
        if source.failure or silent_s > _SILENT_S:
            self._alarms.raise_condition(table.SAMPLES.alarm(now_s, source.name, source.failure or silent_s, _SILENT_S))
        else:
            self._alarms.return_to_normal(source.name, table.SAMPLES.quantity)

    def disagreement(self) -> Alarm | None:
        """Return the alarm, at no time, of the first witness whose interlock is set, None if none is."""
        for (name, kind), witness in zip(self._kinds.items(), self.arrivals.witness, strict=False):
            if witness.disagrees:
                component = kind.components[int(witness.component)]
                device, notes = (
                    name if name == MONITOR else device_of(name),
                    (f" {component.doc or component.name}", ""),
                )
                value, limit = float(witness.value), float(witness.limit)
                return table.NAVIGATION_POSE.alarm(0.0, device, value, limit, unit=component.unit, notes=notes)
        return None

    def record(self, cycle: int) -> None:
        """Send the samples of ``cycle``, with what the navigation has made of them, to the sink."""
        if not self.arrivals.arrived:
            return
        names = tuple(self._kinds)
        for arrival in self.arrivals.arrival[: self.arrivals.arrived]:
            name = names[arrival.sample.sensor]
            self._newest[name] = float(arrival.sample.t_s)
            self._sigmas[name] = float(np.abs(arrival.innovation[: len(self._kinds[name].components)]).max())
        for i in range(log_arrivals(self.arrivals, cycle, self._log, 0)):
            self.put(self._log[i : i + 1])

    def put(self, row: np.ndarray) -> None:
        """Send ``row``, shape (1,), to the sink."""
        self.sink.put(row)
        if self._is_kept:
            self._kept.append(row.copy())

    def kept(self) -> np.ndarray:
        """Return the rows so far, (n,)."""
        return np.concatenate(self._kept)

    def suspect(self) -> str:
        """Return the device of the first sensor that is excluded, "" without one."""
        suspects = (name for name, monitor in zip(self._kinds, self.arrivals.monitor, strict=False) if monitor.suspect)
        return next((device_of(name) for name in suspects), "")

    def states(self) -> list[SensorState]:
        """Return the present state of each sensor, in the order of the records."""
        monitors = zip(self._kinds, self.arrivals.monitor, self.arrivals.witness, strict=False)
        return [
            SensorState(self._newest[name], self._sigmas[name], 1 if monitor.suspect else 2 if witness.disagrees else 0)
            for name, monitor, witness in monitors
        ]

    def numbers(self) -> dict[str, dict[str, Any]]:
        """Return for JSON what became of the samples of each sensor, by name, and its mean NIS per component."""
        numbers: dict[str, dict[str, Any]] = {}
        refused = {source.name: dict(source.refused) for source in self.sources}
        for name, monitor in zip(self._kinds, self.arrivals.monitor, strict=False):
            judged = int(monitor.judged)
            numbers[name] = {
                "accepted": int(monitor.accepted),
                "rejected": int(monitor.rejected),
                "excluded": int(monitor.excluded),
                "too_late": int(monitor.late),
                "suspected": int(monitor.suspected),
                "mean_nis": float(monitor.total_nis) / judged if judged else None,
                "refused": refused.get(device_of(name), {}),
            }
        return numbers

    def close(self) -> None:
        """Release the wires of all sources."""
        for source in self.sources:
            source.close()
