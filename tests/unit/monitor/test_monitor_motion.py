"""Motion over portions: errors match covariances, and what makes the frames scatter is found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.config.load import load_scene
from hil.config.scene import Scene
from hil.parts.monitor.kernels.pose import FOCAL, UNKNOWNS
from hil.parts.monitor.motion import _CARRIED, MotionFit, MotionSolution, _design, _gains, transition
from hil.parts.monitor.results import FrameDetection, FrameResult
from hil.parts.monitor.settings import MonitorSettings

SIGMAS = np.array([2e-3, 2e-3, 1e-3, 3e-4, 3e-4, 2e-4, 0.02])
FINE = 0.05 * SIGMAS
UNIFORM = MonitorSettings(acceleration_mps2=1e-9, angular_acceleration_radps2=1e-9)


@pytest.fixture(scope="module")
def atv() -> Scene:
    """Return the shipped ATV-like scene."""
    return load_scene("atv").value


def test_accelerations_act_as_in_uniformly_accelerated_motion() -> None:
    state, acceleration = np.arange(1.0, 13.0), np.arange(1.0, 7.0)
    moved = transition(3.0) @ state + _gains(3.0)[:12] @ acceleration
    place, rate = state[0::2], state[1::2]
    assert moved[0::2] == pytest.approx(place + 3.0 * rate + 4.5 * acceleration)
    assert moved[1::2] == pytest.approx(rate + 3.0 * acceleration)
    seen = _design(3.0)[:6] @ np.concatenate([state, np.zeros(_CARRIED - 12), acceleration])
    assert seen == pytest.approx(moved[0::2])


def motion() -> np.ndarray:
    """Return w (12,) of a closing camera."""
    return np.array([0.2, 0.01, -0.15, 0.02, 8.0, -0.1, 0.01, 1e-3, -0.02, 5e-4, 0.03, -1e-3])


def frame(t_s: float, pose: np.ndarray, normal: np.ndarray, number: int = 0) -> FrameResult:
    """Return a frame with ``pose`` (7,) and its ``normal`` (7, 7), of a camera that only lets edges grow."""
    full, whole = np.zeros((UNKNOWNS, UNKNOWNS)), np.zeros(UNKNOWNS)
    full[:7, :7], whole[:7] = normal, pose
    prior = np.array([0.0] * 7 + [1e12] * (UNKNOWNS - 7))
    return FrameResult(
        FrameDetection(number, t_s, "near"), "", whole, full, prior, np.array([100.0, 107, 10, 17]), True
    )  # fmt: skip


def frames_at(
    rng: np.random.Generator, stated: np.ndarray, real: np.ndarray, sigmas: np.ndarray = FINE, jitter: float = 0.0
) -> list[FrameResult]:
    """Return frames at times ``stated`` that were exposed at ``real``; jitter: rad, of the pointing."""
    w, out = motion(), []
    for number, (t_s, t) in enumerate(zip(stated, real, strict=True)):
        pose = np.append(w[0::2] + t * w[1::2], 0.0) + sigmas * rng.normal(size=7)
        pose[3:5] += jitter * rng.normal(size=2)
        out.append(frame(t_s, pose, np.diag(sigmas**-2.0), number))
    return out


def ratio(found: MotionSolution, t_s: float) -> np.ndarray:
    """Return the errors of the motion over their sigmas, (12,)."""
    error = found.motion.w - transition(t_s) @ motion()
    return np.asarray(error / np.sqrt(np.diag(found.motion.covariance)))


def test_errors_of_the_carried_motion_match_its_covariance(rng: np.random.Generator, atv: Scene) -> None:
    """The fit of whole poses, q = 0.5: the mean square error in sigmas is one, for places and for rates."""
    spread = rng.normal(size=(7, 7))
    normal = np.diag(1.0 / SIGMAS) @ (np.eye(7) + 0.05 * (spread + spread.T)) @ np.diag(1.0 / SIGMAS)
    root = np.linalg.cholesky(np.linalg.inv(normal))
    squares, runs, growth = np.zeros(12), 150, UNIFORM.growth_px
    for _ in range(runs):
        fit, own = MotionFit(UNIFORM, atv), np.append(np.zeros(6), growth * rng.normal())
        for portion in range(4):
            times = 0.1 * np.arange(10 * portion, 10 * portion + 10)
            poses = [
                np.append(motion()[0::2] + t * motion()[1::2], 0.0) + own + root @ rng.normal(size=7) for t in times
            ]
            found = fit.fit([frame(t, pose, normal) for t, pose in zip(times, poses, strict=True)], times[-1])
        assert found is not None
        squares += ratio(found, times[-1]) ** 2 / runs
    np.testing.assert_allclose(squares, 1.0, atol=0.4)


def test_images_lost_unnoticed_are_found_by_the_motion(rng: np.random.Generator, atv: Scene) -> None:
    stated = np.arange(10) / atv.fps
    real = np.concatenate([stated[:4], stated[4:] + 1.0 / atv.fps])
    found = MotionFit(UNIFORM, atv).fit(frames_at(rng, stated, real), stated[-1])
    assert found is not None
    assert found.timing == "1 images lost"
    assert not found.consistent
    assert np.abs(ratio(found, real[-1])).max() < 4.0


def test_fields_in_the_other_order_are_found_by_the_motion(rng: np.random.Generator, atv: Scene) -> None:
    interlaced = atv.model_copy(update={"fields": "upper_first"})
    stated = np.arange(10) * 0.5 / atv.fps
    real = stated.reshape(5, 2)[:, ::-1].ravel()
    found = MotionFit(UNIFORM, interlaced).fit(frames_at(rng, stated, real), stated[-1])
    assert found is not None
    assert found.timing == "fields exchanged"
    assert np.abs(ratio(found, stated[-1])).max() < 4.0


def test_vibration_widens_the_pointing_alone(rng: np.random.Generator, atv: Scene) -> None:
    times = np.arange(10) / atv.fps
    jitter = 0.5 / atv.camera.f
    found = MotionFit(UNIFORM, atv).fit(frames_at(rng, times, times, jitter=jitter), times[-1])
    still = MotionFit(UNIFORM, atv).fit(frames_at(rng, times, times), times[-1])
    assert found is not None
    assert still is not None
    assert found.jitter_px in (0.25, 0.5, 1.0)
    assert still.jitter_px == 0.0
    assert np.abs(ratio(found, times[-1])).max() < 4.0
    growth = np.sqrt(np.diag(found.motion.covariance) / np.diag(still.motion.covariance))
    assert growth[[0, 2, 4]].max() < 1.5
    assert growth[[6, 8]].min() > 5.0


def test_a_wild_frame_is_left_out(rng: np.random.Generator, atv: Scene) -> None:
    times = np.arange(10) / atv.fps
    frames = frames_at(rng, times, times)
    frames[5].pose[:6] += 100.0 * FINE[:6]
    found = MotionFit(UNIFORM, atv).fit(frames, times[-1])
    assert found is not None
    assert (found.frames, found.timing) == (9, "")
    assert np.abs(ratio(found, times[-1])).max() < 4.0


def test_error_of_the_lens_is_in_the_covariance_and_does_not_average_out(rng: np.random.Generator, atv: Scene) -> None:
    """A relative error of the focal length is one of the range; that a frame has estimated it makes no difference."""
    sigma = 0.01
    stated = atv.camera.tolerances.model_copy(update={"focal_fraction": sigma})
    scene = atv.model_copy(update={"camera": atv.camera.model_copy(update={"tolerances": stated})})
    fit, w, found = MotionFit(UNIFORM, scene), motion(), None
    for portion in range(3):
        times, frames = 0.1 * np.arange(10 * portion, 10 * portion + 10), []
        for t in times:
            one = frame(t, np.append(w[0::2] + t * w[1::2], 0.0), np.diag(FINE**-2.0))
            rows = np.eye(UNKNOWNS)[:7]
            rows[2, FOCAL] = -(w[4] + t * w[5])  # measured is d3 - focal d3
            normal = rows.T @ np.diag(FINE**-2.0) @ rows
            prior = one.prior.copy()
            prior[FOCAL] = sigma**-2.0
            estimated = np.linalg.solve(normal + np.diag(prior), normal @ one.pose)
            frames.append(replace(one, pose=estimated, normal=normal, prior=prior))
        found = fit.fit(frames, times[-1])
    assert found is not None
    range_m = w[4] + times[-1] * w[5]
    assert found.motion.w[4] == pytest.approx(range_m, abs=1e-6)
    assert np.sqrt(found.motion.covariance[4, 4]) == pytest.approx(sigma * range_m, rel=0.02)
