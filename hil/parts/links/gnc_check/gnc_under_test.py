"""GNC under test: a shared library, or a program at the other end of a link, and the session of one case with it."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import Final, Protocol

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, OUTPUTS, GncMode, GncState
from hil.core.messages import Array, new
from hil.errors import BenchError, LinkTimeout
from hil.gnc import backend_outputs, whole_step
from hil.gnc_backends.backend import Backend, BackendInstance
from hil.gnc_backends.output_texts import fault_text, step_failed
from hil.parts.links.gnc_check.test_cases import Change, CheckCase, Player
from hil.parts.links.link import Arrival, Link
from hil.parts.links.udp import shown

_AGAIN_S: Final = 0.1  # after which a setup that is not answered is sent again
_TIMEOUT_S: Final = 2.0  # time-out of a reply; inputs are repeated meanwhile: a datagram may be lost
_RESEND_S: Final = 0.5


class GncUnderTest(Protocol):
    """A GNC that can be checked."""

    name: str
    modes: tuple[GncMode, ...]
    """Modes that are sent to it before the run's time starts."""

    def begin(self, setup: np.record) -> None:
        """Restart with ``setup`` (GNC_SETUP). Raises BadInput or BenchError."""

    def ask(self, sent: np.record) -> tuple[np.record, float]:
        """Return GNC_OUTPUT, valid until the next call, and the time of the reply, s. Raises BenchError."""

    def close(self) -> None:
        """Release it."""


class LibraryUnderTest:
    """A shared library or an FMU, with a new instance per case. It is called as in a run: in RUNNING and HOLD."""

    modes: tuple[GncMode, ...] = ()

    def __init__(self, library: Backend) -> None:
        self._library = library
        self.name = self._library.name
        self._instance: BackendInstance | None = None
        self._output = new(GNC_OUTPUT)
        whole_step.compile_call(new(GNC_INPUT), self._output)

    def begin(self, setup: np.record) -> None:
        """Open a new instance."""
        self.close()
        self._instance = self._library.open(setup)

    def ask(self, sent: np.record) -> tuple[np.record, float]:
        """Call the library's step."""
        assert self._instance is not None
        begun_s = time.perf_counter()
        code = whole_step.call(self._instance.step_address, self._instance.address, sent, self._output)
        took_s = time.perf_counter() - begun_s
        if code != 0:
            raise step_failed(self.name, code, self._output.text)
        return self._output, took_s

    def close(self) -> None:
        """Close the instance."""
        if self._instance is not None:
            self._instance.close()
            self._instance = None


class ProgramUnderTest:
    """A program that exchanges datagrams (docs/reference/wire-formats.md); receives each mode, and a setup per case."""

    modes: tuple[GncMode, ...] = (GncMode.STANDBY, GncMode.ARMED)

    def __init__(self, link: Link, wait_s: float) -> None:
        self.name = "gnc"
        self._link = link
        self._wait_s = wait_s
        self._block = np.zeros(1, GNC_OUTPUT).view(np.recarray)

    def begin(self, setup: np.record) -> None:
        """Send ``setup`` until the GNC acknowledges it. Raises LinkTimeout with the address of this side."""
        give_up_s, sent_s = time.monotonic() + self._wait_s, -_AGAIN_S
        while True:
            self._link.service()
            now_s = time.monotonic()
            there = self._link.peer is not None or self._link.expects
            if there and now_s - sent_s >= _AGAIN_S:
                sent_s = now_s
                self._link.send_setup(setup)
            self._link.wait(_AGAIN_S / 2)
            for output in self._outputs():
                if output["cycle"] == -1 and output["state"] != GncState.STARTING:
                    self._settle()
                    return
            if now_s > give_up_s:
                raise LinkTimeout(self.name, f"none has answered {shown(self._link.address)} within {self._wait_s:g} s")

    def ask(self, sent: np.record) -> tuple[np.record, float]:
        """Send ``sent`` and wait for the next output. Raises LinkTimeout."""
        self._link.service()
        list(self._outputs())  # discard late replies
        begun_s = resend_s = time.perf_counter()
        self._link.send_input(sent)
        while True:
            self._link.wait(_RESEND_S)
            now_s = time.perf_counter()
            for output in self._outputs():
                self._block[0] = output
                return self._block[0], now_s - begun_s
            if now_s - begun_s > _TIMEOUT_S:
                text = f"has not answered cycle {sent.cycle} ({GncMode(sent.mode).name}) for {_TIMEOUT_S:g} s"
                raise LinkTimeout(self.name, text)
            if now_s - resend_s > _RESEND_S:
                resend_s = now_s
                self._link.send_input(sent)

    def close(self) -> None:
        """Disconnect."""
        self._link.close("the check is over")

    def _settle(self) -> None:
        """Discard the replies to setups that were sent twice."""
        while self._link.wait(_AGAIN_S / 2):
            self._outputs()

    def _outputs(self) -> list[np.void]:
        return [self._output_in(arrival) for arrival in self._link.poll() if arrival.name == "gnc.output"]

    @staticmethod
    def _output_in(arrival: Arrival) -> np.void:
        output: np.void = arrival.record[0]
        return output


