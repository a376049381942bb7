"""Simulated floating vehicle: where it stands, what its lines do, and what the floor does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.session.floating import SimulatedVehicle

EVEN = ("rig.floating.tilt_deg=[0.0, 0.0]",)
IDEAL = (
    "chaser.thrusters.errors.delay_s=0.0",
    "truth.misalignment_sigma_deg=0.0",
    "truth.force_scatter_sigma=0.0",
    "truth.centre_of_mass_offset_m=[0.0, 0.0, 0.0]",
    "truth.mass_loss=false",
)


def vehicle(*settings: str) -> SimulatedVehicle:
    settings = (*EVEN, *IDEAL, "initial.attitude_deg=[0.0, 0.0, 0.0]", *settings)
    return SimulatedVehicle(
        load_scenario("planar-floating", settings).value, load_rig("mock-floating", settings).value, 0
    )


def test_vehicle_stands_until_the_first_valve_opens() -> None:
    it = vehicle("initial.velocity_mps=[0.01, 0.0, 0.0]")
    assert it.axes_at(10.0).rail_m[0] == 5.0
    it.fire(b"\0\0", 10.0)
    assert it.axes_at(20.0).rail_m[0] == 5.0
    it.fire(b"\1\0", 20.0)
    assert it.axes_at(21.0).rail_m[0] != 5.0


def test_two_lines_push_along_x_from_their_time_on() -> None:
    it = vehicle()
    it.fire(b"\1\0\1", 1.005)  # both thrusters that fire along -x
    axes = it.axes_at(2.005)
    assert axes.rail_mps[0] == pytest.approx(-10.0 / 1000.0, rel=1e-9)
    assert axes.rail_m[0] == pytest.approx(5.0 - 0.5 * 0.01, rel=1e-9)
    it.fire(b"", 2.005)
    assert it.axes_at(3.005).rail_mps[0] == pytest.approx(-0.01, rel=1e-9)


def test_equal_lines_give_equal_poses_however_often_they_are_asked_for() -> None:
    poses = []
    for times in ([0.5], np.linspace(0.02, 0.5, 25)):
        it = vehicle()
        it.fire(b"\1", 0.0)
        for t_s in times:
            axes = it.axes_at(float(t_s))
        poses.append((*axes.rail_m, *axes.gimbal_rad))
    np.testing.assert_allclose(poses[0], poses[1], atol=1e-12)


def test_slope_pulls_and_friction_stops() -> None:
    speeds = []
    for it in (vehicle("rig.floating.tilt_deg=[0.01, 0.0]"), vehicle()):
        it.fire(b"\1\0\1", 0.0)
        it.fire(b"", 0.02)
        speeds.append(float(it.axes_at(10.0).rail_mps[0]))
    assert speeds[0] - speeds[1] == pytest.approx(10.0 * 9.80665 * math.sin(math.radians(0.01)), rel=1e-6)
    rough = vehicle("rig.floating.friction_mps2=0.001")
    rough.fire(b"\1\0\1", 0.0)
    rough.fire(b"", 1.0)
    assert rough.axes_at(5.0).rail_mps[0] < -0.004
    assert rough.axes_at(30.0).rail_mps[0] == pytest.approx(0.0, abs=1e-12)
