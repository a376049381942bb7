"""Scenario files: vehicle, sensors, initial state, GNC and requirements."""

from __future__ import annotations

import json
import math
from typing import Annotated, Final, Literal, Self, get_args

import numpy as np
from pydantic import Field, field_validator, model_validator

from hil.config.live_tunable import BACKEND_SETTINGS, live_ranges
from hil.config.tables.dispersions import Dispersions
from hil.config.tables.docking_monitor import DockingMonitorConfig
from hil.config.tables.error_models import ErrorBudget, ImuErrors, ThrusterErrors, VisionErrors
from hil.config.tables.faults import TimedFault
from hil.config.tables.guard import KeepOut
from hil.config.tables.machine import BenchScale
from hil.config.tables.model import (
    AngleTriple,
    ConfigModel,
    Delay,
    Live,
    Matrix3,
    Name,
    NotNegative,
    Positive,
    Probability,
    Triple,
)
from hil.config.tables.open_table import FileTable
from hil.config.tables.sensors import SensorConfig, device_of
from hil.config.tables.target import KnownTarget, MovingTarget
from hil.config.tables.truth import Ephemeris, KnownMode, ModelFmu, Orbit, SolarArray, ThrusterModel, Truth
from hil.config.tables.verdict import PART_COLUMNS, Integrity
from hil.core.gnc_records import MAX_SETTINGS
from hil.core.messages import MAX_FAULTS, MAX_MODES, MAX_PHASES, MAX_THRUSTERS
from hil.core.sensor_records import ADDED_SENSORS_MAX
from hil.errors import did_you_mean
from hil.maths import linear

DURATION_MAX_S = 1e6
CYCLES_MAX = 5_000_000  # cycles of a run with a duration, 28 h at 50 Hz: 2 kB each in a recording
Duration = Annotated[float, Field(gt=0.0, le=DURATION_MAX_S)]


class Thrusters(ConfigModel):
    """On/off thrusters, in c; positions from the reference point, directions of the force on the vehicle."""

    force_n: Positive
    """Nominal force of each thruster."""
    minimum_on_s: NotNegative
    """Shortest burn."""
    specific_impulse_s: Positive
    """Specific impulse."""
    position_m: Annotated[tuple[Triple, ...], Field(min_length=1, max_length=MAX_THRUSTERS)]
    """Positions in c, from the reference point."""
    direction: tuple[Triple, ...]
    """Unit vectors in c of the force on the vehicle."""
    isolation: Literal["none", "each", "bank"] = "none"
    """Isolation valves upstream of the thrusters' own: none, one per thruster, or one per bank."""
    isolation_closing_s: Annotated[float, Field(ge=0.0, le=10.0)] = 0.5
    """Time that an isolation valve takes to close; it does not open again."""
    bank: tuple[Annotated[int, Field(ge=1, le=MAX_THRUSTERS)], ...] = ()
    """Bank of each thruster."""
    errors: ThrusterErrors = ThrusterErrors.model_construct()

    @model_validator(mode="after")
    def _one_direction_each(self) -> Self:
        if len(self.direction) != len(self.position_m):
            raise ValueError(f"{len(self.position_m)} position_m, but {len(self.direction)} direction: one each")
        if self.isolation == "bank" and len(self.bank) != len(self.position_m):
            raise ValueError(
                f'isolation = "bank" with {len(self.bank)} bank: needs one per thruster, {len(self.position_m)}'
            )
        for number, vector in enumerate(self.direction, start=1):
            if abs(linear.length(vector) - 1.0) > 1e-6:
                raise ValueError(f"direction {number} = {list(vector)} must be a unit vector")
        return self


class Chaser(ConfigModel):
    """Mass properties of the chaser."""

    mass_kg: Positive
    """Nominal mass at the start."""
    inertia_kg_m2: Matrix3
    """Nominal inertia in c about the reference point."""
    propellant_gyration_m: tuple[NotNegative, NotNegative, NotNegative] = (0.0, 0.0, 0.0)
    """Radius of gyration of the propellant about each axis of c; what is used takes its inertia along, none if 0."""
    planar: bool = False
    """Moves in a plane of H and turns about its normal alone, as on a level floor: truth and demands are held in it."""
    plane: Literal["xz", "xy"] = "xz"
    """Of H, of a planar chaser. Free motion leaves xy, by the Coriolis acceleration; what is held back is reported."""
    thrusters: Thrusters

    solar_array: SolarArray | None = None

    @property
    def held(self) -> int:
        """Axis of H along which a planar chaser is held: 1 x, 2 y, 3 z; 0: it moves in space."""
        return 0 if not self.planar else 2 if self.plane == "xz" else 3

    @field_validator("inertia_kg_m2")
    @classmethod
    def _inertia_is_one_of_a_body(cls, value: Matrix3) -> Matrix3:
        """The inertia of a body is symmetric, not singular, and no principal moment exceeds the sum of the others."""
        j = np.array(value)
        shown = [list(row) for row in value]
        if np.abs(j - j.T).max() > 1e-9 * np.abs(j).max():
            raise ValueError(f"{shown}: must be symmetric")
        moments = linear.eigenvalues(j)
        if moments[0] <= 1e-9 * abs(moments[2]):
            raise ValueError(f"{shown}: is singular or not positive definite, every principal moment must be above 0")
        if moments[2] > (moments[0] + moments[1]) * (1.0 + 1e-9):
            largest, others = f"{moments[2]:.6g}", f"{moments[0]:.6g} + {moments[1]:.6g}"
            raise ValueError(f"{shown}: principal moment {largest} must not exceed the sum of the others, {others}")
        return value


