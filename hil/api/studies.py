"""Studies of a scenario by many cases: ``hil.rare_event`` and ``hil.sobol_indices``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.api.campaigns import campaign, job_of_stored_case
from hil.api.jobs import Overrides
from hil.api.results import Run
from hil.api.runs import RunRequest, log, run_job
from hil.config.scenario import Scenario
from hil.errors import BadInput
from hil.monte_carlo.campaign import RIG
from hil.session.warm_up import compile_kernels
from hil.setup.assembly import Job

if TYPE_CHECKING:
    import pyarrow as pa


class StudyResults:
    """Results of a study of many cases.

    summary: the content of ``summary.json``, by its keys. cases: pyarrow table with one row per case. job: the nominal
    run. folder: of the results, None if they are not kept.
    """

    def __init__(self, job: Job, summary: dict[str, Any], cases: pa.Table | None, folder: Path | None) -> None:
        self.job = job
        self.summary = summary
        self.cases = cases
        self.folder = folder

    def run_case(self, case: int) -> Run:
        """Return case number ``case``, run again in full detail with the same bits.

        Raises BadInput for a number that has no case, and for a study whose folder was not given.
        """
        if self.folder is None:
            raise BadInput.single("case", "", "the study has no folder: give out")
        job, campaign_seed, _ = job_of_stored_case(self.job, self.folder, case)
        compile_kernels(job, log.warning)
        return run_job(RunRequest(job, RIG, more={"campaign_seed": campaign_seed, "case": case}))

    def __repr__(self) -> str:
        number = 0 if self.cases is None else len(self.cases)
        return f"<StudyResults {self.summary['scenario']}: {number} cases>"


def rare_event(
    scenario: str | Path | Scenario,
    event: str,
    out: str | Path | None = None,
    method: str = "subset",
    runs: int | None = None,
    seed: int = 0,
    overrides: Overrides | None = None,
    workers: int = 0,
) -> StudyResults:
    """Estimate the probability of a rare event over the dispersions and all noise of a scenario.

    Parameters
    ----------
    scenario
        ``scheme-1``, ``scheme-2``, ``scheme-3``, the path of a TOML file, or a Scenario.
    event
        An outcome of a case, ``<`` or ``>``, and a number: ``"position_m_x > 0.0058"``.
    out
        Folder for the results, in which an interrupted study is resumed; None for a temporary one.
    method
        ``subset``: simulation in levels, of any outcome; ``importance``: sampling with weights, of largest deviations.
    runs
        Number of cases, by ``subset`` of each level; None for the method's own number.
    seed
        Seed of the study.
    overrides
        Dotted keys or nested tables to values, as for ``hil.run``.
    workers
        Number of processes; 0: one per core.

    Returns
    -------
    StudyResults
        ``summary["rare"]`` has ``probability``, ``cov``, ``low``, ``high``, ``verdict`` and the failing cases.

    Raises
    ------
    BadInput
        Invalid arguments, with one line per error.
    """
    found: StudyResults = campaign(scenario, runs, out, seed, None, overrides, workers, rare=event, method=method)
    return found


def sobol_indices(
    scenario: str | Path | Scenario,
    rows: int,
    out: str | Path | None = None,
    seed: int = 0,
    overrides: Overrides | None = None,
    workers: int = 0,
) -> StudyResults:
    """Compute Sobol' indices of the outcomes, of each dispersed number and the noise, from ``rows`` x (d + 3) cases.

    The other parameters and errors are those of ``rare_event``; ``summary["sobol"]`` has the indices of each outcome.
    """
    found: StudyResults = campaign(scenario, None, out, seed, None, overrides, workers, sobol=rows)
    return found
