"""Vehicles and sensors that are not as the GNC assumes: flown, and no device is accused in their place."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import pytest

from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.outcome import row_of
from tests.support.run_settings import faults_setting

pytestmark = pytest.mark.xdist_group("campaign")

SCHEMES = ("scheme-1", "scheme-2")
LATE = "chaser.thrusters.errors.delay_s=0.12"
PROPELLANT_MAX_KG = 0.5


@lru_cache(maxsize=2)
def _runner(name: str) -> tuple[Scenario, CaseRunner]:
    scenario = load_scenario(name).value
    return scenario, CaseRunner(scenario, load_rig("mock").value, scenario.duration_s)


@pytest.fixture(autouse=True, scope="module")
def _release() -> Iterator[None]:
    """Release the memory of the runs after the last test."""
    yield
    _runner.cache_clear()


def fly(name: str, settings: tuple[str, ...], seed: int) -> dict[str, Any]:
    """Return the outcome of a run whose truth has ``settings`` that is unknown to its GNC."""
    assumed, runner = _runner(name)
    truth = load_scenario(name, settings).value
    return row_of(*runner.run(truth, seed), assumed, truth)


def scaled(key: str, factor: float) -> str:
    """Return the setting of ``key`` of the chaser with all its numbers multiplied by ``factor``."""
    value = load_scenario("scheme-1").value.chaser
    for part in key.split("."):
        value = getattr(value, part)
    return f"chaser.{key}={_times(value, factor)}"


def _times(value: Any, factor: float) -> Any:
    return [_times(entry, factor) for entry in value] if isinstance(value, (tuple, list)) else value * factor


def leak(thruster: int, fraction: float, at_s: float) -> str:
    """Return the setting of a valve that leaks."""
    return faults_setting({"device": f"thruster.{thruster}", "kind": "leak", "value": fraction, "at_s": at_s})


def accelerometer(error: float) -> str:
    """Return the setting of an error of all scales of the accelerometer."""
    return f"imu.errors.accelerometer_scale_error={[error] * 3}"


HEAVY, LIGHT = scaled("mass_kg", 1.2), scaled("mass_kg", 0.8)
WEAK, STRONG = scaled("thrusters.force_n", 0.7), scaled("thrusters.force_n", 1.3)
AGILE, SLUGGISH = scaled("inertia_kg_m2", 0.6), scaled("inertia_kg_m2", 1.5)
WRONG = {
    "heavy": (HEAVY,),
    "light": (LIGHT,),
    "weak thrusters": (WEAK,),
    "strong thrusters": (STRONG,),
    "small inertia": (AGILE,),
    "great inertia": (SLUGGISH,),
    "late valves": (LATE,),
    "heavy, weak, late": (HEAVY, WEAK, SLUGGISH, LATE),
    "strong and agile with late valves": (STRONG, AGILE, LATE),
    "leak of 8 % from the start": (leak(2, 0.08, 0.0),),
    "leak of 6 % that begins in the approach": (leak(9, 0.06, 100.0),),
    "leak of 1 % that begins in the approach": (leak(4, 0.01, 150.0),),
    "leak of 0.4 % that begins near the target": (leak(11, 0.004, 230.0),),
}


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("settings", WRONG.values(), ids=WRONG)
def test_wrong_parameters_are_flown_and_no_sensor_is_accused_for_them(name: str, settings: tuple[str, ...]) -> None:
    found = fly(name, settings, 41)
    assert found["passed"], found["abort"]
    assert not found["decision_error"]
    assert found["beyond_level_cycles"] == 0
    assert found["false_alarm_imu"] == found["false_alarm_vision"] == 0
    assert found["propellant_kg"] <= PROPELLANT_MAX_KG


def test_approaches_with_an_accelerometer_that_reads_5_percent_wrong_are_flown_and_none_is_misled() -> None:
    found = [fly(name, (accelerometer(sign * 0.05),), seed) for name in SCHEMES for sign in (1, -1) for seed in (7, 8)]
    for row in found:
        assert row["passed"], row["abort"]
        assert row["false_alarm_vision"] == row["false_alarm_imu"] == 0
        assert row["hmi_cycles"] == row["beyond_level_cycles"] == 0
        assert not row["decision_error"]


@pytest.mark.parametrize("name", SCHEMES)
@pytest.mark.parametrize("speed_mps", [1e-4, 3e-4, 1e-3, 2e-3])
def test_vision_unit_that_drifts_is_found_even_when_a_disturbance_would_explain_it_at_first(
    name: str, speed_mps: float
) -> None:
    drift = {"device": "vmu", "kind": "drift", "value": [0.0, speed_mps, 0.0], "at_s": 120.0}
    found = fly(name, (faults_setting(drift),), 43)
    assert found["hmi_cycles"] == 0
    assert found["beyond_level_cycles"] == 0
    assert not found["decision_error"]
    if speed_mps >= 1e-3:
        assert not found["passed"]
