"""Campaign of Sobol' indices of the outcomes, of each dispersed number and the noise."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import numpy as np

from hil.errors import BadInput
from hil.parts.campaigns.campaign import CampaignJob, Watch, write_summary
from hil.parts.campaigns.engines import Engine
from hil.parts.campaigns.sobol_indices import index_rows, sobol_indices
from hil.parts.campaigns.statistics import CONFIDENCE
from hil.parts.campaigns.store import Store

OUTCOMES: Final = (
    "passed", "passed_all_parts", "control_margin", "propellant_kg", "ready_time_s", "corridor_margin_m",
    "closing_margin_mps",
)  # fmt: skip
"""Outcomes whose indices are computed."""
NOISE: Final = "noise"
"""Name of the noise among the dispersed numbers."""


class SobolCampaign:
    """Runs the cases of ``rows`` rows and computes the indices. Raises BadInput for a scenario without dispersions."""

    def __init__(self, job: CampaignJob, rows: int) -> None:
        self._job = job
        self._rows = rows
        self._d = len(job.design.names)
        if self._d == 0 or job.design.draws_faults:
            reason = "draws faults, whose part is not separable" if self._d else "has no dispersions"
            raise BadInput.single("--sobol", job.scenario.value.name, reason)

    @property
    def runs(self) -> int:
        """Number of cases."""
        return self._rows * (self._d + 3)

    @staticmethod
    def identity() -> dict[str, Any]:
        """Return what distinguishes the folder from other campaigns' folders."""
        return {"sobol": True}

    def run(self, store: Store, engine: Engine, watch: Watch) -> dict[str, Any]:
        """Run the missing cases; return the summary, which is also written to the folder."""
        job = self._job
        job.fly(dataclasses.replace(job.spec, sobol=True), store, self.runs, engine, watch)
        summary = {
            "scenario": job.scenario.value.name,
            "seed": job.seed,
            "rows": self._rows,
            "cases": self.runs,
            "confidence": CONFIDENCE,
            "sobol": {outcome: self._indices(store, outcome) for outcome in OUTCOMES},
        }
        write_summary(store.folder / "summary.json", summary)
        return summary

    def _indices(self, store: Store, outcome: str) -> list[dict[str, Any]]:
        values = np.asarray(store.column(outcome), dtype=float).reshape(self._rows, self._d + 3).T
        names = [*self._job.design.names, NOISE]
        return index_rows(sobol_indices(values[0], values[1], values[2:]), names)
