"""Phase-plane control: signs, dead band, burn length, convergence."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import COMMAND, NAVIGATION, REFERENCE, new
from hil.gnc import control as control_module
from hil.gnc.control import FEED_FORWARD, burn_cycles, burn_time, control, dead_band, firing_time, lead_time
from hil.params import gnc as gnc_params

IDENTITY = [0.0, 0.0, 0.0, 1.0]
A, NOISE, COAST, LEAD, DT = 0.02, 0.002, 0.0005, 8.0, 0.02
PULSE = A * DT  # change of rate by the shortest firing


@pytest.fixture
def params(scheme_1: Scenario) -> np.record:
    """Return the shipped parameters."""
    return gnc_params.control(scheme_1, gnc_params.allocation(scheme_1.chaser)[1])


def seen(r: tuple[float, ...] = (0, 0, 0), q: list[float] | np.ndarray = IDENTITY) -> np.record:
    """Return a valid navigation at ``r`` and ``q``, at rest."""
    navigation = new(NAVIGATION)
    navigation.valid, navigation.r_CT_H, navigation.q_CH = 1, r, q
    return navigation


def held() -> np.record:
    """Return the reference at the origin, aligned."""
    reference = new(REFERENCE)
    reference.q_CH = IDENTITY
    return reference


def demanded(params: np.record, navigation: np.record) -> np.record:
    command = new(COMMAND)
    control(params, navigation, held(), new(FEED_FORWARD), command)
    return command


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_displaced_chaser_is_pushed_back(params: np.record, axis: int, sign: int) -> None:
    r = np.zeros(3)
    r[axis] = 0.5 * sign
    command = demanded(params, seen(tuple(r)))
    np.testing.assert_array_equal(command.force, -sign * np.eye(3, dtype=int)[axis])
    np.testing.assert_array_equal(command.torque, 0)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_turned_chaser_is_turned_back(params: np.record, axis: int, sign: int) -> None:
    turn = 0.05 * sign * np.eye(3)[axis]
    command = demanded(params, seen(q=Rotation.from_rotvec(turn).as_quat()))
    np.testing.assert_array_equal(command.torque, -sign * np.eye(3, dtype=int)[axis])
    np.testing.assert_array_equal(command.force, 0)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("sign", [-1, 1])
def test_motion_is_braked(params: np.record, axis: int, sign: int) -> None:
    navigation = seen()
    navigation.v_CT_H[axis], navigation.w_CH_C[axis] = 0.05 * sign, 0.01 * sign
    command = demanded(params, navigation)
    np.testing.assert_array_equal(command.force, -sign * np.eye(3, dtype=int)[axis])
    np.testing.assert_array_equal(command.torque, -sign * np.eye(3, dtype=int)[axis])


def test_demand_is_along_body_axes(params: np.record) -> None:
    # yawed by +90 deg, the body's -y axis points along x_H
    command = demanded(params, seen((0.5, 0.0, 0.0), Rotation.from_rotvec([0.0, 0.0, math.pi / 2]).as_quat()))
    np.testing.assert_array_equal(command.force, [0, 1, 0])


def test_both_signs_of_a_quaternion_demand_the_same(params: np.record) -> None:
    q = Rotation.from_rotvec([0.02, -0.03, 0.04]).as_quat()
    np.testing.assert_array_equal(demanded(params, seen(q=q)).torque, demanded(params, seen(q=-q)).torque)


def coast_of(params: np.record, axis: int) -> float:
    """Return the amplitude of the limit cycle of an axis."""
    return float(control_module.coast_of(params, axis, params.acceleration[axis] * params.pulse_s))


def test_nothing_fires_inside_the_dead_band(params: np.record) -> None:
    inside = 0.9 * coast_of(params, 0)
    command = demanded(params, seen((inside, -inside, inside), [0.4 * coast_of(params, 3), 0.0, 0.0, 1.0]))
    np.testing.assert_array_equal([*command.force, *command.torque], 0)


def test_nothing_fires_without_valid_navigation(params: np.record) -> None:
    command = demanded(params, seen((1.0, 1.0, 1.0)))
    assert command.force.all()
    navigation = seen((1.0, 1.0, 1.0))
    navigation.valid = 0
    control(params, navigation, held(), new(FEED_FORWARD), command)
    for name in ("force", "torque", "cycles_left", "until_decision"):
        np.testing.assert_array_equal(command[name], 0)


def edge(pulse_s: float = DT) -> float:
    return float(dead_band(LEAD, NOISE, COAST, A * pulse_s))


def burn(error: float, rate: float) -> float:
    return float(burn_time(error, rate, A, LEAD, edge(), DT))


def test_burn_takes_s_a_smallest_firing_inside_the_dead_band() -> None:
    time = burn(0.02, 0.0)
    assert time < 0.0
    assert 0.02 + LEAD * A * time == pytest.approx(edge() - LEAD * PULSE)
    assert burn(-0.02, 0.0) == -time


@pytest.mark.parametrize("pulse_s", [0.02, 0.06, 0.2])
def test_no_pulse_from_one_edge_of_the_dead_band_reaches_the_other(pulse_s: float) -> None:
    band = edge(pulse_s)
    assert burn_time(0.999 * band, 0.0, A, LEAD, band, pulse_s) == 0.0
    time = burn_time(1.001 * band, 0.0, A, LEAD, band, pulse_s)
    assert time == pytest.approx(-pulse_s, rel=0.02)
    assert abs(1.001 * band + LEAD * A * time) < band


def test_switching_line_is_the_braking_parabola_plus_the_lead() -> None:
    for rate in (0.05, 0.2):
        on_line = -LEAD * rate - rate * rate / (2.0 * A)
        assert burn(on_line, rate) == 0.0
        assert burn(on_line + 1.1 * edge(), rate) < 0.0
        assert burn(on_line - 1.1 * edge(), rate) > 0.0
        assert burn(-on_line, -rate) == 0.0


@pytest.mark.parametrize(
    ("time", "least", "extra", "cycles", "given"),
    [
        (0.07, 0.02, 0.0, 3, 0.06),  # rounded down
        (0.001, 0.02, 0.0, 1, 0.02),  # at least one
        (9.0, 0.02, 0.0, 50, 1.0),  # at most the period
        (0.05, 0.06, 0.0, 1, 0.06),  # a valve that opens longer needs no longer command
        (0.09, 0.06, 0.0, 4, 0.08),
        (0.07, 0.02, 0.025, 2, 0.065),  # a tail gives its part in each firing
        (0.02, 0.02, -0.01, 1, 0.01),  # and a slow rise takes it
    ],
)
def test_command_is_for_what_the_valve_gives(
    time: float, least: float, extra: float, cycles: int, given: float
) -> None:
    for sign in (-1, 1):
        assert burn_cycles(sign * time, least, extra, 50, DT) == sign * cycles
        assert firing_time(sign * cycles, least, extra, DT) == pytest.approx(sign * given)


def test_lead_shares_the_noise_between_error_and_rate(params: np.record) -> None:
    """The ratio of the standard deviations, at most what a pulse allows, and between two bounds."""
    low, high = params.lead_bounds[0]
    assert low < 2.0 < high
    assert lead_time(params, 0, 0.002, 0.001, 1e-5) == pytest.approx(2.0)
    assert lead_time(params, 0, 0.002, 1e-6, 1e-5) == high
    assert lead_time(params, 0, 1e-4, 1e-6, 1e-4) == pytest.approx(2.0 * params.deadband_sigmas[0])
    assert lead_time(params, 0, 1e-9, 1e-6, 1e-4) == low
    assert lead_time(params, 0, 0.0, 0.0, 1e-4) == low
    assert lead_time(params, 0, np.nan, 1e-6, 1e-4) == pytest.approx(math.sqrt(low * high))
    params.lead[0] = 7.0
    assert lead_time(params, 0, 0.002, 0.001, 1e-5) == 7.0


def test_valves_of_60_ms_have_a_limit_cycle_of_single_pulses(params: np.record) -> None:
    """An axis without noise crosses its dead band from edge to edge, one pulse each way, with the coast's amplitude."""
    params.pulse_s = 0.06
    pulse = params.acceleration[3] * params.pulse_s
    command, turn, rate, open_cycles, fired = new(COMMAND), 0.0, 0.3 * pulse, 0, 0
    found = []
    for k in range(40_000):
        navigation = seen(q=Rotation.from_rotvec([turn, 0.0, 0.0]).as_quat())
        navigation.w_CH_C = [rate, 0.0, 0.0]
        control(params, navigation, held(), new(FEED_FORWARD), command)
        demand = int(command.torque[0])
        if demand != 0 and open_cycles == 0:
            open_cycles, sign = 3, demand
            fired += k >= 20_000
        if open_cycles > 0:
            rate += sign * params.acceleration[3] * params.dt_s
            open_cycles -= 1
        turn += rate * params.dt_s
        if k >= 20_000:
            found.append(turn)
    coast = coast_of(params, 3)
    lead = params.lead_bounds[3, 0]
    assert np.abs(found).max() < coast + lead * pulse
    # a pulse each way in 8 coasts / pulse at the mean rate of half a pulse
    assert fired * pulse / 400.0 <= 1.1 * pulse**2 / (4.0 * coast)


