"""Error models of sensors and thrusters beyond drift and white noise. All terms are zero unless set."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil.config.tables.model import ConfigModel, NotNegative, NotNegativeTriple, Positive, Triple

RelativeError = Annotated[float, Field(gt=-0.5, lt=0.5)]
RelativeErrors = tuple[RelativeError, RelativeError, RelativeError]
Rotation = Annotated[float, Field(ge=-30.0, le=30.0)]
Misalignment = tuple[Rotation, Rotation, Rotation]
SmallAngle = Annotated[float, Field(ge=0.0, le=10.0)]
RelativeSigma = Annotated[float, Field(ge=0.0, le=0.5)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
LAG_MAX_S = 1.0
Lag = Annotated[float, Field(ge=0.0, le=LAG_MAX_S)]
_NONE = (0.0, 0.0, 0.0)


class VisionErrors(ConfigModel):
    """Errors of the vision unit's model ([error models](../../explanation/error-models.md))."""

    bias_m: Triple = _NONE
    """Constant error of the measured position, in v."""
    misalignment_deg: Misalignment = _NONE
    """Rotation of the cameras against their assumed axes: the measured ring is rotated so about v's axes."""
    scale_error: RelativeError = 0.0
    """Relative error of the distance."""
    correlated_fraction: Fraction = 0.0
    """Fraction of the noise's variance that is correlated in time, a first-order Gauss-Markov process."""
    correlation_time_s: Positive = 10.0
    """Its correlation time."""
    outlier_probability: Fraction = 0.0
    """Of a pose to be displaced by `outlier_size_m` in a random direction."""
    outlier_size_m: NotNegative = 0.3
    """Displacement of an outlier."""
    misidentified_probability: Fraction = 0.0
    """Of a pose whose LEDs are taken for others: rotated about the ring's axis by 60 deg or a multiple."""
    needs_view: bool = True
    """A pose is lost if not at least three LEDs are in both images."""


class ImuErrors(ConfigModel):
    """Errors of the IMU's model ([error models](../../explanation/error-models.md))."""

    gyro_scale_error: RelativeErrors = _NONE
    """Relative error of each gyro's scale factor."""
    gyro_misalignment_deg: Misalignment = _NONE
    """Rotation of the gyros' axes against c."""
    gyro_instability_degps: NotNegative = 0.0
    """Bias instability: standard deviation of a first-order Gauss-Markov process in the drift."""
    gyro_instability_time_s: Positive = 100.0
    """Its correlation time."""
    gyro_quantum_degps: NotNegative = 0.0
    """Quantum of a reading; what it cuts off comes with the next ones."""
    accelerometer_scale_error: RelativeErrors = _NONE
    """Relative error of each accelerometer's scale factor."""
    accelerometer_misalignment_deg: Misalignment = _NONE
    """Rotation of the accelerometers' axes against c."""
    accelerometer_instability_mps2: NotNegative = 0.0
    """Bias instability, defined as for the gyros."""
    accelerometer_instability_time_s: Positive = 100.0
    """Its correlation time."""
    accelerometer_quantum_mps2: NotNegative = 0.0
    """Quantum of a reading, defined as for the gyros."""
    lever_arm_m: Triple = _NONE
    """From the reference point to the accelerometers, in c; the GNC takes them to be there."""


class ThrusterErrors(ConfigModel):
    """Errors of the thrusters' model ([error models](../../explanation/error-models.md))."""

    delay_s: Lag = 0.0
    """From a command to the valve, opening and closing."""
    rise_s: Lag = 0.0
    """Time constant of the thrust once the valve is open."""
    tail_off_s: Lag = 0.0
    """Time constant of the thrust once the valve is closed."""
    impulse_scatter_sigma: Annotated[float, Field(ge=0.0, le=0.5)] = 0.0
    """Relative scatter of the impulse of a firing of the minimum on-time, from firing to firing."""
    half_pressure_kg: Positive | None = None
    """Propellant whose use halves supply pressure and thrust (blow-down, `truth.mass_loss`); unset: regulated."""
    plume_target_radius_m: NotNegative = 0.0
    """Radius of the target, a sphere that the plumes push; 0: they do not act."""
    plume_target_mass_kg: Positive = 1000.0
    """Mass of the target."""
    plume_exponent: Annotated[float, Field(ge=0.0, le=100.0)] = 8.0
    """Of the cosine of the angle from a plume's axis: 2 / (gamma - 1), with the ratio of specific heats."""
    plume_dimming_fraction: Fraction = 0.0
    """Fraction of the LEDs' light that is lost while one thruster's whole plume meets the target."""


class ErrorBudget(ConfigModel):
    """Sizes of the sensors' errors for the GNC, all standard deviations; without them the filters have none.

    Constants of the IMU are considered, the others estimated ([error budget](../../explanation/error-budget.md)).
    """

    vision_bias_sigma_m: NotNegativeTriple = _NONE
    """Constant error of the measured position, in c."""
    vision_misalignment_sigma_deg: SmallAngle = 0.0
    """Rotation of the cameras against their assumed axes, about each axis."""
    vision_scale_sigma: RelativeSigma = 0.0
    """Relative error of the distance."""
    vision_correlated_fraction: Annotated[float, Field(ge=0.0, le=0.95)] = 0.0
    """Fraction of the reported variance that is correlated in time."""
    vision_correlation_time_s: Positive = 10.0
    """Correlation time of it, and of the bench's error."""
    vision_noise_scale_sigma: Annotated[float, Field(ge=0.0, le=1.0)] = 0.0
    """Relative uncertainty of the reported standard deviations; above 0 the noise's size is estimated."""
    vision_noise_window: Annotated[int, Field(ge=16, le=100_000)] = 256
    """Poses over which it is estimated."""
    bench_sigma_m: NotNegative = 0.0
    """Part of the reported position that is the bench's error, correlated: `vmu.bench_sigma_m` of the rig, or 0."""
    bench_sigma_deg: NotNegative = 0.0
    """The same for the attitude."""
    gyro_scale_sigma: RelativeSigma = 0.0
    """Relative error of each gyro's scale factor."""
    gyro_misalignment_sigma_deg: SmallAngle = 0.0
    """Rotation of the gyros' axes against c, about each axis."""
    gyro_instability_degps: NotNegative = 0.0
    """Bias instability, a part of the drift."""
    gyro_instability_time_s: Positive = 100.0
    """Its correlation time."""
    accelerometer_scale_sigma: RelativeSigma = 0.0
    """Relative error of each accelerometer's scale factor."""
    accelerometer_misalignment_sigma_deg: SmallAngle = 0.0
    """Rotation of the accelerometers' axes against c, about each axis."""
    accelerometer_instability_mps2: NotNegative = 0.0
    """Bias instability, a part of the bias."""
    accelerometer_instability_time_s: Positive = 100.0
    """Its correlation time."""
    camera_position_m: Triple = (0.6, 0.0, 0.0)
    """In c: where the GNC assumes the left camera; `bench.camera_position_m` of the rig."""
    led_ring_position_m: Triple = _NONE
    """In H: where it assumes the centre of the LED ring; `bench.led_ring_position_m` of the rig."""

    @property
    def is_empty(self) -> bool:
        """Whether it has no error."""
        return self.model_copy(update={name: getattr(_EMPTY, name) for name in _DETAILS}) == _EMPTY


_DETAILS = (
    "vision_correlation_time_s", "vision_noise_window", "gyro_instability_time_s", "accelerometer_instability_time_s",
    "camera_position_m", "led_ring_position_m",
)  # fmt: skip
_EMPTY = ErrorBudget.model_construct()
