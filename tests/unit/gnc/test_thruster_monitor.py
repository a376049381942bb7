"""Thruster monitor: each thruster of the shipped layout, stuck open and dead, and a healthy chaser."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.config.scenario import Scenario
from hil.core.gnc_records import GncHealth
from hil.core.messages import IMU, MAX_THRUSTERS, NAVIGATION, new
from hil.gnc import thruster_monitor
from hil.gnc.thruster_monitor import DEAD, NO_FAULT, STUCK_OPEN, THRUSTER_MONITOR_STATE
from hil.params import gnc as gnc_params

STEP_S = 0.02
N = 16


class MonitoredChaser:
    """The IMU of a chaser with 3 % error in every thrust, which pulses its thrusters at random."""

    def __init__(self, params: np.record, rng: np.random.Generator) -> None:
        self.params, self.state, self.health = params, new(THRUSTER_MONITOR_STATE), 0
        self.mass, self.inertia, self.delay, self.arm = 1.0, 1.0, 0, np.zeros(3)  # delay: cycles, arm: m
        self._given: list[np.ndarray] = []
        self.bias_sigma = np.full(3, 1e-5)
        self._rng = rng
        self._unit = np.repeat([params.force_unit, params.torque_unit], 3)
        self._scale = 1.0 + 0.03 * rng.uniform(-1.0, 1.0, N)
        self._rate = np.zeros(3)
        self._on = np.zeros(MAX_THRUSTERS, np.int64)
        self.samples = np.zeros(1, IMU).view(np.recarray)

    def cycle(self, forced: dict[int, float], wanted: int | None = None) -> None:
        """Run a cycle. forced: thrust of failed thrusters, whatever is commanded. wanted: thruster that is needed."""
        if wanted is not None:
            self._on[:] = 0
            self._on[wanted] = self.state.withheld_cycles == 0 or self.state.withheld != wanted
        self._given.append(self._on[:N] * self._scale)
        thrust = self._given[max(0, len(self._given) - 1 - self.delay)].copy()
        for j, value in forced.items():
            thrust[j] = value
        acceleration = (thrust @ self.params.signature[:N]) * self._unit
        acceleration /= np.repeat([self.mass, self.inertia], 3)
        self._rate += STEP_S * acceleration[3:]
        force = acceleration[:3] + np.cross(acceleration[3:], self.arm)
        self.samples[0].force_C = force + 2e-4 * self._rng.standard_normal(3)
        self.samples[0].rate_C = self._rate - 0.5 * STEP_S * acceleration[3:] + 1e-8 * self._rng.standard_normal(3)
        self.watch()
        if wanted is None and self._rng.uniform() < 0.2:
            self._on[:N] = self._rng.uniform(size=N) < 0.25

    def watch(self) -> None:
        out = new(NAVIGATION)
        bias = np.concatenate([np.zeros(3), self.bias_sigma])
        thruster_monitor.watch(self.params, self.state, self.samples, self._on, bias, False, out)
        self.health = int(out.health)


@pytest.fixture
def chaser(scheme_1: Scenario, rng: np.random.Generator) -> MonitoredChaser:
    """Return a healthy chaser after 2 s."""
    made = MonitoredChaser(gnc_params.thruster_monitor(scheme_1), rng)
    for _ in range(100):
        made.cycle({})
    return made


def test_healthy_chaser_is_healthy(chaser: MonitoredChaser) -> None:
    for _ in range(5000):
        chaser.cycle({})
        assert chaser.health == 0


GYRO_DEGPS, ACCELEROMETER_MPS2 = 1e-3, 2e-3
QUANTA = (f"gnc.akf.gyro_quantum_degps={GYRO_DEGPS}", f"gnc.pkf.accelerometer_quantum_mps2={ACCELEROMETER_MPS2}")


class CoarseChaser(MonitoredChaser):
    """A chaser whose IMU reads whole quanta; the remainder comes with the next readings."""

    remainder = np.zeros(6)

    def watch(self) -> None:
        sample, quantum = self.samples[0], np.repeat([ACCELEROMETER_MPS2, math.radians(GYRO_DEGPS)], 3)
        exact = np.concatenate([sample.force_C, sample.rate_C]) + self.remainder
        read = quantum * np.floor(exact / quantum + 0.5)
        self.remainder = exact - read
        sample.force_C, sample.rate_C = read[:3], read[3:]
        super().watch()


@pytest.mark.parametrize("told", [True, False])
def test_readings_of_a_coarse_imu_repeat_and_are_sound_with_its_resolution(
    rng: np.random.Generator, told: bool
) -> None:
    scenario = load_scenario("scheme-1", QUANTA if told else ()).value
    chaser = CoarseChaser(gnc_params.thruster_monitor(scenario), rng)
    for cycle in range(3000):
        if cycle % 200 < 100:
            chaser._on[:] = 0
        chaser.cycle({})
    assert (chaser.state.imu_revoked + chaser.state.imu_suspect == 0) == told
    assert not told or chaser.health == 0


@pytest.mark.parametrize("sensor", ["force_C", "rate_C"])
def test_coarse_imu_that_is_stuck_is_suspect_once_thrusters_should_change_it(
    rng: np.random.Generator, sensor: str
) -> None:
    chaser = CoarseChaser(gnc_params.thruster_monitor(load_scenario("scheme-1", QUANTA).value), rng)
    for _ in range(300):
        chaser.cycle({})
    stuck = chaser.samples[0][sensor].copy()
    watch = thruster_monitor.watch
    for _ in range(400):
        chaser.cycle({})
        chaser.samples[0][sensor] = stuck
        out = new(NAVIGATION)
        bias = np.concatenate([np.zeros(3), chaser.bias_sigma])
        watch(chaser.params, chaser.state, chaser.samples, chaser._on, bias, False, out)
    assert chaser.state.imu_suspect == 1


def test_bias_of_the_accelerometer_that_is_not_known_yet_is_no_fault(chaser: MonitoredChaser) -> None:
    chaser.bias_sigma[:] = 5e-4
    for _ in range(200):
        chaser.samples[0].force_C = np.array([1.9e-3, -1.9e-3, 1.9e-3]) + 1e-6 * chaser.state.calls
        chaser.samples[0].rate_C += 1e-9
        chaser._on[:] = 0
        chaser.watch()
    assert chaser.health == 0


@pytest.mark.parametrize("given", [3.0, 2.25, 1.0, 0.5])  # cycles: a valve that stays open, a tail, a slow rise
def test_impulse_of_the_shortest_firing_is_measured(chaser: MonitoredChaser, given: float) -> None:
    pair = [0, 4]  # both along +x: a force; 0 and 5 turn about z
    for turn in ([0, 5], pair):
        for _ in range(20):
            for cycle in range(40):
                chaser._on[:] = 0
                chaser._on[turn] = cycle == 20
                left = min(1.0, max(0.0, given - (cycle - 20))) if cycle >= 20 else 0.0
                chaser.cycle(dict.fromkeys(turn, left), wanted=None)
        assert chaser.state.pulse_s == pytest.approx(given * STEP_S, rel=0.05)


def test_shortest_firing_of_a_chaser_that_accelerates_all_the_time_is_measured(chaser: MonitoredChaser) -> None:
    push, turn, given = [0, 4], [8, 13], 3.0  # along x, about y
    for cycle in range(1000):
        chaser._on[:] = 0
        thrust = {}
        for pair, every, first in ((push, 8, 0), (turn, 25, 3)):
            age = (cycle - first) % every
            chaser._on[pair] = age == 0
            thrust |= dict.fromkeys(pair, 1.0 if age < given else 0.0)
        chaser.state.busy = 1
        chaser.cycle(thrust, wanted=None)
    assert chaser.state.firings == 0
    found = thruster_monitor.shortest_firing(chaser.params, chaser.state, True)
    np.testing.assert_allclose(found, [given * STEP_S, (given - 1.0) * STEP_S], rtol=0.05)
    assert thruster_monitor.shortest_firing(chaser.params, chaser.state, False)[0] < 2.0 * STEP_S


@pytest.mark.parametrize("thruster", range(N))
def test_thruster_stuck_open_is_found_within_a_second(chaser: MonitoredChaser, thruster: int) -> None:
    for _ in range(50):
        chaser.cycle({thruster: 1.0})
    assert (chaser.state.fault, chaser.state.thruster) == (STUCK_OPEN, thruster)
    assert chaser.health == GncHealth.THRUSTER_FAULT


@pytest.mark.parametrize("thruster", range(N))
def test_dead_thruster_is_found_when_it_is_used(chaser: MonitoredChaser, thruster: int) -> None:
    for _ in range(400):
        chaser.cycle({thruster: 0.0})
    assert (chaser.state.fault, chaser.state.thruster) == (DEAD, thruster)
    assert chaser.health == GncHealth.THRUSTER_FAULT


@pytest.mark.parametrize("thruster", range(N))
def test_dead_thruster_whose_command_lasts_is_found(chaser: MonitoredChaser, thruster: int) -> None:
    for _ in range(50):
        chaser.cycle({thruster: 0.0}, wanted=thruster)
    assert (chaser.state.fault, chaser.state.thruster) == (DEAD, thruster)


def test_thruster_stuck_open_is_distinguished_from_a_dead_opposite_one_under_a_lasting_command(
    chaser: MonitoredChaser,
) -> None:
    # at the same place, in opposite directions: together they give nothing
    for _ in range(50):
        chaser.cycle({5: 1.0}, wanted=4)
    assert (chaser.state.fault, chaser.state.thruster) == (STUCK_OPEN, 5)


def test_no_command_is_withheld_from_a_healthy_chaser(chaser: MonitoredChaser) -> None:
    for _ in range(2000):
        chaser.cycle({})
        assert chaser.state.withheld_cycles == 0


@pytest.mark.parametrize("sensor", ["rate_C", "force_C"])
def test_readings_that_repeat_are_suspect(chaser: MonitoredChaser, sensor: str) -> None:
    last = chaser.samples[0][sensor].copy()
    for _ in range(12):
        chaser.samples[0].rate_C += 1e-8
        chaser.samples[0].force_C += 1e-6
        chaser.samples[0][sensor] = last
        chaser.watch()
    assert chaser.health & GncHealth.IMU_SUSPECT


def test_jump_of_the_gyro_beyond_all_thrusters_is_suspect_at_once(chaser: MonitoredChaser) -> None:
    chaser._rate += np.array([0.0, np.radians(0.1), 0.0])
    chaser.cycle({})
    assert chaser.health == GncHealth.IMU_SUSPECT


def test_chaser_that_swings_has_an_unknown_cause(chaser: MonitoredChaser) -> None:
    bits = 0
    for cycle in range(1500):
        chaser._on[:] = 0
        size = min(1.0, cycle / 600) * math.sin(2.0 * math.pi * 0.1 * STEP_S * cycle)
        chaser.samples[0].force_C = size * np.array([0.006, 0.001, 0.0])
        chaser.samples[0].force_C += 1e-5 * chaser._rng.standard_normal(3)
        chaser.samples[0].rate_C += 1e-9
        chaser.watch()
        bits |= chaser.health
    assert bits == GncHealth.CAUSE_UNKNOWN


def test_jump_of_the_rate_alone_is_passed_on_as_one_of_the_gyros(chaser: MonitoredChaser) -> None:
    for _ in range(100):
        chaser._on[:] = 0
        chaser.cycle({}, wanted=None)
        chaser._on[:] = 0
    chaser._rate += np.array([0.0, np.radians(0.004), 0.0])
    chaser.cycle({})
    assert chaser.state.jump == pytest.approx(np.radians(0.004), rel=0.05)
    assert chaser.health == 0


def test_acceleration_that_no_thruster_explains_is_suspect_after_a_second(
    chaser: MonitoredChaser, scheme_1: Scenario
) -> None:
    for cycle in range(60):
        chaser.samples[0].force_C = np.array([0.006, 0.001, 0.0]) + 1e-6 * cycle
        chaser.samples[0].rate_C += 1e-9
        chaser._on[:] = 0
        chaser.watch()
    assert chaser.health == GncHealth.IMU_SUSPECT
    assert chaser.state.fault == NO_FAULT


def changed(chaser: MonitoredChaser, **fields: object) -> MonitoredChaser:
    """Return the healthy ``chaser`` with these properties, as of a run's start."""
    chaser.state = new(THRUSTER_MONITOR_STATE)
    for name, value in fields.items():
        setattr(chaser, name, value)
    return chaser


