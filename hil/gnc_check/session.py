"""Session of one case: plays it to a GNC and keeps the replies."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hil.core.gnc_records import GNC_OUTPUT, GncMode, GncState
from hil.core.messages import Array
from hil.errors import BenchError
from hil.gnc_backends import external_records
from hil.gnc_backends.external import fault_text
from hil.gnc_check.gnc_under_test import GncUnderTest
from hil.gnc_check.test_cases import Change, CheckCase, Player


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
    found: Array = np.where((outputs["direct"] == 1)[:, None], by_thruster, demands)
    return found


def play(gnc: GncUnderTest, player: Player, setup: np.record, case: CheckCase, change: Change | None = None) -> Played:
    """Play ``case`` after a new setup. change: applied to each input before it is sent."""
    outputs, modes, t_s, took_s = [], [], [], []
    faults: dict[int, tuple[str, int]] = {}
    ended = ""
    gnc.begin(setup)
    n = int(setup.n_thrusters)
    for sent in player.inputs(case, change):
        try:
            answer, took = gnc.ask(sent)
        except BenchError as error:
            ended = f"{error} (in case: {case.name})"
            break
        fault, place = external_records.fault_of(answer, sent.cycle, n)
        if fault != external_records.FINE and (sent.mode == GncMode.RUNNING or fault == external_records.CYCLE):
            faults.setdefault(fault, (fault_text(answer, fault, place, int(sent.cycle), n), int(sent.cycle)))
        outputs.append(np.array(answer, GNC_OUTPUT))
        modes.append(int(sent.mode))
        t_s.append(float(sent.t_s))
        took_s.append(took)
        if answer.state == GncState.FAULT:
            ended = f"it reports a fault (in case: {case.name})"
            break
    rows = np.array(outputs, GNC_OUTPUT) if outputs else np.zeros(0, GNC_OUTPUT)
    return Played(case, rows, np.array(modes), np.array(t_s), np.array(took_s), faults, ended)
