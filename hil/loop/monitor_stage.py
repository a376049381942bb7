"""Docking monitor as a stage of the cycle: its measurements and the interlock between them and the navigation."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.core.kernel_record import kernel_record
from hil.core.messages import Array
from hil.dynamics.docking_monitor import MONITOR_NOISE, UNOBSERVED_RAD
from hil.gnc_backends.base import GncBackend
from hil.loop import core
from hil.loop.core_memory import CoreMemory
from hil.loop.monitor_kernel import is_measured, measure_bench, put_frame
from hil.maths import quat
from hil.maths.random_streams import NormalRows, stream
from hil.monitor.results import NO_TARGET, Portion


class PortionSource(Protocol):
    """Docking monitor whose results arrive while the loop runs."""

    def poll(self) -> list[Portion]:
        """Return the portions that have been completed since the last call; never waits."""


def monitor_noise(seed: int) -> NormalRows:
    """Return the noise of the modelled measurements of a run, one row each."""
    return NormalRows(stream(seed, "monitor"), MONITOR_NOISE)


class MonitorStage:
    """Interlock of the docking monitor.

    memory: of the core. axes: returns the positions of rails and turntable, m and rad, that a modelled monitor sees;
    noise: of its measurements. source: of the results of a monitor that measures on images.
    """

    def __init__(
        self,
        memory: CoreMemory,
        axes: Callable[[], tuple[Array, Array]],
        noise: NormalRows,
        source: PortionSource | None = None,
    ) -> None:
        self._memory = memory
        self.params, self.memory = kernel_record(memory.params.monitor), memory.view("monitor")
        """MONITOR_PARAMS, MONITOR_STATE."""
        self.noise = noise
        self.source = source
        self._bench = kernel_record(memory.params.bench)
        self._axes = axes
        self._r, self._q = np.empty(3), np.empty(4)

    def check(self, t_s: float, gnc: GncBackend) -> None:
        """Compare what has arrived by ``t_s`` of the run with the estimate of the cycle before."""
        if is_measured(self.params, self.memory, t_s):
            number = int(self.memory.next)
            pose_of_axes(self._bench, *self._axes(), self._r, self._q)
            measure_bench(self.params, self.memory, t_s, self._r, self._q, self.noise.peek(1), number)
            self.noise.skip(int(self.memory.next) - number)
        if self.source is not None:
            for portion in self.source.poll():
                self._put(portion, t_s)
        core.compare_monitor(self._memory.params, self._memory.state, t_s)
        found = self.memory.interlock  # a GNC that is not built in has a state of its own
        gnc.set_monitor_disagrees(bool(found.disagrees))
        gnc.set_monitor_bound(float(found.bound_m), float(found.last_s))

    def disagreement(self) -> tuple[int, float, float]:
        """Return component, value and limit, m or rad, of the last disagreement."""
        found = self.memory.interlock
        return int(found.component), float(found.value), float(found.limit)

    def _put(self, portion: Portion, t_s: float) -> None:
        """Take a portion that arrives at ``t_s``; one without range and line of sight is no measurement."""
        frame = self.memory.frame
        if portion.status == NO_TARGET or not write_measurement(portion, frame):
            return
        frame.counter += 1
        frame.t_s, frame.received_s = portion.t_s, t_s
        put_frame(self.params, self.memory)


def write_measurement(portion: Portion, frame: np.record) -> bool:
    """Write pose and covariance of ``portion`` to ``frame`` (VMU_FRAME); return whether it has range and line of sight.

    Angles that the portion does not have get a standard deviation with which they do not count.
    """
    range_m, right, up = (portion.value(name) for name in ("range_m", "los_right_rad", "los_up_rad"))
    if not np.isfinite([range_m, right, up]).all():
        return False
    sight = np.array([np.tan(right), np.tan(up), 1.0])
    sight /= np.linalg.norm(sight)
    along, across = portion.sigma("range_m"), np.array([portion.sigma("los_right_rad"), portion.sigma("los_up_rad")])
    frame.t_v = range_m * sight
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = along**2 * np.outer(sight, sight)
    covariance[0, 0] += (range_m * across[0]) ** 2
    covariance[1, 1] += (range_m * across[1]) ** 2
    phi = np.array([portion.value(name) for name in ("phi1_rad", "phi2_rad", "phi3_rad")])
    sigmas = np.array([portion.sigma(name) for name in ("phi1_rad", "phi2_rad", "phi3_rad")])
    observed = np.isfinite(phi) & np.isfinite(sigmas)
    covariance[3:, 3:] = np.diag(np.where(observed, sigmas, UNOBSERVED_RAD) ** 2)
    frame.q_vt = quat.from_rotation_vector(np.where(observed, phi, 0.0))
    frame.covariance = covariance
    return True