def check_link(bind: tuple[str, int] | None, peer: tuple[str, int] | None) -> Link:
    """Return a link on which this side acts as the bench."""
    from hil.frmn.mailboxes import Role

    link = Link(Role.DSS, "hil gnc check", ("gnc.setup", "gnc.input"), ("gnc.output",), bind, peer)
    link.silent_max_s = _TIMEOUT_S
    return link


@dataclass
class Played:
    """Result of a case. outputs: (n,) of GNC_OUTPUT; modes, t_s, took_s: (n,), of the inputs.

    faults: by kind, the first message and its cycle. ended: why the case ended early.
    """

    case: CheckCase
    outputs: np.ndarray
    modes: np.ndarray
    t_s: Array
    took_s: Array
    faults: dict[int, tuple[str, int]] = field(default_factory=dict)
    ended: str = ""

    def pushes(self, setup: np.record, from_s: float = 0.0) -> Array:
        """Return force and torque, (6,), as mean over the time that runs from ``from_s`` on.

        Relative to a demand: 1 is a permanent demand.
        """
        chosen = self.outputs[(self.modes == GncMode.RUNNING) & (self.t_s >= from_s)]
        return pushes(chosen, setup).mean(axis=0) if len(chosen) else np.zeros(6)


def pushes(outputs: np.ndarray, setup: np.record) -> Array:
    """Return force and torque that ``outputs`` (n,) call for, (n, 6), relative to a demand."""
    demands = np.hstack([outputs["force"], outputs["torque"]]).astype(float)
    n = int(setup.n_thrusters)
    forces, arms = setup.thruster_force_N[:n], setup.thruster_position_m[:n]
    push = forces / setup.mass_kg / setup.acceleration_mps2
    twist = np.cross(arms, forces) @ np.linalg.inv(setup.inertia_kgm2).T / setup.angular_acceleration_radps2
    by_thruster = outputs["on"][:, :n].astype(float) @ np.hstack([push, twist])
    applied: Array = np.where((outputs["direct"] == 1)[:, None], by_thruster, demands)
    return applied


def play(gnc: GncUnderTest, player: Player, setup: np.record, case: CheckCase, change: Change | None = None) -> Played:
    """Play ``case`` after a new setup. change: applied to each input before it is sent."""
    outputs, modes, t_s, took_s = [], [], [], []
    faults: dict[int, tuple[str, int]] = {}
    ended = ""
    gnc.begin(setup)
    n, parts = int(setup.n_thrusters), (new(OUTPUTS["navigation"]), new(OUTPUTS["control"]))
    for sent in player.inputs(case, change):
        try:
            answer, took = gnc.ask(sent)
        except BenchError as error:
            ended = f"{error} (in case: {case.name})"
            break
        fault, index = whole_step.take_apart(answer, sent.cycle, n, *parts)
        if fault != backend_outputs.FINE and (sent.mode == GncMode.RUNNING or fault == backend_outputs.CYCLE):
            faults.setdefault(fault, (fault_text(answer, fault, index, n, int(sent.cycle)), int(sent.cycle)))
        outputs.append(np.array(answer, GNC_OUTPUT))
        modes.append(int(sent.mode))
        t_s.append(float(sent.t_s))
        took_s.append(took)
        if answer.state == GncState.FAULT:
            ended = f"it reports a fault (in case: {case.name})"
            break
    rows = np.array(outputs, GNC_OUTPUT) if outputs else np.zeros(0, GNC_OUTPUT)
    return Played(case, rows, np.array(modes), np.array(t_s), np.array(took_s), faults, ended)
