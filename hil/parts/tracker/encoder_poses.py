"""Poses of a bench by its encoders, at any moment between two of its cycles."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from hil.bench.kinematics import pose_on_bench
from hil.core.messages import Array
from hil.maths import linear, quat

_KEPT: Final = 64
_GAP_CYCLES: Final = 3.5  # no pose is interpolated over a longer gap
_STEP: Final = 1e-6  # m, rad


class Moment(NamedTuple):
    """A moment of the bench. axes: rails, m, and gimbals, rad, (6,). r: in H, (3,), m. q: H to c, (4,). rate: of r and
    of the rotation in c, (6,), m/s, rad/s."""

    axes: Array
    r: Array
    q: Array
    rate: Array


def pose_of(bench: np.record, axes: Array) -> tuple[Array, Array]:
    """Return r (3,), m, in H, and q (4,), H to c, of a bench (BENCH_PARAMS) whose axes are at ``axes`` (6,)."""
    r, q = np.empty(3), np.empty(4)
    pose_on_bench(bench, axes[:3], axes[3:], r, q)
    return r, q


def difference(r: Array, q: Array, r_other: Array, q_other: Array) -> Array:
    """Return a pose less another one, (6,): in H, m, and the rotation from the other to it, in c, rad."""
    rotation = np.empty(3)
    quat.rotation_between(q, q_other, rotation)
    return np.concatenate([r - r_other, rotation])


def mean_pose(poses: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Return the mean of poses that are close to each other, r (3,), m, and q (4,)."""
    r, q = poses[0]
    mean = np.array([difference(*each, r, q) for each in poses]).mean(axis=0)
    return r + mean[:3], quat.multiply(quat.from_rotation_vector(mean[3:]), q)


class PoseTrack:
    """The last poses of a body, interpolated. step_s: their period."""

    def __init__(self, step_s: float) -> None:
        self._gap_s = _GAP_CYCLES * step_s
        self._kept: deque[tuple[float, Array, Array, Array]] = deque(maxlen=_KEPT)

    @property
    def newest_s(self) -> float:
        """Time of the newest pose, -inf without one."""
        return self._kept[-1][0] if self._kept else -np.inf

    def add_pose(self, t_s: float, axes: Array, r: Array, q: Array) -> None:
        """Add a pose at ``t_s``: r in H (3,), m, and q, H to c, (4,). axes: (6,), as in ``Moment``."""
        if t_s > self.newest_s:
            self._kept.append((t_s, axes, r, q))

    def at(self, t_s: float) -> Moment | None:
        """Return the pose at ``t_s``, None if that is before or after the poses, or in a gap of them."""
        if not t_s <= self.newest_s:
            return None
        later = self._kept[-1]
        for earlier in reversed(self._kept):
            if earlier[0] <= t_s and earlier is not later:
                return self._between(earlier, later, t_s)
            later = earlier
        return None

    def _between(
        self, earlier: tuple[float, Array, Array, Array], later: tuple[float, Array, Array, Array], t_s: float
    ) -> Moment | None:
        duration_s = later[0] - earlier[0]
        if duration_s > self._gap_s:
            return None
        fraction = (t_s - earlier[0]) / duration_s
        change = difference(later[2], later[3], earlier[2], earlier[3])
        q = quat.multiply(quat.from_rotation_vector(fraction * change[3:]), earlier[3])
        axes = earlier[1] + fraction * (later[1] - earlier[1])
        return Moment(axes, earlier[2] + fraction * change[:3], q, change / duration_s)


class EncoderPoses(PoseTrack):
    """The last poses of a bench by its encoders. bench: BENCH_PARAMS. step_s: period of the cycle."""

    def __init__(self, bench: np.record, step_s: float) -> None:
        super().__init__(step_s)
        self.bench = bench

    def add(self, t_s: float, axes: Array) -> None:
        """Add the positions of rails, m, and gimbals, rad, (6,), at bench time ``t_s``."""
        self.add_pose(t_s, axes, *pose_of(self.bench, axes))

    def change_per_axis(self, axes: Array) -> Array:
        """Return the change of the pose per axis, (6, 6): a column for each axis, per m or rad."""
        r, q = pose_of(self.bench, axes)
        columns = []
        for k in range(6):
            moved = axes.copy()
            moved[k] += _STEP
            columns.append(difference(*pose_of(self.bench, moved), r, q) / _STEP)
        return np.column_stack(columns)

    def blame(self, axes: Array, off: Array, sigmas: Array) -> tuple[int, float, float]:
        """Return the axis whose error alone explains ``off`` (6,) best, that error, m or rad, and the explained part.

        sigmas: (6,), of the components of ``off``.
        """
        weights = 1.0 / np.square(sigmas)
        columns = self.change_per_axis(axes)
        whole = linear.total(weights * off * off)
        products = [linear.total(weights * column * off) for column in columns.T]
        squares = [linear.total(weights * column * column) for column in columns.T]
        explained = [p * p / s if s > 0.0 else 0.0 for p, s in zip(products, squares, strict=True)]
        axis = max(range(6), key=explained.__getitem__)
        return axis, products[axis] / squares[axis], explained[axis] / whole
