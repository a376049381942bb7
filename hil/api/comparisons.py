"""Results of several campaigns: of two that are compared, and along the values of one key."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from hil.api.campaign_results import Campaign
from hil.errors import BadInput
from hil.monte_carlo.campaign import Sweep, sweep_summary
from hil.monte_carlo.statistics import compare as compare_columns

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Comparison:
    """Two campaigns with the same cases. summary: second minus first, by the keys of ``comparison.json``."""

    def __init__(self, first: Campaign, second: Campaign, summary: dict[str, Any]) -> None:
        self.first, self.second, self.summary = first, second, summary

    @property
    def difference(self) -> dict[str, Any]:
        """Mean difference of each outcome with its 95 % interval: ``mean``, ``low``, ``high``, ``n``."""
        found: dict[str, Any] = self.summary["difference"]
        return found

    def __repr__(self) -> str:
        rates = self.summary["accepted_rate"]
        first, second = (rates[name]["passed"] for name in ("first", "second"))
        names = f"{self.summary['second']} against {self.summary['first']}"
        return f"<Comparison {names}: {second} and {first} of {self.summary['runs']} accepted>"


def compare(first: Campaign, second: Campaign) -> Comparison:
    """Return the paired differences of two campaigns, second minus first, case by case.

    Raises BadInput if they do not have the same seed and number of cases.
    """
    if first.job.seed != second.job.seed or len(first.cases) != len(second.cases):
        text = "both campaigns must have the same seed and number of cases"
        raise BadInput.single("compare", "", text)
    names = (first.summary["scenario"], second.summary["scenario"])
    return Comparison(first, second, compare_columns(first, second, names))


class SweepResults:
    """Campaigns along the values of one key. values: of the key; campaigns: in their order; summary: ``sweep.json``."""

    def __init__(self, sweep: Sweep, campaigns: Sequence[Campaign]) -> None:
        self.key, self.values, self.campaigns = sweep.key, sweep.values, list(campaigns)
        self.summary: dict[str, Any] = sweep_summary(sweep, self.campaigns)

    def figure(self) -> Figure:
        """Return rate of accepted cases and propellant along the values."""
        from hil.monte_carlo.figure import sweep_figure  # slow import

        return sweep_figure(self.summary)

    def to_pandas(self) -> Any:
        """Return a DataFrame with one row per value: rates and means. Raises BadInput without pandas."""
        from hil.api.frames import library

        rows = [
            {
                "value": point["value"],
                **{name: point[name]["rate"] for name in ("accepted_rate", "pass_rate")},
                **{name: part["mean"] for name, part in point.items() if isinstance(part, dict) and "mean" in part},
            }
            for point in self.summary["points"]
        ]
        return library("pandas").DataFrame(rows).set_index("value")

    def __repr__(self) -> str:
        return f"<SweepResults {self.key}: {len(self.values)} values, {len(self.campaigns[0].cases)} cases each>"
