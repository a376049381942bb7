"""Closed loop in plain Python: numpy, filterpy's filters, the same algorithm.

The truth in the whole field (constant over a step as in the product), IMU, poses at 6.25 Hz, filterpy's
KalmanFilter for position and for the attitude error, the reference line, a phase plane per axis, thruster
sets. Bench, late poses and all bookkeeping are omitted: this loop does less than the product's.
"""

from __future__ import annotations

import math
import time

import numpy as np
from filterpy.kalman import KalmanFilter

from hil.config.load import load_scenario
from hil.core.messages import REFERENCE, new
from hil.gnc import guidance
from hil.gnc.control import rule_of
from hil.gnc.guidance import GUIDANCE_STATE
from hil.maths import euler, quat
from hil.params import dynamics as dynamics_params
from hil.params import gnc as gnc_params
from hil.params.dynamics import gravity
from hil.sensors.vision_unit import parameters as vmu_params

FRAME_CYCLES = 8


def skew(v):
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def matrix(q):
    """A(q), scalar last."""
    v, s = q[:3], q[3]
    return (s * s - v @ v) * np.eye(3) + 2.0 * np.outer(v, v) - 2.0 * s * skew(v)


def product(p, q):
    return np.array([*(p[3] * q[:3] + q[3] * p[:3] - np.cross(p[:3], q[:3])), p[3] * q[3] - p[:3] @ q[:3]])


def turned(phi):
    angle = math.sqrt(phi @ phi)
    scale = 0.5 if angle < 1e-9 else math.sin(0.5 * angle) / angle
    return np.array([*(scale * phi), math.cos(0.5 * angle)])


class Field:
    """Harmonics to degree N after Pines, one order of numpy arrays at a time."""

    def __init__(self, scenario):
        found, size = gravity(scenario), scenario.truth.gravity_degree + 1
        self.gm, self.radius, self.c, self.s, self.size = found.gm, found.radius, found.c, found.s, size
        n, m = np.meshgrid(np.arange(size), np.arange(size), indexing="ij")
        with np.errstate(all="ignore"):
            self.alpha = np.sqrt((2 * n + 1) * (2 * n - 1) / ((n - m) * (n + m)))
            lower = (2 * n + 1) * (n + m - 1) * (n - m - 1) / ((2 * n - 3) * (n + m) * (n - m))
            self.beta = np.sqrt(np.where(lower > 0.0, lower, 0.0))
            self.up = np.sqrt(np.maximum(0.0, (n - m) * (n + m + 1) * np.where(m == 0, 0.5, 1.0)))
        self.diagonal = [math.sqrt((2 * k + 1) / (2 * k) * (2.0 if k == 1 else 1.0)) if k else 1.0 for k in range(size)]
        self.weight = np.arange(size)[:, None] + np.arange(size)[None, :] + 1

    def pull(self, r, angle):
        """The acceleration of degrees 2 and above in inertial axes."""
        ca, sa = math.cos(angle), math.sin(angle)
        x, y, z = ca * r[0] + sa * r[1], ca * r[1] - sa * r[0], r[2]
        distance = math.sqrt(r @ r)
        s, t, u, size = x / distance, y / distance, z / distance, self.size
        a = np.zeros((size, size + 1))
        for n in range(size):
            if n:
                a[n, :n] = self.alpha[n, :n] * u * a[n - 1, :n] - (self.beta[n, :n] * a[n - 2, :n] if n > 1 else 0.0)
            a[n, n] = self.diagonal[n] * a[n - 1, n - 1] if n else 1.0
        a *= (self.radius / distance) ** np.arange(size)[:, None]
        a *= self.gm / distance**2
        wave = (s + 1j * t) ** np.arange(size)
        cosine = self.c * wave.real + self.s * wave.imag
        low = np.concatenate([[0.0], wave[:-1]])
        order = np.arange(size)
        a1 = float((order * a[:, :size] * (self.c * low.real + self.s * low.imag)).sum())
        a2 = float((order * a[:, :size] * (self.s * low.real - self.c * low.imag)).sum())
        a3 = float((self.up * a[:, 1:] * cosine).sum())
        a4 = -float((self.weight * a[:, :size] * cosine).sum()) - u * a3
        gx, gy, gz = a1 + s * a4, a2 + t * a4, a3 + u * a4
        return np.array([ca * gx - sa * gy, sa * gx + ca * gy, gz])