class Initial(ConfigModel):
    """Initial state of the chaser relative to the target: 3-2-1 angles theta1 (roll), theta2, theta3."""

    position_m: Triple
    """Chaser relative to target in H."""
    attitude_deg: AngleTriple
    """3-2-1 angles theta1 (roll), theta2 (pitch), theta3 (yaw) from H to c."""
    velocity_mps: Triple = (0.0, 0.0, 0.0)
    """In H."""
    rate_degps: Triple = (0.0, 0.0, 0.0)
    """Rate of c relative to H, in c."""


class Imu(ModelFmu):
    """Sensor grade of the virtual IMU (bench paper Table I); *_initial_sigma_*: dispersion of the true values."""

    gyro_drift_degps: Triple
    """Mean initial drift of the gyros."""
    gyro_drift_initial_sigma_degps: NotNegative
    """Dispersion of the initial drift, drawn once per run."""
    gyro_drift_noise_degps2: NotNegative
    """Random walk of the drift."""
    gyro_noise_degps: NotNegative
    """Noise of a sample."""
    accelerometer_bias_mps2: Triple
    """Mean initial bias of the accelerometers."""
    accelerometer_bias_initial_sigma_mps2: NotNegative
    """Dispersion of the initial bias, drawn once per run."""
    accelerometer_bias_noise_mps3: NotNegative
    """Random walk of the bias."""
    accelerometer_noise_mps2: NotNegative
    """Noise of a sample."""
    rate_hz: Positive | None = None
    """Samples per second, a multiple of the cycle's rate; unless set, one sample per cycle."""
    errors: ImuErrors = ImuErrors.model_construct()


class RenderedImages(ConfigModel):
    """Rendered cameras, and lights other than the LEDs."""

    psf_sigma_px: Positive = 1.0
    """Point spread of the lens, 1 sigma."""
    led_diameter_m: Positive = 0.005
    """Diameter of an LED."""
    led_flux_1m_levels: Positive = 25_000.0
    """Sum of grey levels of an LED's spot at 1 m."""
    background_levels: NotNegative = 12.0
    """Background."""
    electrons_per_level: Positive = 100.0
    """Electrons per grey level: shot noise."""
    read_noise_levels: NotNegative = 0.8
    """Read noise, 1 sigma."""
    decoy_lights: Annotated[int, Field(ge=0, le=20)] = 0
    """Other lights on the target."""


class VisionNoise(ConfigModel):
    """Noise of the vision unit, Table I up to ``reference_range_m`` and proportional to range beyond, and the
    transport of its poses, which are time-stamped at exposure."""

    source: Literal["model", "rendered", "cameras"] = "model"
    """Poses with the noise below, computed from images that are rendered at the axis positions, or from the cameras
    of a rig on wires, `rig.vmu.cameras`."""
    sigma_position_m: Positive
    """Noise of the position, per axis, up to the reference range."""
    sigma_angle_deg: Positive
    """Noise of the attitude, per axis, up to the reference range."""
    reference_range_m: Positive
    """Range beyond which the noise is proportional to range."""
    reported_sigma_scale: Positive = 1.0
    """Reported over true sigma; 1 is a consistent unit."""
    latency_s: Delay = 0.0
    """Delay from exposure to arrival, in addition to the delay of the rig's wires."""
    latency_jitter_s: Delay = 0.0
    """Largest random addition to it."""
    duplicate_probability: Probability = 0.0
    """Of a pose to arrive twice."""
    loss_probability: Probability = 0.0
    """Of a pose to be lost."""
    images: RenderedImages = RenderedImages.model_construct()
    errors: VisionErrors = VisionErrors.model_construct()


BUILTIN: Final = "builtin"
VISION_ALONE: Final = "vision_alone"
PREDICTIVE: Final = "predictive"
BUILT_IN: Final = {"navigation": (BUILTIN, VISION_ALONE), "control": (BUILTIN, PREDICTIVE)}
"""Names of the built-in backends, by the part of the GNC."""
Settings = Annotated[dict[str, float], Field(max_length=MAX_SETTINGS)]


class CommandedThrust(ConfigModel):
    """What the filters make of the thrusters that are commanded."""

    enabled: bool = True
    """The specific force of a step without thrust is known, and the accelerometer measures its bias in it."""
    disturbance_mps2: Positive = 1e-4
    """Specific force without thrust, 1 sigma at the start: a leak, solar pressure."""
    disturbance_walk_mps2: NotNegative = 1e-6
    """Its random walk over a minute."""
    velocity_noise_mps: Positive = 2e-6
    """Change of the velocity within a second that neither thrust nor disturbance explain, 1 sigma."""
    scale_sigma: Positive = 0.05
    """Relative error of a commanded thrust: mass, supply pressure, valves. It counts without a sound IMU."""
    settle_s: NotNegative = 0.2
    """After a command, in which a valve may still be open."""
    rate_noise_degps: Positive = 2e-3
    """Change of the rate within a second that the commanded torques do not explain, 1 sigma, without a sound IMU."""
    rate_sigma_degps: Positive = 0.1
    """Rate at the start, 1 sigma, of navigation without an IMU."""


