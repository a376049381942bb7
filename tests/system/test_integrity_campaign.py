"""Single faults of the threat model in a campaign: none leads the chaser into the keep-out."""

from __future__ import annotations

import pytest

from hil.config.load import load_scenario
from sims.integrity_campaign import by_kind, flown, numbers, with_threats

KEEP_OUT_M = load_scenario("scheme-1").value.keep_out.radius_m


def test_every_kind_of_the_threat_model_is_drawn_and_none_enters_the_keep_out() -> None:
    rows = flown("scheme-1", 100, 1)
    found = numbers(rows, KEEP_OUT_M)
    assert found["cases"] == 100
    assert found["inside"] == 0
    assert found["detected"] >= 80
    kinds = {f"{draw.device} {draw.kind}" for draw in with_threats("scheme-1").dispersions.faults.draw}
    assert set(by_kind(rows)) <= kinds
    assert len(by_kind(rows)) >= len(kinds) - 4


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2"])
def test_no_case_of_ten_thousand_enters_the_keep_out(scheme: str) -> None:
    assert numbers(flown(scheme, 10_000, 2), KEEP_OUT_M)["inside"] == 0
