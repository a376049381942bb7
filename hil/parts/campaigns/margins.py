"""Delay margins: by how much one part of the loop may be later before the first case of a campaign fails.

Each delay is flown by the same cases. They are searched upwards in steps of a factor of two, then between the last
delay that all cases pass and the first that some fail: a loop that passed again beyond that is not looked for.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from matplotlib.figure import Figure

from hil.config.scenario import Scenario
from hil.config.tables.verdict import PART_COLUMNS, required_parts
from hil.loop.runner import COMPLETED
from hil.parts.campaigns.campaign import CampaignJob
from hil.parts.campaigns.engines import Engine
from hil.parts.campaigns.statistics import wilson
from hil.parts.campaigns.store import Store, atomic_write

_FIRST_S: Final = 0.01
_WITHIN: Final = 0.05  # accuracy relative to the first delay that fails


@dataclass(frozen=True)
class DelayedPart:
    """A part of the loop that can be late. most_s: largest delay that is flown.

    job: returns the campaign in which the part is later by a time, s.
    """

    name: str
    most_s: float
    job: Callable[[float], CampaignJob]


def delay_margins(
    parts: Sequence[DelayedPart], runs: int, engine: Engine, folder: Path, watch: Callable[[str], None]
) -> list[dict[str, Any]]:
    """Return the margin of each part with the delays that were flown, by the keys of ``hil margins --json``.

    folder: of the campaigns. watch: called with a line before each delay. margin_s: the largest delay with which all
    cases are accepted, None if they are not even without one. The cases without a delay are the same for
    all parts and flown once.
    """

    def fly(job: CampaignJob, name: str, delay_s: float) -> dict[str, Any]:
        with job.store(folder / name) as store:
            job.run(store, runs, engine, lambda _: None)
            return {"delay_s": delay_s} | _judged(store, job.scenario.value)

    watch("no delay")
    undelayed = fly(parts[0].job(0.0), "undelayed", 0.0)

    def margin(part: DelayedPart) -> dict[str, Any]:
        def fly_delay(delay_s: float) -> dict[str, Any]:
            watch(f"{part.name} later by {delay_s:.4g} s")
            return fly(part.job(delay_s), f"{part.name}/{1e6 * delay_s:.0f}us", delay_s)

        return _delay_margin(part, undelayed, fly_delay)

    return [margin(part) for part in parts]


def _delay_margin(
    part: DelayedPart, undelayed: dict[str, Any], fly: Callable[[float], dict[str, Any]]
) -> dict[str, Any]:
    """Return the margin of one part. undelayed: rate of accepted cases without delay. fly: returns it with one, s."""
    points = {0.0: undelayed}

    def passes(delay_s: float) -> bool:
        if delay_s not in points:
            points[delay_s] = fly(delay_s)
        rate = points[delay_s]["pass_rate"]
        return bool(rate["passed"] == rate["runs"])

    good, bad = None, None
    delay_s = 0.0
    while bad is None and (good is None or good < part.most_s):
        if passes(delay_s):
            good = delay_s
            delay_s = min(part.most_s, max(_FIRST_S, 2.0 * delay_s))
        else:
            bad = delay_s
    while good is not None and bad is not None and bad - good > _WITHIN * bad:
        middle = 0.5 * (good + bad)
        if passes(middle):
            good = middle
        else:
            bad = middle
    return {
        "part": part.name,
        "margin_s": good,
        "fails_at_s": bad,
        "why": points[bad]["why"] if bad is not None else [],
        "points": [points[delay_s] for delay_s in sorted(points)],
    }


def _judged(store: Store, scenario: Scenario) -> dict[str, Any]:
    """Return the rate of accepted cases, and why others are not accepted, the most frequent reason first."""
    required = required_parts(scenario.requirements.required_parts, PART_COLUMNS)
    flags = {name: np.asarray(store.column(PART_COLUMNS[name]), dtype=bool) for name in required}
    accepted = np.asarray(store.column("accepted"), dtype=bool)
    reasons: Counter[str] = Counter()
    for i in np.flatnonzero(~accepted):
        stop, abort = str(store.column("stop")[i]), str(store.column("abort")[i])
        failed = ", ".join(name.replace("_", " ") for name, flag in flags.items() if not flag[i])
        reasons[f"abort: {abort}" if abort else stop if stop != COMPLETED else f"not passed: {failed}"] += 1
    return {
        "pass_rate": wilson(int(accepted.sum()), len(accepted)),
        "why": [{"reason": reason, "cases": cases} for reason, cases in reasons.most_common()],
    }


def draw_margins(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the rate of accepted cases of each part against its delay into ``path``."""
    figure = Figure(figsize=(8.0, 4.0), layout="constrained")
    plot = figure.subplots()
    for each in rows:
        delays = [1e3 * point["delay_s"] for point in each["points"]]
        rates = [100.0 * point["pass_rate"]["rate"] for point in each["points"]]
        plot.plot(delays, rates, marker="o", markersize=4, label=each["part"])
    plot.set_xscale("symlog", linthresh=1e3 * _FIRST_S)
    plot.set_xlim(left=0.0)
    plot.set_xlabel("delay in addition to that of the scenario, ms")
    plot.set_ylabel("accepted, %")
    plot.legend(fontsize=8)
    with atomic_write(path) as partial:
        figure.savefig(partial, dpi=110, format="png")