class Handover(ConfigModel):
    """Start of the filters by what an earlier navigation hands over, instead of by the first pose of the vision unit.

    They start at the planned start with these standard deviations; `gnc.pkf.initial_velocity_sigma_mps` is that of the
    velocity.
    """

    sigma_m: Positive
    """Standard deviation of the position, per axis."""
    sigma_deg: Positive
    """Standard deviation of the attitude, per axis."""


class Navigation(ConfigModel):
    """Backend of navigation, and the gate of the innovations of the built-in ones."""

    backend: Annotated[str, Field(min_length=1)] = BUILTIN
    """Fusion of poses and IMU (`builtin`), `vision_alone`, or one of your own: `package:name` of an entry point,
    `file.py:name`, a shared library (`.so`), or an FMU (`.fmu`)."""
    settings: Settings = Field(default_factory=dict)
    """Settings that a backend of your own declares."""
    gate_sigma: Annotated[Positive, Live(2.0, 10.0)]
    """Poses with a larger innovation are rejected and counted."""
    noise_scale: Annotated[float, Field(ge=0.1, le=10.0), Live(0.1, 10.0)] = 1.0
    """Standard deviations that poses report are taken times this factor."""
    memory_s: Positive = 1.28
    """Time for which samples and filters are kept: an older pose cannot be fused at its exposure and is discarded."""
    budget: ErrorBudget = ErrorBudget.model_construct()
    """Sizes of the sensors' errors, for the filters."""
    handover: Handover | None = None
    """Start without a pose: what another navigation hands over."""
    thrust: CommandedThrust = CommandedThrust.model_construct()
    """Use of the commanded thrust."""


class AttitudeFilter(ConfigModel):
    """Gyro model of the AKF."""

    gyro_noise_degps: Annotated[Positive, Live(1e-8, 1.0)]
    """Noise of a gyro sample."""
    gyro_quantum_degps: NotNegative = 0.0
    """Resolution of a gyro sample, by the data sheet: what it cuts off comes with the next ones."""
    gyro_drift_noise_degps2: Annotated[NotNegative, Live(0.0, 0.1)]
    """Random walk of the drift."""
    gyro_drift_degps: Triple
    """Initial estimate of the drift."""
    initial_drift_sigma_degps: Positive
    """Its standard deviation."""


class PositionFilter(ConfigModel):
    """Accelerometer model and initial covariance of the PKF."""

    accelerometer_noise_mps2: Annotated[Positive, Live(1e-8, 0.1)]
    """Noise of an accelerometer sample."""
    accelerometer_quantum_mps2: NotNegative = 0.0
    """Resolution of an accelerometer sample, as that of the gyros."""
    accelerometer_bias_noise_mps3: Annotated[NotNegative, Live(0.0, 0.01)]
    """Random walk of the bias."""
    accelerometer_bias_mps2: Triple
    """Initial estimate of the bias."""
    initial_bias_sigma_mps2: Positive
    """Its standard deviation."""
    initial_velocity_sigma_mps: Positive
    """Standard deviation of the initial velocity."""


class Shadow(ConfigModel):
    """filterpy's filters in parallel with the compiled ones; an alarm when they diverge."""

    enabled: bool
    """Run the shadow filter."""
    position_limit_m: Positive
    """Difference from which it raises an alarm."""
    attitude_limit_deg: Positive
    """The same for the attitude."""


