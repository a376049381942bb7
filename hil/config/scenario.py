"""Scenario files: vehicle, sensors, initial state, GNC and requirements."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from hil.config.dispersions import Dispersions
from hil.config.docking_monitor import DockingMonitorConfig
from hil.config.live_tunable import LiveTuning
from hil.config.model import ConfigModel, Matrix3, Name, NotNegative, Positive, Triple
from hil.config.truth import Orbit, SolarArray, Truth
from hil.core.messages import MAX_PHASES, MAX_THRUSTERS

AngleTriple = tuple[
    Annotated[float, Field(gt=-180.0, le=180.0)],
    Annotated[float, Field(gt=-90.0, lt=90.0)],
    Annotated[float, Field(gt=-180.0, le=180.0)],
]


DURATION_MAX_S = 1e6
CYCLES_MAX = 5_000_000  # of a run, 28 h at 50 Hz: each leaves a record of 2 kB
Duration = Annotated[float, Field(gt=0.0, le=DURATION_MAX_S)]
Delay = Annotated[float, Field(ge=0.0, le=1.0)]
Probability = Annotated[float, Field(ge=0.0, lt=1.0)]


class Thrusters(ConfigModel):
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


class Chaser(ConfigModel):
    mass_kg: Positive
    inertia_kg_m2: Matrix3
    thrusters: Thrusters

    solar_array: SolarArray | None = None

    @field_validator("inertia_kg_m2")
    @classmethod
    def _inertia_is_one_of_a_body(cls, value: Matrix3) -> Matrix3:
        """The inertia of a body is symmetric, not singular, and no principal moment exceeds the sum of the others."""
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


class Initial(ConfigModel):
    """Initial state of the chaser relative to the target: 3-2-1 angles theta1 (roll), theta2, theta3."""

    position_m: Triple
    attitude_deg: AngleTriple
    velocity_mps: Triple = (0.0, 0.0, 0.0)
    rate_degps: Triple = (0.0, 0.0, 0.0)


class Imu(ConfigModel):
    """Sensor grade of the virtual IMU (bench paper Table I); *_initial_sigma_*: dispersion of the true values."""

    gyro_drift_degps: Triple
    gyro_drift_initial_sigma_degps: NotNegative
    gyro_drift_noise_degps2: NotNegative
    gyro_noise_degps: NotNegative
    accelerometer_bias_mps2: Triple
    accelerometer_bias_initial_sigma_mps2: NotNegative
    accelerometer_bias_noise_mps3: NotNegative
    accelerometer_noise_mps2: NotNegative


class RenderedImages(ConfigModel):
    """Rendered cameras, and lights other than the LEDs."""

    psf_sigma_px: Positive = 1.0
    led_diameter_m: Positive = 0.005
    led_flux_1m_levels: Positive = 25_000.0  # sum of grey levels of an LED's spot at 1 m
    background_levels: NotNegative = 12.0
    electrons_per_level: Positive = 100.0
    read_noise_levels: NotNegative = 0.8
    decoy_lights: Annotated[int, Field(ge=0, le=20)] = 0  # other lights on the target


class VisionNoise(ConfigModel):
    """Noise of the vision unit, Table I up to ``reference_range_m`` and proportional to range beyond, and the
    transport of its poses, which are time-stamped at exposure."""

    source: Literal["model", "rendered"] = "model"  # rendered: poses from images, rendered from the axis positions
    sigma_position_m: Positive
    sigma_angle_deg: Positive
    reference_range_m: Positive
    reported_sigma_scale: Positive = 1.0  # reported sigma over true sigma
    latency_s: Delay = 0.0
    latency_jitter_s: Delay = 0.0
    duplicate_probability: Probability = 0.0
    loss_probability: Probability = 0.0
    images: RenderedImages = RenderedImages()


class Navigation(ConfigModel):
    sensors: Literal["vision_imu", "vision"]
    gate_sigma: Positive  # innovations beyond this many sigma are rejected


class AttitudeFilter(ConfigModel):
    """Gyro model and attitude error definition of the AKF."""

    form: Literal["multiplicative", "as_printed"]
    gyro_noise_degps: Positive
    gyro_drift_noise_degps2: NotNegative
    gyro_drift_degps: Triple
    initial_drift_sigma_degps: Positive


class PositionFilter(ConfigModel):
    """Accelerometer model and initial covariance of the PKF."""

    accelerometer_noise_mps2: Positive
    accelerometer_bias_noise_mps3: NotNegative
    accelerometer_bias_mps2: Triple
    initial_bias_sigma_mps2: Positive
    initial_velocity_sigma_mps: Positive


class VisionOnly(ConfigModel):
    """Time constants of the low-passes of vision-only navigation."""

    position_lag_s: NotNegative
    velocity_lag_s: NotNegative
    attitude_lag_s: NotNegative
    rate_lag_s: NotNegative


class Shadow(ConfigModel):
    """filterpy's filters in parallel with the compiled ones; an alarm when they diverge."""

    enabled: bool
    position_limit_m: Positive
    attitude_limit_deg: Positive


