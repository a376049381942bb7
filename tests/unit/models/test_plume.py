"""Plumes on the target: their push by the cosine law, and the light of the LEDs behind them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import MAX_THRUSTERS, VMU_FRAME, new
from hil.dynamics import truth as kernels
from hil.dynamics.truth import TRUTH_MEMORY
from hil.maths import quat
from hil.models.plume import PLUME_MEMORY, keep_share, met_fraction, push_of_plumes, share_at
from hil.params import dynamics as dynamics_params
from hil.sensors.vision_unit.faults import dim, see_through_plume
from hil.sensors.vision_unit.parameters import LEAST_SNR, least_light
from hil.vmu.detect import DetectorSettings
from tests.conftest import PLAIN

DT = 0.02
RADIUS, MASS, EXPONENT = 0.5, 800.0, 10.0
PLUME = (
    f"chaser.thrusters.errors.plume_target_radius_m={RADIUS}",
    f"chaser.thrusters.errors.plume_target_mass_kg={MASS}",
    f"chaser.thrusters.errors.plume_exponent={EXPONENT}",
)
AHEAD = (
    "chaser.thrusters.position_m=[[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 1.0, 0.0]]",
    "chaser.thrusters.direction=[[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]",
    "chaser.thrusters.bank=[]",
    "initial.attitude_deg=[0.0, 0.0, 0.0]",
)
"""A thruster whose plume points at a target on the x axis, one that points away, and one that points across."""


def pushed(at: tuple[float, float, float], *on: int) -> tuple[np.ndarray, float]:
    """Return the target's acceleration in H, and the thrust that it meets over that of one thruster.

    at: place of the chaser. on: its thrusters that fire.
    """
    scenario = load_scenario("scheme-1", (*PLAIN, *AHEAD, *PLUME, f"initial.position_m={list(at)}")).value
    params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
    fraction, out = np.zeros(MAX_THRUSTERS), np.empty(3)
    fraction[list(on)] = 1.0
    return out, push_of_plumes(params, RADIUS, fraction, truth, out)


def test_push_at_a_known_place_is_thrust_times_the_cone_that_the_target_fills() -> None:
    push, share = pushed((3.5, 0.0, 0.0), 0)  # the nozzle is 3 m from the target, on the axis
    met = 1.0 - math.cos(math.asin(RADIUS / 3.0)) ** (EXPONENT + 2.0)
    np.testing.assert_allclose(push, [-5.0 * met / MASS, 0.0, 0.0], rtol=1e-12, atol=1e-18)
    assert share == pytest.approx(met, rel=1e-12)


def test_momentum_in_all_directions_is_the_thrust() -> None:
    # the flux of a small sphere, over its disc, integrated over half of all directions
    angle = np.linspace(0.0, math.pi / 2.0, 20001)
    small = 1e-3
    flux = np.array([met_fraction(EXPONENT, small, 1.0, math.cos(a)) for a in angle]) / (math.pi * small**2)
    along = np.trapezoid(flux * np.cos(angle) * 2.0 * math.pi * np.sin(angle), angle)
    assert along == pytest.approx(1.0, rel=1e-4)


def test_push_falls_with_the_square_of_the_range_and_with_the_angle() -> None:
    near, far = (np.linalg.norm(pushed((distance + 0.5, 0.0, 0.0), 0)[0]) for distance in (20.0, 40.0))
    assert near / far == pytest.approx(4.0, rel=5e-3)
    beside, _ = pushed((20.5, -20.0 * math.tan(0.2), 0.0), 0)
    distance = 20.0 / math.cos(0.2)
    straight = np.linalg.norm(pushed((distance + 0.5, 0.0, 0.0), 0)[0])
    assert np.linalg.norm(beside) == pytest.approx(straight * math.cos(0.2) ** EXPONENT, rel=1e-9)
    assert beside / np.linalg.norm(beside) == pytest.approx([-math.cos(0.2), math.sin(0.2), 0.0])


def test_thrusters_that_do_not_point_at_the_target_push_nothing() -> None:
    push, share = pushed((3.5, 0.0, 0.0), 1)
    assert (push == 0.0).all()
    assert share == 0.0
    assert not pushed((3.5, -1.0, 0.0), 2)[0].any()  # at right angles


@pytest.mark.parametrize("motion", ["hill", "nonlinear"])
def test_step_gives_the_target_the_momentum_that_it_meets_and_the_imu_none(motion: str) -> None:
    found = []
    for settings in (PLUME, ()):
        given = (*PLAIN, *AHEAD, f"truth.relative_motion={motion}", "truth.gravity_degree=0", *settings)
        scenario = load_scenario("scheme-1", (*given, "initial.position_m=[2.5, 0.1, -0.2]")).value
        params, truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
        field, memory, on = dynamics_params.field(scenario), new(TRUTH_MEMORY), np.zeros(MAX_THRUSTERS, np.int64)
        on[0] = 1
        expected = np.zeros(3)
        for _ in range(50):
            out = np.empty(3)
            push_of_plumes(params, RADIUS, on.astype(float), truth, out)
            expected += DT * out
            kernels.step(params, field, memory, truth, on)
        found.append((truth, expected))
    (with_plume, pushes), (without, _) = found
    assert np.linalg.norm(pushes) > 1e-4
    np.testing.assert_allclose(without.v_CT_H - with_plume.v_CT_H, pushes, atol=2e-6)  # and Coriolis' acceleration
    np.testing.assert_allclose(with_plume.mean_force_C, without.mean_force_C, atol=1e-12)
    if motion == "nonlinear":
        gained = quat.to_matrix(with_plume.q_HI) @ (with_plume.v_T_I - without.v_T_I)
        np.testing.assert_allclose(gained, pushes, atol=2e-6)


def test_share_is_kept_for_the_times_of_exposure() -> None:
    plume, memory = dynamics_params.dss(load_scenario("scheme-1", PLUME).value).plume, new(PLUME_MEMORY)
    for k in range(100):
        keep_share(plume, memory, (k + 0.5) * DT, 0.01 * k)
    assert share_at(plume, memory, 40.3 * DT) == pytest.approx(0.40)
    assert share_at(plume, memory, 100.2 * DT) == pytest.approx(0.99)  # the step under way is like the last
    assert share_at(plume, memory, 102.5 * DT) == 0.0
    keep_share(plume, memory, 5000.5 * DT, 0.7)  # after a gap
    assert share_at(plume, memory, 5000.1 * DT) == pytest.approx(0.7)
    assert share_at(plume, memory, 4950.5 * DT) == 0.0
    assert share_at(plume, memory, 99.5 * DT) == 0.0


def frame_at(range_m: float) -> np.record:
    frame = new(VMU_FRAME)
    frame.t_v, frame.q_vt = [0.0, 0.0, range_m], [0.0, 0.0, 0.0, 1.0]
    frame.covariance[range(6), range(6)] = [1e-6] * 3 + [4e-8] * 3
    return frame


def test_dimmed_leds_have_noise_as_the_root_of_the_light_and_report_it() -> None:
    errors, angles = [], []
    for counter in range(4000):
        frame = frame_at(2.0)
        frame.counter = counter
        assert dim(0.75, 1e-6, 5, 8, frame)
        errors.append(frame.t_v - [0.0, 0.0, 2.0])
        angles.append(2.0 * frame.q_vt[:3])
    # a quarter of the light: twice the noise, of which three quarters of the variance are new
    np.testing.assert_allclose(np.var(errors, axis=0), 3e-6, rtol=0.1)
    np.testing.assert_allclose(np.var(angles, axis=0), 12e-8, rtol=0.1)
    np.testing.assert_allclose(np.diag(frame.covariance), [4e-6] * 3 + [16e-8] * 3, rtol=1e-12)


def test_leds_are_lost_when_too_dim_for_their_range() -> None:
    scenario = load_scenario("scheme-1").value
    least = least_light(scenario)
    assert DetectorSettings().least_snr == LEAST_SNR
    images = scenario.vmu.images
    flux = least * images.led_flux_1m_levels
    pixel = images.read_noise_levels**2 + images.background_levels / images.electrons_per_level
    sigma = math.sqrt(4.0 * math.pi * images.psf_sigma_px**2 * pixel + flux / images.electrons_per_level)
    assert flux / sigma == pytest.approx(LEAST_SNR)
    for range_m in (0.5, 5.0):
        lost = 1.0 - least * range_m**2
        assert dim(lost - 1e-6, least, 5, 8, frame_at(range_m))
        assert not dim(lost + 1e-6, least, 5, 8, frame_at(range_m))
    assert not dim(1.0, least, 5, 8, frame_at(0.4))


def test_plume_dims_the_frames_exposed_while_it_meets_the_target() -> None:
    settings = (*PLUME, "chaser.thrusters.errors.plume_dimming_fraction=0.8")
    plume, memory = dynamics_params.dss(load_scenario("scheme-1", settings).value).plume, new(PLUME_MEMORY)
    keep_share(plume, memory, 0.50, 0.5)
    keep_share(plume, memory, 0.52, 0.0)
    for t_s, factor in ((0.51, 1.0 / 0.6), (0.53, 1.0), (0.49, 1.0)):
        frame = frame_at(2.0)
        frame.t_s = 100.0 + t_s
        assert see_through_plume(plume, memory, 5, 100.0, frame)
        np.testing.assert_allclose(np.diag(frame.covariance)[:3], factor * 1e-6, rtol=1e-12)
        assert (frame.t_v[2] == 2.0) == (factor == 1.0)