class Phase(ConfigModel):
    """One phase of the approach; defaults come from the guidance table."""

    kind: Literal["approach", "hold", "wait", "final", "retreat", "fly_around", "slew", "transfer"]
    """See [the approach](../../explanation/approach.md)."""
    point_m: Triple | None = None
    """End point in H of a moving phase; unless set, the ready point. Of a fly-around: the end of its arc."""
    speed_mps: Positive | None = None
    """Largest speed; unless set, `approach_speed_mps`."""
    acceleration_mps2: Positive | None = None
    """Unless set, that of `[gnc.guidance]`."""
    deceleration_mps2: Positive | None = None
    """Unless set, that of `[gnc.guidance]`."""
    attitude_deg: AngleTriple | None = None
    """Of a slew: 3-2-1 angles from H to c at its end."""
    rate_degps: Positive | None = None
    """Of a slew: largest rate; unless set, `gnc.control.slew_rate_degps`."""
    acceleration_degps2: Positive | None = None
    """Of a slew: angular acceleration; unless set, the rate within 2 s."""
    duration_s: NotNegative | None = None
    """Of a hold, and of a transfer."""
    end_time_s: NotNegative | None = None
    """Of a wait, time of the run; unless set, it waits for the operator's go."""
    impulses: Literal["two", "optimal"] | None = None
    """Of a transfer: at begin and end (`two`, unless set), or those of the least sum, whatever their number."""
    passively_safe_s: Positive | None = None
    """Of a transfer: time for which the drift after any missed burn stays so far from the target that the bodies of
    `[keep_out]` cannot meet, whatever their attitude; unless set, it may not."""

    @property
    def reacts_as(self) -> str:
        """Kind of phase whose reactions it has."""
        return "approach" if self.kind in ("fly_around", "slew", "transfer") else self.kind

    @model_validator(mode="after")
    def _keys_suit_the_kind(self) -> Self:
        moving = ("point_m", "speed_mps", "acceleration_mps2", "deceleration_mps2")
        own = {
            "hold": ("duration_s",),
            "wait": ("end_time_s",),
            "slew": ("attitude_deg", "rate_degps", "acceleration_degps2"),
            "transfer": ("point_m", "duration_s", "acceleration_mps2", "impulses", "passively_safe_s"),
        }
        allowed = own.get(self.kind, moving)
        names = dict.fromkeys((*moving, *(name for each in own.values() for name in each)))
        given = [name for name in names if getattr(self, name) is not None]
        foreign = [name for name in given if name not in allowed]
        if foreign:
            raise ValueError(f'{foreign[0]} does not go with kind = "{self.kind}", which takes: {", ".join(allowed)}')
        if self.kind in ("hold", "transfer") and self.duration_s is None:
            raise ValueError(f'kind = "{self.kind}" needs duration_s')
        if self.kind in ("retreat", "fly_around") and self.point_m is None:
            raise ValueError(f'kind = "{self.kind}" needs point_m')
        if self.kind == "slew" and self.attitude_deg is None:
            raise ValueError('kind = "slew" needs attitude_deg')
        return self


class Guidance(ConfigModel):
    """Phases of the approach in their order."""

    ready_point_m: Triple
    """In H; end of moving phases without a point."""
    approach_speed_mps: Positive
    """Largest speed of phases without one."""
    acceleration_mps2: Positive
    """Acceleration of phases without one."""
    deceleration_mps2: Positive
    """Deceleration of phases without one."""
    slew_s: Positive = 10.0
    """Time in which the initial attitude error is removed: determines the minimum propellant of the slew."""
    sequence: Annotated[tuple[str, ...], Field(min_length=1, max_length=MAX_PHASES)]
    """Names of phases in order; the last one never ends."""
    phases: dict[str, Phase]
    """Phases by name."""

    @model_validator(mode="after")
    def _sequence_names_phases(self) -> Self:
        for name in self.sequence:
            if name not in self.phases:
                raise ValueError(f'sequence: "{name}" is no phase; known phases: {", ".join(self.phases)}')
        return self


class Corridor(ConfigModel):
    """Approach corridor about the line of the phase, and limit of the closing rate."""

    axis: Triple = (1.0, 0.0, 0.0)
    """In H, from the target outwards: docking axis, along which an abort retreats."""
    half_angle_deg: Annotated[float, Field(gt=0.0, lt=90.0), Live(0.5, 30.0)]
    """Radius of the corridor over range."""
    minimum_radius_m: Annotated[Positive, Live(0.01, 1.0)]
    """Its smallest radius."""
    closing_rate_mps: Annotated[Positive, Live(1e-3, 0.5)]
    """Largest closing rate up to the range of the ready point."""
    closing_rate_slope_per_s: Annotated[NotNegative, Live(0.0, 1.0)]
    """Its increase with range."""
    closing_rate_max_mps: Annotated[Positive, Live(1e-2, 0.5)]
    """Its maximum."""
    confidence: Annotated[NotNegative, Live(0.0, 10.0)] = 3.0
    """Standard deviations of the velocity that are added to the closing rate."""
    persistence_s: Annotated[NotNegative, Live(0.0, 5.0)]
    """A limit is violated if exceeded for this time."""

    @model_validator(mode="after")
    def _axis_is_a_unit_vector(self) -> Self:
        if abs(linear.length(self.axis) - 1.0) > 1e-6:
            raise ValueError(f"axis = {list(self.axis)} must be a unit vector")
        return self


class Abort(ConfigModel):
    """Brake, retreat along the corridor's axis, hold."""

    brake_mps2: Positive
    """Deceleration of the reference; thrusters that oppose the motion must provide it."""
    hold_distance_m: Positive
    """End of the retreat, from the target; at most the start distance."""
    speed_mps: Positive
    """Of the retreat."""
    acceleration_mps2: Positive
    """Of the retreat."""
    at_s: NotNegative | None = None
    """Time of a simulated abort."""
    one_thruster_failed: bool = True
    """Require before a run that an abort stays clear of the keep-out with any one thruster stuck open or closed."""


