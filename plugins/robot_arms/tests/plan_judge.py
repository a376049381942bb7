"""Judge of plans that shares nothing with the check that it judges: ``python plan_judge.py PLANS.json``.

Needs roboticstoolbox-python 1.5.0 with rtb-data 2.0.0, not hil. Reach and joints by Newton's method with the toolbox's
Jacobian, along the path; singularity, twist of the cables, links and speeds by formulas of its own. Prints for each
plan the least margin, deg or cm (negative: cannot be followed), and what has it.
"""

from __future__ import annotations

import json
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import roboticstoolbox as rtb  # type: ignore[import-not-found]
from numpy.typing import NDArray

Array = NDArray[np.float64]
ET = rtb.ET
APPROACH_STEPS, ABORT_STEPS, LEAST_S = 10, 4, 0.2
STARTS, ITERATIONS, JUMP_RAD = 400, 30, 1.5


def rotation(vector: Array) -> Array:
    """Return the matrix of a rotation vector, rad (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


class Judge:
    """One plan and its robot."""

    def __init__(self, given: dict[str, Any]) -> None:
        self.geometry, self.bodies, self.plan = given["geometry"], given["bodies"], given["plan"]
        self.least_m, g = given["least_m"], given["geometry"]
        d = {key.removesuffix("_m"): value for key, value in g["lengths"].items()}
        self.shoulder = ET.Rz() * ET.tz(d["c1"]) * ET.tx(d["a1"]) * ET.ty(d["b"])
        self.elbow = self.shoulder * ET.Ry() * ET.tz(d["c2"])
        self.wrist = self.elbow * ET.Ry() * ET.tx(d["a2"]) * ET.tz(d["c3"])
        self.arm = self.wrist * ET.Rz() * ET.Ry() * ET.Rz() * ET.tz(d["c4"])
        self.base, self.tool = np.array(g["base_axes"]), np.array(g["tool_axes"])
        self.zero, self.sign = np.radians(g["zero_deg"]), np.array(g["signs"], float)
        self.travel = np.radians(g["joint_travel_deg"])

    def flange(self, pose: Array) -> Array:
        """Return the flange in the base frame, (4, 4), for position, m, and rotation vector, rad, of c in L."""
        matrix = np.eye(4)
        matrix[:3, :3] = self.base @ rotation(pose[3:]) @ self.tool
        away = self.base @ (pose[:3] - np.array(self.geometry["base_m"]))
        matrix[:3, 3] = away - matrix[:3, :3] @ np.array(self.geometry["tool_m"])
        return matrix

    def solved(self, flange: Array, joints: Array) -> Array | None:
        """Return the joints of ``flange`` by Newton's method from ``joints``; None if it does not converge."""
        for _ in range(ITERATIONS):
            at = self.arm.eval(joints)
            turn = flange[:3, :3] @ at[:3, :3].T
            axis = 0.5 * np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
            sine = float(np.linalg.norm(axis))
            angle = np.arctan2(sine, 0.5 * (np.trace(turn) - 1.0)) / sine if sine > 1e-12 else 1.0
            error = np.concatenate([flange[:3, 3] - at[:3, 3], axis * angle])
            if np.abs(error).max() < 1e-9:
                return joints
            step = np.linalg.lstsq(self.arm.jacob0(joints), error, rcond=1e-12)[0]
            joints = joints + min(1.0, 0.3 / np.abs(step).max()) * step
        return None

    def points(self, joints: Array) -> list[Array]:
        """Return axis 2, axis 3 and the wrist's centre in the base frame, m."""
        chains = ((self.shoulder, 1), (self.elbow, 2), (self.wrist, 3))
        return [chain.eval(joints[:n])[:3, 3] for chain, n in chains]

    def is_configured(self, joints: Array) -> bool:
        """Return whether the arm reaches forward with the elbow up and joint 5 positive."""
        ahead = np.array([np.cos(joints[0]), np.sin(joints[0]), 0.0])
        shoulder, elbow, wrist = self.points(joints)
        (x, z), (u, w) = ((float(ahead @ p), float(p[2])) for p in (wrist - shoulder, elbow - shoulder))
        return bool(ahead @ wrist > 0.0 and x * w - z * u > 0.0 and (joints[4] + np.pi) % (2.0 * np.pi) > np.pi)

    def start(self, flange: Array) -> Array | None:
        """Return the joints of the first flange, in the turn nearest to the middle of their travel."""
        draws = np.random.default_rng(0)
        for _ in range(STARTS):
            low, high = np.array([-np.pi, -1.5, -0.5, *3 * [-np.pi]]), np.array([np.pi, 1.5, 2.8, *3 * [np.pi]])
            joints = self.solved(flange, draws.uniform(low, high))
            if joints is not None and self.is_configured(joints):
                middle = self.sign * (self.travel.mean(axis=1) - self.zero)
                return joints + 2.0 * np.pi * np.round((middle - joints) / (2.0 * np.pi))
        return None

    def margin(self, joints: Array, before: Array | None, span_s: float) -> tuple[float, str]:
        """Return the least margin, deg or cm, and its name."""
        g, counted = self.geometry, self.zero + self.sign * joints
        room = np.degrees(np.minimum(counted - self.travel[:, 0], self.travel[:, 1] - counted))
        margins = [(float(room[n]), f"joint {n + 1}") for n in range(6)]
        fifth = abs((joints[4] + np.pi) % (2.0 * np.pi) - np.pi)
        margins.append((float(np.degrees(min(fifth, np.pi - fifth))) - g["wrist_angle_min_deg"], "wrist"))
        shoulder, elbow, wrist = self.points(joints)
        upper, fore = elbow - shoulder, wrist - elbow
        cosine = upper @ fore / np.linalg.norm(upper) / np.linalg.norm(fore)
        bend, least = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))), g["elbow_angle_min_deg"]
        margins.append((min(bend, 180.0 - bend) - least, "elbow"))
        margins.append((100.0 * float(np.hypot(*wrist[:2]) - g["shoulder_distance_min_m"]), "shoulder"))
        margins.append((g["twist_max_deg"] - float(abs(np.degrees(joints[3] + joints[5]))), "twist"))
        if before is not None:
            rates = np.degrees(np.abs(joints - before) / max(span_s, LEAST_S))
            margins.append((float((np.array(g["joint_rate_max_degps"]) - rates).min()), "speed"))
        ends = [np.array(g["base_m"]) + self.base.T @ each for each in (shoulder, elbow, wrist)]
        return min([*margins, *self._clearances(ends)])

    def _clearances(self, ends: list[Array]) -> list[tuple[float, str]]:
        """Return the margins of both links to boxes, by points along the links."""
        radius = self.geometry["link_radius_m"]
        clearances = []
        for first, last in pairwise(ends):
            along = first + (last - first) * np.linspace(0.0, 1.0, 60)[:, None]
            for vertices, rounding in self.bodies if radius is not None else ():
                low, high = np.min(vertices, axis=0), np.max(vertices, axis=0)
                away = np.linalg.norm(np.maximum(np.maximum(low - along, along - high), 0.0), axis=1).min()
                clearances.append((100.0 * float(away - radius - rounding - self.least_m), "link"))
        return clearances

    def judged(self) -> tuple[float, str]:
        """Return the least margin of the whole plan, aborts included."""
        worst: tuple[float, str] = (1e9, "none")
        approach: dict[float, tuple[Any, Any]] = {}
        before: Any = None
        joints: Any = None
        for t_s, abort_s, *values in self.plan:
            pose = np.array(values)
            if abort_s is not None and (before is None or before[1] != abort_s or t_s < before[0]):
                before, joints = approach[abort_s]
            if before is None:
                joints = self.start(self.flange(pose))
                if joints is None:
                    return -99.0, "reach"
                worst = min(worst, self.margin(joints, None, 1.0))
            else:
                steps = APPROACH_STEPS if abort_s is None else ABORT_STEPS
                for fraction in np.linspace(0.0, 1.0, steps + 1)[1:]:
                    reached = self.solved(self.flange(before[2] + fraction * (pose - before[2])), joints)
                    if reached is None or np.abs(reached - joints).max() > JUMP_RAD:
                        return (-99.0, "reach") if worst[0] > 0.0 else worst
                    worst = min(worst, self.margin(reached, joints, (t_s - before[0]) / steps))
                    joints = reached
            if worst[0] < -2.0:
                return worst
            before = t_s, abort_s, pose
            if abort_s is None:
                approach[t_s] = before, joints
        return worst


if __name__ == "__main__":
    for line in Path(sys.argv[1]).read_text(encoding="utf-8").splitlines():
        sys.stdout.write(json.dumps(Judge(json.loads(line)).judged()) + "\n")
        sys.stdout.flush()
