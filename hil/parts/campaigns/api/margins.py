"""Delay margins of a scenario: ``hil.margins``, and what ``hil margins`` prints."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

from hil.api import jobs
from hil.config.rig import GIMBAL_NAMES, LEAD_MAX_S, RAIL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.config.tables.error_models import LAG_MAX_S
from hil.config.tables.model import DELAY_MAX_S
from hil.core.public import public
from hil.core.surroundings import temporary_folder
from hil.parts.campaigns.campaign import RIG, CampaignJob, write_summary
from hil.parts.campaigns.engines import LocalEngine
from hil.parts.campaigns.margins import DelayedPart, delay_margins, draw_margins


@public
def margins(
    scenario: str | Path | Scenario,
    runs: int = 20,
    out: str | Path | None = None,
    seed: int = 0,
    overrides: jobs.Overrides | None = None,
    workers: int = 0,
    watch: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Search how much later poses, time stamps, thrusters and axes may be before the first of ``runs`` cases fails.

    Each is delayed alone, on the mock rig, with the dispersions of the scenario. The bench guard is off: it would end a
    run whose axes are late before the loop does.

    Parameters
    ----------
    scenario
        ``scheme-1``, ``scheme-2``, ``scheme-3``, the path of a TOML file, or a Scenario.
    runs
        Number of cases of each delay.
    out
        Folder for ``margins.json``, ``margins.png`` and the campaigns, of which complete ones are not flown again;
        None for none.
    seed
        Seed of the campaigns.
    overrides
        Dotted keys or nested tables to values, as for ``hil.run``.
    workers
        Number of processes; 0: one per core.
    watch
        Called with a line before each delay is flown.

    Returns
    -------
    dict
        The content of ``hil margins --json``: ``scenario``, ``runs``, ``seed`` and a list ``margins`` with ``part``,
        ``margin_s``, ``fails_at_s``, ``why`` and ``points``.

    Raises
    ------
    BadInput
        Invalid arguments, with one line per error.
    """
    with jobs.named_as_argument():
        settings = jobs.settings_of(overrides)
        flown, rig = jobs.loaded_scenario(scenario, settings).value, jobs.loaded_rig(RIG, settings).value
    return search_margins(flown, rig, runs, out, seed, workers, watch)


def search_margins(
    scenario: Scenario,
    rig: Rig,
    runs: int,
    out: str | Path | None,
    seed: int,
    workers: int,
    watch: Callable[[str], None],
) -> dict[str, Any]:
    """Return the margins of a scenario on a rig, both checked; see ``margins``."""
    parts = delayed_parts(scenario, rig, seed)
    temporary = temporary_folder("margins") if out is None else None
    folder = Path(temporary.name if temporary else str(out))
    try:
        parts[0].job(0.0).warm_up()
        with closing(LocalEngine(workers)) as engine:
            margin = delay_margins(parts, runs, engine, folder, watch)
        summary = {"scenario": scenario.name, "runs": runs, "seed": seed, "margins": margin}
        if out is not None:
            write_summary(folder / "margins.json", summary)
            draw_margins(margin, folder / "margins.png")
    finally:
        if temporary:
            temporary.cleanup()
    return summary


def delayed_parts(scenario: Scenario, rig: Rig, seed: int) -> list[DelayedPart]:
    """Return the parts of the loop of ``scenario`` that can be late."""

    valve_s = scenario.chaser.thrusters.errors.delay_s

    def job(settings: jobs.Settings, faults: jobs.Faults = ()) -> CampaignJob:
        late = jobs.with_faults(jobs.loaded_scenario(scenario, settings), faults)
        return CampaignJob(late, jobs.loaded_rig(rig, ["rig.guard.enabled=false", *settings]), seed)

    def poses(delay_s: float) -> CampaignJob:
        return job([f"vmu.latency_s={scenario.vmu.latency_s + delay_s}"])

    def stamps(delay_s: float) -> CampaignJob:
        late = {"device": "vmu", "kind": "latency", "at_s": 0.0, "value": delay_s, "stamp": "arrival"}
        return job([], [late] if delay_s else [])

    def thrusters(delay_s: float) -> CampaignJob:
        return job([f"chaser.thrusters.errors.delay_s={valve_s + delay_s}"])

    def axes(delay_s: float) -> CampaignJob:
        leads = {f"rails.{name}": getattr(rig.rails, name).lead_s for name in RAIL_NAMES}
        leads |= {f"turntable.{name}": getattr(rig.turntable, name).lead_s for name in GIMBAL_NAMES}
        return job([f"rig.{name}.lead_s={lead_s - delay_s}" for name, lead_s in leads.items()])

    return [
        DelayedPart("poses", DELAY_MAX_S - scenario.vmu.latency_s, poses),
        DelayedPart("stamps", DELAY_MAX_S, stamps),
        DelayedPart("thrusters", LAG_MAX_S - valve_s, thrusters),
        DelayedPart("axes", LEAD_MAX_S, axes),
    ]
