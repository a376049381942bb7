"""Base class for external GNCs: one input and one output record, output fully validated."""

from __future__ import annotations

import traceback
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, GncMode, GncOrder, GncState
from hil.core.messages import COMMAND, IMU, MAX_POSES, NAVIGATION, POSE, REFERENCE, SUPERVISION, Array, Event, new
from hil.core.observable import ObservableList
from hil.errors import DeviceError, ProtocolError
from hil.gnc import guidance, step
from hil.gnc.step import APPROACH_STATE
from hil.gnc_backends import external_records
from hil.gnc_backends.approach import Approach
from hil.gnc_backends.approach_events import ApproachEventLog
from hil.gnc_backends.base import Poses, Records

_AXES: Final = "xyz"
_MESSAGES_MAX: Final = 200  # logged in a run: a text that changes in each cycle must not fill the log
_NO_POSES: Final = np.zeros(MAX_POSES, POSE).view(np.recarray)


class BackendSetup(NamedTuple):
    """What an external GNC's backend is made from, see ``hil.setup.gnc_setup.backend_setup``.

    setup: GNC_SETUP. params: GNC_PARAMS, of which approach and allocation are used.
    """

    setup: np.record
    params: np.record
    event_log: ApproachEventLog


class ExternalGnc(Approach):
    """Takes estimate and thrusters from ``exchange``; guidance, approach monitor and event log run on the bench.

    name: of the GNC, in events and errors. approach: APPROACH_STATE of the loop; None: of its own. ``input`` and
    ``output`` are GNC_INPUT and GNC_OUTPUT of the present cycle.
    """

    def __init__(self, name: str, setup: BackendSetup, approach: np.record | None = None) -> None:
        super().__init__(setup.params.approach, new(APPROACH_STATE) if approach is None else approach, setup.event_log)
        self.name = name
        self.setup = setup.setup
        self.input, self.output = new(GNC_INPUT), new(GNC_OUTPUT)
        self.messages: ObservableList[Event] = ObservableList()
        """Texts that the GNC has sent for the operator."""
        self.params = setup.params
        """GNC_PARAMS."""
        self._n = int(setup.params.n_thrusters)
        self._last_text = b""
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
        external_records.mark_invalid(now.navigation)
        external_records.close_thrusters(now.command)

    def step(self, t_s: float, now: Records, inbox: Poses) -> None:
        """Write the reference, exchange input and output, and check the estimate."""
        self.cycle += 1
        orders = GncOrder.ABORT if self.approach_state["abort_began"] else GncOrder.NONE
        ordered, phase = self._progress["go"], int(self._progress["phase"])
        self.guide(t_s, now.supervision, now.reference)
        if ordered and self._progress["phase"] != phase:
            orders |= GncOrder.GO
        self._write_input(t_s, GncMode.RUNNING, orders, now, inbox)
        if self.exchange():
            self.read_output(now, self.cycle, t_s)
        else:
            self.on_missing_output(now)
        self.watch_approach(t_s, now.navigation, now.reference, now.supervision)

    def read_output(self, now: Records, cycle: int, t_s: float) -> None:
        """Write NAVIGATION and COMMAND from ``output``, the reply to the input ``cycle``. Raises BenchError."""
        out = self.output
        fault, index = external_records.fault_of(out, cycle, self._n)
        if fault != external_records.FINE:
            raise ProtocolError(self.name, fault_text(out, fault, index, cycle, self._n))
        self.log_text(t_s)
        if out.state >= external_records.ASKS_FOR_HOLD:
            self.on_state(out)
        external_records.read_output(out, self.params, now.reference.boost, now.navigation, now.command)

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

    def _write_input(self, t_s: float, mode: GncMode, orders: GncOrder, now: Records, inbox: Poses | None) -> None:
        """Write ``input``. inbox: None if no poses are to be sent."""
        poses, arrived = (inbox.poses, inbox.arrived) if inbox is not None else (_NO_POSES, 0)
        external_records.write_input(
            self.cycle, t_s, int(mode), int(orders), now.imu, now.reference, poses, arrived, self.input
        )

    def on_state(self, out: np.record) -> None:
        """Request the hold for which ``out`` (GNC_OUTPUT) asks, or raise the fault that it reports."""
        if out.state == GncState.FAULT:
            raise reported_fault(self.name, out)
        self.request_hold(hold_reason(self.name, out))

    def _compile(self) -> None:
        """Call each kernel once: nothing compiles once the bench is powered."""
        navigation, command, output, reference = new(NAVIGATION), new(COMMAND), new(GNC_OUTPUT), new(REFERENCE)
        external_records.write_input(
            -1, 0.0, int(GncMode.STANDBY), 0, new(IMU), reference, _NO_POSES, 0, self.input
        )  # fmt: skip
        external_records.clear_output(output, 0)
        external_records.fault_of(output, 0, self._n)
        external_records.read_output(output, self.params, reference.boost, navigation, command)
        external_records.mark_invalid(navigation)
        external_records.close_thrusters(command)
        state, supervision = new(APPROACH_STATE), new(SUPERVISION)
        guidance.start(self._approach_params.guidance, state.guidance)
        step.guide(self._approach_params, state, 0.0, supervision, reference)
        step.watch_approach(self._approach_params, state, 0.0, navigation, reference, supervision, True)


