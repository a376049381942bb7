"""The mechanics behind the emulated drives, and each fault of an axis."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import HeldLinearAxes
from hil.core.clock import WallClock
from hil.core.messages import Homing
from hil.parts.emulation.emulated_axes import EmulatedAxes
from hil.parts.emulation.shared_state import ChainState, SharedAxisState

Make = Callable[..., EmulatedAxes]
PERIOD_S = 0.02


class StoppedClock(WallClock):
    """A clock that stands at zero: time is handed in."""

    def now_s(self) -> float:
        return 0.0


@pytest.fixture
def board() -> Iterator[SharedAxisState]:
    board = SharedAxisState.create()
    yield board
    board.close()


@pytest.fixture
def make(board: SharedAxisState) -> Make:
    def rails(*settings: str, chain: Callable[[], ChainState] = ChainState) -> EmulatedAxes:
        config = load_rig("emulated", settings).value.rails
        return EmulatedAxes("rails", config, StoppedClock(), board, chain=chain)

    return rails


def travel(axes: EmulatedAxes, axis: int, rate: float, from_s: float, to_s: float) -> float:
    """Let one axis follow a ramp from the position of its encoder; return the largest following error."""
    start = float(axes.position[axis])
    worst = 0.0
    for k in range(round((to_s - from_s) / PERIOD_S)):
        t_s = from_s + k * PERIOD_S
        wanted = start + rate * (t_s - from_s)
        worst = max(worst, abs(wanted - float(axes.position[axis])))
        axes.follow(axis, wanted, rate, t_s)
        axes.advance(t_s + PERIOD_S)
    return worst


def test_an_axis_follows_a_ramp_closely(make: Make) -> None:
    assert travel(make(), 1, 0.05, 0.0, 3.0) < 0.003


@pytest.mark.parametrize("fault", ["stuck", "reversed"])
def test_an_axis_that_fails_no_longer_follows(make: Make, fault: str) -> None:
    axes = make()
    travel(axes, 1, 0.05, 0.0, 1.0)
    axes.faults.on(fault, "y")
    assert travel(axes, 1, 0.05, 1.0, 3.0) > 0.05


WIDE = "rig.rails.drive_following_error_max_m=100"


def test_a_reversed_encoder_makes_the_axis_run_away(make: Make, board: SharedAxisState) -> None:
    axes = make(WIDE)
    axes.faults.on("reversed", "y")
    travel(axes, 1, 0.02, 0.0, 4.0)
    assert axes.limit(1) == 1  # ran into the end of its travel, not 40 mm on
    assert board.read("rails", 4.0)[0][1] == pytest.approx(axes.high[1])


def test_an_axis_with_a_reversed_encoder_loses_its_torque_soon_and_for_as_long_as_the_fault_stays(make: Make) -> None:
    axes = make()
    axes.faults.on("reversed", "y")
    travel(axes, 1, 0.1, 0.0, 0.6)
    assert axes.astray == [False, True, False]
    assert abs(axes.position[1]) < 0.15  # 100 mm of window, and the way of 50 ms
    axes.faults.clear()
    travel(axes, 1, 0.1, 0.6, 2.6)
    assert abs(axes.position[1]) < 0.4  # friction has brought it to a stand; setpoints do not move it
    assert not axes.moving(1)
    axes.astray[1] = False
    assert travel(axes, 1, 0.1, 2.6, 3.6) < 0.01


def test_a_short_following_error_is_within_the_time_of_the_window(make: Make) -> None:
    def stuck(window_s: float) -> list[bool]:
        axes = make(f"rig.rails.drive_following_error_s={window_s}")
        axes.faults.on("stuck", "y")
        axes.follow(1, 0.11, 0.0, 0.0)
        axes.advance(0.2)
        return axes.astray

    assert stuck(0.3) == [False, False, False]
    assert stuck(0.1) == [False, True, False]


def test_an_axis_on_its_way_to_a_far_setpoint_keeps_its_torque(make: Make) -> None:
    axes = make()
    axes.follow(1, 1.0, 0.0, 0.0, watchdog_s=20.0)  # within its limits it passes the setpoint at first
    axes.advance(3.0)
    assert axes.position[1] > 1.1
    axes.advance(10.0)
    assert axes.astray == [False, False, False]
    assert axes.position[1] == pytest.approx(1.0, abs=0.1)


def test_a_drive_with_a_reversed_encoder_cannot_brake(make: Make) -> None:
    axes = make(WIDE)
    travel(axes, 1, 0.1, 0.0, 1.0)
    axes.faults.on("reversed", "y")
    axes.advance(1.004)
    axes.brake(1)
    before = abs(axes.rate[1])
    axes.advance(1.304)
    assert abs(axes.rate[1]) > before + 0.1


def test_a_jump_of_the_encoder_is_seen_at_once_and_happens_once(make: Make) -> None:
    axes = make()
    travel(axes, 2, 0.05, 0.0, 1.0)
    before = axes.position[2]
    axes.faults.on("jump", "z", 0.1)
    axes.advance(1.0 + 0.004)
    assert axes.position[2] - before == pytest.approx(0.1, abs=0.002)
    assert axes.faults.shown() == "none"


def test_clear_repairs_the_encoders(make: Make, board: SharedAxisState) -> None:
    axes = make()
    axes.faults.on("jump", "z", 0.1)
    axes.faults.on("reversed", "y")
    travel(axes, 1, 0.05, 0.0, 0.5)
    assert np.abs(axes.position - board.read("rails", 0.5)[0]).max() > 0.05
    axes.faults.clear()
    axes.brake(1)
    axes.advance(0.504)
    np.testing.assert_allclose(axes.position, board.read("rails", 0.504)[0], atol=1e-12)


def test_frozen_values_stay_while_the_axis_moves_on(make: Make, board: SharedAxisState) -> None:
    axes = make()
    axes.faults.on("freeze")
    before = axes.position.copy()
    travel(axes, 1, 0.05, 0.0, 1.0)
    assert np.array_equal(axes.position, before)
    assert board.read("rails", 1.0)[0][1] > before[1] + 0.04


def test_axis_without_commands_brakes_and_reports_it(make: Make) -> None:
    axes = make()
    travel(axes, 1, 0.05, 0.0, 1.0)
    axes.advance(3.0)
    assert axes.overdue == [False, True, False]
    assert not axes.moving(1)


def test_an_open_chain_takes_the_torque_and_closing_it_starts_nothing(make: Make) -> None:
    closed = [True]
    axes = make(chain=lambda: ChainState(*closed * 3))
    travel(axes, 1, 0.05, 0.0, 1.0)
    closed[0] = False
    axes.advance(1.5)
    assert axes.torque_off
    assert not axes.moving(1)
    stood = float(axes.position[1])
    axes.follow(1, stood + 0.1, 0.0, 1.5)
    axes.advance(2.0)
    closed[0] = True
    axes.advance(2.5)
    assert axes.position[1] == pytest.approx(stood, abs=1e-6)


INCREMENTAL = (
    'rig.rails.y={travel_m=[-1.5,1.5],rate_max_mps=0.5,acceleration_max_mps2=0.6,park_m=0.3,encoder="incremental"}'
)


def test_an_incremental_encoder_counts_from_nowhere_until_it_has_been_homed(make: Make, board: SharedAxisState) -> None:
    axes = make(INCREMENTAL)
    assert axes.homing == [Homing.DONE, Homing.NEEDED, Homing.DONE]
    assert axes.position[1] == pytest.approx(0.0)  # it stands at 0.3 m
    axes.home(1)
    axes.advance(3.0)
    assert axes.homing[1] is Homing.UNDER_WAY
    axes.advance(12.0)
    assert axes.homing[1] is Homing.DONE
    assert axes.position[1] == pytest.approx(board.read("rails", 12.0)[0][1], abs=1e-6)
    assert axes.position[1] == pytest.approx(0.0, abs=0.005)


def test_homing_that_is_broken_off_has_failed(make: Make) -> None:
    axes = make(INCREMENTAL)
    axes.home(1)
    axes.advance(1.0)
    axes.brake(1)
    axes.advance(2.0)
    assert axes.homing[1] is Homing.FAILED
    assert not axes.moving(1)


def test_homing_of_a_stuck_axis_fails(make: Make) -> None:
    axes = make(INCREMENTAL)
    axes.faults.on("stuck", "y")
    axes.home(1)
    axes.advance(130.0)
    assert axes.homing[1] is Homing.FAILED


OPEN = ChainState(False, False, False)


def fall(axes: EmulatedAxes, board: SharedAxisState, to_s: float) -> float:
    """Advance to ``to_s``; return by how much the z axis has sunk, m."""
    before = board.read("rails", axes._t_s)[0][2]
    while axes._t_s < to_s:
        axes.advance(axes._t_s + 0.004)
    return float(before - board.read("rails", axes._t_s)[0][2])


def test_an_axis_without_torque_coasts_against_friction(make: Make) -> None:
    chain = [ChainState()]
    axes = make(chain=lambda: chain[0])
    travel(axes, 1, 0.1, 0.0, 2.0)
    speed, place = float(axes.rate[1]), float(axes.position[1])
    chain[0] = OPEN
    axes.advance(4.0)
    assert axes.position[1] - place == pytest.approx(speed**2 / (2.0 * 0.3), rel=0.05)  # its ramp: half of that


@pytest.mark.parametrize(
    ("brake", "drop_m"),
    [
        pytest.param("{ close_s = 0.05 }", 9.81 * 0.05**2, id="brake"),  # falls, and is stopped as fast again
        pytest.param("{ close_s = 0.2 }", 9.81 * 0.2**2, id="slow brake"),
    ],
)
def test_a_gravity_loaded_axis_falls_until_its_brake_has_closed(
    make: Make, board: SharedAxisState, brake: str, drop_m: float
) -> None:
    chain = [ChainState()]
    axes = make(f"rig.rails.z.brake={brake}", "rig.io.torque_delay_s=0.2", chain=lambda: chain[0])
    axes.follow(2, 0.0, 0.0, 0.0)
    assert fall(axes, board, 0.4) == pytest.approx(0.0, abs=1e-6)
    chain[0] = OPEN
    assert fall(axes, board, 2.0) == pytest.approx(drop_m, rel=0.15)


def test_a_delayed_contact_of_the_relay_keeps_the_torque_until_the_brake_has_closed(
    make: Make, board: SharedAxisState
) -> None:
    chain = [ChainState()]
    axes = make(chain=lambda: chain[0])
    axes.follow(2, 0.0, 0.0, 0.0)
    fall(axes, board, 0.2)
    chain[0] = ChainState(False, True, False)
    assert fall(axes, board, 0.26) == pytest.approx(0.0, abs=1e-5)
    chain[0] = OPEN
    assert fall(axes, board, 2.0) == pytest.approx(0.0, abs=1e-5)


def test_a_disabled_drive_closes_its_brake_before_it_switches_the_torque_off(
    make: Make, board: SharedAxisState
) -> None:
    axes = make()
    axes.follow(2, 0.0, 0.0, 0.0)
    fall(axes, board, 0.2)
    axes.disable(2)
    assert fall(axes, board, 2.0) == pytest.approx(0.0, abs=1e-5)


def test_an_axis_with_a_counterweight_stays_where_it_is(make: Make, board: SharedAxisState) -> None:
    chain = [ChainState()]
    axes = make("rig.rails.z.counterweight=true", chain=lambda: chain[0])
    axes.follow(2, 0.0, 0.0, 0.0)
    fall(axes, board, 0.2)
    chain[0] = ChainState(False, False, True)
    assert fall(axes, board, 1.0) == pytest.approx(0.0, abs=1e-6)


def test_a_runaway_ignores_all_commands_as_long_as_it_has_torque(make: Make) -> None:
    chain = [ChainState()]
    axes = make(chain=lambda: chain[0])
    travel(axes, 1, 0.1, 0.0, 1.0)
    axes.faults.on("runaway", "y")
    axes.advance(1.004)
    speed = float(axes.rate[1])
    axes.brake(1)
    axes.advance(2.0)
    assert axes.rate[1] == pytest.approx(speed)
    chain[0] = OPEN
    axes.advance(4.0)
    assert not axes.moving(1)


def test_encoders_of_two_groups_have_noise_of_their_own(board: SharedAxisState) -> None:
    config = load_rig("emulated", ("rig.rails.encoder_sigma_m=1e-5",)).value.rails
    positions = []
    for device in ("rails", "rails", "further.lamp"):
        axes = EmulatedAxes(device, config, StoppedClock(), board, seed=3)
        axes.advance(PERIOD_S)
        positions.append(axes.position.tolist())
    assert positions[0] == positions[1] != positions[2]


@pytest.mark.parametrize("friction_n", [0.0, 40.0])
def test_six_axes_move_as_the_same_axes_of_a_group_of_three(board: SharedAxisState, friction_n: float) -> None:
    """Bit by bit: with an ideal servo, and with the mechanics of a machine."""
    rails = load_rig("emulated").value.rails
    table = rails.model_dump(mode="json", include={"driver", "servo", "x", "y", "z"})
    table |= {"u": table["x"], "v": table["y"], "w": table["z"], "place_m": (0.0,) * 6}
    if friction_n:
        table["mechanics"] = {"friction_coulomb_n": friction_n, "friction_breakaway_n": friction_n}
    of_six = HeldLinearAxes.model_validate(table, strict=False)
    of_three = rails.model_copy(update={"mechanics": of_six.mechanics})
    six, three = (EmulatedAxes("further", config, StoppedClock(), board) for config in (of_six, of_three))
    for step in range(50):
        for group in (six, three):
            for axis, position in enumerate(group.position.tolist()):
                group.follow(axis, position + 0.01 * (1 + axis % 3), 0.0, PERIOD_S * step)
            group.advance(PERIOD_S * (step + 1))
    np.testing.assert_array_equal(six.position, np.tile(three.position, 2))
    np.testing.assert_array_equal(six.rate, np.tile(three.rate, 2))
    assert np.abs(six.rate).min() > 0.01