def cycles_until(chaser: MonitoredChaser, acquitted: Callable[[], bool]) -> int:
    """Return after how many healthy cycles the ``chaser`` is ``acquitted``, which it then stays for 10 s."""
    cycles = 0
    while not acquitted() and cycles < 200:
        chaser.cycle({})
        cycles += 1
    assert cycles < 200
    for _ in range(500):
        chaser.cycle({})
        assert chaser.health == 0
    return cycles


@pytest.mark.parametrize(
    "fields",
    [
        {"mass": 1.2, "inertia": 1.2},
        {"mass": 1.0 / 0.7, "inertia": 1.0 / 0.7},  # thrust x 0.7
        {"mass": 1.0 / 1.3, "inertia": 1.0 / 1.3},  # thrust x 1.3
        {"inertia": 1.5},
        {"delay": 6},
        {"arm": np.array([0.3, 0.0, 0.0])},
        {"arm": np.array([0.0, -0.3, 0.0])},
        {"arm": np.array([0.0, 0.0, 0.3])},
    ],
    ids=["mass", "less thrust", "more thrust", "inertia", "late valves", "arm x", "arm y", "arm z"],
)
def test_parameter_that_is_wrong_accuses_nothing(chaser: MonitoredChaser, fields: dict[str, object]) -> None:
    changed(chaser, **fields)
    for _ in range(3000):
        chaser.cycle({})
        assert chaser.health == 0


