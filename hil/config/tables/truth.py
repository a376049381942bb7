"""Truth model: orbit of the target, solar array of the chaser, effects, and parts of it in FMUs."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.model import ConfigModel, NotNegativeTriple, Positive, Triple
from hil.core.messages import MAX_MODES
from hil.maths import linear


class ModelFmu(ConfigModel):
    """FMU for co-simulation (FMI 2.0, 3.0) instead of a built-in model."""

    fmu: str | None = None
    """FMU that replaces the built-in model."""
    fmu_mapping: str | None = None
    """File that maps the FMU's variables to the records; by name without one."""
    fmu_parameters: dict[str, bool | int | float | str] = Field(default_factory=dict)
    """Parameters and start values of the FMU, in its units."""


class ThrusterModel(ModelFmu):
    """Model of the valves and their thrust, without their places, which are the chaser's."""


HIGHEST_DEGREE = 360  # beyond it the Legendre functions of Pines' form leave the range of a double at the poles

Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


def check_direction(name: str, vector: Triple) -> None:
    """Raise ValueError if ``vector`` is no unit vector."""
    if abs(linear.length(vector) - 1.0) > 1e-6:
        raise ValueError(f"{name} = {list(vector)} must be a unit vector")


class Orbit(ConfigModel):
    """The target's orbit, inertial axes along the equator of the central body."""

    body: Annotated[str, Field(min_length=1)] = "moon"
    """Central body: `moon`, `earth`, `mars`, `bennu` or a file, see [Orbits](../../explanation/orbits.md)."""
    altitude_m: Positive
    """Of the semi-major axis above the equatorial radius of the body."""
    eccentricity: Annotated[float, Field(ge=0.0, le=0.7)] = 0.0
    """Eccentricity."""
    inclination_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 0.0
    """Against the body's equator."""
    raan_deg: Degrees = 0.0
    """Right ascension of the ascending node."""
    argument_of_periapsis_deg: Degrees = 0.0
    """Argument of periapsis."""
    true_anomaly_deg: Degrees = 0.0
    """True anomaly at the start."""
    body_rotation_deg: Degrees = 0.0
    """From inertial x to the prime meridian at the start."""


class Ephemeris(ConfigModel):
    """Target's orbit in the GNC: errors, its value minus the true one, and the accuracy of what follows from it."""

    semi_major_axis_error_m: float = 0.0
    """Error of the semi-major axis."""
    eccentricity_error: Annotated[float, Field(gt=-0.1, lt=0.1)] = 0.0
    """Error of the eccentricity."""
    true_anomaly_error_deg: Degrees = 0.0
    """Error of the true anomaly at the start."""
    rate_sigma_degps: NotNegativeTriple = (0.0, 0.0, 0.0)
    """Standard deviations of the rate of H beyond that of the orbit, in H; harmonics of the Moon: 0, 1.3e-6, 9e-6."""
    along_track_error_m: float = 0.0
    """Error of the position along the orbit at the start, in addition."""
    gravity_degree: Annotated[int, Field(ge=0, le=HIGHEST_DEGREE)] = 0
    """Highest degree of the body's field by which it is propagated before the run; 0: point mass."""


Part = Annotated[float, Field(ge=0.0, lt=1.0)]
DampingRatio = Annotated[float, Field(ge=0.0, lt=1.0)]


class BendingMode(ConfigModel):
    """A further bending mode of the solar array."""

    frequency_hz: Positive
    """Frequency on a hub that does not move."""
    damping: DampingRatio
    """Damping ratio."""
    coupling: Triple = (0.0, 0.0, 0.0)
    """Coupling to the hub's rotation, in c, kg^1/2 m."""
    translation_coupling: Triple = (0.0, 0.0, 0.0)
    """Coupling to the hub's translation, in c, kg^1/2."""