class PlainLoop:
    """scheme-1 with gravity, gravity gradient and thrusters; array, solar pressure and centre of mass are omitted."""

    def __init__(self, seed=0):
        scenario = load_scenario("scheme-1").value
        self.rng, self.dt = np.random.default_rng(seed), scenario.step_s
        self.dss, self.truth = dynamics_params.dss(scenario), dynamics_params.initial_truth(scenario)
        self.field, self.imu = Field(scenario), dynamics_params.imu(scenario)
        self.vision, self.nav = vmu_params.model(scenario), gnc_params.navigation(scenario).fusion
        self.sets, strength = gnc_params.allocation(scenario.chaser)
        self.control = gnc_params.control(scenario, strength)
        self.line, self.flown, self.point = gnc_params.guidance(scenario), new(GUIDANCE_STATE), new(REFERENCE)
        guidance.start(self.line, self.flown)
        t = self.truth
        to_h = matrix(t.q_HI)
        rho, rho_rate = to_h.T @ t.r_CT_H, to_h.T @ (t.v_CT_H + np.cross(t.w_HI_H, t.r_CT_H))
        self.y = np.concatenate([rho, rho_rate, product(t.q_CH, t.q_HI), t.w_CI_C, t.r_T_I, t.v_T_I])
        self.bias, self.drift = np.full(3, 3e-4), np.zeros(3)
        self.on, self.until, self.left, self.owed = np.zeros(16), np.zeros(6, int), np.zeros(6, int), np.zeros(6)
        self.kf = None
        self.q = np.array(t.q_CH)
        self.t_s = 0.0

    def frame(self):
        """A(q_HI) and the rate of H in H."""
        r, v = self.y[13:16], self.y[16:19]
        z, y = -r / np.linalg.norm(r), -np.cross(r, v)
        y /= np.linalg.norm(y)
        a = np.array([np.cross(y, z), y, z])
        return a, np.array([0.0, -(a[0] @ v) / np.linalg.norm(r), 0.0])

    def step_truth(self):
        d, dt, y = self.dss, self.dt, self.y
        thrust = d.thruster_direction[:16] * (self.on * d.thruster_force[:16])[:, None]
        force = thrust.sum(axis=0) / self.truth.mass_kg
        torque = np.cross(d.thruster_position[:16], thrust).sum(axis=0)
        r, v, gm = y[13:16], y[16:19], d.gravity.gm
        near = -gm / np.linalg.norm(r) ** 3 * r
        pulls = []
        for t in (0.0, 0.5 * dt, dt):
            here = r + t * v + 0.5 * t * t * near
            pulls.append(self.field.pull(here, d.gravity.rotation + d.gravity.rate * (self.t_s + t)))
        middle = r + 0.5 * dt * v + y[0:3] + 0.5 * dt * y[3:6]
        apart = self.field.pull(middle, d.gravity.rotation + d.gravity.rate * (self.t_s + 0.5 * dt)) - pulls[1]

        def rate(state, pull):
            target, chaser = state[13:16], state[13:16] + state[0:3]
            central, distance = -gm / np.linalg.norm(target) ** 3, np.linalg.norm(chaser)
            a, w = matrix(state[6:10]), state[10:13]
            nadir = a @ (-chaser / distance)
            twist = torque + 3.0 * gm / distance**3 * np.cross(nadir, d.inertia @ nadir)
            return np.concatenate(
                [
                    state[3:6],
                    -gm / distance**3 * chaser - central * target + apart + a.T @ force,
                    0.5 * product(np.array([*w, 0.0]), state[6:10]),
                    d.inertia_inverse @ (twist - np.cross(w, d.inertia @ w)),
                    state[16:19],
                    central * target + pull,
                ]
            )

        k1 = rate(y, pulls[0])
        k2 = rate(y + 0.5 * dt * k1, pulls[1])
        k3 = rate(y + 0.5 * dt * k2, pulls[1])
        k4 = rate(y + dt * k3, pulls[2])
        before = y[10:13].copy()
        self.y = y + dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
        self.y[6:10] /= np.linalg.norm(self.y[6:10])
        self.t_s += dt
        n = self.rng.standard_normal((4, 3))
        self.rate_c = 0.5 * (before + self.y[10:13]) + self.drift + self.imu.sigma_gyro * n[0]
        self.force_c = force + self.bias + self.imu.sigma_accelerometer * n[1]
        self.drift = self.drift + dt * self.imu.sigma_drift * n[2]
        self.bias = self.bias + dt * self.imu.sigma_bias * n[3]

    def predict(self):
        if self.kf is None:
            return
        dt, akf, pkf, p = self.dt, self.akf, self.kf, self.nav
        turn = (self.rate_c - akf.x[3:]) * dt
        back = turned(np.array([0.0, p.orbit.mean_motion * dt, 0.0]))
        self.q = product(turned(turn), product(self.q, back))
        akf.F = np.eye(6)
        akf.F[:3, :3], akf.F[:3, 3:] = matrix(turned(turn)), -dt * np.eye(3)
        akf.Q = np.diag([*[(dt * p.akf.sigma_gyro) ** 2] * 3, *[(dt * p.akf.sigma_drift) ** 2] * 3])
        drift = akf.x.copy()
        akf.predict()
        akf.x = drift
        self.w = turn / dt + matrix(self.q)[:, 1] * p.orbit.mean_motion
        response = p.pkf.hill_response @ matrix(self.q).T
        pkf.F, pkf.B = np.eye(9), np.zeros((9, 3))
        pkf.F[:6, :6], pkf.F[:6, 6:], pkf.B[:6] = p.pkf.hill_transition, -response, response
        pkf.Q = p.pkf.sigma_accelerometer**2 * pkf.B @ pkf.B.T
        pkf.Q[6:, 6:] += (dt * p.pkf.sigma_bias) ** 2 * np.eye(3)
        pkf.predict(u=self.force_c)

    def see(self):
        a, _ = self.frame()
        r, n = a @ self.y[0:3], self.rng.standard_normal(6)
        q = product(self.y[6:10], quat.conjugate(quat.from_matrix(a)))
        factor = max(1.0, np.linalg.norm(r) / self.vision.reference_range)
        sigma, angle = factor * self.vision.sigma_position, factor * self.vision.sigma_angle
        q_measured = product(turned(angle * n[3:]), q)
        z = -(matrix(q) @ r) + sigma * n[:3]
        if self.kf is None:
            self.akf, self.kf = KalmanFilter(6, 3), KalmanFilter(9, 3, 3)
            self.q, self.w = q_measured, np.zeros(3)
            self.akf.x, self.akf.P = np.zeros(6), np.diag([*[angle**2] * 3, *[self.nav.akf.initial_drift_sigma**2] * 3])
            self.kf.x = np.concatenate([-matrix(q_measured).T @ z, np.zeros(3), self.nav.pkf.initial_bias])
            lever = sigma**2 + (angle * np.linalg.norm(z)) ** 2
            self.kf.P = np.diag([*[lever] * 3, *[4e-4] * 3, *[2.5e-7] * 3])
            return
        off = product(q_measured, self.q * np.array([-1.0, -1.0, -1.0, 1.0]))
        drift = self.akf.x[3:].copy()
        self.akf.x = np.concatenate([np.zeros(3), drift])
        self.akf.update(2.0 * off[:3], R=angle**2 * np.eye(3), H=np.eye(3, 6))
        self.q = product(turned(self.akf.x[:3]), self.q)
        self.q /= np.linalg.norm(self.q)
        self.akf.x[:3] = 0.0
        a = matrix(self.q)
        arm = skew(a @ self.kf.x[:3])
        spread = sigma**2 * np.eye(3) + arm @ self.akf.P[:3, :3] @ arm.T
        self.kf.update(z, R=spread, H=np.hstack([-a, np.zeros((3, 6))]))

    def decide(self):
        c, dt = self.control, self.dt
        guidance.advance(self.line, self.flown, self.t_s, 0, 1)
        guidance.reference(self.line, self.flown, self.t_s, self.point)
        if self.kf is None:
            return
        a, p = matrix(self.q), np.sqrt(np.diag(self.kf.P))
        error = np.concatenate([a @ (self.kf.x[:3] - self.point.r_CT_H), 2.0 * self.q[:3] * np.sign(self.q[3])])
        rate = np.concatenate([a @ (self.kf.x[3:6] - self.point.v_CT_H), self.w])
        ahead = np.concatenate([a @ self.point.a_CT_H, np.zeros(3)])
        votes = np.zeros(16)
        for i in range(6):
            strong, period = c.acceleration[i], int(c.period[i])
            if self.until[i] <= 0:
                sigmas = (p[i], p[3 + i]) if i < 3 else (0.0, 0.0)
                lead, _, _, band = rule_of(c, i, *sigmas, strong * c.pulse_s)
                reach = lead * c.correction_rate[i]
                known = rate[i] + self.owed[i]
                s = min(reach, max(-reach, error[i])) + lead * known + known * abs(known) / (2.0 * strong)
                cycles = 0
                if abs(s) > band:
                    cycles = -int(math.copysign(min(period, max(1, int(abs(s) / (lead * strong * dt)))), s))
                fed = round((self.owed[i] + ahead[i] * period * dt) / (strong * dt))
                fed = min(period - cycles, max(-period - cycles, fed))
                self.owed[i] -= fed * strong * dt
                self.left[i], self.until[i] = cycles + fed, period
            self.owed[i] += ahead[i] * dt
            self.until[i] -= 1
            demand = int(np.sign(self.left[i]))
            self.left[i] -= demand
            if demand:
                chosen = (1, 0) if demand > 0 else (0, 1)
                votes += self.sets[i, chosen[0], :16] - self.sets[i, chosen[1], :16]
        self.on = (votes > 0).astype(float)

    def run(self, span_s):
        """Simulate ``span_s``; return the final position and attitude angles, deg, relative to H."""
        for k in range(round(span_s / self.dt)):
            if k:
                self.predict()
            if k % FRAME_CYCLES == 0:
                self.see()
            self.decide()
            self.step_truth()
        a, _ = self.frame()
        q = product(self.y[6:10], quat.conjugate(quat.from_matrix(a)))
        return a @ self.y[0:3], np.degrees(euler.from_quaternion(q, np.array([2, 1, 0])))


if __name__ == "__main__":
    for span_s in (20.0, 200.0):
        loop = PlainLoop()
        begun_s = time.process_time()
        place, angles = loop.run(span_s)
        print(
            f"{span_s:g} s: {time.process_time() - begun_s:.2f} s of CPU, at {place.round(4)} m, {angles.round(3)} deg"
        )