class NavigationIntegrity(ConfigModel):
    """Monitors of the navigation and protection levels ([integrity](../../explanation/integrity.md))."""

    risk_probability: Annotated[float, Field(gt=0.0, le=0.01)] = 1e-7
    """Probability per approach that an error exceeds its protection level without a fault."""
    go_risk_probability: Annotated[float, Field(gt=0.0, le=0.1)] = 1e-4
    """Probability that docking is a go although an error exceeds the requirement: 1e-4 is 3.9 standard deviations."""
    go_fraction: Annotated[float, Field(gt=0.0, le=1.0)] = 0.75
    """Of the requirements, within which the encoders must be for a go; the rest is for the control error after it."""
    go_alarm_interval_s: Annotated[float, Field(ge=60.0, le=1e8)] = 36_000.0
    """Mean time between two withdrawals of a go by the innovations of sound poses; sets the sum that ends one."""
    vision_range_m: Positive | None = None
    """Range up to which poses are expected: farther out vision cannot be lost; unless set, everywhere."""
    pose_range_max_m: Positive = 100.0
    """A pose farther from the target is none."""
    pose_sigma_max_m: Positive = 1.0
    """A pose with a larger standard deviation is none."""
    pose_sigma_max_deg: Positive = 20.0
    """The same for its attitude."""
    lost_after_s: Positive = 2.0
    """Vision is lost if the last accepted pose is older."""
    suspect_after: Annotated[int, Field(ge=1)] = 4
    """Vision is suspect after so many consecutive rejections."""
    close_after: Annotated[int, Field(ge=1)] = 8
    """The gate is closed after so many consecutive rejections."""
    reopen_after: Annotated[int, Field(ge=2)] = 8
    """It opens again for the last of so many consecutive poses that agree with each other and with the IMU."""
    mean_shift_sigmas: Positive = 0.25
    """Mean of the normalised innovations that the CUSUM permits."""
    cusum_limit_sigmas: Positive = 36.0
    """Sum of the excess from which on vision is suspect."""
    nis_window: Annotated[int, Field(ge=2)] = 16
    """Poses in the mean NIS."""
    thruster_open_s: Positive = 0.3
    """Time after which a thruster that was not commanded counts as stuck open."""
    acquisition_s: NotNegative = 45.0
    """Time after the first pose in which the filters may converge."""


ReactionName = Literal["continue", "coast", "hold", "retreat", "abort"]
REACTION_NAMES: tuple[str, ...] = get_args(ReactionName)


class PhaseReactions(ConfigModel):
    """Reaction to one condition, by kind of phase."""

    approach: ReactionName = "abort"
    """In a phase of kind approach, fly_around, slew or transfer."""
    hold: ReactionName = "abort"
    """Of kind hold."""
    wait: ReactionName = "abort"
    """Of kind wait."""
    final: ReactionName = "abort"
    """Of kind final."""
    retreat: ReactionName = "abort"
    """Of kind retreat."""


_HOLD = PhaseReactions(approach="hold", hold="hold", wait="hold", final="abort", retreat="continue")
_CONTINUE = PhaseReactions(approach="continue", hold="continue", wait="continue", final="abort", retreat="continue")


class Reactions(ConfigModel):
    """Reactions to the health of the navigation; of several the strongest."""

    vision_lost: PhaseReactions = _HOLD
    """No usable pose for `gnc.integrity.lost_after_s`, and a protection level beyond `coast_fraction` of its limit."""
    coast_fraction: Annotated[float, Field(ge=0.0, le=1.0)] = 0.7
    """Of an alert limit, up to which a protection level permits the approach without vision."""
    vision_suspect: PhaseReactions = _HOLD
    """Poses are rejected, or their innovations contradict their covariance."""
    imu_suspect: PhaseReactions = _CONTINUE
    """Readings repeat, or no thruster explains them."""
    thruster_fault: PhaseReactions = PhaseReactions.model_construct()
    """A thruster is stuck open or dead."""
    monitor_disagrees: PhaseReactions = _HOLD
    """The docking monitor measures another pose."""
    covariance_invalid: PhaseReactions = PhaseReactions.model_construct()
    """A variance of the filters is not finite or not positive."""
    bench_disagrees: PhaseReactions = _HOLD
    """The encoders of the bench contradict the estimate."""
    sensor_suspect: PhaseReactions = _CONTINUE
    """A further sensor contradicts the others and is excluded."""
    cause_unknown: PhaseReactions | None = None
    """Innovations or the IMU are inconsistent, and no device stands out; unless set, as `vision_suspect`."""
    unprotected: PhaseReactions = PhaseReactions.model_construct()
    """The protection level exceeds the alert limit for `integrity.time_to_alert_s`."""
    hold_max_s: Positive = 60.0
    """A hold or retreat that lasts longer becomes an abort."""

    def conditions(self) -> tuple[PhaseReactions, ...]:
        """Return the reactions in the order of the bits of health, the last one to the protection level."""
        return (
            self.vision_lost,
            self.vision_suspect,
            self.imu_suspect,
            self.thruster_fault,
            self.monitor_disagrees,
            self.covariance_invalid,
            self.bench_disagrees,
            self.sensor_suspect,
            self.cause_unknown or self.vision_suspect,
            self.unprotected,
        )