class Phase(ConfigModel):
    """One phase of the approach; defaults come from the guidance table."""

    kind: Literal["approach", "hold", "wait", "final", "retreat"]
    point_m: Triple | None = None  # of a moving phase; default: the ready point
    speed_mps: Positive | None = None
    acceleration_mps2: Positive | None = None
    deceleration_mps2: Positive | None = None
    duration_s: NotNegative | None = None  # of a hold
    end_time_s: NotNegative | None = None  # of a wait; default: waits for the operator

    @model_validator(mode="after")
    def _keys_suit_the_kind(self) -> Self:
        moving = ("point_m", "speed_mps", "acceleration_mps2", "deceleration_mps2")
        allowed = {"hold": ("duration_s",), "wait": ("end_time_s",)}.get(self.kind, moving)
        given = [name for name in (*moving, "duration_s", "end_time_s") if getattr(self, name) is not None]
        foreign = [name for name in given if name not in allowed]
        if foreign:
            raise ValueError(f'{foreign[0]} does not go with kind = "{self.kind}", which takes: {", ".join(allowed)}')
        if self.kind == "hold" and self.duration_s is None:
            raise ValueError('kind = "hold" needs duration_s')
        if self.kind == "retreat" and self.point_m is None:
            raise ValueError('kind = "retreat" needs point_m')
        return self


class Guidance(ConfigModel):
    """Phases of the approach in their order."""

    ready_point_m: Triple
    approach_speed_mps: Positive
    acceleration_mps2: Positive
    deceleration_mps2: Positive
    slew_s: Positive = 10.0
    sequence: Annotated[tuple[str, ...], Field(min_length=1, max_length=MAX_PHASES)]
    phases: dict[str, Phase]

    @model_validator(mode="after")
    def _sequence_names_phases(self) -> Self:
        for name in self.sequence:
            if name not in self.phases:
                raise ValueError(f'sequence: "{name}" is no phase; known phases: {", ".join(self.phases)}')
        return self


class Corridor(ConfigModel):
    """Approach corridor about the line of the phase, and limit of the closing rate."""

    axis: Triple = (1.0, 0.0, 0.0)
    half_angle_deg: Annotated[float, Field(gt=0.0, lt=90.0)]
    minimum_radius_m: Positive
    closing_rate_mps: Positive
    closing_rate_slope_per_s: NotNegative
    closing_rate_max_mps: Positive
    confidence: NotNegative = 3.0
    persistence_s: NotNegative

    @model_validator(mode="after")
    def _axis_is_a_unit_vector(self) -> Self:
        if abs(math.hypot(*self.axis) - 1.0) > 1e-6:
            raise ValueError(f"axis = {list(self.axis)} must be a unit vector")
        return self


class Abort(ConfigModel):
    """Brake, retreat along the corridor's axis, hold; ``at_s``: time of a rehearsal."""

    brake_mps2: Positive
    hold_distance_m: Positive
    speed_mps: Positive
    acceleration_mps2: Positive
    at_s: NotNegative | None = None


class Control(ConfigModel):
    """Phase planes of position and attitude; each axis is updated once per period."""

    deadband_m: Positive
    lead_s: Positive
    period_s: Positive
    deadband_sigmas: NotNegative = 0.0
    correction_rate_mps: Positive = 0.05
    deadband_deg: Positive
    attitude_lead_s: Positive
    attitude_period_s: Positive
    attitude_deadband_sigmas: NotNegative = 0.0
    slew_rate_degps: Positive = 0.6


class GncConfig(ConfigModel):
    """GNC of the chaser. library: shared library that replaces the built-in navigation, guidance and control."""

    library: str | None = None
    navigation: Navigation
    akf: AttitudeFilter
    pkf: PositionFilter
    vision_only: VisionOnly
    shadow: Shadow
    guidance: Guidance
    corridor: Corridor
    abort: Abort
    control: Control


class Requirements(ConfigModel):
    """Requirements of the ready phase (bench paper Table III), per axis, and the propellant budget."""

    axial_distance_m: Positive
    axial_tolerance_m: Positive
    axial_rate_mps: Positive
    radial_distance_m: Positive
    radial_rate_mps: Positive
    angle_deg: Positive
    angular_rate_degps: Positive
    dwell_s: Positive
    propellant_factor: Positive = 3.0  # propellant of the run over the impulsive minimum of reference and slews


class Reachability(ConfigModel):
    """Margins about the plan for the reachability check (docs/explanation/reachability.md)."""

    corridor_fraction: NotNegative = 0.5  # of the corridor's half angle, in addition to Table III
    attitude_margin_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 1.0
    startup_lag_s: NotNegative = 0.2


class Scenario(ConfigModel):
    """One closed-loop run, independent of the rig."""

    name: Name
    duration_s: Duration
    step_s: Annotated[float, Field(ge=1e-4, le=1.0)]
    orbit: Orbit
    truth: Truth = Truth()
    chaser: Chaser
    initial: Initial
    imu: Imu
    vmu: VisionNoise
    gnc: GncConfig
    requirements: Requirements
    reachability: Reachability = Reachability()
    monitor: DockingMonitorConfig = DockingMonitorConfig()
    dispersions: Dispersions = Dispersions()
    console: LiveTuning = LiveTuning()
