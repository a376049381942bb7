"""Truth model: orbit of the target, solar array of the chaser, and effects."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.model import ConfigModel, Positive, Triple

HIGHEST_DEGREE = 360  # beyond it the Legendre functions of Pines' form leave the range of a double at the poles

Degrees = Annotated[float, Field(ge=-360.0, le=360.0)]
Fraction = Annotated[float, Field(ge=0.0, le=1.0)]


def _check_direction(name: str, vector: Triple) -> None:
    if abs(math.hypot(*vector) - 1.0) > 1e-6:
        raise ValueError(f"{name} = {list(vector)} must be a unit vector")


class Orbit(ConfigModel):
    """The target's orbit about the Moon, inertial axes along the Moon's equator; ``altitude_m``: mean, that of the
    semi-major axis above 1738 km."""

    altitude_m: Positive
    eccentricity: Annotated[float, Field(ge=0.0, lt=0.1)] = 0.0
    inclination_deg: Annotated[float, Field(ge=0.0, le=180.0)] = 0.0
    raan_deg: Degrees = 0.0
    argument_of_periapsis_deg: Degrees = 0.0
    true_anomaly_deg: Degrees = 0.0
    moon_rotation_deg: Degrees = 0.0


class SolarArray(ConfigModel):
    """Flat plate fixed to the hub, in c, with one bending mode coupled to the rotation of the hub."""

    area_m2: Positive
    normal: Triple
    centre_m: Triple
    specular: Fraction
    diffuse: Fraction
    mode_frequency_hz: Positive
    mode_damping: Annotated[float, Field(ge=0.0, lt=1.0)]
    mode_coupling: Triple

    @model_validator(mode="after")
    def _plate_is_possible(self) -> Self:
        _check_direction("normal", self.normal)
        if self.specular + self.diffuse > 1.0:
            raise ValueError(f"specular {self.specular:g} and diffuse {self.diffuse:g} must not exceed 1 together")
        return self


class Truth(ConfigModel):
    """Model of relative motion, and a switch or magnitude for each effect."""

    relative_motion: Literal["hill", "nonlinear"] = "nonlinear"
    gravity_degree: Annotated[int, Field(ge=0, le=HIGHEST_DEGREE)] = 8
    gravity_file: str | None = None
    gravity_gradient: bool = True
    solar_pressure: bool = False
    sun_direction: Triple = (1.0, 0.0, 0.0)
    flexible_array: bool = False
    mass_loss: bool = True
    misalignment_sigma_deg: Annotated[float, Field(ge=0.0, le=10.0)] = 0.0
    force_scatter_sigma: Annotated[float, Field(ge=0.0, le=0.2)] = 0.0
    centre_of_mass_offset_m: Triple = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _sun_is_a_direction(self) -> Self:
        _check_direction("sun_direction", self.sun_direction)
        return self