class KnownMode(BendingMode):
    """Bending mode or slosh as a data sheet states it: by its coupling, or by the part of mass and inertia."""

    frequency_sigma: Annotated[float, Field(ge=0.0, le=0.4)] = 0.1
    """Standard deviation of the frequency, relative."""
    inertia_fraction: tuple[Part, Part, Part] = (0.0, 0.0, 0.0)
    """Part of the vehicle's inertia about each axis of c that swings, in addition to `coupling`."""
    mass_fraction: tuple[Part, Part, Part] = (0.0, 0.0, 0.0)
    """Part of the vehicle's mass along each axis that swings, in addition to `translation_coupling`."""


class SolarArray(ConfigModel):
    """Flat plate fixed to the hub, in c, with bending modes coupled to the motion of the hub."""

    area_m2: Positive
    """Area."""
    normal: Triple
    """Unit vector normal to the plate."""
    centre_m: Triple
    """Centre, from the reference point."""
    specular: Fraction
    """Fraction of the light that is reflected specularly."""
    diffuse: Fraction
    """Fraction that is scattered; the rest is absorbed."""
    mode_frequency_hz: Positive
    """Frequency of the first bending mode on a hub that does not move."""
    mode_damping: DampingRatio
    """Damping ratio of the mode."""
    mode_coupling: Triple
    """Coupling to the hub's rotation, in c, kg^1/2 m."""
    mode_translation_coupling: Triple = (0.0, 0.0, 0.0)
    """Coupling to the hub's translation, in c, kg^1/2."""
    further_modes: Annotated[dict[str, BendingMode], Field(max_length=MAX_MODES - 1)] = Field(default_factory=dict)
    """Further bending modes by name."""

    @model_validator(mode="after")
    def _plate_is_possible(self) -> Self:
        check_direction("normal", self.normal)
        if self.specular + self.diffuse > 1.0:
            raise ValueError(f"specular {self.specular:g} and diffuse {self.diffuse:g} must not exceed 1 together")
        return self


class Truth(ModelFmu):
    """Model of relative motion, and a switch or magnitude for each effect."""

    relative_motion: Literal["hill", "nonlinear", "free"] = "nonlinear"
    """Exact differential gravity, the linear motion of a circular orbit, or none of both: a level floor."""
    gravity_degree: Annotated[int, Field(ge=0, le=HIGHEST_DEGREE)] = 8
    """Highest degree of the body's field; 0: point mass."""
    gravity_file: str | None = None
    """Field instead of the body's own, for the Moon LP165P to degree 8: ICGEM .gfc, GMAT .cof or PDS SHADR .tab."""
    gravity_gradient: bool = True
    """Torque of the gravity gradient."""
    solar_pressure: bool = False
    """Force and torque of sunlight on the solar array."""
    sun_direction: Triple = (1.0, 0.0, 0.0)
    """Inertial unit vector to the Sun."""
    eclipse: bool = False
    """Shadow of the body, umbra and penumbra, on the pressure of sunlight."""
    drag: bool = False
    """Drag of the body's atmosphere on target and chaser."""
    density_scale: Positive = 1.0
    """Factor of the density: activity of the Sun."""
    target_ballistic_kgpm2: Positive = 100.0
    """Ballistic coefficient of the target: mass over drag coefficient and area."""
    chaser_ballistic_kgpm2: Positive = 100.0
    """Ballistic coefficient of the chaser."""
    third_bodies: bool = False
    """Pull of the other bodies in the body file."""
    flexible_array: bool = False
    """Bending modes of the solar array."""
    mass_loss: bool = True
    """Mass decreases by the propellant used."""
    misalignment_sigma_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    """Of each thruster about each of two axes, drawn once per run."""
    force_scatter_sigma: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    """Of each thruster's force, relative, drawn once per run."""
    centre_of_mass_offset_m: Triple = (0.0, 0.0, 0.0)
    """True centre of mass from the reference point, in c."""

    @model_validator(mode="after")
    def _sun_is_a_direction(self) -> Self:
        check_direction("sun_direction", self.sun_direction)
        return self
