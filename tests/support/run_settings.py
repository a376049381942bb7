"""Settings and jobs that many tests run with."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest

from hil.config.load import load_rig, load_scenario
from hil.session.build import Job

NEAR = ("initial.position_m=[0.7, -0.03, 0.03]", "rig.rails.x.park_m=0.6", "requirements.required_ready_s=1.0")
"""A start from which the ready point is near, for a run that is short in real time: faster
ones ask more of the computer that the tests run on than it may have left."""

PATIENT_RELAY = ("rig.io.pump_timeout_s=1.0",)
"""The safety relay's own 0.05 s are tested where processes are killed: elsewhere a computer that stops for a moment
is no fault. The other time-outs are 0.4 s and more as shipped."""

UNHURRIED = (*PATIENT_RELAY, *(f"rig.{device}.lost_packets_max=50" for device in ("rails", "turntable", "vmu")))
"""Nor are the packets that such a moment loses: that they are counted is tested by the table of faults."""

HARDWARE_WIRES = """
rails.modbus.x.port = 502
rails.modbus.y.port = 503
rails.modbus.z.port = 504
turntable.cia402.channel = "/dev/null"
vmu.rs422.port = "/dev/null"
io.port = 505
io.coils.brakes_released = 40
io.inputs.brakes_closed = 9
"""
"""Wires of a rig of hardware, none of which is there."""


def typed(*settings: str) -> tuple[str, ...]:
    """Return ``settings`` as they are typed."""
    return tuple(word for setting in settings for word in ("--set", setting))


def make_job(
    duration_s: float,
    settings: Sequence[str] = (),
    *,
    scenario: str = "scheme-1",
    rig: str = "mock",
    seed: int = 0,
    speed: float = 1.0,
) -> Job:
    """Return a job of a shipped or written scenario on a rig; ``settings`` are of both."""
    return Job(load_scenario(scenario, settings), load_rig(rig, settings), seed, duration_s, speed)


ALL_ERRORS = (
    "vmu.errors.bias_m=[0.001, -0.001, 0.002]",
    "vmu.errors.misalignment_deg=[0.05, -0.1, 0.1]",
    "vmu.errors.scale_error=0.002",
    "vmu.errors.correlated_fraction=0.4",
    "vmu.errors.outlier_probability=0.05",
    "vmu.errors.misidentified_probability=0.02",
    "imu.errors.gyro_scale_error=[1e-4, -1e-4, 2e-4]",
    "imu.errors.gyro_misalignment_deg=[0.02, 0.01, -0.02]",
    "imu.errors.gyro_instability_degps=1e-5",
    "imu.errors.gyro_quantum_degps=1e-5",
    "imu.errors.accelerometer_scale_error=[1e-3, 0.0, -1e-3]",
    "imu.errors.accelerometer_misalignment_deg=[0.1, -0.1, 0.2]",
    "imu.errors.accelerometer_instability_mps2=1e-4",
    "imu.errors.accelerometer_quantum_mps2=2e-4",
    "imu.errors.lever_arm_m=[0.2, -0.3, 0.1]",
    "chaser.thrusters.minimum_on_s=0.033",
    "chaser.thrusters.errors.delay_s=0.027",
    "chaser.thrusters.errors.rise_s=0.01",
    "chaser.thrusters.errors.tail_off_s=0.02",
    "chaser.thrusters.errors.impulse_scatter_sigma=0.1",
    "chaser.thrusters.errors.half_pressure_kg=1.0",
    "chaser.thrusters.errors.plume_target_radius_m=0.6",
    "chaser.thrusters.errors.plume_target_mass_kg=700.0",
    "chaser.thrusters.errors.plume_dimming_fraction=0.9",
    "chaser.propellant_gyration_m=[0.4, 0.5, 0.6]",
    "chaser.solar_array.mode_translation_coupling=[1.0, 0.0, 4.0]",
    "chaser.solar_array.further_modes.second.frequency_hz=0.7",
    "chaser.solar_array.further_modes.second.damping=0.01",
    "chaser.solar_array.further_modes.second.coupling=[0.0, 4.0, 1.0]",
    "chaser.solar_array.further_modes.second.translation_coupling=[2.0, -1.0, 0.0]",
)
"""Settings with all terms of the error models, and of the truth those that no shipped scenario has."""


def faults_setting(*faults: dict[str, Any]) -> str:
    """Return the setting of a scenario's ``faults``, tables of ``[[faults]]``."""
    tables = [", ".join(f"{key} = {json.dumps(value)}" for key, value in table.items()) for table in faults]
    return f"faults=[{', '.join(f'{{{table}}}' for table in tables)}]"


@contextmanager
def without_figures() -> Iterator[None]:
    """Let campaigns draw no figures of their cases, and write no page: both take longer than short flights."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("draw_percentiles", "draw_integrity", "write_page"):
            patch.setattr(f"hil.parts.campaigns.api.campaign_request.{name}", lambda *_: None)
        yield
