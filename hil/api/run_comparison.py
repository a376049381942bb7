"""Comparison of two runs or recordings: ``hil.compare``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from hil.api.frames import library
from hil.api.results import Run
from hil.config.scenario import Scenario
from hil.recording.schema import leaves
from hil.report.comparison import RunDivergence, divergences, key_numbers
from hil.report.results import RunResults

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def settings_of_both(first: Scenario, second: Scenario) -> dict[str, tuple[Any, Any]]:
    """Return the values in ``first`` and ``second`` of each key that differs, None where it is absent."""
    one, other = (dict(leaves(each.model_dump(mode="json"))) for each in (first, second))
    keys = [path for path in {**other, **one} if one.get(path) != other.get(path) and path != ("name",)]
    return {".".join(path): (one.get(path), other.get(path)) for path in keys}


def shown(settings: Mapping[str, tuple[Any, Any]]) -> str:
    """Return `` (KEY second for first)`` of three ``settings`` at most, "" for none."""
    texts = [f"{key} {second} for {first}"[:80] for key, (first, second) in settings.items()]
    more = f" and {len(texts) - 3} more: settings" if len(texts) > 3 else ""
    return f" ({', '.join(texts[:3])}{more})" if texts else ""


class RunComparison:
    """Two runs or recordings, the second against the first.

    numbers: label -> text of the first and of the second, as in a report of several runs. divergences: of the truths,
    one entry per axis of position, velocity and attitude: largest difference, its time, and its size in sigmas of both
    filters and dead bands and relative to Table III; none if scenario or step differ.
    """

    def __init__(self, first: Run, second: Run) -> None:
        self.first, self.second = first, second
        a, b = (dict(key_numbers(RunResults.of(run.summary))) for run in (first, second))
        self.numbers = {label: (a.get(label, "-"), b.get(label, "-")) for label in {**a, **b}}
        self.divergences: list[RunDivergence] = []
        if self.is_of_one_scenario:
            self.divergences = divergences(first.history, second.history, first.scenario)

    @property
    def is_of_one_scenario(self) -> bool:
        """Whether both runs have the same scenario, by its name, and the same step."""
        return len({(run.scenario.name, run.scenario.step_s) for run in (self.first, self.second)}) == 1

    @property
    def settings(self) -> dict[str, tuple[Any, Any]]:
        """Keys of the scenario that differ, with the values of the first and of the second."""
        return settings_of_both(self.first.scenario, self.second.scenario)

    def to_pandas(self) -> Any:
        """Return a DataFrame of the divergences, indexed by their names. Raises BadInput without pandas."""
        return library("pandas").DataFrame([asdict(each) for each in self.divergences]).set_index("name")

    def plot(self) -> Figure:
        """Return position and attitude of both truths over time, and their difference."""
        from hil.report.plots import difference  # slow import

        return difference(self.first.history, self.second.history, self.first.scenario)

    def __repr__(self) -> str:
        names = " against ".join(repr(run)[1:-1].partition(":")[0] for run in (self.second, self.first))
        names += shown(self.settings)
        if not self.is_of_one_scenario:
            return f"<RunComparison {names}: other scenarios or steps, the truths are not compared>"
        worst = max(self.divergences, key=lambda each: each.of_tolerance, default=None)
        if worst is None:
            return f"<RunComparison {names}: no common cycle>"
        verdicts = ["accepted" if run.accepted else "not accepted" for run in (self.second, self.first)]
        if verdicts[0] != verdicts[1]:
            names += f": {verdicts[0]}, {verdicts[1]}"
        if worst.largest == 0.0:
            return f"<RunComparison {names}: the truths are identical>"
        share = f"{100.0 * worst.of_tolerance:.0f} % of Table III"
        return f"<RunComparison {names}: {worst.name} differs by up to {worst.largest:.4g} {worst.unit}, {share}>"

    def _repr_html_(self) -> str:
        """Return the numbers of both for a notebook."""
        from hil.report import html

        rows = [(label, *texts) for label, texts in self.numbers.items()]
        return html.paragraph(repr(self)[1:-1]) + html.table(("", "first", "second"), rows)
