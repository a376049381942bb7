"""Further sensors as a stage of the cycle: modelled ones, and those whose samples a program of the user's own sends."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.core.kernel_record import kernel_record
from hil.core.messages import Array
from hil.core.sensor_records import SENSOR_ARRIVAL
from hil.dynamics.truth import rate_against_hill
from hil.frmn.ring import Telemetry
from hil.loop.core_memory import CoreMemory
from hil.sensors.measurement import deliver, is_any_due, log_arrivals, measure, put_sample


class SampleSource(Protocol):
    """A sensor whose samples arrive while the loop runs."""

    def poll(self, now_s: float, run_zero_s: float) -> np.ndarray:
        """Return what has arrived since the last call, (n,) of SENSOR_SAMPLE in the run's time; never waits.

        now_s: bench time. run_zero_s: bench time of the run's time zero.
        """

    def close(self) -> None:
        """Release the wire; may be called more than once."""


class SensorStage:
    """Sensors of a scenario, by ``names`` in its order.

    axes: returns the positions of rails and turntable, m and rad, that modelled ones see. sources: of those that are
    not modelled.
    """

    def __init__(
        self,
        memory: CoreMemory,
        names: Sequence[str],
        axes: Callable[[], tuple[Array, Array]],
        sources: Sequence[SampleSource] = (),
    ) -> None:
        self._memory, self._names, self._axes, self.sources = memory, tuple(names), axes, tuple(sources)
        self._params, self._state = kernel_record(memory.params.sensors), memory.view("sensors")
        self._bench = kernel_record(memory.params.bench)
        self.arrivals = kernel_record(memory.state.gnc.navigation.fusion.sensors)
        """SENSOR_FUSION_STATE: samples of the present cycle, and what became of them."""
        self.sink: Telemetry | None = None
        """Receives each sample that arrives, as a row of SENSOR_ARRIVAL."""
        self._r, self._q, self._rate = np.empty(3), np.empty(4), np.empty(3)
        self._log = np.zeros(len(self.arrivals.arrival), SENSOR_ARRIVAL).view(np.recarray)

    def receive(self, t_s: float, now_s: float, run_zero_s: float) -> None:
        """Measure what is due at ``t_s`` of the run, and pass what has arrived on to the navigation."""
        if is_any_due(self._params, self._state, t_s):
            pose_of_axes(self._bench, *self._axes(), self._r, self._q)
            truth = self._memory.now.truth
            rate_against_hill(truth, self._rate)
            measure(self._params, self._state, t_s, truth, self._rate, self._r, self._q)
        for source in self.sources:
            for sample in source.poll(now_s, run_zero_s).view(np.recarray):
                put_sample(self._params, self._state, sample)
        deliver(self._state, t_s, self.arrivals)

    def record(self, cycle: int) -> None:
        """Send the samples of ``cycle``, with what the navigation has made of them, to the sink."""
        if self.sink is None or not self.arrivals.arrived:
            return
        for i in range(log_arrivals(self.arrivals, cycle, self._log, 0)):
            self.sink.put(self._log[i : i + 1])

    def numbers(self) -> dict[str, dict[str, float | int | None]]:
        """Return for JSON what became of the samples of each sensor, by name, and its mean NIS per component."""
        found = {}
        for name, monitor in zip(self._names, self.arrivals.monitor, strict=False):
            judged = int(monitor.judged)
            found[name] = {
                "accepted": int(monitor.accepted),
                "rejected": int(monitor.rejected),
                "excluded": int(monitor.excluded),
                "too_late": int(monitor.late),
                "suspected": int(monitor.suspected),
                "mean_nis": float(monitor.total_nis) / judged if judged else None,
            }
        return found

    def close(self) -> None:
        """Release the wires of all sources."""
        for source in self.sources:
            source.close()
