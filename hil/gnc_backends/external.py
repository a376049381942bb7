"""The seat of a GNC that is not ours: told what the bench knows in one record, heard in another, never trusted."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, GncMode, GncOrder, GncState
from hil.core.messages import COMMAND, IMU, MAX_POSES, NAVIGATION, POSE, REFERENCE, SUPERVISION, Array, Event, new
from hil.core.observable import ObservableList
from hil.errors import DeviceError, ProtocolError
from hil.gnc_backends import external_records
from hil.gnc_backends.approach import Approach
from hil.gnc_backends.approach_events import ApproachEventLog
from hil.gnc_backends.base import Poses, Records

_AXES: Final = "xyz"
_WORDS: Final = 200  # that are put down in a run: a text that changes in each cycle must not fill the log
_NO_POSES: Final = np.zeros(MAX_POSES, POSE).view(np.recarray)


class BackendSetup(NamedTuple):
    """What the seat of a foreign GNC is made from, see ``hil.setup.gnc_setup.briefing``.

    setup: GNC_SETUP. guidance, supervision: GUIDANCE_PARAMS, SUPERVISION_PARAMS. sets: int64 (allocation.ROWS, 2,
    MAX_THRUSTERS).
    """

    setup: np.record
    guidance: np.record
    supervision: np.record
    sets: np.ndarray
    diary: ApproachEventLog


class ExternalGnc(Approach):
    """Flies with whatever ``exchange`` asks; guidance, supervision and the diary of the approach stay ours.

    name: of the GNC, in what is said of it.
    ``input`` and ``output`` are GNC_INPUT and GNC_OUTPUT of the present cycle.
    """

    def __init__(self, name: str, briefing: BackendSetup) -> None:
        super().__init__(briefing.guidance, briefing.supervision, briefing.diary)
        self.name = name
        self.setup = briefing.setup
        self.input, self.output = new(GNC_INPUT), new(GNC_OUTPUT)
        self.words: ObservableList[Event] = ObservableList()
        """What the GNC says."""
        self._sets = briefing.sets
        self._n = int(briefing.setup.n_thrusters)
        self._abort_began = False
        self._said = b""
        self._nees = np.full(2, np.nan)
        self._compile()

    @property
    def logs(self) -> tuple[ObservableList[Event], ...]:
        """What happened, of the approach and of the GNC."""
        return (self.diary.events, self.words)

    def exchange(self) -> bool:
        """Give ``input`` to the GNC and bring its answer into ``output``; False where none has come in time."""
        raise NotImplementedError

    def miss(self, now: Records) -> None:
        """Write NAVIGATION and COMMAND of a cycle without an answer: nothing is known, all thrusters are closed."""
        external_records.mark_invalid(now.navigation)
        external_records.rest(now.command)

    def act(self, t_s: float, now: Records, vision: Poses) -> None:
        """Write the reference, ask the GNC, take what it says, and supervise that."""
        self.cycle += 1
        orders = GncOrder.ABORT if self._abort_began else GncOrder.NONE
        self._abort_began = False
        ordered, phase = self._go, int(self._flown.phase)
        self.guide(t_s, now.supervision, now.reference)
        if ordered and self._flown.phase != phase:
            orders |= GncOrder.GO
        self._write_input(t_s, GncMode.RUNNING, orders, now.imu, now.reference, vision.poses, vision.arrived)
        if self.exchange():
            self.take(now, self.cycle, t_s)
        else:
            self.miss(now)
        self.supervise(t_s, now.navigation, now.reference, now.supervision)

    def take(self, now: Records, cycle: int, t_s: float) -> None:
        """Write NAVIGATION and COMMAND from ``output``, the answer to the input ``cycle``. Raises BenchError."""
        out = self.output
        fault, place = external_records.fault_of(out, cycle, self._n)
        if fault != external_records.FINE:
            raise ProtocolError(self.name, self._complaint(fault, place, cycle))
        text = out.text
        if text != self._said:
            self._said = text
            if text and len(self.words) < _WORDS:
                self.words.append(Event(t_s, self.name, printable(text)))
        if out.state >= external_records.ASKS_FOR_HOLD:
            self._on_state(out)
        external_records.take_output(out, self._sets, self._n, now.reference.boost, now.navigation, now.command)

    def supervise(self, t_s: float, estimate: np.record, reference: np.record, out: np.record) -> None:
        """Judge the estimate, or without one act on what is ordered alone. Writes SUPERVISION."""
        aborted = out.aborted
        if not estimate.valid and external_records.abort_unseen(
            self._supervision, self._guidance, self._flown, t_s, reference, self._abort, out
        ):
            self.diary.abort_began(t_s, out)
        super().supervise(t_s, estimate, reference, out)
        self._abort_began = out.aborted != aborted

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return nan, (2,): an estimate comes without covariance."""
        return self._nees

    def _write_input(
        self,
        t_s: float,
        mode: GncMode,
        orders: GncOrder,
        imu: np.record,
        reference: np.record,
        poses: np.ndarray,
        arrived: int,
    ) -> None:
        external_records.write_input(
            self.cycle, t_s, int(mode), int(orders), imu, reference, poses, arrived, self.input
        )

    def _on_state(self, out: np.record) -> None:
        if out.state == GncState.FAULT:
            raise reported_fault(self.name, out)
        self.request_hold(hold_reason(self.name, out))

    def _complaint(self, fault: int, place: int, cycle: int) -> str:
        return complaint(self.output, fault, place, cycle, self._n)

    def _compile(self) -> None:
        """Call each kernel once: nothing compiles once the bench is powered."""
        navigation, command, output = new(NAVIGATION), new(COMMAND), new(GNC_OUTPUT)
        external_records.write_input(
            -1, 0.0, int(GncMode.STANDBY), 0, new(IMU), new(REFERENCE), _NO_POSES, 0, self.input
        )
        external_records.clear_output(output, 0)
        external_records.fault_of(output, 0, self._n)
        external_records.take_output(output, self._sets, self._n, new(REFERENCE).boost, navigation, command)
        external_records.mark_invalid(navigation)
        external_records.rest(command)
        external_records.abort_unseen(
            self._supervision, self._guidance, self._flown, -1.0, new(REFERENCE), 0, new(SUPERVISION)
        )


