"""Results of studies of a scenario by many cases: of a rare event, and of Sobol' indices."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.api.cases import job_of_stored_case
from hil.api.results import Run
from hil.api.runs import RunRequest, log, run_job
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
