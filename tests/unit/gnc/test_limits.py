"""Margins to the limits of a run, and the one that was broken first."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE
from hil.gnc.limits import CORRIDOR, LEVEL, TRACKING, VISION_AGE
from hil.loop.compiled.run_stats import counted

SCENARIO, RIG = load_scenario("scheme-1", ()).value, load_rig("mock", ()).value
STEP_S = SCENARIO.step_s


def rows(n: int = 400) -> np.ndarray:
    """Return rows of a chaser at rest on the line of its approach, 3 m away, estimated without error."""
    found = np.zeros(n, CYCLE)
    found["t_s"] = STEP_S * np.arange(n)
    for name in ("truth", "navigation", "reference"):
        found[name]["r_CT_H"][:, 0] = 3.0
        found[name]["q_CH"][:, 3] = 1.0
    found["reference"]["from_H"][:, 0], found["reference"]["to_H"][:, 0] = 5.0, 0.4
    found["navigation"]["valid"], found["pose"]["fresh"] = 1, 1
    found["navigation"]["protection_level_m"], found["navigation"]["protection_level_rad"] = 0.01, 1e-3
    found["supervision"]["level"], found["supervision"]["alert_limit"] = (0.01, 0.01, 1e-3), (0.3, 0.2, 0.02)
    found["supervision"]["corridor_margin_m"] = found["supervision"]["closing_margin_mps"] = 0.1
    return found


def judged(found: np.ndarray) -> np.record:
    """Return LIMITS_STATE of the rows."""
    state: np.record = counted(found, SCENARIO, RIG).integrity.limits
    return state


def test_least_margin_has_its_time_value_and_limit() -> None:
    found = rows()
    found["truth"]["r_CT_H"][100, 1] = found["navigation"]["r_CT_H"][100, 1] = 0.05
    state = judged(found)
    assert state.at_s[CORRIDOR] == found["t_s"][100]
    assert state.value[CORRIDOR] == pytest.approx(0.05)
    assert state.limit[CORRIDOR] - state.value[CORRIDOR] == pytest.approx(state.margin[CORRIDOR])
    assert np.isnan(state.broken_s[CORRIDOR])


def test_corridor_is_broken_at_the_first_cycle_outside() -> None:
    found = rows()
    found["truth"]["r_CT_H"][200:, 2] = 2.0
    state = judged(found)
    assert state.broken_s[CORRIDOR] == found["t_s"][200]
    assert state.broken_value[CORRIDOR] == pytest.approx(2.0)


def test_level_is_broken_after_the_time_to_alert_and_not_by_a_shorter_excess() -> None:
    found, cycles = rows(), round(SCENARIO.integrity.time_to_alert_s / STEP_S)
    found["supervision"]["level"][50 : 50 + cycles - 1, 1] = 0.25
    assert np.isnan(judged(found).broken_s[LEVEL + 1])
    found["supervision"]["level"][150:, 1] = 0.25
    state = judged(found)
    assert state.broken_s[LEVEL + 1] == pytest.approx(found["t_s"][150] + SCENARIO.integrity.time_to_alert_s)
    assert (state.broken_value[LEVEL + 1], state.broken_limit[LEVEL + 1]) == (0.25, 0.2)


def test_levels_do_not_count_while_the_filters_converge() -> None:
    found = rows(100)
    found["supervision"]["level"][:, 0] = 1.0
    assert judged(found).margin[LEVEL] == np.inf


def test_nothing_counts_after_an_abort_but_the_axes() -> None:
    found = rows()
    found["supervision"]["aborted"][100:] = 3
    found["truth"]["r_CT_H"][150:, 1] = 2.0
    found["feedback"]["rail_m"][200, 1] = 0.03
    state = judged(found)
    assert np.isnan(state.broken_s[CORRIDOR])
    assert (state.aborted, state.at_s[TRACKING + 1]) == (3, found["t_s"][200])


def test_age_of_the_last_pose_counts_up() -> None:
    found = rows()
    found["pose"]["fresh"][101:160] = 0
    state = judged(found)
    assert state.value[VISION_AGE] == pytest.approx(59 * STEP_S)


def test_health_bits_have_the_time_at_which_each_was_first_set() -> None:
    found = rows()
    found["navigation"]["health"][20:30] = 2
    found["navigation"]["health"][25:40] |= 8
    state = judged(found)
    np.testing.assert_array_equal(state.health_s[[1, 3]], found["t_s"][[20, 25]])
    assert np.isnan(state.health_s[0])