def test_axis_holds_its_decision_for_a_period(params: np.record) -> None:
    params.period[:3] = 10
    command, demands = new(COMMAND), []
    params.lead[:3] = 5.0
    error = coast_of(params, 1) + 3.1 * 5.0 * params.acceleration[1] * params.dt_s  # three cycles of thrust
    for k in range(20):
        # the moved chaser is not looked at until the period is over
        control(params, seen((0.0, error if k == 0 or k >= 10 else -0.5, 0.0)), held(), new(FEED_FORWARD), command)
        demands.append(int(command.force[1]))
    assert demands == [-1, -1, -1, 0, 0, 0, 0, 0, 0, 0] * 2


@pytest.mark.parametrize(("period", "start"), [(1, 0.5), (1, 0.05), (25, 0.5)])
def test_double_integrator_comes_to_rest_with_at_most_one_overshoot(
    params: np.record, period: int, start: float
) -> None:
    params.period[:3] = period
    params.lead[:3] = 5.0
    params.correction_rate[:3] = 0.05  # half a metre is worked off within the 80 s
    command, position, velocity, track = new(COMMAND), start, 0.0, []
    for _ in range(6000):
        navigation = seen((position, 0.0, 0.0))
        navigation.v_CT_H = [velocity, 0.0, 0.0]
        control(params, navigation, held(), new(FEED_FORWARD), command)
        velocity += command.force[0] * params.acceleration[0] * params.dt_s
        position += velocity * params.dt_s
        track.append(position)
    found = np.array(track)
    band = 1.5 * coast_of(params, 0) + params.acceleration[0] * params.dt_s * params.lead[0]
    assert np.abs(found[4000:]).max() <= band
    outside = np.sign(found[np.abs(found) > band])
    assert np.count_nonzero(np.diff(outside)) <= 1


