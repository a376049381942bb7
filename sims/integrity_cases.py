"""What stops a bench when something fails: each case, what detected it and when, and how near the chaser came.

python sims/integrity_cases.py               all cases on the mock rig, in memory
python sims/integrity_cases.py emulated      stuck rails of the emulated rig as well, with its shipped limits
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.config.load import load_rig, load_scenario
from hil.drivers.mock_axes import MockAxes
from hil.gnc_backends.backend import OwnBackends
from hil.loop.runner import Runner
from hil.report.summary import summarise
from hil.session import build
from hil.session.build import Job, wired_bench
from hil.session.warm_up import warm_up
from sims.fault_matrix import TRIPS, FaultCase, FaultReaction, run_case


class PushingGnc:
    """GNC that pushes the chaser towards the target with all thrusters that can."""

    def start(self, setup: Any) -> None:
        """Choose the thrusters."""
        force = setup.thruster_force_N[: setup.n_thrusters]
        self._on = (force[:, 0] < -0.5 * np.linalg.norm(force, axis=1)).astype(int)

    def step(self, _: Any) -> np.ndarray:
        """Return the thrusters."""
        return self._on


@dataclass(frozen=True)
class IntegrityCase:
    """One case. fault: table of ``[[faults]]`` as TOML, "" for none. settings: of scenario and rig. gnc: an object."""

    name: str
    fault: str = ""
    settings: tuple[str, ...] = ()
    gnc: object | None = None


@dataclass(frozen=True)
class CaseResult:
    """Outcome of a case: why it ended, when, and the nearest distances to the target of truth and bench, m.

    detected_by, detected_s, reaction: as in ``injected`` of the JSON. go_error_m: error of the estimate along the
    docking axis when docking became a go, with its alert limit; None without a go.
    """

    stop: str
    end_s: float
    detected_by: str | None
    detected_s: float | None
    reaction: str | None
    nearest_m: float
    bench_end_m: float
    go_error_m: float | None
    hmi_cycles: int | None


def _vmu(kind: str, at_s: float, more: str = "") -> str:
    return f'{{device = "vmu", kind = "{kind}", at_s = {at_s}{more}}}'


CASES: Final = (
    IntegrityCase("no fault"),
    IntegrityCase("vision unit frozen from 15 s", _vmu("frozen", 15.0)),
    IntegrityCase("GNC that pushes at the target", gnc=PushingGnc()),
    IntegrityCase("no pose from 60 s", _vmu("no_pose", 60.0)),
    IntegrityCase("range wrong by 0.3 m from 60 s", _vmu("offset", 60.0, ", value = [0.3, 0.0, 0.0]")),
    IntegrityCase("range wrong by -0.3 m from 60 s", _vmu("offset", 60.0, ", value = [-0.3, 0.0, 0.0]")),
    IntegrityCase("range drifts by 2 mm/s from 60 s", _vmu("drift", 60.0, ", value = [0.002, 0.0, 0.0]")),
    IntegrityCase("range drifts by 0.3 mm/s from 60 s", _vmu("drift", 60.0, ", value = [0.0003, 0.0, 0.0]")),
    *(
        IntegrityCase(
            f"thruster {k} stuck open at 60 s", f'{{device = "thruster.{k}", kind = "stuck_open", at_s = 60}}'
        )
        for k in (1, 2, 3)
    ),
    *(
        IntegrityCase(f"{axis} stuck at 60 s", f'{{device = "{axis}", kind = "stuck", at_s = 60}}')
        for axis in ("rails.x", "rails.y", "rails.z")
    ),
)


def run(case: IntegrityCase, seed: int = 0) -> CaseResult:
    """Run ``case`` with scheme 1 on the mock rig."""
    settings = (*case.settings, f"faults=[{case.fault}]")
    scenario, rig = load_scenario("scheme-1", settings), load_rig("mock", settings)
    job = Job(scenario, rig, seed, scenario.value.duration_s, 1.0, own=OwnBackends(gnc=case.gnc))
    build.check(job)
    with build.runner(job) as runner:
        outcome = runner.run()
        bench_end_m = _bench_range_m(runner)
    summary, _ = summarise(outcome, scenario.value, rig.value, "mock", seed, 1.0 / scenario.value.step_s)
    history, injected = outcome.history, summary["injected"]
    found = injected[0] if injected else dict.fromkeys(("detected_by", "detected_s", "reaction"))
    go_error_m = None
    if summary["docking_go_s"] is not None:
        row = history[np.searchsorted(history["t_s"], summary["docking_go_s"] - 1e-9)]
        go_error_m = float(abs(row["truth"]["r_CT_H"][0] - row["navigation"]["r_CT_H"][0]))
    return CaseResult(
        outcome.stop, float(history["t_s"][-1]), found["detected_by"], found["detected_s"], found["reaction"],
        summary["integrity"]["nearest_m"], bench_end_m, go_error_m, summary["integrity"]["hmi_cycles"],
    )  # fmt: skip


def _bench_range_m(runner: Runner) -> float:
    """Return the distance to the target at which the bench came to rest."""
    bench = runner.loop.bench
    assert isinstance(bench.rails, MockAxes)
    assert isinstance(bench.turntable, MockAxes)
    r, q = np.empty(3), np.empty(4)
    pose_of_axes(bench.params, bench.rails.servo.position, bench.turntable.servo.position, r, q)
    return math.hypot(*r)


def run_emulated(settings: tuple[str, ...] = ()) -> list[FaultReaction]:
    """Return the reactions to stuck rails of the emulated rig with its shipped limits."""
    job = Job(load_scenario("scheme-1", settings), load_rig("emulated", settings), 0, 60.0, 1.0)
    build.check(job)
    warm_up(job)
    with wired_bench(job) as bench:
        return [
            run_case(bench, FaultCase("rails", f"on stuck {axis}", expected=TRIPS, watched_s=20.0)) for axis in "xyz"
        ]


def main(arguments: list[str]) -> None:
    for case in CASES:
        found = run(case)
        detected = "-" if found.detected_s is None else f"{found.detected_by} {found.detected_s:.2f} s"
        go = "" if found.go_error_m is None else f", docking: go with an error of {1e3 * found.go_error_m:.1f} mm"
        near = f"nearest {found.nearest_m:.3f} m, bench at rest at {found.bench_end_m:.3f} m"
        print(f"{case.name:34} {found.end_s:7.2f} s  {detected:20} {near}{go}; {found.stop}")
    if "emulated" in arguments:
        for reaction in run_emulated():
            print(f"emulated, {reaction.case.line:12} after {reaction.detected_s or math.nan:.2f} s: {reaction.alarm}")


if __name__ == "__main__":
    main(sys.argv[1:])
