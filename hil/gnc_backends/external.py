"""Base class for GNCs with which the loop exchanges input and output itself: over wires."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, OUTPUTS, GncMode, GncOrder, GncState
from hil.core.messages import COMMAND, IMU, MAX_POSES, NAVIGATION, POSE, REFERENCE, SUPERVISION, Array, Event, new
from hil.core.observable import ObservableList
from hil.core.sensor_records import SAMPLES_PER_CYCLE, SENSOR_ARRIVAL
from hil.errors import ProtocolError
from hil.gnc import backend_outputs, backend_step, guidance, step, whole_step
from hil.gnc.step import APPROACH_STATE
from hil.gnc_backends.approach_events import ApproachEventLog
from hil.gnc_backends.base import GncBackend, Poses, Records
from hil.gnc_backends.output_texts import fault_text, hold_reason, printable, reported_fault

_MESSAGES_MAX: Final = 200  # logged in a run: a text that changes in each cycle must not fill the log
NO_POSES: Final = np.zeros(MAX_POSES, POSE).view(np.recarray)


class BackendSetup(NamedTuple):
    """What an external GNC's backend is made from, see ``hil.session.gnc_setup.backend_setup``.

    setup: GNC_SETUP. params: GNC_PARAMS, of which approach and allocation are used.
    """

    setup: np.record
    params: np.record
    event_log: ApproachEventLog


class ExternalGnc(GncBackend):
    """Takes estimate and thrusters from ``exchange``; guidance, approach monitor and event log run on the bench.

    name: of the GNC, in events and errors. ``input`` and ``output`` are GNC_INPUT and GNC_OUTPUT of the present cycle.
    """

    def __init__(self, name: str, setup: BackendSetup) -> None:
        super().__init__(setup.params.approach, new(APPROACH_STATE), setup.event_log)
        self.name = name
        self.setup = setup.setup
        self.input, self.output = new(GNC_INPUT), new(GNC_OUTPUT)
        self._parts = (new(OUTPUTS["navigation"]), new(OUTPUTS["control"]))
        self.messages: ObservableList[Event] = ObservableList()
        """Texts that the GNC has sent for the operator."""
        self.params = setup.params
        """GNC_PARAMS."""
        self._n = int(setup.params.n_thrusters)
        self._last_text = b""
        self._arrivals: np.ndarray = np.zeros(SAMPLES_PER_CYCLE, SENSOR_ARRIVAL).view(np.recarray)
        self._arrived = 0
        self._nees = np.full(2, np.nan)
        self._compile()

    @property
    def event_logs(self) -> tuple[ObservableList[Event], ...]:
        """Lists of events: of the approach and of the GNC."""
        return (self.event_log.events, self.messages)

    def exchange(self) -> bool:
        """Send ``input`` to the GNC and bring its reply into ``output``; return False if none has come in time."""
        raise NotImplementedError

    def on_missing_output(self, now: Records) -> None:
        """Write NAVIGATION and COMMAND of a cycle without a reply: no estimate, all thrusters closed."""
        backend_outputs.mark_invalid(now.navigation)
        whole_step.close_thrusters(now.command)

    def step(self, t_s: float, now: Records, inbox: Poses) -> None:
        """Write the reference, exchange input and output, and check the estimate."""
        self.cycle += 1
        before = self._progress.tobytes()
        orders = GncOrder(
            whole_step.guide(self._approach_params, self.approach_state, t_s, now.supervision, now.reference)
        )
        self.log_progress(t_s, before, now.supervision)
        self._write_input(t_s, GncMode.RUNNING, orders, now, inbox)
        if self.exchange():
            self.read_output(now, self.cycle, t_s)
        else:
            self.on_missing_output(now)
        self.watch_approach(t_s, now.navigation, now.reference, now.supervision)

    def read_output(self, now: Records, cycle: int, t_s: float) -> None:
        """Write NAVIGATION and COMMAND from ``output``, the reply to the input ``cycle``. Raises BenchError."""
        out, n = self.output, self._n
        fault, index = whole_step.take_apart(out, cycle, n, *self._parts)
        if fault != backend_outputs.FINE:
            raise ProtocolError(self.name, fault_text(out, fault, index, n, cycle))
        self.log_text(t_s)
        if out.state == GncState.FAULT:
            raise reported_fault(self.name, out.text)
        if out.state == GncState.ASKS_FOR_HOLD:
            self.request_hold(hold_reason(self.name, out.text))
        whole_step.use_output(self.params, now.reference.boost, *self._parts, now.navigation, now.command)

    def log_text(self, t_s: float) -> None:
        """Log the text of ``output`` if it is a new one."""
        text = self.output.text
        if text != self._last_text:
            self._last_text = text
            if text and len(self.messages) < _MESSAGES_MAX:
                self.messages.append(Event(t_s, self.name, printable(text)))

    def watch_approach(self, t_s: float, estimate: np.record, reference: np.record, supervision: np.record) -> None:
        """Check the estimate; an ordered abort begins without one as well. Writes SUPERVISION."""
        self._watch_approach(t_s, estimate, reference, supervision, True)

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return nan, (2,): the estimate has no covariance."""
        return self._nees

    def set_sensor_arrivals(self, arrivals: np.ndarray) -> None:
        """Take the samples of further sensors of the next cycle, (n,) of SENSOR_ARRIVAL."""
        self._arrived = len(arrivals)
        self._arrivals[: self._arrived] = arrivals

    def _write_input(self, t_s: float, mode: GncMode, orders: GncOrder, now: Records, inbox: Poses | None) -> None:
        """Write ``input``. inbox: None if no poses and measurements are to be sent."""
        (poses, n), arrived = ((inbox.poses, inbox.arrived), self._arrived) if inbox is not None else ((NO_POSES, 0), 0)
        whole_step.write_input(
            self.cycle, t_s, int(mode), int(orders), now.imu, now.reference, poses, n, self.input
        )  # fmt: skip
        backend_step.write_measured(
            self.params, self.cycle, now.samples, poses, n, self._arrivals, arrived, self.input.measured
        )

    def _compile(self) -> None:
        """Call each kernel once: nothing compiles once the bench is powered."""
        navigation, command, output, reference = new(NAVIGATION), new(COMMAND), new(GNC_OUTPUT), new(REFERENCE)
        whole_step.write_input(
            -1, 0.0, int(GncMode.STANDBY), 0, new(IMU), reference, NO_POSES, 0, self.input
        )  # fmt: skip
        backend_step.write_measured(
            self.params, -1, np.zeros(1, IMU), NO_POSES, 0, self._arrivals, 0, self.input.measured
        )  # fmt: skip
        whole_step.clear_output(output, 0)
        whole_step.take_apart(output, 0, self._n, *self._parts)
        whole_step.use_output(self.params, reference.boost, *self._parts, navigation, command)
        backend_outputs.mark_invalid(navigation)
        whole_step.close_thrusters(command)
        state, supervision = new(APPROACH_STATE), new(SUPERVISION)
        guidance.start(self._approach_params.guidance, state.guidance)
        whole_step.guide(self._approach_params, state, 0.0, supervision, reference)
        step.watch_approach(self._approach_params, state, 0.0, navigation, reference, supervision, True)