def test_attitude_converges_in_about_ten_seconds(params: np.record) -> None:
    """Bench paper, discussion of Fig. 6: scheme 1 starts at 3 deg and has converged at about 10 s."""
    command, turn, rate = new(COMMAND), math.radians(3.0), 0.0
    for _ in range(round(12.0 / params.dt_s)):
        navigation = seen(q=Rotation.from_rotvec([turn, 0.0, 0.0]).as_quat())
        navigation.w_CH_C = [rate, 0.0, 0.0]
        control(params, navigation, held(), new(FEED_FORWARD), command)
        rate += command.torque[0] * params.acceleration[3] * params.dt_s
        turn += rate * params.dt_s
    assert abs(math.degrees(turn)) < 0.1


def test_dead_band_is_widened_by_the_uncertainty_of_navigation(params: np.record) -> None:
    params.lead[:3] = 5.0
    error = 5.0 * coast_of(params, 0)
    navigation = seen((error, 0.0, 0.0))
    assert demanded(params, navigation).force[0] == -1
    navigation.sigma_v_mps[0] = error / (params.deadband_sigmas[0] * params.lead[0])
    assert demanded(params, navigation).force[0] == 0
    navigation.sigma_v_mps[0] = np.nan  # not known: no widening
    assert demanded(params, navigation).force[0] == -1


def test_brake_of_an_abort_has_no_dead_band_margin(params: np.record) -> None:
    navigation, command, reference = seen((0.02, 0.0, 0.0)), new(COMMAND), held()
    navigation.sigma_r_m[0] = 1.0
    control(params, navigation, reference, new(FEED_FORWARD), command)
    assert command.force[0] == 0
    reference.boost = 1
    control(params, navigation, reference, new(FEED_FORWARD), command)
    assert command.force[0] == -1
    assert command.boost == 1