class Control(ConfigModel):
    """Backend of control. The built-in one: phase planes of position and attitude, updated once per period."""

    backend: Annotated[str, Field(min_length=1)] = BUILTIN
    """Phase planes (`builtin`), linear programs over a horizon (`predictive`), or one of your own: `package:name` of
    an entry point, `file.py:name`, a shared library (`.so`), or an FMU (`.fmu`)."""
    settings: Settings = Field(default_factory=dict)
    """Settings that a backend of your own declares."""
    deadband_m: Annotated[NotNegative, Live(0.0, 0.2)] = 0.0
    """Least coast in the dead band; 0: by the rule from valve, propellant and requirement."""
    lead_s: Annotated[NotNegative, Live(0.0, 100.0)] = 0.0
    """Weight of the rate relative to the position; 0: by the rule from noise and valve."""
    period_s: Annotated[NotNegative, Live(0.0, 60.0)] = 0.0
    """An axis decides once per period; 0: by the rule from the valve."""
    deadband_sigmas: Annotated[NotNegative, Live(0.0, 10.0)] = 2.0
    """Standard deviations of the switching function in the dead band."""
    correction_rate_mps: Annotated[Positive, Live(1e-4, 0.5)] = 0.05
    """Largest rate at which a position error is corrected; plus the approach speed, below the largest closing rate."""
    deadband_deg: Annotated[NotNegative, Live(0.0, 5.0)] = 0.0
    """Least coast of the attitude in its dead band; 0: by the rule."""
    attitude_lead_s: Annotated[NotNegative, Live(0.0, 100.0)] = 0.0
    """Weight of the angular rate; 0: by the rule."""
    attitude_period_s: Annotated[NotNegative, Live(0.0, 60.0)] = 0.0
    """Decision period of an attitude axis; 0: by the rule."""
    attitude_deadband_sigmas: Annotated[NotNegative, Live(0.0, 10.0)] = 0.0
    """Standard deviations of the attitude in the dead band."""
    slew_rate_degps: Annotated[Positive, Live(0.01, 5.0)] = 0.6
    """Largest rate at which an attitude error is corrected."""


class GncConfig(ConfigModel):
    """GNC of the chaser."""

    library: str | None = None
    """Shared library that replaces the built-in navigation and control."""
    fmu: str | None = None
    """FMU for co-simulation (FMI 2.0, 3.0) that replaces the built-in navigation and control."""
    fmu_mapping: str | None = None
    """File that maps the FMU's variables to the records; by name without one."""
    fmu_parameters: dict[str, bool | int | float | str] = Field(default_factory=dict)
    """Parameters and start values of the FMU, in its units."""
    fmu_process: bool = False
    """Run the FMU in a process of its own: if it hangs or crashes, the bench stops."""
    fmu_timeout_s: Annotated[float, Field(gt=0.0, le=60.0)] = 0.5
    """Longest time of a step in a process of its own, real time."""
    navigation: Navigation
    ephemeris: Ephemeris = Ephemeris.model_construct()
    modes: Annotated[dict[str, KnownMode], Field(max_length=MAX_MODES)] = Field(default_factory=dict)
    """Bending modes and slosh that filters and control allow for, by name; the truth has its own."""
    target: KnownTarget = KnownTarget.model_construct()
    akf: AttitudeFilter
    pkf: PositionFilter
    shadow: Shadow
    guidance: Guidance
    corridor: Corridor
    abort: Abort
    control: Control
    integrity: NavigationIntegrity = NavigationIntegrity.model_construct()
    reactions: Reactions = Reactions.model_construct()

    @model_validator(mode="after")
    def _every_phase_can_be_aborted(self) -> Self:
        for name in self.guidance.sequence:
            kind = self.guidance.phases[name].reacts_as
            if all(getattr(condition, kind) != "abort" for condition in self.reactions.conditions()):
                raise ValueError(
                    f'reactions: phase "{name}", of kind {kind}, is left without an abort: allowed is at least one'
                )
        return self

    @model_validator(mode="after")
    def _filters_can_have_the_budget(self) -> Self:
        if self.shadow.enabled and not (self.navigation.budget.is_empty and not self.navigation.thrust.enabled):
            raise ValueError(
                "shadow.enabled = true: the shadow filter has neither error budget nor commanded thrust; allowed with "
                "gnc.navigation.thrust.enabled = false and without gnc.navigation.budget, or with sizes of 0 in it"
            )
        return self

    @model_validator(mode="after")
    def _shadow_has_filters(self) -> Self:
        if self.shadow.enabled and "navigation" in self.foreign:
            raise ValueError(
                f"shadow.enabled = true: checks the built-in filters, not navigation.backend = "
                f'"{self.navigation.backend}"'
            )
        return self

    @model_validator(mode="after")
    def _is_one_binary(self) -> Self:
        if self.library is not None and self.fmu is not None:
            raise ValueError("library and fmu: both are given, allowed is one of them")
        return self

    @model_validator(mode="after")
    def _is_one_gnc(self) -> Self:
        if self.binary is None:
            return self
        given = "library" if self.fmu is None else "fmu"
        for part, own in self.foreign.items():
            raise ValueError(
                f'{given} and {part}.backend = "{own}": {given} replaces navigation and control; allowed is one of both'
            )
        return self

    @property
    def foreign(self) -> dict[str, str]:
        """Backends that are not built in, by the part of the GNC: navigation, control."""
        parts = {"navigation": self.navigation.backend, "control": self.control.backend}
        return {part: name for part, name in parts.items() if name not in BUILT_IN[part]}

    @property
    def fuses_imu(self) -> bool:
        """Whether the built-in filters fuse poses and IMU."""
        return self.navigation.backend == BUILTIN and self.binary is None

    def built_in(self) -> GncConfig:
        """Return the same with the built-in GNC in place of an external one."""
        parts = {
            part: getattr(self, part).model_copy(update={"backend": BUILTIN, "settings": {}}) for part in self.foreign
        }
        return self.model_copy(update={"library": None, "fmu": None, **parts})

    @property
    def binary(self) -> str | None:
        """Path of the library or FMU, None for the built-in GNC."""
        return self.library if self.fmu is None else self.fmu


