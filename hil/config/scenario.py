"""Scenario files: the vehicle, its sensors, where it starts, how it is flown, and what is asked of it."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hil.config.model import (
    Matrix3,
    NotNegative,
    Positive,
    Strict,
    Triple,
)
from hil.config.truth import Orbit, SolarArray, Truth
from hil.messages import MAX_THRUSTERS

AngleTriple = tuple[
    Annotated[float, Field(gt=-180.0, le=180.0)],
    Annotated[float, Field(gt=-90.0, lt=90.0)],
    Annotated[float, Field(gt=-180.0, le=180.0)],
]


Delay = Annotated[float, Field(ge=0.0, le=1.0)]
Share = Annotated[float, Field(ge=0.0, lt=1.0)]


class Thrusters(Strict):
    """On/off thrusters, in c; positions from the reference point, directions of the force on the vehicle."""

    force_n: Positive
    minimum_on_s: NotNegative
    specific_impulse_s: Positive
    position_m: Annotated[tuple[Triple, ...], Field(min_length=1, max_length=MAX_THRUSTERS)]
    direction: tuple[Triple, ...]

    @model_validator(mode="after")
    def _one_direction_each(self) -> Self:
        if len(self.direction) != len(self.position_m):
            raise ValueError(f"{len(self.position_m)} position_m, but {len(self.direction)} direction: one each")
        for number, vector in enumerate(self.direction, start=1):
            if abs(math.hypot(*vector) - 1.0) > 1e-6:
                raise ValueError(f"direction {number} = {list(vector)} must be a unit vector")
        return self


class Chaser(Strict):
    mass_kg: Positive
    inertia_kg_m2: Matrix3
    thrusters: Thrusters

    solar_array: SolarArray | None = None

    @field_validator("inertia_kg_m2")
    @classmethod
    def _inertia_is_one_of_a_body(cls, value: Matrix3) -> Matrix3:
        """A body's inertia is symmetric, not singular, and no principal moment exceeds the sum of the others."""
        j = np.array(value)
        shown = [list(row) for row in value]
        if np.abs(j - j.T).max() > 1e-9 * np.abs(j).max():
            raise ValueError(f"{shown}: must be symmetric")
        moments = np.linalg.eigvalsh(j)
        if moments[0] <= 1e-9 * abs(moments[2]):
            raise ValueError(f"{shown}: is singular or not positive definite, every principal moment must be above 0")
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            largest, others = f"{moments[2]:.6g}", f"{moments[0]:.6g} + {moments[1]:.6g}"
            raise ValueError(f"{shown}: principal moment {largest} must not exceed the sum of the others, {others}")
        return value


class Initial(Strict):
    """Where the chaser starts, relative to the target: 3-2-1 angles theta1 (roll), theta2, theta3."""

    position_m: Triple
    attitude_deg: AngleTriple
    velocity_mps: Triple = (0.0, 0.0, 0.0)
    rate_degps: Triple = (0.0, 0.0, 0.0)


class Imu(Strict):
    """Sensor grade of the virtual IMU (bench paper Table I); *_initial_sigma_*: how the true values spread."""

    gyro_drift_degps: Triple
    gyro_drift_initial_sigma_degps: NotNegative
    gyro_drift_noise_degps2: NotNegative
    gyro_noise_degps: NotNegative
    accelerometer_bias_mps2: Triple
    accelerometer_bias_initial_sigma_mps2: NotNegative
    accelerometer_bias_noise_mps3: NotNegative
    accelerometer_noise_mps2: NotNegative


class VisionNoise(Strict):
    """Noise of the vision unit, Table I up to ``reference_range_m`` and growing in proportion beyond, and
    how its poses travel: they belong to their exposure, however late they come."""

    sigma_position_m: Positive
    sigma_angle_deg: Positive
    reference_range_m: Positive
    reported_sigma_scale: Positive = 1.0  # what the unit says of its noise against what it is
    latency_s: Delay = 0.0
    latency_jitter_s: Delay = 0.0
    duplicate_share: Share = 0.0
    loss_share: Share = 0.0


class Navigation(Strict):
    sensors: Literal["vision_imu", "vision"]
    gate_sigma: Positive  # innovations that are rarer than this many sigma are not let in


class AttitudeFilter(Strict):
    """What the AKF believes of the gyro, and how it takes the attitude's error."""

    form: Literal["multiplicative", "as_printed"]
    gyro_noise_degps: Positive
    gyro_drift_noise_degps2: NotNegative
    gyro_drift_degps: Triple
    initial_drift_sigma_degps: Positive


class PositionFilter(Strict):
    """What the PKF believes of the accelerometer and of the start."""

    accelerometer_noise_mps2: Positive
    accelerometer_bias_noise_mps3: NotNegative
    accelerometer_bias_mps2: Triple
    initial_bias_sigma_mps2: Positive
    initial_velocity_sigma_mps: Positive


class VisionOnly(Strict):
    """Time constants of the low-passes of vision-only navigation."""

    position_lag_s: NotNegative
    velocity_lag_s: NotNegative
    attitude_lag_s: NotNegative
    rate_lag_s: NotNegative


class Shadow(Strict):
    """filterpy's filters beside the compiled ones, with an alarm when the two part."""

    enabled: bool
    position_limit_m: Positive
    attitude_limit_deg: Positive


class Guidance(Strict):
    """A straight line from the start to the ready point, rest to rest."""

    ready_point_m: Triple
    approach_speed_mps: Positive
    acceleration_mps2: Positive
    deceleration_mps2: Positive


class Control(Strict):
    """Phase planes of position and attitude; an axis decides once a period."""

    deadband_m: Positive
    lead_s: Positive
    period_s: Positive
    deadband_deg: Positive
    attitude_lead_s: Positive
    attitude_period_s: Positive


class Gnc(Strict):
    navigation: Navigation
    akf: AttitudeFilter
    pkf: PositionFilter
    vision_only: VisionOnly
    shadow: Shadow
    guidance: Guidance
    control: Control


class Requirements(Strict):
    """What the ready phase must keep (bench paper Table III); each axis alone."""

    axial_distance_m: Positive
    axial_tolerance_m: Positive
    axial_rate_mps: Positive
    radial_distance_m: Positive
    radial_rate_mps: Positive
    angle_deg: Positive
    angular_rate_degps: Positive
    dwell_s: Positive


class Scenario(Strict):
    """One closed-loop run, whatever the rig."""

    name: str
    duration_s: Positive
    step_s: Positive
    orbit: Orbit
    truth: Truth = Truth()
    chaser: Chaser
    initial: Initial
    imu: Imu
    vmu: VisionNoise
    gnc: Gnc
    requirements: Requirements
