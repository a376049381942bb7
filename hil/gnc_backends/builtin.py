"""Built-in GNC: navigation, guidance, approach monitor, control and allocation in the loop's own thread.

Navigation and control may each be a backend of the user's own, which the same kernel calls; of these it has the
instances, their addresses in the state of the GNC, their texts and failures.
"""

from __future__ import annotations

import math

import numpy as np

from hil.core.gnc_records import GNC_SETUP
from hil.core.kernel_record import kernel_record
from hil.core.messages import Array, Event, new
from hil.core.observable import ObservableList
from hil.gnc import step, thruster_monitor
from hil.gnc.estimation import navigation
from hil.gnc.estimation.filter_monitor import FilterMonitor
from hil.gnc.estimation.plane import is_held_innovation
from hil.gnc_backends.approach_events import ApproachEventLog
from hil.gnc_backends.backend import Backends
from hil.gnc_backends.base import Poses, Records
from hil.gnc_backends.open_backends import CompiledGnc, OpenBackends

_LIVE = ("navigation", "control", "settings")


class BuiltinGnc(CompiledGnc):
    """The compiled GNC. params: GNC_PARAMS. filter_monitor: reads the same record of parameters.

    backends: that take the place of its navigation, its control, or both; setup: GNC_SETUP, what they are opened with.
    state: GNC_STATE of the loop; None: of its own.
    """

    def __init__(
        self,
        params: np.record,
        event_log: ApproachEventLog,
        filter_monitor: FilterMonitor,
        backends: Backends | None = None,
        setup: np.record | None = None,
        state: np.record | None = None,
    ) -> None:
        opened = OpenBackends(backends or {}, new(GNC_SETUP) if setup is None else setup)
        super().__init__(params, opened, event_log, state)
        self._filters = kernel_record(self.state.navigation.fusion.filters)
        self._thrust = self.state.navigation.fusion.thrust
        self._orbit = kernel_record(self.params.navigation.fusion.orbit)
        self.filter_monitor: FilterMonitor = filter_monitor
        self._nees = np.empty(2)
        self._plane = int(self.params.navigation.fusion.held)
        self.fuses = params.navigation.sensors == navigation.VISION_AND_IMU and "navigation" not in self._backends.kinds
        self.fused_now = False
        """Whether the filters took a pose in the last cycle."""

    @property
    def event_logs(self) -> tuple[ObservableList[Event], ...]:
        """Lists of events: of the approach, of the filter monitor and of backends."""
        return (self.event_log.events, self.filter_monitor.events, self._backends.messages)

    def step(self, t_s: float, now: Records, inbox: Poses) -> None:
        """Run stages 4 to 7 of the cycle."""
        before = self._progress.tobytes()
        works = step.gnc_step(
            self.params,
            self.state,
            self.memory,
            t_s,
            now.samples,
            inbox.poses,
            inbox.arrived,
            now.navigation,
            now.reference,
            now.supervision,
            now.command,
        )
        if not works:
            self.fail(t_s, before, now.supervision)
        self._monitor_filters(now.samples, inbox, now.navigation)
        self.log_step(t_s, before, now.supervision)
        if self._backends.kinds and self.state["backends"]["asks_for_hold"]:
            self.hold_as_asked()

    def log_step(self, t_s: float, before: bytes, supervision: np.record) -> None:
        """Log the progress, new texts of backends, and once that poses contradict the plane that holds the chaser."""
        super().log_step(t_s, before, supervision)
        if self._plane == 0:
            return
        off, integrity = self.state.navigation.fusion.off_plane, self.state.navigation.integrity
        is_biased = integrity.biased and integrity.worst_of < 6 and is_held_innovation(self._plane, integrity.worst_of)
        if not (off.sigmas or is_biased):
            return
        self._plane, text = 0, "poses stay on one side of it"
        if off.sigmas:
            text = f"the pose of {off.t_s:.2f} s is {off.across:.3f} m and {math.degrees(off.tilt):.2f} deg out of it, "
            text += f"up to {off.sigmas:.1f} sigma"
        text = f"measures another plane than that in which chaser.planar holds the chaser: {text}"
        self.filter_monitor.events.append(Event(t_s, "vmu", text))

    def add_innovations(self, cycle: int, nis_position: float, nis_attitude: float) -> None:
        """Check the NIS of ``cycle``, in which poses arrived, of a step that was run elsewhere."""
        if self.fuses:
            self.filter_monitor.add_innovations(cycle, nis_position, nis_attitude)

    def set_monitor_bound(self, bound_m: float, measured_s: float) -> None:
        """Take the bound on the position error by the docking monitor, 0 for none, for the protection levels."""
        integrity = self.state.navigation.integrity
        integrity.second_m, integrity.second_s = bound_m, measured_s

    def navigate(self, samples: np.ndarray, inbox: Poses, estimate: np.record, command: np.record | None) -> None:
        """Run stage 4 alone, for a GNC whose guidance runs on the bench: write NAVIGATION.

        command: COMMAND of the cycle before; None if its samples are unknown.
        """
        self.state.navigation.fusion.commanded[:] = 0 if command is None else command.on
        navigation.navigate(
            self.params.navigation, self.state.navigation, self.memory, samples, inbox.poses, inbox.arrived, estimate
        )
        if command is None:
            thruster_monitor.pause(self.state.thrusters)
        else:
            step.watch_thrusters(self.params, self.state, self.memory, samples, command, estimate)
        self._monitor_filters(samples, inbox, estimate)

    def actuate(self, estimate: np.record, reference: np.record, command: np.record) -> None:
        """Run stage 7 alone: write the demands and the thrusters of COMMAND."""
        step.actuate(self.params, self.state, estimate, reference, command)

    def _monitor_filters(self, samples: np.ndarray, inbox: Poses, estimate: np.record) -> None:
        self.cycle += 1
        self.fused_now = bool(self.state["navigation"]["fused"])
        if self.fused_now or (self.fuses and self.filter_monitor.needs_every_cycle):
            self.filter_monitor.update(self.cycle, samples, inbox.poses[: inbox.arrived], estimate, self.memory)

    def adjust(self, params: np.record) -> int:
        """Take over other parameters between two cycles; return the number of the cycle from which on they act.

        params: GNC_PARAMS of the same step and sensors; those of guidance are left as they are. The record is written
        in place: the shadow filter, which reads the same one, takes the new values as well.
        """
        for name in _LIVE:
            self.params[name] = params[name]
        for name in ("monitor", "reactions"):
            self.params["approach"][name] = params["approach"][name]
        self._backends.set_settings(self.params["settings"])
        return self.cycle + 1

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return NEES of position and attitude filter, (2,), in cycles with a pose, nan otherwise.

        Valid until the next call.
        """
        if self.fused_now:
            navigation.normalised_errors(self._filters, self._orbit, truth, imu, self._nees)
            if self._thrust.without_imu != 0:  # the drift is the error of a rate by commands
                self._nees[1] = np.nan
        else:
            self._nees[:] = np.nan
        return self._nees
