"""Extended Kalman filter in Python as a backend of navigation: attitude, gyro drift, position, velocity, bias, joint.

hil run scheme-1 --set 'gnc.navigation.backend="examples/backends/ekf.py:Ekf"'
"""

import numpy as np

from hil.maths import quat

ANGLE, DRIFT, POSITION, VELOCITY, BIAS = (slice(i, i + 3) for i in range(0, 15, 3))  # errors of the state
START = (1e-4, 1.7e-7, 1e-2, 2e-2, 5e-4)  # their standard deviations with the first pose: rad, rad/s, m, m/s, m/s^2
NOISE = (1.5e-8, 1.5e-9, 0.0, 1e-4, 1e-5)  # what a second adds to each by one sample's noise


def cross(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


class Ekf:
    def start(self, setup, settings):
        self.n, self.dt, self.q, self.nis = setup.mean_motion_radps, setup.step_s, None, (np.nan, np.nan)
        self.drift, self.bias, self.v, self.w = np.full(3, 4.9e-8), np.full(3, 3e-4), np.zeros(3), np.zeros(3)
        self.p = np.diag(np.repeat(START, 3)) ** 2

    def step(self, inp):
        for sample in inp.samples[: inp.n_samples] if self.q is not None else ():
            self.predict(sample.rate_radps, sample.force_mps2, self.dt / inp.n_samples)
        for pose in inp.poses[: inp.n_poses]:
            self.update(pose, inp.t_s - pose.t_s)
        if self.q is None:
            return None
        sigma = np.sqrt(np.diag(self.p))
        found = {"sigma_attitude_rad": sigma[ANGLE], "sigma_r_m": sigma[POSITION], "sigma_v_mps": sigma[VELOCITY]}
        found |= {"bias_mps2": self.bias, "bias_sigma_mps2": sigma[BIAS]}
        found |= dict(zip(("nis_position", "nis_attitude"), self.nis, strict=True))
        return found | {"r_CT_H": self.r, "v_CT_H": self.v, "q_CH": self.q, "w_CH_C": self.w}

    def predict(self, rate, force, dt):
        a, n = quat.to_matrix(self.q), self.n
        self.w = rate - self.drift - a @ (0.0, -n, 0.0)
        hill = (2.0 * n * self.v[2], -n * n * self.r[1], -2.0 * n * self.v[0] + 3.0 * n * n * self.r[2])
        self.r = self.r + dt * self.v
        self.v = self.v + dt * (a.T @ (force - self.bias) + hill)
        self.q = quat.multiply(quat.from_rotation_vector(self.w * dt), self.q)
        f = np.eye(15)
        f[ANGLE, ANGLE] -= dt * cross(self.w)
        f[ANGLE, DRIFT], f[POSITION, VELOCITY], f[VELOCITY, BIAS] = -dt * np.eye(3), dt * np.eye(3), -dt * a.T
        f[VELOCITY, ANGLE] = -dt * a.T @ cross(force - self.bias)
        self.p = f @ self.p @ f.T + np.diag(np.repeat(np.square(np.array(NOISE) * dt), 3))

    def update(self, pose, age_s):
        if self.q is None:
            self.q, self.r = pose.q_CH.copy(), -quat.to_matrix(pose.q_CH).T @ pose.r_TC_C_m
        q = quat.multiply(quat.from_rotation_vector(-self.w * age_s), self.q)
        r, h, noise = quat.to_matrix(q) @ (self.r - age_s * self.v), np.zeros((6, 15)), np.zeros((6, 6))
        h[:3, ANGLE], h[:3, POSITION], h[3:, ANGLE] = -cross(r), -quat.to_matrix(q), np.eye(3)
        noise[:3, :3], noise[3:, 3:] = pose.covariance_position_m2, pose.covariance_attitude_rad2
        turned = quat.to_rotation_vector(quat.multiply(pose.q_CH, quat.conjugate(q)))
        y, s = np.concatenate([pose.r_TC_C_m + r, turned]), h @ self.p @ h.T + noise
        self.nis = tuple(y[k] @ np.linalg.solve(s[k, k], y[k]) for k in (slice(0, 3), slice(3, 6)))
        gain = np.linalg.solve(s, h @ self.p).T
        x, keep = gain @ y, np.eye(15) - gain @ h
        self.p = keep @ self.p @ keep.T + gain @ noise @ gain.T
        self.q = quat.multiply(quat.from_rotation_vector(x[ANGLE]), self.q)
        self.drift, self.bias = self.drift + x[DRIFT], self.bias + x[BIAS]
        self.r, self.v = self.r + x[POSITION], self.v + x[VELOCITY]