def test_lever_arm_of_the_accelerometers_is_estimated(chaser: MonitoredChaser) -> None:
    changed(chaser, arm=np.array([0.2, -0.15, 0.1]))
    for _ in range(1500):
        chaser.cycle({})
    np.testing.assert_allclose(chaser.state.arm, [0.2, -0.15, 0.1], atol=0.05)


@pytest.mark.parametrize(("value", "fault"), [(0.0, DEAD), (1.0, STUCK_OPEN)])
def test_failed_thruster_is_found_although_the_valves_are_late(
    chaser: MonitoredChaser, value: float, fault: int
) -> None:
    changed(chaser, delay=3)
    for _ in range(500):
        chaser.cycle({})
    assert (chaser.health, chaser.state.delay) == (0, 3)
    for _ in range(400):
        chaser.cycle({7: value})
        if chaser.health:
            break
    assert chaser.health == GncHealth.THRUSTER_FAULT
    assert (chaser.state.fault, chaser.state.thruster) == (fault, 7)


def test_imu_that_repeats_for_a_moment_is_accused_and_acquitted_after_a_second(chaser: MonitoredChaser) -> None:
    last = chaser.samples[0].copy()
    for _ in range(15):
        chaser.samples[0] = last
        chaser.watch()
    assert chaser.health == GncHealth.IMU_SUSPECT
    assert 0.8 <= cycles_until(chaser, lambda: chaser.health == 0) * STEP_S <= 1.6
    assert chaser.state.imu_revoked == 1


def test_thruster_that_is_accused_without_a_fault_is_acquitted(chaser: MonitoredChaser) -> None:
    chaser.state.fault, chaser.state.thruster = STUCK_OPEN, 7
    cycles_until(chaser, lambda: chaser.state.fault == NO_FAULT)
    assert chaser.state.thruster_revoked == 1


def test_thruster_that_is_accused_for_another_is_acquitted_and_the_other_one_found(chaser: MonitoredChaser) -> None:
    chaser.state.fault, chaser.state.thruster = DEAD, 7
    for _ in range(400):
        chaser.cycle({2: 1.0})
    assert (chaser.state.fault, chaser.state.thruster, chaser.state.thruster_revoked) == (STUCK_OPEN, 2, 1)


@pytest.mark.parametrize(("value", "fault"), [(0.0, DEAD), (1.0, STUCK_OPEN)])
def test_thruster_that_has_failed_stays_accused(chaser: MonitoredChaser, value: float, fault: int) -> None:
    chaser.state.fault, chaser.state.thruster = fault, 7
    for _ in range(1500):
        chaser.cycle({7: value})
    assert (chaser.state.fault, chaser.state.thruster, chaser.state.thruster_revoked) == (fault, 7, 0)