class ProbabilisticRequirement(ConfigModel):
    """Requirement on the cases of a campaign: an outcome is within its limit with a probability."""

    id: Name
    """Identifier, as in the specification."""
    text: Annotated[str, Field(min_length=1, max_length=500)]
    """Wording."""
    column: Name
    """Outcome: a column of cases.parquet with numbers, or a flag as passed, which counts as 0 or 1."""
    at_most: float | None = None
    """Largest value that is allowed, in the unit of the column."""
    at_least: float | None = None
    """Smallest value that is allowed, in the unit of the column."""
    probability: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.9973
    """Required fraction of cases within the limit."""
    consumer_risk: Annotated[float, Field(gt=0.0, lt=1.0)] = 0.1
    """Largest probability of accepting a design that does not have that fraction."""

    @model_validator(mode="after")
    def _has_one_limit(self) -> Self:
        if (self.at_most is None) == (self.at_least is None):
            raise ValueError("at_most and at_least: one of them must be given")
        return self

    @property
    def sign(self) -> float:
        """1 if large values violate the requirement, -1 if small ones do."""
        return 1.0 if self.at_least is None else -1.0

    @property
    def limit(self) -> float:
        """The limit, in the unit of the column."""
        limit = self.at_least if self.at_most is None else self.at_most
        assert limit is not None
        return limit


