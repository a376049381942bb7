"""Setup of an external GNC from the scenario as the GNC has it: GNC_SETUP, and setup of its backend."""

from __future__ import annotations

import numpy as np

from hil.config.scenario import Scenario
from hil.core.gnc_records import GNC_SETUP
from hil.core.messages import new
from hil.gnc_backends.approach_events import ApproachEventLog
from hil.gnc_backends.external import BackendSetup
from hil.maths import euler
from hil.params import gnc as gnc_params
from hil.params.target import inertia, known_rate


def gnc_setup(scenario: Scenario) -> np.record:
    """Return GNC_SETUP: the nominal vehicle and plan, without seed and dispersions."""
    setup = new(GNC_SETUP)
    chaser, thrusters = scenario.chaser, scenario.chaser.thrusters
    control = gnc_params.gnc(scenario).control
    setup.scenario = scenario.name.encode()[: GNC_SETUP["scenario"].itemsize]
    setup.step_s = scenario.step_s
    setup.duration_s = scenario.duration_s
    orbit = gnc_params.target_orbit(scenario)
    setup.mean_motion_radps = orbit.mean_motion
    setup.eccentricity, setup.mean_anomaly_rad = orbit.eccentricity, orbit.mean_anomaly
    if scenario.target.motion == "tumble":
        setup.tumbles = 1
        setup.target_rate_radps, setup.target_inertia_kgm2 = known_rate(scenario), inertia(scenario.target)
    setup.mass_kg = chaser.mass_kg
    setup.inertia_kgm2 = chaser.inertia_kg_m2
    n = len(thrusters.position_m)
    setup.n_thrusters = n
    setup.thruster_position_m[:n] = thrusters.position_m
    setup.thruster_force_N[:n] = thrusters.force_n * np.array(thrusters.direction)
    setup.minimum_on_s = thrusters.minimum_on_s
    setup.acceleration_mps2 = control.acceleration[:3]
    setup.angular_acceleration_radps2 = control.acceleration[3:]
    setup.start_r_CT_H_m = scenario.initial.position_m
    setup.start_q_CH = euler.to_quaternion(np.radians(scenario.initial.attitude_deg), euler.YAW_PITCH_ROLL)
    setup.ready_point_m = scenario.gnc.guidance.ready_point_m
    setup.closing_rate_max_mps = scenario.gnc.corridor.closing_rate_max_mps
    return setup


def backend_setup(scenario: Scenario) -> BackendSetup:
    """Return the setup of the backend of an external GNC for ``scenario``."""
    return BackendSetup(gnc_setup(scenario), gnc_params.gnc(scenario), approach_event_log(scenario))


def approach_event_log(scenario: Scenario) -> ApproachEventLog:
    """Return the event log of the approach of ``scenario``."""
    return ApproachEventLog(scenario.gnc.guidance.sequence, scenario.requirements.dwell_s)
