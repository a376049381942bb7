"""A sensor of inertial directions: what the bench gives it, in the plain run and in the cases of a campaign."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from hil.core.clock import SimulatedClock
from hil.loop.rate_keeper import SimulatedRate
from hil.parts.campaigns.api.campaign_results import job_of_case
from hil.parts.campaigns.dispersions import Design
from hil.session.assembly import Job
from hil.session.build import in_memory
from tests.support.run_settings import make_job

MODULE = """
import hil
from hil.maths import quat
import numpy as np


class SunSensor(hil.SensorModule):
    \"\"\"Cosine of the angle between the Sun and an axis of the chaser that is far from it.\"\"\"

    kind = "sun_sensor"
    sees = "truth"
    components = (hil.Component("cosine", "1"),)
    settings = (hil.Setting("sigma", 2e-3, "1", 1e-6, 1.0),)
    faults = {"no_sample": "at once"}

    @staticmethod
    def measure(settings, truth, out):
        sun = np.empty(3)
        quat.transform_into(truth.q_HI, truth.sun_I, sun)
        quat.transform_into(truth.q_CH, sun, sun)
        out.valid = 1 if truth.sunlight > 0.5 else 0
        out.sample.value[0] = sun[1] + settings.sigma * truth.normal[0]
        out.sample.covariance[0, 0] = settings.sigma**2

    @staticmethod
    def innovate(settings, estimate, out):
        sun = np.empty(3)
        quat.transform_into(estimate.q_HI, estimate.sun_I, sun)
        quat.transform_into(estimate.q_CH, sun, sun)
        out.value[0] = out.sample.value[0] - sun[1]
        out.h[0, 6], out.h[0, 8] = sun[2], -sun[0]  # of -theta x s
"""
SUN = np.array([0.6, -0.8, 0.0])


def sun_job(folder: Path, *settings: str) -> Job:
    module = folder / "sun.py"
    module.write_text(MODULE)
    given = (
        f'sensors.sun.kind="{module}:SunSensor"',
        "sensors.sun.rate_hz=50.0",
        f"truth.sun_direction={SUN.tolist()}",
    )
    return make_job(6.0, (*given, *settings))


def results(job: Job) -> np.ndarray:
    """Return what became of each sample of the sensor."""
    runner = in_memory(job, SimulatedRate(SimulatedClock(), job.tick_s))
    runner.run()
    monitor = runner.loop.sensors.arrivals.monitor[0]
    return np.array([monitor.accepted, monitor.rejected])


def test_sun_is_where_the_scenario_has_it_also_in_a_case_on_any_place_of_the_orbit(tmp_path: Path) -> None:
    job = sun_job(tmp_path)
    assert "orbit.true_anomaly_deg" in Design(job.scenario, 0).names
    for flown in (job, job_of_case(job, 0), job_of_case(job, 1)):
        accepted, rejected = results(flown)
        assert accepted > 200
        assert rejected < 5


def test_sensor_measures_nothing_in_the_shadow(tmp_path: Path) -> None:
    behind = sun_job(
        tmp_path, "truth.eclipse=true", "truth.sun_direction=[-1.0, 0.0, 0.0]", "orbit.inclination_deg=0.0"
    )
    assert results(behind).sum() == 0