class Requirements(ConfigModel):
    """Requirements of the ready phase (bench paper Table III), per axis, and the propellant budget."""

    axial_distance_m: Positive
    """Distance along x that is required."""
    axial_tolerance_m: Positive
    """Tolerance of x."""
    axial_rate_mps: Positive
    """Largest speed along x."""
    radial_distance_m: Positive
    """Largest deviation along y and z."""
    radial_rate_mps: Positive
    """Largest speed along y and z."""
    angle_deg: Positive
    """Largest attitude angle, per axis."""
    angular_rate_degps: Positive
    """Largest angular rate, per axis."""
    dwell_s: Positive
    """Time for which every row must hold before the ready phase starts."""
    required_ready_s: NotNegative = 30.0
    """Shortest ready phase that passes."""
    go_valid_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 30.0
    """Time for which a go promises the ready state, without a new failure."""

    propellant_factor: Positive = 3.0
    """Allowed propellant over the impulsive minimum of reference and slews."""

    required_parts: tuple[str, ...] | None = None
    """Parts of the [verdict](../../explanation/approach.md#verdict) that a run must pass to be accepted; unless set,
    all."""

    probabilistic: Annotated[tuple[ProbabilisticRequirement, ...], Field(max_length=200)] = ()
    """Requirements on the cases of a campaign; [[requirements]] in a file that extends another means this list."""

    @field_validator("required_parts")
    @classmethod
    def _parts_exist(cls, value: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if value is None:
            return None
        if not value:
            raise ValueError(f"[]: must have at least one of {', '.join(PART_COLUMNS)}")
        for i, name in enumerate(value):
            if name not in PART_COLUMNS:
                raise ValueError(f'"{name}": must be one of {", ".join(PART_COLUMNS)}')
            if name in value[:i]:
                raise ValueError(f'"{name}": given more than once')
        return value

    @field_validator("probabilistic")
    @classmethod
    def _ids_are_unique(cls, value: tuple[ProbabilisticRequirement, ...]) -> tuple[ProbabilisticRequirement, ...]:
        ids = [each.id for each in value]
        if twice := sorted({each for each in ids if ids.count(each) > 1}):
            raise ValueError(f"id {', '.join(twice)}: given more than once")
        return value


class Reachability(ConfigModel):
    """Margins about the plan for the reachability check (docs/explanation/reachability.md)."""

    corridor_fraction: NotNegative = 0.5
    """Fraction of the corridor's half angle by which Table III is widened."""
    attitude_margin_deg: Annotated[float, Field(ge=0.0, le=45.0)] = 1.0
    """About each body axis."""
    startup_lag_s: NotNegative = 0.2
    """Time in which the axes, at rest at the start pose, must catch up with a start in motion."""


class LiveTuning(ConfigModel):
    """Table ``[console]`` of a scenario: settings that the operator may change during a run."""

    adjustable: tuple[str, ...] = ()
    """Dotted keys that the operator may change during a run."""

    @field_validator("adjustable")
    @classmethod
    def _each_is_live_tunable(cls, value: tuple[str, ...]) -> tuple[str, ...]:
        ranges = live_ranges(Scenario) if value else {}
        for key in value:
            if key not in ranges and not key.startswith(BACKEND_SETTINGS):
                hint = did_you_mean(key, ranges, 0.8)
                allowed = ", ".join(ranges)
                raise ValueError(f"{json.dumps(key)}: cannot be changed in flight: {hint}allowed: {allowed}")
            if value.count(key) > 1:
                raise ValueError(f"{json.dumps(key)}: is listed twice")
        return value


class Scenario(FileTable):
    """One closed-loop run, independent of the rig."""

    name: Name
    """Name in reports and recordings."""
    duration_s: Duration
    """Length of the run."""
    step_s: Annotated[float, Field(ge=1e-4, le=1.0)]
    """Period of the cycle: of guidance, navigation and control, and of the recorded rows."""
    orbit: Orbit
    target: MovingTarget = MovingTarget.model_construct()
    truth: Truth = Truth.model_construct()
    chaser: Chaser
    initial: Initial
    imu: Imu
    thrusters: ThrusterModel = ThrusterModel.model_construct()
    vmu: VisionNoise
    gnc: GncConfig
    requirements: Requirements
    keep_out: KeepOut = KeepOut.model_construct()
    integrity: Integrity = Integrity.model_construct()
    reachability: Reachability = Reachability.model_construct()
    monitor: DockingMonitorConfig = DockingMonitorConfig.model_construct()
    bench: BenchScale = BenchScale.model_construct()
    sensors: Annotated[dict[str, SensorConfig], Field(max_length=ADDED_SENSORS_MAX)] = Field(default_factory=dict)
    """Sensors other than vision unit, IMU and docking monitor, by name."""
    faults: Annotated[tuple[TimedFault, ...], Field(max_length=5 * MAX_FAULTS)] = ()
    """Faults of devices, in the run's time."""
    dispersions: Dispersions = Dispersions.model_construct()
    console: LiveTuning = LiveTuning.model_construct()

    @model_validator(mode="after")
    def _models_have_their_own_faults(self) -> Self:
        parts = {"truth": ("target", self.truth), "thrusters": ("thruster", self.thrusters), "imu": ("imu", self.imu)}
        for name, (family, part) in parts.items():
            if part.fmu is not None and any(fault.family == family for fault in self.faults):
                raise ValueError(
                    f"{name}.fmu: faults of family {family} are of the built-in model: put them into the FMU"
                )
        return self

    @model_validator(mode="after")
    def _sensors_with_faults_exist(self) -> Self:
        for fault in self.faults:
            if fault.family == "sensor" and fault.member not in self.sensors:
                devices = ", ".join(map(device_of, self.sensors)) or "none"
                raise ValueError(f'faults: device = "{fault.device}": the scenario\'s sensors are {devices}')
        return self

    @model_validator(mode="after")
    def _models_know_the_target(self) -> Self:
        if self.target.motion == "aligned":
            return self
        motion = f'target.motion = "{self.target.motion}"'
        if self.truth.relative_motion != "nonlinear":
            raise ValueError(f'{motion} requires truth.relative_motion = "nonlinear"')
        if self.truth.fmu is not None:
            raise ValueError(f"{motion} does not go with truth.fmu: put the motion into the FMU")
        if self.gnc.shadow.enabled:
            raise ValueError(f"{motion} does not go with gnc.shadow.enabled, whose filters are those of the Hill frame")
        return self

    @property
    def truth_orbits(self) -> bool:
        """Whether the truth integrates the orbit of a target that is aligned with its Hill frame."""
        return self.truth.relative_motion == "nonlinear" and self.target.motion == "aligned"

    @property
    def models(self) -> dict[str, ModelFmu]:
        """Parts of the plant that are in FMUs."""
        parts: dict[str, ModelFmu] = {"thrusters": self.thrusters, "truth": self.truth, "imu": self.imu}
        return {name: part for name, part in parts.items() if part.fmu is not None}

    @property
    def gnc_orbit(self) -> Orbit:
        """The target's orbit in the GNC: with the errors of its ephemeris."""
        errors = self.gnc.ephemeris
        changes = {
            "altitude_m": self.orbit.altitude_m + errors.semi_major_axis_error_m,
            "eccentricity": self.orbit.eccentricity + errors.eccentricity_error,
            "true_anomaly_deg": self.orbit.true_anomaly_deg + errors.true_anomaly_error_deg,
        }
        return self.orbit.model_copy(update=changes)

    @property
    def imu_samples(self) -> int:
        """Samples of the IMU per cycle."""
        return 1 if self.imu.rate_hz is None else max(1, round(self.imu.rate_hz * self.step_s))

    @property
    def sample_s(self) -> float:
        """Period of the IMU: step of the truth and of the filters, s."""
        return self.step_s / self.imu_samples

    @property
    def memory_steps(self) -> int:
        """Steps of the filters that are kept."""
        return math.ceil(self.gnc.navigation.memory_s / self.sample_s - 1e-9)
