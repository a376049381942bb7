"""Output of an external GNC: protection levels and health, reported or not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.core.gnc_records import GNC_OUTPUT, GncHealth
from hil.core.messages import COMMAND, NAVIGATION, new
from hil.gnc.step import GNC_PARAMS
from hil.gnc_backends import external_records
from hil.gnc_backends.external import fault_text


def output() -> np.record:
    out = new(GNC_OUTPUT)
    external_records.clear_output(out, 3)
    out.estimate, out.q_CH = 1, (0.0, 0.0, 0.0, 1.0)
    return out


def estimate_of(out: np.record) -> np.record:
    navigation = new(NAVIGATION)
    external_records.read_output(out, new(GNC_PARAMS), 0, navigation, new(COMMAND))
    return navigation


@pytest.mark.parametrize("unset", [0.0, math.nan])
def test_output_without_protection_levels_reports_none(unset: float) -> None:
    out = output()
    out.protection_level_m, out.protection_level_rad = unset, unset
    assert external_records.fault_of(out, 3, 1) == (external_records.FINE, 0)
    estimate = estimate_of(out)
    assert np.isnan([*estimate.protection_level_m, estimate.protection_level_rad]).all()
    assert estimate.health == 0


def test_reported_protection_levels_and_health_are_those_of_the_estimate() -> None:
    out = output()
    out.protection_level_m, out.protection_level_rad = (0.1, 0.2, math.inf), 0.01
    out.health = GncHealth.VISION_LOST | GncHealth.THRUSTER_FAULT
    assert external_records.fault_of(out, 3, 1) == (external_records.FINE, 0)
    estimate = estimate_of(out)
    assert (*estimate.protection_level_m, estimate.protection_level_rad) == (0.1, 0.2, math.inf, 0.01)
    assert estimate.health == 9


def test_estimate_that_is_marked_invalid_has_no_protection_level() -> None:
    out = output()
    out.estimate, out.protection_level_m, out.health = 0, 0.1, 1
    estimate = estimate_of(out)
    assert np.isnan(estimate.protection_level_m).all()
    assert estimate.health == 0


@pytest.mark.parametrize(
    ("field", "value", "text"),
    [
        ("protection_level_m", (0.1, -0.2, 0.1), "protection_level_m[1] is -0.2, allowed 0 and more"),
        ("protection_level_rad", -1.0, "protection_level_rad is -1, allowed 0 and more"),
        ("health", 256, "health 256, allowed 0 to 255"),
        ("health", -1, "health -1, allowed 0 to 255"),
    ],
)
def test_impossible_protection_level_or_health_is_a_fault(field: str, value: object, text: str) -> None:
    out = output()
    out[field] = value
    fault, index = external_records.fault_of(out, 3, 1)
    assert fault_text(out, fault, index, 3, 1).startswith(text)
