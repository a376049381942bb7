"""Jobs of the cases of campaigns and studies."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from hil.core.messages import Array
from hil.errors import BadInput
from hil.maths.random_streams import MixedSeed
from hil.monte_carlo.campaign import campaign_digest
from hil.monte_carlo.dispersions import Design, case_seed
from hil.monte_carlo.sobol_indices import sobol_point
from hil.monte_carlo.stored_campaign import StoredCampaign
from hil.setup.assembly import Job


def job_of_case(job: Job, case: int, mixed: MixedSeed | None = None, unit: Array | None = None) -> Job:
    """Return the job of a campaign's case: its true scenario, that of the GNC, and its own seed.

    mixed: that seed in a campaign of a rare event or of Sobol' indices. unit: in the latter, the point of the dispersed
    numbers in the unit cube.
    """
    design = Design(job.scenario, job.seed)
    truth, known = design.apply(design.values(case, mixed, unit), design.fault(case))
    known = known.model_copy(update={"faults": truth.faults})
    seed = case_seed(job.seed, case) if mixed is None else mixed
    return replace(job, scenario=replace(job.scenario, value=known), seed=seed, dispersed=truth)


def job_of_stored_case(job: Job, folder: Path, case: int) -> tuple[Job, int, str]:
    """Return the job of a case of the campaign in ``folder``, the campaign's seed, and a note if the scenario differs.

    job: the nominal run; seed and duration are those of the campaign. Raises BadInput.
    """
    stored = StoredCampaign(folder)
    job = replace(job, seed=stored.seed, duration_s=stored.duration_s)
    if not stored.is_sample and job.rig.value.kind != "mock":
        raise BadInput.single("--rig", job.rig.value.name, "a case of --rare or --sobol runs on the mock rig")
    mixed, unit = stored.mixed_seed(case), None
    if stored.is_sobol:
        unit, mixed = sobol_point(stored.seed, case, len(Design(job.scenario, job.seed).names))
    note = ""
    if stored.digest != campaign_digest(job.scenario.value, job.rig.value):
        note = f"{folder}: its campaign has another scenario, rig or settings: the run differs from its case {case}"
    return job_of_case(job, case, mixed, unit), stored.seed, note
