"""Keep-out volume against the points of the plan."""

from __future__ import annotations

import pytest

from hil.checks.compatibility import check_keep_out
from hil.config.load import load_scenario


@pytest.mark.parametrize(
    ("settings", "text"),
    [
        (("keep_out.radius_m=0.4",), "0.4: must be below 0.4, the distance of gnc.guidance.ready_point_m"),
        (("initial.position_m=[0.2, 0.0, 0.0]",), "0.25: must be below 0.2, the distance of initial.position_m"),
        (
            ("gnc.guidance.phases.approach.point_m=[0.1, 0.0, 0.0]",),
            "0.25: must be below 0.1, the distance of gnc.guidance.phases.approach.point_m",
        ),
        (
            ("requirements.axial_distance_m=0.2",),
            "0.25: must be below 0.2, the distance of requirements.axial_distance_m",
        ),
    ],
)
def test_plan_with_a_point_in_the_keep_out_is_refused(settings: tuple[str, ...], text: str) -> None:
    (problem,) = check_keep_out(load_scenario("scheme-1", settings))
    assert problem.key == "keep_out.radius_m"
    assert problem.message == f"{text}, or 0 for a scenario that docks"


@pytest.mark.parametrize("settings", [(), ("keep_out.radius_m=0", "initial.position_m=[0.0, 0.0, 0.0]")])
def test_plan_outside_of_the_keep_out_or_without_one_is_accepted(settings: tuple[str, ...]) -> None:
    assert check_keep_out(load_scenario("scheme-1", settings)) == []
