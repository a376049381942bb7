"""Input and output of a whole GNC elsewhere: what is measured, and protection levels and health, reported or not."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.core.gnc_records import GNC_INPUT, GNC_OUTPUT, OUTPUTS, GncHealth
from hil.core.messages import COMMAND, IMU, NAVIGATION, POSE, POSITION_ONLY, REFERENCE, new
from hil.core.sensor_records import SENSOR_ARRIVAL
from hil.gnc import backend_outputs, backend_step, whole_step
from hil.gnc.step import GNC_PARAMS
from hil.gnc_backends.output_texts import fault_text

PARTS = (new(OUTPUTS["navigation"]), new(OUTPUTS["control"]))


def output() -> np.record:
    out = new(GNC_OUTPUT)
    whole_step.clear_output(out, 3)
    out.estimate, out.q_CH = 1, (0.0, 0.0, 0.0, 1.0)
    return out


def estimate_of(out: np.record) -> np.record:
    assert whole_step.take_apart(out, 3, 1, *PARTS) == (backend_outputs.FINE, 0)
    navigation = new(NAVIGATION)
    whole_step.use_output(new(GNC_PARAMS), 0, *PARTS, navigation, new(COMMAND))
    return navigation


@pytest.mark.parametrize("unset", [0.0, math.nan])
def test_output_without_protection_levels_reports_none(unset: float) -> None:
    out = output()
    out.protection_level_m, out.protection_level_rad = unset, unset
    estimate = estimate_of(out)
    assert np.isnan([*estimate.protection_level_m, estimate.protection_level_rad]).all()
    assert estimate.health == 0


def test_reported_protection_levels_and_health_are_those_of_the_estimate() -> None:
    out = output()
    out.protection_level_m, out.protection_level_rad = (0.1, 0.2, math.inf), 0.01
    out.health = GncHealth.VISION_LOST | GncHealth.THRUSTER_FAULT
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
        ("health", 512, "health 512, allowed 0 to 511"),
        ("health", -1, "health -1, allowed 0 to 511"),
        ("estimate", 2, "estimate 2, allowed 0, 1"),
        ("direct", 2, "direct 2, allowed 0, 1"),
        ("torque", (0, -2, 0), "torque demand about y is -2, allowed -1, 0, 1"),
        ("w_CH_C_radps", (0.0, 0.0, math.inf), "estimated w_CH_C_radps[2] is inf, allowed finite numbers"),
        ("q_CH", (0.0, 0.0, 0.0, 2.0), "estimated q_CH (0, 0, 0, 2) is not of length 1"),
        ("cycle", 2, "answers cycle 2 to the input of cycle 3"),
        ("state", 4, "state 4, allowed 0 to 3"),
    ],
)
def test_impossible_number_is_a_fault_by_the_name_of_its_field(field: str, value: object, text: str) -> None:
    out = output()
    out[field] = value
    fault, place = whole_step.take_apart(out, 3, 1, *PARTS)
    assert fault_text(out, fault, place, 1, 3).startswith(text)


def test_demands_that_do_not_count_are_not_checked() -> None:
    """Those of thrusters that are opened directly, and those of a GNC that is starting."""
    out = output()
    out.force, out.direct, out.on[0] = 7, 1, 1
    estimate_of(out)
    assert PARTS[1].on[0] == 1
    out.direct, out.state = 0, 0
    estimate_of(out)
    assert not PARTS[1].force.any()


def test_positions_alone_are_among_what_is_measured_but_not_among_the_whole_poses() -> None:
    poses, sent = np.zeros(3, POSE).view(np.recarray), new(GNC_INPUT)
    poses.t_s, poses.status = [0.1, 0.2, 0.3], [0, POSITION_ONLY, 0]
    whole_step.write_input(1, 0.3, 0, 0, new(IMU), new(REFERENCE), poses, 3, sent)
    assert sent.poses["t_s"][: sent.n_poses].tolist() == [0.1, 0.3]
    samples, arrivals = np.zeros(4, IMU), np.zeros(2, SENSOR_ARRIVAL).view(np.recarray)
    samples["rate_C"][:, 0], arrivals.sample.number = [1.0, 2.0, 3.0, 4.0], [7, 8]
    params = new(GNC_PARAMS)
    params.navigation.fusion.sensors.slot[0]["enabled"] = 1
    backend_step.write_measured(params, 1, samples, poses, 3, arrivals, 2, sent.measured)
    measured = sent.measured
    assert measured.poses["status"][: measured.n_poses].tolist() == [0, POSITION_ONLY, 0]
    assert measured.samples["rate_radps"][: measured.n_samples, 0].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert measured.measurements["number"][: measured.n_measurements].tolist() == [7, 8]
