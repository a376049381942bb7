"""Runner of a campaign's cases that the compiled loop does not run: of floating vehicles, robots, targets on axes."""

from __future__ import annotations

import gc

import numpy as np

from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.alarms import Alarm
from hil.core.clock import SimulatedClock
from hil.errors import BadInput
from hil.gnc_backends.backend import OwnBackends
from hil.gnc_backends.backend_registry import NO_BACKENDS
from hil.loop.compiled import run_cycles as shell
from hil.loop.compiled.run_stats import count_rows, new_run_stats, run_stats_params
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.runner import COMPLETED
from hil.loop.session_parts import SessionParts
from hil.params import integrity as integrity_params
from hil.params.ready import settled_s
from hil.parts.campaigns.case_runner import CaseRunner
from hil.report.verdict_parts import FieldOfView
from hil.session import build
from hil.session.assembly import Job


class PythonCaseRunner:
    """Runs cases of one scenario on one mock rig by the cycle in Python; otherwise as ``CaseRunner``."""

    user_error: BaseException | None = None

    def __init__(self, scenario: Scenario, rig: Rig, duration_s: float, own: OwnBackends = NO_BACKENDS) -> None:
        self.scenario, self.rig, self._duration_s, self._own = scenario, rig, duration_s, own
        self.alarm: Alarm | None = None
        """Alarm that ended the last case."""

    def set_gnc_scenario(self, scenario: Scenario) -> None:
        """Set the scenario of the GNC."""
        self.scenario = scenario

    def run(self, truth: Scenario, seed: int) -> tuple[np.record, str]:
        """Run one case; return its RUN_STATS and why it ended. truth: see ``CaseRunner.run``."""
        stats, view = new_run_stats(), FieldOfView(truth, self.rig)
        params = run_stats_params(self.scenario, self.rig, settled_s(self._duration_s))
        integrity_params.set_faults(params.integrity, truth.faults)

        def count(rows: np.ndarray) -> np.ndarray:
            count_rows(params, stats, rows.view(np.ndarray))
            view.add(rows)
            return rows

        loaded = Loaded(self.scenario, "campaign", {}), Loaded(self.rig, "campaign", {})
        job = Job(*loaded, seed, self._duration_s, 1.0, dispersed=truth, own=self._own)
        rate = SimulatedRate(SimulatedClock(), job.tick_s)
        gc.collect()  # the records of the last case, 20 MB, are few objects
        outcome = build.in_memory(job, rate, SessionParts(on_full=count)).run()
        if len(outcome.history):
            count(outcome.history)
            seen = view.part()
            stats.view_margin, stats.view_margin_s = seen.margin_px or 0.0, seen.at_s or 0.0
        self.alarm = next((alarm for alarm in outcome.alarms if alarm.text == outcome.stop), None)
        stats.ended = shell.COMPLETED if outcome.stop == COMPLETED else shell.VISION_SILENT
        return stats, outcome.stop

    def noise(self) -> dict[str, tuple[np.ndarray, float]]:
        """Raise BadInput: the likelihood of a case is that of the compiled loop's noise."""
        raise BadInput.single(self.rig.name, _only_in_python(self.rig)[0], "not supported by campaigns of rare events")


def _only_in_python(rig: Rig) -> list[str]:
    """Return the keys of what the compiled loop cannot fly; axes that are held at their places do not matter."""
    target = "rotary_manipulator" if rig.rotated_target is not None else "target_manipulator.sharing"
    parts = {"floating": rig.floating is not None, "arm": bool(rig.robots), target: rig.moving_target is not None}
    return [f"rig.{key}" for key, has in parts.items() if has]


def case_runner(
    scenario: Scenario, rig: Rig, duration_s: float, own: OwnBackends = NO_BACKENDS
) -> CaseRunner | PythonCaseRunner:
    """Return what runs the cases of ``scenario`` on ``rig``."""
    return (PythonCaseRunner if _only_in_python(rig) else CaseRunner)(scenario, rig, duration_s, own)
