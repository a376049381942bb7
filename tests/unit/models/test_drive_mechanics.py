"""Mechanics of a driven axis: each effect against its closed form, and each switched off."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.tables.mechanics import RailMechanics
from hil.core.clock import WallClock
from hil.drivers.axes import MechanicalAxes, ServoAxes
from hil.errors import BadInput
from hil.models.drive_mechanics import friction_step, spring_force
from hil.parts.emulation.emulated_axes import EmulatedAxes
from hil.parts.emulation.shared_state import SharedAxisState

RAILS = load_rig("emulated-machine").value.rails
STEP_S = 0.002


def machine(**effects: float) -> MechanicalAxes:
    """Return rails with these effects only."""
    return MechanicalAxes(RAILS, RailMechanics(**effects))


def follow(axes: ServoAxes, path: Callable[[float], tuple[float, float]], duration_s: float) -> np.ndarray:
    """Let axis y follow ``path`` (position, rate); return load and encoder after each step, (n, 2)."""
    places = []
    for k in range(round(duration_s / STEP_S)):
        axes.setpoint[1], axes.feedforward[1] = path((k + 1) * STEP_S)
        axes.step(STEP_S)
        places.append((float(axes.position[1]), float(axes.counted[1])))
    return np.array(places)


def sine(t_s: float) -> tuple[float, float]:
    w = math.tau * 0.5
    return 0.01 * math.sin(w * t_s), 0.01 * w * math.cos(w * t_s)


def test_a_machine_without_effects_moves_like_the_ideal_servo() -> None:
    ideal, rigid = follow(ServoAxes(RAILS), sine, 4.0), follow(machine(), sine, 4.0)
    assert np.abs(rigid[:, 0] - ideal[:, 0]).max() < 5e-5  # steps of the integration differ
    assert (rigid[:, 0] == rigid[:, 1]).all()


def test_friction_at_constant_speed_is_that_of_the_stribeck_curve() -> None:
    coulomb, breakaway, stribeck, viscous, presliding = 0.1, 0.15, 0.001, 0.25, 1.5e-5
    for rate in (2e-4, 1e-3, 0.05):
        bristle, friction = 0.0, 0.0
        for _ in range(20000):
            bristle, friction = friction_step(
                bristle, rate, coulomb, breakaway, stribeck, viscous, presliding, 1.0, 1e-4
            )
        curve = coulomb + (breakaway - coulomb) * math.exp(-((rate / stribeck) ** 2)) + viscous * rate
        assert friction == pytest.approx(curve, rel=1e-6)


def test_an_axis_sticks_and_slips_at_creep_speed_only_if_breaking_away_takes_more_than_sliding() -> None:
    def steadiness(breakaway_n: float) -> float:
        axes = machine(
            friction_coulomb_n=40.0,
            friction_breakaway_n=breakaway_n,
            resonance_hz=5.0,
            load_ratio=9.0,
            damping_ratio=0.02,
        )
        load = follow(axes, lambda t: (2e-4 * t, 2e-4), 12.0)[2000:, 0]
        return float(np.std(np.diff(load)) / np.mean(np.diff(load)))

    assert steadiness(80.0) > 1.0  # at rest most of the time, then a jump
    assert steadiness(40.0) < 0.3


def test_backlash_is_a_hysteresis_that_the_encoder_does_not_show() -> None:
    places = follow(machine(backlash_m=5e-5), sine, 4.0)[1000:]
    hidden = places[:, 0] - places[:, 1]
    assert hidden.max() == pytest.approx(2.5e-5, rel=1e-6)
    assert hidden.min() == pytest.approx(-2.5e-5, rel=1e-6)
    assert spring_force(2e-5, 0.0, 5e-5, 100.0, 1.0) == 0.0  # within the gap
    assert spring_force(4e-5, -1.0, 5e-5, 100.0, 1.0) == 0.0  # a contact does not pull
    assert spring_force(4e-5, 0.0, 5e-5, 100.0, 1.0) == pytest.approx(1.5e-3)


def test_the_load_rings_at_the_frequency_of_the_two_masses() -> None:
    axes = machine(
        resonance_hz=10.0, load_ratio=1.0, damping_ratio=0.001, velocity_bandwidth_hz=0.01, force_reserve_fraction=1e-9
    )
    axes.kp[:] = 0.0  # a free motor
    axes.displace(1, 0.0, 0.0)
    axes.position[1] = 1e-4
    twist = np.subtract(*follow(axes, lambda _: (0.0, 0.0), 2.0).T)
    crossings = np.flatnonzero(np.diff(np.sign(twist)))
    frequency_hz = (len(crossings) - 1) / (2.0 * STEP_S * (crossings[-1] - crossings[0]))
    assert frequency_hz == pytest.approx(10.0 * math.sqrt(2.0), rel=0.02)  # motor and load have equal masses


def test_cogging_moves_the_axis_at_its_own_period() -> None:
    rate = 0.02

    def ripple(period_m: float) -> np.ndarray:
        axes = machine(cogging_n=20.0, cogging_period_m=period_m)
        return follow(axes, lambda t: (rate * t, rate), 4.1)[1025:, 0] - rate * STEP_S * np.arange(1026, 2051)

    found = ripple(0.004)
    spectrum = np.abs(np.fft.rfft((found - found.mean()) * np.hanning(len(found))))
    peak_hz = np.fft.rfftfreq(len(found), STEP_S)[int(np.argmax(spectrum[3:])) + 3]
    assert peak_hz == pytest.approx(rate / 0.004, abs=0.5)
    assert np.ptp(found) > 5.0 * np.ptp(
        follow(machine(), lambda t: (rate * t, rate), 4.1)[1025:, 0] - rate * STEP_S * np.arange(1026, 2051)
    )


def test_an_encoder_counts_whole_steps() -> None:
    places = follow(machine(encoder_step_m=1e-4), sine, 2.0)
    assert np.allclose(places[:, 1] / 1e-4, np.rint(places[:, 1] / 1e-4))
    assert np.abs(places[:, 0] - places[:, 1]).max() == pytest.approx(5e-5, rel=0.1)


def test_the_drive_acts_on_a_setpoint_after_its_delay() -> None:
    def arrival_s(delay_s: float) -> float:
        board = SharedAxisState.create()
        rails = load_rig("emulated-machine", (f"rig.rails.mechanics.loop_delay_s={delay_s}",)).value.rails

        class Stopped(WallClock):
            def now_s(self) -> float:
                return 0.0

        axes = EmulatedAxes("rails", rails, Stopped(), board)
        axes.follow(1, 0.001, 0.0, 0.0)
        t_s = 0.0
        while axes.position[1] < 1e-5:
            t_s += 0.002
            axes.advance(t_s)
        board.close()
        return t_s

    assert arrival_s(0.05) - arrival_s(0.0) == pytest.approx(0.05, abs=0.0041)


def test_disabled_mechanics_are_the_ideal_servo() -> None:
    assert RAILS.emulated_mechanics is not None
    assert load_rig("emulated").value.rails.emulated_mechanics is None
    assert load_rig("mock").value.rails.emulated_mechanics is None


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("backlash_m=-1e-6", "backlash_m"),
        ("resonance_hz=900.0", "resonance_hz"),
        ("friction_breakaway_n=1.0", "friction_breakaway_n 1: allowed from friction_coulomb_n"),
        ("presliding_m=1e-9", "presliding_m 1e-09: allowed from"),
        ("stiction=1.0", "stiction"),
    ],
)
def test_mechanics_out_of_range_are_refused_in_one_line(setting: str, text: str) -> None:
    with pytest.raises(BadInput) as raised:
        load_rig("emulated", (f"rig.rails.mechanics.{setting}",))
    assert len(raised.value.problems) == 1
    assert text in str(raised.value.problems[0])
