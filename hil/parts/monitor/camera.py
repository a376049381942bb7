"""Simulated television camera: images of the docking target rendered from the axes' encoders."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hil.bench.kinematics import pose_on_bench
from hil.config.rig import Rig
from hil.config.scene import Scene
from hil.config.tables.docking_monitor import DockingMonitorConfig
from hil.core.messages import POSE, Array, new
from hil.maths import quat
from hil.maths.random_streams import stream
from hil.models import docking_view
from hil.params import bench as bench_params
from hil.parts.monitor.params import mounting
from hil.parts.monitor.render import Conditions, TargetRenderer
from hil.parts.monitor.sources import VideoFrame, exposure
from hil.sensors.mounting import camera_pose, chaser_pose

_KEPT_S = 2.0  # s of samples kept before the last requested time: largest delay of an encoder


def view(mounting: np.record, r_CT_H: Array, q_CH: Array) -> tuple[Array, Array]:
    """Return d (3,), m, and phi (3,), rad, of the camera of a chaser at ``r_CT_H`` with ``q_CH``."""
    t_v, q_vt, d, phi = np.empty(3), np.empty(4), np.empty(3), np.empty(3)
    camera_pose(mounting, r_CT_H, q_CH, t_v, q_vt)
    docking_view.of_camera_pose(t_v, q_vt, d, phi)
    return d, phi


def chaser_position(mounting: np.record, d: Array, phi: Array) -> Array:
    """Return r_CT_H (3,), m, of the chaser whose camera has d (3,), m, and phi (3,), rad: the inverse of ``view``."""
    t_v, q_vt, pose = np.empty(3), np.empty(4), new(POSE)
    docking_view.to_camera_pose(d, phi, t_v, q_vt)
    chaser_pose(mounting, t_v, q_vt, np.zeros((6, 6)), pose)
    r_TC_H: Array = quat.transform_back(pose.q_CH, pose.z_TC_C)
    return -r_TC_H


class EncoderTrack:
    """Camera pose over time: linear interpolation of the encoders' samples, each with its own time."""

    def __init__(self, bench: np.record, mounting: np.record) -> None:
        self._bench = bench
        self._mounting = mounting
        self._times = (np.empty(0), np.empty(0))  # sample times of rails and turntable
        self._axes = (np.empty((0, 3)), np.empty((0, 3)))

    def add(self, rows: np.ndarray) -> None:
        """Append the encoder samples in ``rows`` (n,) of CYCLE."""
        new_axes = (rows["feedback"]["rail_m"], rows["feedback"]["gimbal_rad"])
        times, axes = [], []
        for device in range(2):
            t = np.concatenate((self._times[device], rows["sampled_s"][:, device]))
            newer = np.diff(np.maximum.accumulate(t), prepend=-np.inf) > 0.0  # the same sample may be read twice
            times.append(t[newer])
            axes.append(np.concatenate((self._axes[device], new_axes[device]))[newer])
        self._times, self._axes = (times[0], times[1]), (axes[0], axes[1])

    def covers(self, t_s: float) -> bool:
        """Return whether there are samples of ``t_s`` or later."""
        return all(len(t) > 0 and t[-1] >= t_s for t in self._times)

    def __call__(self, t_s: float) -> tuple[Array, Array]:
        """Return d (3,), m, and phi (3,), rad, at ``t_s``, which is covered."""
        rail, gimbal = (
            np.array([np.interp(t_s, t, axes[:, i]) for i in range(3)])
            for t, axes in zip(self._times, self._axes, strict=True)
        )
        r, q = np.empty(3), np.empty(4)
        pose_on_bench(self._bench, rail, gimbal, r, q)
        return view(self._mounting, r, q)

    def drop_before(self, t_s: float) -> None:
        """Drop samples that are not needed once ``t_s`` has passed."""
        keep = [max(int(np.searchsorted(t, t_s - _KEPT_S)) - 1, 0) for t in self._times]
        self._times = (self._times[0][keep[0] :], self._times[1][keep[1] :])
        self._axes = (self._axes[0][keep[0] :], self._axes[1][keep[1] :])


class RenderedCamera:
    """Renders the docking target along an EncoderTrack, at the scene's rate from t = 0 of the run on."""

    def __init__(self, scene: Scene, config: DockingMonitorConfig, rig: Rig, step_s: float, seed: int) -> None:
        self.track = EncoderTrack(bench_params.bench_as_built(rig, step_s), mounting(config))
        self._renderer = TargetRenderer(scene, scene.chosen(config.target), Conditions(blur_px=config.blur_px))
        self._rng = stream(seed, "monitor")
        self._next = 0

    def frames(self) -> Iterator[VideoFrame]:
        """Yield, in order, the frames covered by encoder samples so far."""
        while self.track.covers(t_s := exposure(self._renderer.scene, self._next)[0]):
            yield self._renderer.frame(self._next, self.track, self._rng)
            self._next += 1
            self.track.drop_before(t_s)
