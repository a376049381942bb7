"""Filters of the navigation without their memory, for tests of one prediction or update."""

from __future__ import annotations

import numpy as np

from hil.core.messages import new
from hil.gnc.estimation import joint_filter, pose_model
from hil.gnc.estimation.error_state import FILTERS, INNOVATION, NOISE_FACTOR
from hil.gnc.estimation.step_memory import STEP

NO_FORCE = np.zeros(3)


class JointFilter:
    """FILTERS with FUSION_PARAMS ``params``, started from ``pose`` (POSE) if there is one."""

    def __init__(self, params: np.record, pose: np.record | None = None) -> None:
        self.params, self.filters, self.noise = params, new(FILTERS), new(NOISE_FACTOR)
        self.akf, self.pkf, self.found = self.filters.akf, self.filters.pkf, new(INNOVATION)
        self._step = new(STEP)
        self._rate, self._force = self._step.rate_C, self._step.force_C
        if pose is not None:
            pose_model.start(params, pose, self.noise, self.filters)

    @property
    def p(self) -> np.ndarray:
        """Covariance of all errors (n, n), a view."""
        n = int(self.params.errors.n)
        return np.asarray(self.filters["p"])[:n, :n]

    @property
    def p_akf(self) -> np.ndarray:
        """Covariance of the attitude filter's errors (6, 6), a view."""
        return self.p[9:15, 9:15]

    @property
    def p_pkf(self) -> np.ndarray:
        """Covariance of the position filter's errors (9, 9), a view."""
        return self.p[:9, :9]

    def predict(self, rate: np.ndarray, force: np.ndarray, hill: np.record) -> None:
        """Make a step with samples of gyro and accelerometer."""
        self._rate[:], self._force[:] = rate, force
        self._step.hill = hill
        joint_filter.predict(self.params, self.filters, self._step)

    def innovate_attitude(self, q: np.ndarray, covariance: np.ndarray) -> float:
        """Return the NIS of a measured attitude; ``found`` has its innovation."""
        return pose_model.innovate_attitude(self.params.errors, self.filters, self.noise, q, covariance, self.found)

    def innovate_position(self, z: np.ndarray, covariance: np.ndarray, delta_s: float = 0.0) -> float:
        """Return the NIS of a measured position; ``found`` has its innovation."""
        errors = self.params.errors
        return pose_model.innovate_position(errors, self.filters, self.noise, z, covariance, delta_s, self.found)

    def update(self) -> None:
        """Fuse the last innovation."""
        joint_filter.update(self.params.errors, self.filters, self.found)

    def gain(self, first: int, rows: int) -> np.ndarray:
        """Return rows of the gain of the last innovation, (rows, 3)."""
        return np.asarray(self.found["gain"])[:, first : first + rows].T.copy()
