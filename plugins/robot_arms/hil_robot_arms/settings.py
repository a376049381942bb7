"""Table ``geometry`` of a robot in a rig file."""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from hil.config.tables.arm import Arm
from hil.config.tables.model import ConfigModel, Matrix3, NotNegative, Positive, Triple
from hil_robot_arms.model import ArmModel

Pair = tuple[float, float]
SixPairs = tuple[Pair, Pair, Pair, Pair, Pair, Pair]
SixRates = tuple[Positive, Positive, Positive, Positive, Positive, Positive]
Six = tuple[float, float, float, float, float, float]
Sign = Literal[1, -1]
Signs = tuple[Sign, Sign, Sign, Sign, Sign, Sign]
UNIT: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_SIDES = {"front": 1, "back": -1, "up": 1, "down": -1, "positive": 1, "negative": -1}


class ArmLengths(ConfigModel):
    """Lengths of an arm with an ortho-parallel base and a spherical wrist, as in its data sheet."""

    a1_m: float
    """Axis 1 to axis 2, forward."""
    a2_m: float
    """Axis 3 to the axis of the forearm, downward with the forearm forward."""
    b_m: float = 0.0
    """Offset of the arm to the side."""
    c1_m: float
    """Base to axis 2, upward."""
    c2_m: Positive
    """Axis 2 to axis 3."""
    c3_m: Positive
    """Axis 3 to the centre of the wrist, along the forearm."""
    c4_m: NotNegative
    """Centre of the wrist to the flange."""


class ArmGeometry(ConfigModel):
    """Where the robot stands, its lengths and joints, and what they may not."""

    base_m: Triple
    """In L: origin of the robot's base frame."""
    base_axes: Matrix3 = UNIT
    """Rows: axes of the base frame in L."""
    tool_m: Triple
    """In the flange frame: the point that stands for the turntable's centre of rotation."""
    tool_axes: Matrix3 = UNIT
    """Rows: axes of c in the flange frame."""
    lengths: ArmLengths
    zero_deg: Six = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    """Angles of the controller's joints where the model's are 0: arm upright, forearm and flange upward."""
    signs: Signs = (1, 1, 1, 1, 1, 1)
    """Direction of the controller's joints against the model's."""
    joint_travel_deg: SixPairs
    """Low and high end of each joint, as the controller counts it."""
    joint_rate_max_degps: SixRates
    """Speed limit of each joint."""
    shoulder: Literal["front", "back"] = "front"
    """Whether the arm reaches forward, or backward over itself."""
    elbow: Literal["up", "down"] = "up"
    """Configuration of axis 3."""
    wrist: Literal["positive", "negative"] = "positive"
    """Sign of the model's joint 5."""
    wrist_angle_min_deg: Annotated[float, Field(ge=0.1, le=45.0)] = 5.0
    """Least magnitude of joint 5: at 0 joints 4 and 6 rotate about the same axis."""
    elbow_angle_min_deg: Annotated[float, Field(ge=0.1, le=45.0)] = 5.0
    """Least angle of the elbow from the stretched and from the folded arm."""
    shoulder_distance_min_m: Positive = 0.1
    """Least distance of the wrist's centre from axis 1."""
    twist_max_deg: Positive = 270.0
    """Largest twist of the cables to the flange: the sum of joints 4 and 6, whole turns counted."""
    link_radius_m: Positive | None = None
    """Radius of upper arm and forearm, which must stay clear of bodies of the lab; unless set, they are not checked."""

    @model_validator(mode="after")
    def _axes_and_travels_are_possible(self) -> ArmGeometry:
        for name in ("base_axes", "tool_axes"):
            axes = np.array(getattr(self, name))
            if np.abs(axes @ axes.T - np.eye(3)).max() > 1e-6 or np.linalg.det(axes) < 0.0:
                raise ValueError(f"{name} must be three right-handed unit axes at right angles")
        for number, (low, high) in enumerate(self.joint_travel_deg, 1):
            if low >= high:
                raise ValueError(f"joint_travel_deg: joint {number} must rise from low to high")
        return self


def arm_model(arm: Arm) -> ArmModel:
    """Return the model of the robot of ``[arm]``, whose driver's table has a table ``geometry``."""
    given: ArmGeometry = arm.settings.geometry
    return ArmModel(
        **{name.removesuffix("_m"): value for name, value in given.lengths},
        zero=np.radians(given.zero_deg),
        sign=np.array(given.signs, float),
        travel=np.radians(given.joint_travel_deg),
        rate_max=np.radians(given.joint_rate_max_degps),
        shoulder=_SIDES[given.shoulder],
        elbow=_SIDES[given.elbow],
        wrist=_SIDES[given.wrist],
        wrist_min=float(np.radians(given.wrist_angle_min_deg)),
        elbow_min=float(np.radians(given.elbow_angle_min_deg)),
        shoulder_min=given.shoulder_distance_min_m,
        twist_max=float(np.radians(given.twist_max_deg)),
        r_B=np.array(given.base_m),
        a_B=np.array(given.base_axes),
        r_T=np.array(given.tool_m),
        a_T=np.array(given.tool_axes),
        link_radius=given.link_radius_m,
    )
