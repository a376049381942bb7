"""Six-joint arm with an ortho-parallel base and a spherical wrist: joints of a pose of the flange, and their limits.

Brandstoetter, Angerer, Hofbaur, "An Analytical Solution of the Inverse Kinematics Problem of Industrial Serial
Manipulators with an Ortho-parallel Basis and a Spherical Wrist", 2014. Joints of the model are 0 with the arm upright,
forearm and flange upward. In numbers of Python and elementary functions of fixed order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from hil.core.messages import Array
from hil.drivers.arm.model import Unreachable
from hil.maths import linear
from hil.maths.elementary import acos, atan2, cos, hypot, sin, square

_TURN: Final = 2.0 * math.pi
_DEGREES: Final = math.degrees(1.0)


@dataclass(frozen=True)
class ArmModel:
    """Lengths, m; limits of the joints as the controller counts them, rad and rad/s, (6,) or (6, 2).

    zero, sign: joint of the controller = zero + sign * joint of the model. shoulder, elbow, wrist: 1 for front, up,
    positive, -1 otherwise. wrist_min, elbow_min: rad, see ``ArmGeometry``. r_B, a_B: base in L, (3,) m, and
    its axes in L as rows; r_T, a_T: the tool in the flange frame, and the axes of c there as rows.
    """

    a1: float
    a2: float
    b: float
    c1: float
    c2: float
    c3: float
    c4: float
    zero: Array
    sign: Array
    travel: Array
    rate_max: Array
    shoulder: int
    elbow: int
    wrist: int
    wrist_min: float
    elbow_min: float
    shoulder_min: float
    twist_max: float
    r_B: Array
    a_B: Array
    r_T: Array
    a_T: Array
    link_radius: float | None = None

    def flange_of(self, r_L: Array, a_CL: Array) -> tuple[Array, Array]:
        """Return the flange in the base frame: position (3,), m, and its axes as columns, (3, 3).

        r_L: of the turntable's centre in L, m. a_CL: takes components in L to c.
        """
        axes = linear.product(linear.product(self.a_B, a_CL.T), self.a_T)
        position: Array = linear.product(self.a_B, r_L - self.r_B) - linear.product(axes, self.r_T)
        return position, axes

    def pose_of(self, r_F: Array, axes: Array) -> tuple[Array, Array]:
        """Return r_L (3,) and a_CL (3, 3) of a flange in the base frame, the inverse of ``flange_of``."""
        r_L = self.r_B + linear.product(self.a_B.T, r_F + linear.product(axes, self.r_T))
        return r_L, linear.product(self.a_T, linear.product(axes.T, self.a_B))

    def joints_of(self, r_F: Array, axes: Array, near: Array | None = None) -> Array:
        """Return the joints (6,), rad, in the configuration of the arm; whole turns as ``near`` has them.

        Raises Unreachable for a pose beyond the reach, at a singularity, or that a joint or the cables do not allow.
        """
        joints: Array = self.zero + self.sign * np.array(self._model_joints(r_F, axes))
        if near is None:  # the turn that is nearest to the middle of the travel
            near = self.travel.mean(axis=1)
        joints += _TURN * np.round((near - joints) / _TURN)
        self._check(joints)
        return joints

    def _model_joints(self, r_F: Array, axes: Array) -> tuple[float, ...]:
        a1, a2, b, c2, c3 = self.a1, self.a2, self.b, self.c2, self.c3
        x, y, z = (r_F - self.c4 * axes[:, 2]).tolist()
        beside = square(x) + square(y) - square(b)
        if beside <= 0.0 or hypot(x, y) < self.shoulder_min:
            raise Unreachable(
                f"the wrist is {hypot(x, y):.3f} m from axis 1, allowed from {self.shoulder_min:g} m (singular)"
            )
        nx = math.sqrt(beside) - a1
        if self.shoulder > 0:
            forward, q1 = nx, atan2(y, x) - atan2(b, nx + a1)
        else:
            forward, q1 = nx + 2.0 * a1, atan2(y, x) + atan2(b, nx + a1) - math.pi
        up = z - self.c1
        far, k = hypot(forward, up), hypot(a2, c3)
        if not abs(c2 - k) < far < c2 + k:
            raise Unreachable(f"the wrist is {far:.3f} m from axis 2, its reach is {abs(c2 - k):.3f} to {c2 + k:.3f} m")
        inner = acos((square(far) + square(c2) - square(k)) / (2.0 * far * c2))
        bend = acos((square(far) - square(c2) - square(k)) / (2.0 * c2 * k))  # 0 with the arm stretched
        if not self.elbow_min <= bend <= math.pi - self.elbow_min:
            raise Unreachable(
                f"the elbow is bent by {bend * _DEGREES:.1f} deg, allowed {self.elbow_min * _DEGREES:g} to "
                f"{180.0 - self.elbow_min * _DEGREES:g} deg (singular)"
            )
        side = self.elbow * self.shoulder
        if self.shoulder > 0:
            q2 = atan2(forward, up) - side * inner
        else:
            q2 = -atan2(forward, up) - side * inner
        q3 = side * bend - atan2(a2, c3)
        s1, k1, s23, k23 = sin(q1), cos(q1), sin(q2 + q3), cos(q2 + q3)
        (e11, e12, e13), (e21, e22, e23), (e31, e32, e33) = axes.tolist()
        m = min(1.0, max(-1.0, e13 * s23 * k1 + e23 * s23 * s1 + e33 * k23))
        q5 = atan2(math.sqrt(1.0 - m * m), m)
        if not self.wrist_min <= q5 <= math.pi - self.wrist_min:
            raise Unreachable(
                f"joint 5 is {min(q5, math.pi - q5) * _DEGREES:.1f} deg from a singular wrist, allowed from "
                f"{self.wrist_min * _DEGREES:g} deg"
            )
        q4 = atan2(e23 * k1 - e13 * s1, e13 * k23 * k1 + e23 * k23 * s1 - e33 * s23)
        q6 = atan2(e12 * s23 * k1 + e22 * s23 * s1 + e32 * k23, -e11 * s23 * k1 - e21 * s23 * s1 - e31 * k23)
        if self.wrist < 0:
            q4, q5, q6 = q4 + math.pi, -q5, q6 - math.pi
        return q1, q2, q3, q4, q5, q6

    def _check(self, joints: Array) -> None:
        """Raise Unreachable for joints (6,), rad, beyond their travel, or that twist the cables too far."""
        for number, (joint, (low, high)) in enumerate(zip(joints.tolist(), self.travel.tolist(), strict=True), 1):
            if not low <= joint <= high:
                raise Unreachable(
                    f"joint {number} at {joint * _DEGREES:.1f} deg, allowed {low * _DEGREES:g} to "
                    f"{high * _DEGREES:g} deg"
                )
        model = self.sign * (joints - self.zero)
        twist = float(model[3] + model[5])
        if abs(twist) > self.twist_max:
            raise Unreachable(
                f"joints 4 and 6 twist the cables by {twist * _DEGREES:.1f} deg, allowed {self.twist_max * _DEGREES:g}"
            )

    def check_rate(self, before: Array, joints: Array, duration_s: float) -> None:
        """Raise Unreachable if a joint would be too fast from ``before`` to ``joints``, (6,) rad each."""
        rates = np.abs(joints - before) / duration_s
        over = rates - self.rate_max
        if over.max() > 0.0:
            n = int(over.argmax())
            raise Unreachable(
                f"joint {n + 1} at {float(rates[n]) * _DEGREES:.1f} deg/s, allowed "
                f"{float(self.rate_max[n]) * _DEGREES:g} deg/s (near a singular pose)"
            )

    def points(self, joints: Array) -> list[Array]:
        """Return axis 2, axis 3, the wrist's centre and the flange in the base frame, (3,) each, m."""
        q1, q2, q3, q4, q5, _ = (self.sign * (joints - self.zero)).tolist()
        k = hypot(self.a2, self.c3)
        bend = q2 + q3 + atan2(self.a2, self.c3)
        plane = [
            (self.a1, self.c1),
            (self.a1 + self.c2 * sin(q2), self.c1 + self.c2 * cos(q2)),
            (self.a1 + self.c2 * sin(q2) + k * sin(bend), self.c1 + self.c2 * cos(q2) + k * cos(bend)),
        ]
        s1, k1, s23, k23 = sin(q1), cos(q1), sin(q2 + q3), cos(q2 + q3)
        found = [np.array([k1 * x - s1 * self.b, s1 * x + k1 * self.b, z]) for x, z in plane]
        x, y, z = cos(q4) * sin(q5), sin(q4) * sin(q5), cos(q5)  # flange in the frame of the forearm
        along = k23 * x + s23 * z
        found.append(found[2] + self.c4 * np.array([k1 * along - s1 * y, s1 * along + k1 * y, k23 * z - s23 * x]))
        return found

    def links(self, joints: Array) -> dict[str, Array]:
        """Return the ends of upper arm and forearm in L, (2, 3) each, m."""
        ends = self.r_B + np.array([linear.product(self.a_B.T, point) for point in self.points(joints)])
        return {"upper arm": ends[:2], "forearm": ends[1:3]}

    def flange_axes(self, joints: Array) -> Array:
        """Return the axes of the flange in the base frame as columns, (3, 3)."""
        q1, q2, q3, q4, q5, q6 = (self.sign * (joints - self.zero)).tolist()
        wrist = linear.product(_z(q4), linear.product(_y(q5), _z(q6)))
        turned: Array = linear.product(linear.product(_z(q1), _y(q2 + q3)), wrist)
        return turned


def _z(angle: float) -> Array:
    return np.array([[cos(angle), -sin(angle), 0.0], [sin(angle), cos(angle), 0.0], [0.0, 0.0, 1.0]])


def _y(angle: float) -> Array:
    return np.array([[cos(angle), 0.0, sin(angle)], [0.0, 1.0, 0.0], [-sin(angle), 0.0, cos(angle)]])