def printable(text: bytes) -> str:
    """Return what a GNC says as one line of plain characters."""
    words = text.split(b"\0")[0].decode("utf-8", "replace")
    return "".join(c if c.isprintable() else " " for c in words).strip()


def reported_fault(name: str, out: np.record) -> DeviceError:
    """Return the fault that a GNC reports of itself in ``out`` (GNC_OUTPUT)."""
    return DeviceError(name, printable(out.text) or "reports a fault")


def hold_reason(name: str, out: np.record) -> str:
    """Return why the bench is to hold where ``out`` (GNC_OUTPUT) asks for it."""
    said = printable(out.text)
    return f"{name} asks for it" + (f": {said}" if said else "")


def complaint(out: np.record, fault: int, place: int, cycle: int, n_thrusters: int) -> str:
    """Return what is wrong with ``out`` (GNC_OUTPUT) in words; fault, place: of ``foreign.fault_of``."""
    allowed = "allowed -1, 0, 1"
    match fault:
        case external_records.CYCLE:
            return f"answers cycle {out.cycle} to the input of cycle {cycle}"
        case external_records.STATE:
            return f"state {out.state}, allowed 0 to {max(GncState).value}"
        case external_records.DIRECT:
            return f"direct {out.direct}, allowed 0, 1"
        case external_records.FORCE:
            return f"force demand along {_AXES[place]} is {out.force[place]}, {allowed}"
        case external_records.TORQUE:
            return f"torque demand about {_AXES[place]} is {out.torque[place]}, {allowed}"
        case external_records.THRUSTER if place >= n_thrusters:
            return f"opens thruster {place + 1} of {n_thrusters}"
        case external_records.THRUSTER:
            return f"thruster {place + 1} is {out.on[place]}, allowed 0, 1"
        case external_records.CLAIM:
            return f"estimate {out.estimate}, allowed 0, 1"
        case external_records.ATTITUDE:
            values = ", ".join(f"{value:g}" for value in out.q_CH)
            return f"estimated q_CH ({values}) is not of length 1"
        case _:
            name = {external_records.POSITION: "r_CT_H_m", external_records.VELOCITY: "v_CT_H_mps"}.get(
                fault, "w_CH_C_radps"
            )
            return f"estimated {name}[{place}] is {out[name][place]}, allowed finite numbers"