def test_slew_is_no_faster_than_its_rate(params: np.record) -> None:
    command, turn, rate, fastest = new(COMMAND), math.radians(20.0), 0.0, 0.0
    for _ in range(round(30.0 / params.dt_s)):
        navigation = seen(q=Rotation.from_rotvec([0.0, turn, 0.0]).as_quat())
        navigation.w_CH_C = [0.0, rate, 0.0]
        control(params, navigation, held(), new(FEED_FORWARD), command)
        rate += command.torque[1] * params.acceleration[4] * params.dt_s
        turn += rate * params.dt_s
        fastest = max(fastest, abs(rate))
    pulse = params.acceleration[4] * params.dt_s
    assert fastest <= params.correction_rate[4] + pulse


@pytest.mark.parametrize("sigma_m", [1.0, 0.0])  # feedback sees nothing; feedback sees all and finds nothing to do
def test_reference_is_followed_by_feed_forward_alone(params: np.record, sigma_m: float) -> None:
    """A perfect estimate under a constant reference acceleration: thrust makes the same change of rate, to a pulse."""
    command, reference, fired = new(COMMAND), held(), 0
    position = velocity = 0.0
    reference.a_CT_H[0] = 0.0045  # four and a half pulses a period: some delta-v is always pending
    cycles = 70 * int(params.period[0])
    for k in range(cycles):
        t = k * params.dt_s
        reference.r_CT_H[0], reference.v_CT_H[0] = 0.5 * 0.0045 * t * t, 0.0045 * t
        navigation = seen((position, 0.0, 0.0))
        navigation.v_CT_H[0] = velocity
        navigation.sigma_r_m[0] = sigma_m
        control(params, navigation, reference, new(FEED_FORWARD), command)
        change = command.force[0] * params.acceleration[0] * params.dt_s
        position += (velocity + 0.5 * change) * params.dt_s
        velocity += change
        fired += abs(int(command.force[0]))
        assert command.force[0] >= 0
    wanted = 0.0045 * cycles * params.dt_s
    assert fired * params.acceleration[0] * params.dt_s == pytest.approx(
        wanted, abs=2.0 * params.acceleration[0] * params.dt_s
    )
    # fired ahead by up to a period: half of 0.2 s at the speed's growth, and the last step
    assert abs(position - reference.r_CT_H[0]) < 0.005


def test_feedback_leaves_the_pending_delta_v_to_feed_forward(params: np.record) -> None:
    command, navigation = new(COMMAND), seen()
    pulse = params.acceleration[0] * params.dt_s
    params.lead[:3] = 20.0
    command.owed[0] = 0.45 * pulse  # asked for, too little for a pulse so far
    navigation.v_CT_H[0] = -0.45 * pulse
    navigation.r_CT_H[0] = -0.6 * 20.0 * pulse  # with the rate it would be outside the dead band
    assert demanded(params, navigation).force[0] == 1
    navigation.r_CT_H[0] = -0.4 * 20.0 * pulse
    control(params, navigation, held(), new(FEED_FORWARD), command)
    assert command.force[0] == 0


STRONG = 0.04  # rad/s^2 about x: 0.046 deg/s in a cycle, 0.14 deg/s in three


