"""Search of a delay margin, on campaigns whose limit is given."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

import pytest

from hil.config.load import load_scenario
from hil.parts.campaigns.campaign import CampaignJob
from hil.parts.campaigns.engines import LocalEngine
from hil.parts.campaigns.margins import DelayedPart, delay_margins

RUNS = 4


class LimitedCampaign:
    """Campaign whose last case fails beyond ``limit_s``."""

    def __init__(self, delay_s: float, limit_s: float) -> None:
        self.fails = delay_s > limit_s
        self.scenario = load_scenario("scheme-1")

    @contextmanager
    def store(self, _: Path) -> Iterator[LimitedCampaign]:
        yield self

    def run(self, *_: Any) -> None:
        pass

    def column(self, name: str) -> list[Any]:
        if name in ("stop", "abort"):
            return ["completed" if name == "stop" else ""] * RUNS
        failed = self.fails and name in ("accepted", "energy_passed")
        return [True] * (RUNS - 1) + [not failed]


def found(limit_s: float, tmp_path: Path) -> dict[str, Any]:
    part = DelayedPart("poses", 1.0, lambda delay_s: cast(CampaignJob, LimitedCampaign(delay_s, limit_s)))
    (margin,) = delay_margins([part], RUNS, LocalEngine(1), tmp_path, lambda _: None)
    return margin


@pytest.mark.parametrize("limit_s", [0.003, 0.0125, 0.09, 0.7])
def test_margin_lies_within_a_twentieth_below_the_limit(limit_s: float, tmp_path: Path) -> None:
    margin = found(limit_s, tmp_path)
    assert margin["margin_s"] <= limit_s < margin["fails_at_s"]
    assert margin["fails_at_s"] - margin["margin_s"] <= 0.05 * margin["fails_at_s"]
    assert margin["why"] == [{"reason": "not passed: energy", "cases": 1}]
    delays = [point["delay_s"] for point in margin["points"]]
    assert delays == sorted(delays)


def test_margin_above_the_largest_delay_is_that_delay(tmp_path: Path) -> None:
    margin = found(2.0, tmp_path)
    assert (margin["margin_s"], margin["fails_at_s"], margin["why"]) == (1.0, None, [])


def test_loop_that_fails_without_a_delay_has_no_margin(tmp_path: Path) -> None:
    margin = found(-1.0, tmp_path)
    assert (margin["margin_s"], margin["fails_at_s"]) == (None, 0.0)
    assert [point["pass_rate"]["passed"] for point in margin["points"]] == [RUNS - 1]


def test_cases_without_a_delay_are_flown_once_for_all_parts(tmp_path: Path) -> None:
    flown: list[tuple[str, float]] = []

    def part(name: str) -> DelayedPart:
        def job(delay_s: float) -> CampaignJob:
            flown.append((name, delay_s))
            return cast(CampaignJob, LimitedCampaign(delay_s, 0.5))

        return DelayedPart(name, 1.0, job)

    margins = delay_margins([part("poses"), part("axes")], RUNS, LocalEngine(1), tmp_path, lambda _: None)
    assert [margin["part"] for margin in margins] == ["poses", "axes"]
    assert [name for name, delay_s in flown if delay_s == 0.0] == ["poses"]
    assert margins[0]["points"] == margins[1]["points"]
