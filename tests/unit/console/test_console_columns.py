"""The console's numbers against the rows that they come from."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hil.core.clock import SimulatedClock
from hil.loop.rate_keeper import SimulatedRate
from hil.params import bench as bench_params
from hil.parts.console.columns import COLUMNS, INDEX, console_rows
from hil.session import build
from tests.support.run_settings import make_job


@pytest.fixture(scope="module")
def flown() -> tuple[np.ndarray, np.ndarray]:
    """Return CYCLE rows of four seconds on mocks, and the console's."""
    job = make_job(4.0, seed=3)
    step_s = job.scenario.value.step_s
    history = build.in_memory(job, SimulatedRate(SimulatedClock(), step_s)).run().history
    return history, console_rows(bench_params.bench(job.rig.value, step_s), history)


def triple(rows: np.ndarray, name: str) -> np.ndarray:
    return rows[:, [INDEX[f"{name}.{axis}"] for axis in "xyz"]].astype(float)


def rotation(q: np.ndarray) -> Rotation:
    """Return the rotation whose matrix is A(q)."""
    return Rotation.from_quat(q).inv()


def test_every_column_is_written(flown: tuple[np.ndarray, np.ndarray]) -> None:
    assert [name for name, k in INDEX.items() if not np.isfinite(flown[1][:, k]).any()] == []


def known(history: np.ndarray) -> np.ndarray:
    found: np.ndarray = history["navigation"]["valid"] == 1
    assert found.sum() > 100
    return found


def test_position_error_is_estimate_minus_truth_in_mm(flown: tuple[np.ndarray, np.ndarray]) -> None:
    history, rows = flown
    k = known(history)
    error = 1e3 * (history["navigation"]["r_CT_H"] - history["truth"]["r_CT_H"])[k]
    np.testing.assert_allclose(triple(rows, "position_error_mm")[k], error, rtol=1e-5, atol=1e-4)
    band = 3e3 * history["navigation"]["sigma_r_m"][k]
    np.testing.assert_allclose(triple(rows, "position_band_mm")[k], band, rtol=1e-6)


def test_angle_error_is_the_rotation_from_estimate_to_truth(flown: tuple[np.ndarray, np.ndarray]) -> None:
    history, rows = flown
    k = known(history)
    turn = rotation(history["truth"]["q_CH"][k]) * rotation(history["navigation"]["q_CH"][k]).inv()
    # A(q) = exp(-[phi]x) turns components: its vector is that of the frame's turn, with the other sign
    np.testing.assert_allclose(triple(rows, "angle_error_deg")[k], -np.degrees(turn.as_rotvec()), atol=2e-6)


def test_bench_pose_shows_the_truth_and_vision_the_pose_that_came(flown: tuple[np.ndarray, np.ndarray]) -> None:
    history, rows = flown
    off = np.abs(triple(rows, "bench_m") - history["truth"]["r_CT_H"]).max()
    assert off < 0.005
    fresh = history["pose"]["fresh"] > 0
    assert np.isnan(triple(rows, "vision_m")[~fresh]).all()
    seen = -rotation(history["pose"]["q_CH"][fresh]).inv().apply(history["pose"]["z_TC_C"][fresh])
    np.testing.assert_allclose(triple(rows, "vision_m")[fresh], seen, atol=1e-6)


def test_angles_are_those_of_the_3_2_1_sequence(flown: tuple[np.ndarray, np.ndarray]) -> None:
    history, rows = flown
    k = known(history)
    yaw_pitch_roll = Rotation.from_quat(history["navigation"]["q_CH"][k]).as_euler("ZYX", degrees=True)
    np.testing.assert_allclose(triple(rows, "angle_estimate_deg")[k], yaw_pitch_roll[:, ::-1], atol=1e-5)


def test_thrusters_are_bits(flown: tuple[np.ndarray, np.ndarray]) -> None:
    history, rows = flown
    bits = (history["command"]["on"] != 0) @ (1 << np.arange(24))
    assert bits.any()
    np.testing.assert_array_equal(rows[:, INDEX["thrusters"]].astype(np.int64), bits)


def test_nothing_is_shown_of_an_estimate_before_there_is_one() -> None:
    job = make_job(0.04)
    step_s = job.scenario.value.step_s
    history = build.in_memory(job, SimulatedRate(SimulatedClock(), step_s)).run().history
    history["navigation"]["valid"] = 0
    rows = console_rows(bench_params.bench(job.rig.value, step_s), history)
    assert rows.shape == (3, COLUMNS)
    for name in ("estimate_m", "angle_estimate_deg", "position_error_mm", "angle_band_deg"):
        assert np.isnan(triple(rows, name)).all()
    assert np.isfinite(triple(rows, "bench_m")).all()


def test_levels_are_those_of_the_run_over_their_limits(flown: tuple[np.ndarray, np.ndarray]) -> None:
    history, rows = flown
    k, found = known(history), history["supervision"]
    shares = rows[:, [INDEX[f"level_{name}"] for name in ("along", "across", "attitude")]].astype(float)
    np.testing.assert_allclose(shares[k] * found["alert_limit"][k], found["level"][k], rtol=1e-5)
    assert np.all(shares[k] > 0.0)
    np.testing.assert_array_equal(rows[:, INDEX["level_term"]], found["level_term"])
