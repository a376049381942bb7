"""Built-in GNC: navigation, guidance, approach monitor, control and allocation in the loop's own thread.

Navigation and control may each be a backend of the user's own, which the same kernel calls; of these it has the
instances, their addresses in the state of the GNC, their texts and failures.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final, NoReturn

import numpy as np

from hil.core.gnc_records import GNC_SETUP
from hil.core.kernel_record import kernel_record
from hil.core.messages import Array, Event, new
from hil.core.observable import ObservableList
from hil.errors import DeviceError
from hil.gnc import backend_step, step, thruster_monitor
from hil.gnc.estimation import navigation
from hil.gnc.estimation.filter_monitor import FilterMonitor
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc.step import GNC_STATE
from hil.gnc_backends.approach import Approach
from hil.gnc_backends.approach_events import ApproachEventLog
from hil.gnc_backends.backend import PARTS, BackendInstance, Backends, failure_of
from hil.gnc_backends.base import Poses, Records
from hil.gnc_backends.external import printable

_LIVE = ("navigation", "control", "settings")


class BuiltinGnc(Approach):
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
        self._backends = OpenBackends(backends or {}, new(GNC_SETUP) if setup is None else setup)
        self.params = kernel_record(params)
        self.state = kernel_record(new(GNC_STATE) if state is None else state)
        self._filters = kernel_record(self.state.navigation.fusion.filters)
        self._thrust = self.state.navigation.fusion.thrust
        self._orbit = kernel_record(self.params.navigation.fusion.orbit)
        super().__init__(params.approach, self.state.approach, event_log)
        self.filter_monitor: FilterMonitor = filter_monitor
        self.memory = new_memory(params.navigation.fusion)
        """Of the filters, of ``step_memory.new_memory``."""
        self._nees = np.empty(2)
        self.fuses = params.navigation.sensors == navigation.VISION_AND_IMU and "navigation" not in self._backends.kinds
        self.fused_now = False
        """Whether the filters took a pose in the last cycle."""

    @property
    def event_logs(self) -> tuple[ObservableList[Event], ...]:
        """Lists of events: of the approach, of the filter monitor and of backends."""
        return (self.event_log.events, self.filter_monitor.events, self._backends.messages)

    def open(self, bench_s: float) -> None:
        """Open the backends. Raises BadInput or DeviceError."""
        self._backends.open(self.state["backends"], self.params["settings"])

    def close(self) -> None:
        """Close the backends."""
        self._backends.close(self.state["backends"])

    @property
    def user_error(self) -> BaseException | None:
        """What a Python object of the user has raised."""
        return self._backends.user_error

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

    def add_innovations(self, cycle: int, nis_position: float, nis_attitude: float) -> None:
        """Check the NIS of ``cycle``, in which poses arrived, of a step that was run elsewhere."""
        if self.fuses:
            self.filter_monitor.add_innovations(cycle, nis_position, nis_attitude)

    def log_step(self, t_s: float, before: bytes, supervision: np.record) -> None:
        """Log the progress since ``before`` (bytes of APPROACH_PROGRESS) and new texts of backends."""
        self.log_progress(t_s, before, supervision)
        if self._backends.kinds and self.state["backends"]["new_text"]:
            self._backends.log_texts(t_s, self.state["backends"])

    def hold_as_asked(self) -> None:
        """Request the hold for which a backend has asked."""
        self.request_hold(self._backends.hold_reason(self.state["backends"]))

    def fail(self, t_s: float, before: bytes, supervision: np.record) -> NoReturn:
        """Log the step in which a backend has failed; raise its failure."""
        self.log_step(t_s, before, supervision)
        raise self._backends.failure(self.state["backends"])

    def set_monitor_bound(self, bound_m: float, measured_s: float) -> None:
        """Take the bound on the position error by the docking monitor, 0 for none, for the protection levels."""
        known = self.state.navigation.integrity
        known.second_m, known.second_s = bound_m, measured_s

    def set_sensor_arrivals(self, arrivals: np.ndarray) -> None:
        """Take the samples of further sensors of the next cycle, (n,) of SENSOR_ARRIVAL."""
        found = self.state.navigation.fusion.sensors
        found.arrived = len(arrivals)
        found.arrival[: len(arrivals)] = arrivals

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


_MESSAGES_MAX: Final = 200  # logged in a run: a text that changes in each cycle must not fill the log


class OpenBackends:
    """``kinds``, the backends that are not built in, with one instance of each while open.

    setup: GNC_SETUP. The records are BACKENDS of GNC_STATE and GNC_PARAMS.settings.
    """

    def __init__(self, kinds: Backends, setup: np.record) -> None:
        self.kinds = kinds
        self.messages: ObservableList[Event] = ObservableList()
        """Texts of the backends for the operator."""
        self.user_error: BaseException | None = None
        """What a Python object of the user has raised."""
        self.setup = setup
        self._instances: dict[str, BackendInstance] = {}

    def open(self, state: np.record, settings: np.ndarray) -> None:
        """Open an instance of each and write addresses and setup to ``state``. Raises BadInput or DeviceError."""
        if not self.kinds:
            return
        self.close(state)
        setup = np.asarray(self.setup).tobytes()
        for part, kind in self.kinds.items():
            values = settings[PARTS.index(part), : len(kind.settings)]
            try:
                instance = self._instances[part] = kind.open(self.setup, values)
            except DeviceError as error:
                self.user_error = error.__cause__
                raise
            given = state[f"{part}_input"]
            given["setup"] = np.frombuffer(setup, given["setup"].dtype)[0]
            state[part]["step"], state[part]["instance"] = instance.step_address, instance.address

    @contextmanager
    def opened(self, state: np.record, settings: np.ndarray) -> Iterator[None]:
        """Open the instances as long as this lasts."""
        self.open(state, settings)
        try:
            yield
        finally:
            self.close(state)

    def close(self, state: np.record) -> None:
        """Close the instances; the built-in kernels take their place. Idempotent."""
        for part, instance in self._instances.items():
            instance.close()
            state[part]["step"] = 0
        self._instances.clear()

    def set_settings(self, settings: np.ndarray) -> None:
        """Take over other values of the settings between two cycles."""
        for part, instance in self._instances.items():
            instance.set_settings(settings[PARTS.index(part), : len(self.kinds[part].settings)])

    def name(self, part: str) -> str:
        """Return the name of the backend of ``part`` in events and errors."""
        return f"{part} {self.kinds[part].name}"

    def log_texts(self, t_s: float, state: np.record) -> None:
        """Log the text of each backend unless it is the one that was logged last."""
        for part in self.kinds:
            text = printable(bytes(state[part]["text"]))
            last = next((event.text for event in reversed(self.messages) if event.source == self.name(part)), "")
            if text and text != last and len(self.messages) < _MESSAGES_MAX:
                self.messages.append(Event(t_s, self.name(part), text))

    def hold_reason(self, state: np.record) -> str:
        """Return why the bench is to hold if a backend requests it."""
        part = PARTS[int(state["asks_for_hold"]) - 1]
        text = printable(bytes(state[part]["text"]))
        return f"{self.name(part)} asks for it" + (f": {text}" if text else "")

    def failure(self, state: np.record) -> DeviceError:
        """Return the error of the backend that has failed. Raises KeyboardInterrupt if Ctrl-C has ended its step."""
        part = PARTS[int(state["failed"]) - 1]
        instance = self._instances.get(part)
        if instance is not None and state["fault"] == backend_step.RETURNED:
            self.user_error = instance.error
        if isinstance(self.user_error, KeyboardInterrupt):
            raise self.user_error
        return failure_of(self.name(part), state, self.user_error)
