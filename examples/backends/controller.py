"""Controller in Python as a backend of control: a dead band about position and attitude with a lead by the rate.

hil run scheme-1 --set 'gnc.control.backend="examples/backends/controller.py:DeadBand"'
"""

import numpy as np

import hil
from hil.maths import quat


class DeadBand:
    settings = (
        hil.Setting("deadband_m", 0.006, "m", 1e-4, 0.1, "of position and lead"),
        hil.Setting("deadband_deg", 0.15, "deg", 1e-3, 5.0, "of attitude and lead"),
        hil.Setting("lead_s", 12.0, "s", 0.1, 100.0, "weight of the rate"),
        hil.Setting("period_s", 0.4, "s", 0.02, 10.0, "between two decisions"),
    )

    def start(self, setup, settings):
        self.settings, self.dt = settings, setup.step_s
        self.acceleration = np.concatenate([setup.acceleration_mps2, setup.angular_acceleration_radps2])
        self.cycles, self.pending, self.wait = np.zeros(6, int), np.zeros(6), 0

    def step(self, inp):
        nav, ref, lead = inp.navigation, inp.reference, self.settings.lead_s
        to_c, feed = (
            quat.to_matrix(nav.q_CH),
            np.concatenate([ref.a_CT_H + inp.feed_force_mps2, inp.feed_torque_radps2]),
        )
        feed[:3] = to_c @ feed[:3]
        if self.wait == 0:
            self.wait = period = max(1, round(self.settings.period_s / self.dt))
            error, rate = np.zeros(6), np.zeros(6)
            error[:3] = np.clip(to_c @ (nav.r_CT_H - ref.r_CT_H), -0.006 * lead, 0.006 * lead)
            rate[:3] = to_c @ (nav.v_CT_H - ref.v_CT_H)
            quat.rotation_between(nav.q_CH, ref.q_CH, error[3:])
            error[3:] = np.clip(error[3:], -np.radians(0.4) * lead, np.radians(0.4) * lead)
            rate[3:] = nav.w_CH_C - inp.reference_rate_radps
            s = error + lead * (rate + self.pending)
            band = np.repeat([self.settings.deadband_m, np.radians(self.settings.deadband_deg)], 3)
            step = self.acceleration * self.dt
            burn = np.where(abs(s) > band, -np.sign(s) * np.maximum(1, abs(s) // (lead * step)), 0)
            ahead = np.round((self.pending + feed * period * self.dt) / step)
            self.pending -= ahead * step
            self.cycles = np.clip(burn + ahead, -period, period).astype(int)
        self.pending += feed * self.dt
        self.wait -= 1
        demand = np.sign(self.cycles)
        self.cycles -= demand
        return {"force": demand[:3], "torque": demand[3:]}