def printable(text: bytes) -> str:
    """Return a text of a GNC as one line of plain characters."""
    plain = text.split(b"\0")[0].decode("utf-8", "replace")
    return "".join(c if c.isprintable() else " " for c in plain).strip()


def raised_text(method: str, error: BaseException) -> str:
    """Return what an object's ``method`` has raised, with file and line, as one line."""
    text, frames = " ".join(str(error).split()), traceback.extract_tb(error.__traceback__)
    place = f" ({Path(frames[-1].filename).name}, line {frames[-1].lineno})" if frames else ""
    return f"{method} raised {type(error).__name__}" + (f": {text}" if text else "") + place


def reported_fault(name: str, out: np.record) -> DeviceError:
    """Return the fault that a GNC reports in ``out`` (GNC_OUTPUT)."""
    return DeviceError(name, printable(out.text) or "reports a fault")


def hold_reason(name: str, out: np.record) -> str:
    """Return why the bench is to hold if ``out`` (GNC_OUTPUT) requests it."""
    text = printable(out.text)
    return f"{name} asks for it" + (f": {text}" if text else "")


def fault_text(out: np.record, fault: int, index: int, cycle: int, n_thrusters: int) -> str:
    """Return a message for what is wrong with ``out`` (GNC_OUTPUT); fault, index: of ``external_records.fault_of``."""
    allowed = "allowed -1, 0, 1"
    match fault:
        case external_records.CYCLE:
            return f"answers cycle {out.cycle} to the input of cycle {cycle}"
        case external_records.STATE:
            return f"state {out.state}, allowed 0 to {max(GncState).value}"
        case external_records.DIRECT:
            return f"direct {out.direct}, allowed 0, 1"
        case external_records.FORCE:
            return f"force demand along {_AXES[index]} is {out.force[index]}, {allowed}"
        case external_records.TORQUE:
            return f"torque demand about {_AXES[index]} is {out.torque[index]}, {allowed}"
        case external_records.THRUSTER if index >= n_thrusters:
            return f"opens thruster {index + 1} of {n_thrusters}"
        case external_records.THRUSTER:
            return f"thruster {index + 1} is {out.on[index]}, allowed 0, 1"
        case external_records.ESTIMATE:
            return f"estimate {out.estimate}, allowed 0, 1"
        case external_records.ATTITUDE:
            values = ", ".join(f"{value:g}" for value in out.q_CH)
            return f"estimated q_CH ({values}) is not of length 1"
        case external_records.PROTECTION_LEVEL:
            level = [*out.protection_level_m, out.protection_level_rad][index]
            name = f"protection_level_m[{index}]" if index < 3 else "protection_level_rad"
            return f"{name} is {level:g}, allowed 0 and more, 0 or nan: not reported"
        case external_records.HEALTH:
            return f"health {out.health}, allowed 0 to {external_records.HEALTH_MAX}"
        case _:
            name = {external_records.POSITION: "r_CT_H_m", external_records.VELOCITY: "v_CT_H_mps"}.get(
                fault, "w_CH_C_radps"
            )
            return f"estimated {name}[{index}] is {out[name][index]}, allowed finite numbers"
