"""Campaigns and studies: ``hil.campaign``, ``hil.sweep``, ``hil.rare_event``, ``hil.sobol_indices``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, Any, Unpack, overload

from hil.api.jobs import BackendArguments, Overrides, named_as_argument, settings_of
from hil.api.runs import log
from hil.config.scenario import Scenario
from hil.core.public import public
from hil.errors import BadInput
from hil.gnc_backends.backend import PARTS
from hil.parts.campaigns.api.campaign_request import CampaignRequest
from hil.parts.campaigns.api.campaign_results import Campaign, StudyResults, SweepResults
from hil.parts.campaigns.campaign import RIG, Sweep


class CampaignArguments(BackendArguments, total=False):
    """Further arguments of ``hil.campaign``. rig: in memory. scheduler: of Dask. dispersions: set or file.

    on_progress: called with a line of text and the completed fraction.
    """

    rig: Annotated[str, RIG]
    scheduler: str | None
    dispersions: str | Path | None
    on_progress: Callable[[str, float], None]


class StudyArguments(CampaignArguments, total=False):
    """Arguments with which ``hil.campaign`` does what the command does with the option of that name."""

    against: str | Path | Scenario | None
    sweep: str | Sweep | None
    rare: str | None
    method: Annotated[str, "subset"]
    sobol: int | None


class SharedArguments(CampaignArguments, total=False):
    """Further arguments of studies, as in ``hil.campaign``."""

    duration_s: float | None


class SweepArguments(SharedArguments, total=False):
    """Further arguments of ``hil.sweep``."""

    workers: Annotated[int, 0]


@overload
def campaign(
    scenario: str | Path | Scenario,
    runs: int,
    out: str | Path | None = None,
    seed: int = 0,
    duration_s: float | None = None,
    overrides: Overrides | None = None,
    workers: int = 0,
    **options: Unpack[CampaignArguments],
) -> Campaign: ...


@overload
def campaign(
    scenario: str | Path | Scenario,
    runs: int | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    duration_s: float | None = None,
    overrides: Overrides | None = None,
    workers: int = 0,
    **options: Unpack[StudyArguments],
) -> Any: ...


@public
def campaign(
    scenario: str | Path | Scenario,
    runs: int | None = None,
    out: str | Path | None = None,
    seed: int = 0,
    duration_s: float | None = None,
    overrides: Overrides | None = None,
    workers: int = 0,
    **options: Unpack[StudyArguments],
) -> Any:
    """Run many cases of a scenario with its dispersions on the mock rig, in the compiled loop.

    Parameters
    ----------
    scenario
        ``scheme-1``, ``scheme-2``, ``scheme-3``, the path of a TOML file, or a Scenario; ``[dispersions]`` in it sets
        what varies.
    runs
        Number of cases, numbered from 0. A case depends on its number and the seed only.
    out
        Folder for the results and their page, ``report.html``, in which a partial campaign is resumed; None for a
        temporary one.
    seed
        Seed of the whole campaign.
    duration_s
        Time of each run, s; None for the scenario's.
    overrides
        Dotted keys or nested tables to values, as for ``hil.run``.
    workers
        Number of processes; 0: one per core.
    options
        ``navigation=``, ``control=``: backends in place of the scenario's, as for ``hil.run``. Each case has a new
        object of a class, and a copy of an object. A case whose object raises has failed;
        ``summary["first_error"]`` has the first traceback. ``rig=``: another one in memory.
        ``scheduler=``: address of a Dask scheduler, whose workers are used. ``dispersions=``: a set or a
        file, instead of the scenario's. ``on_progress=``: called with a line of text and the completed fraction, as
        ``print``. ``against=``: a second scenario, which returns a Comparison;
        ``sweep="key=low:high:n"`` returns SweepResults; ``rare="column > number"`` with ``method=``, and
        ``sobol=rows`` return StudyResults.

    Raises
    ------
    BadInput
        Invalid arguments, with one line per error.
    CampaignStopped
        The disk is full, the scheduler is lost, or workers end again and again: completed cases are kept.
    """
    given: dict[str, Any] = dict(options)
    backends: Any = {part: given.pop(part) for part in PARTS if part in given}
    if (dispersions := given.pop("dispersions", None)) is not None:
        overrides = {"dispersions": str(dispersions), **(overrides or {})}
    given |= {"seed": seed, "duration_s": duration_s, "workers": workers, "backends": backends}
    show = given.pop("on_progress", lambda *_: None)
    with named_as_argument():
        folder = None if out is None else Path(out)
        results = CampaignRequest(scenario, settings_of(overrides), runs, folder, **given).run(show, log.warning)
    if isinstance(results, Campaign) and (first := results.summary.get("first_error")):
        log.warning("case %d raised, first of all: %s", first["case"], first["traceback"].strip().splitlines()[-1])
    return results


@public
def sweep(
    scenario: str | Path | Scenario,
    key: str,
    values: Sequence[float],
    runs: int,
    out: str | Path | None = None,
    seed: int = 0,
    overrides: Overrides | None = None,
    **options: Unpack[SweepArguments],
) -> SweepResults:
    """Run a campaign for each of the ``values`` of ``key``, with the same seeds.

    out: folder for the results, one of each value in it, ``sweep-000`` and so on. The others are those of
    ``hil.campaign``. Raises BadInput.
    """
    swept = Sweep(key, tuple(float(value) for value in values))
    if not swept.values:
        raise BadInput.single("values", "", "must be one number or more")
    more: Any = options
    results: SweepResults = campaign(scenario, runs, out, seed, overrides=overrides, sweep=swept, **more)
    return results


@public
def rare_event(
    scenario: str | Path | Scenario,
    event: str,
    out: str | Path | None = None,
    method: str = "subset",
    runs: int | None = None,
    seed: int = 0,
    overrides: Overrides | None = None,
    workers: int = 0,
    **options: Unpack[SharedArguments],
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
    options
        ``duration_s``, ``scheduler``, ``dispersions``, ``on_progress`` and backends, as for ``hil.campaign``.

    Returns
    -------
    StudyResults
        ``summary["rare"]`` has ``probability``, ``cov``, ``low``, ``high``, ``verdict`` and the failing cases.

    Raises
    ------
    BadInput
        Invalid arguments, with one line per error.
    """
    more: Any = options
    study: StudyResults = campaign(
        scenario, runs, out, seed, overrides=overrides, workers=workers, rare=event, method=method, **more
    )
    return study


@public
def sobol_indices(
    scenario: str | Path | Scenario,
    rows: int,
    out: str | Path | None = None,
    seed: int = 0,
    overrides: Overrides | None = None,
    workers: int = 0,
    **options: Unpack[SharedArguments],
) -> StudyResults:
    """Compute Sobol' indices of the outcomes, of each dispersed number and the noise, from ``rows`` x (d + 3) cases.

    Other parameters and errors: see ``rare_event``; ``summary["sobol"]`` has the indices of each outcome.
    """
    more: Any = options
    study: StudyResults = campaign(scenario, None, out, seed, overrides=overrides, workers=workers, sobol=rows, **more)
    return study