class SteadyAxis:
    """Rotation about x that rotating axes accelerate all the time, with thrusters whose smallest firing is large."""

    def __init__(self, scenario: Scenario, sustained: float, cycles: int) -> None:
        self.params = gnc_params.control(scenario, gnc_params.allocation(scenario.chaser)[1])
        self.params.acceleration[3:] = STRONG
        self.navigation, self.feed, self.command = seen(), new(FEED_FORWARD), new(COMMAND)
        self.navigation.sigma_attitude_rad = 1e-4
        self.feed.acceleration[3], self.feed.rotates = sustained, 1
        self.feed.pulse_s, self.feed.extra_s = cycles * DT, (cycles - 1) * DT
        self.least, self.sustained = cycles, sustained
        self.angle, self.rate, self.open = 0.0, 0.0, 0.0

    def fly(self, seconds: float) -> tuple[np.ndarray, np.ndarray, list[int]]:
        """Return angles, rates and demands; a valve stays open for ``least`` cycles."""
        angles, rates, demands, left = [], [], [], 0
        for _ in range(round(seconds / DT)):
            self.navigation.q_CH = Rotation.from_rotvec([self.angle, 0.0, 0.0]).as_quat()
            self.navigation.w_CH_C[0] = self.rate
            control(self.params, self.navigation, held(), self.feed, self.command)
            demand = int(self.command.torque[0])
            demands.append(demand)
            if demand != 0:
                self.open, left = float(demand), max(left, self.least) if left == 0 else left
            self.rate += DT * (STRONG * (self.open if left > 0 else 0.0) - self.sustained)
            left = max(0, left - 1)
            self.angle += DT * self.rate
            angles.append(self.angle)
            rates.append(self.rate)
        return np.degrees(angles), np.degrees(rates), demands


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_sustained_acceleration_is_fired_in_pulses_of_its_own_sign_that_also_correct(
    scheme_1: Scenario, sign: float
) -> None:
    axis = SteadyAxis(scheme_1, sign * math.radians(0.02), 2)
    axis.angle = math.radians(0.15)
    pulse = math.degrees(2.0 * STRONG * DT)
    axis.fly(60.0)
    angles, rates, demands = axis.fly(120.0)
    assert {*demands} == {0, round(sign)}
    assert np.abs(rates).max() < 0.75 * pulse  # half of it, and what corrections add
    assert np.abs(angles).max() < 0.2


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_sustained_acceleration_is_fired_against_by_single_smallest_firings(scheme_1: Scenario, sign: float) -> None:
    axis = SteadyAxis(scheme_1, sign * math.radians(0.02), 1)
    axis.rate = sign * math.radians(0.15)
    _, rates, demands = axis.fly(3.0)
    fired = np.flatnonzero(demands)
    assert np.diff(fired).min() > 1
    assert abs(rates[-1]) < 0.05


def test_large_smallest_firing_waits_until_the_rate_has_grown_against_it(scheme_1: Scenario) -> None:
    axis = SteadyAxis(scheme_1, 0.0, 2)
    pulse = math.degrees(2.0 * STRONG * DT)
    limit = 0.1
    assert 0.7 * limit < pulse < limit
    axis.angle, axis.rate = math.radians(0.3), math.radians(0.003)
    angles, rates, demands = axis.fly(40.0)
    first = demands.index(-1)
    assert not any(demands[:first])
    assert angles[first] == pytest.approx(0.75 * 0.5, abs=0.002)  # of the tolerance, where docking is no go
    assert np.abs(rates).max() < limit


def test_error_beyond_a_wide_dead_band_is_worked_off_whatever_is_pending() -> None:
    """Firings of 4 mm/s have a dead band in which the correction rate alone would never fire."""
    heavy = (
        "chaser.mass_kg=20000.0", "chaser.inertia_kg_m2=[[8e4,0.0,0.0],[0.0,1e5,0.0],[0.0,0.0,9.5e4]]",
        "chaser.thrusters.force_n=400.0", "chaser.thrusters.minimum_on_s=0.1",
    )  # fmt: skip
    scenario = load_scenario("scheme-1", heavy).value
    params = gnc_params.control(scenario, gnc_params.allocation(scenario.chaser)[1])
    command, feed = new(COMMAND), new(FEED_FORWARD)
    feed.pulse_s = params.pulse_s
    command.owed[1] = 0.49 * params.acceleration[1] * params.pulse_s
    args = (1, -0.06, -0.0007, 0.001, 0.0001, 0.0, 0.0, params.acceleration[1], command)
    control_module.update_axis(params, feed, *args)
    assert command.force[1] == 1


def test_held_error_is_that_of_a_coast_or_of_the_dead_band(scheme_1: Scenario) -> None:
    params = gnc_params.control(scheme_1, gnc_params.allocation(scheme_1.chaser)[1])
    params.drift[1], params.go_s, pulse = 0.0, 30.0, 2e-4
    coasts = control_module.held_error(params, 1, 1e-3, 1e-5, 1e-3, 1e-4, 0.0, pulse)
    assert coasts == pytest.approx(1e-3 + 30.0 * 1e-5)
    _, _, _, band = control_module.rule_of(params, 1, 1e-3, 1e-4, pulse)
    fires = control_module.held_error(params, 1, 1e-3, 1e-3, 1e-3, 1e-4, 0.0, pulse)
    assert fires == pytest.approx(band + pulse * params.period[1] * params.dt_s)
