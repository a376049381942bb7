"""Body files: gravity, rotation and atmosphere of a central body, and what else pulls or lights its orbits."""

from __future__ import annotations

import math
from typing import Annotated, Any, Final, Self

from pydantic import Field, field_validator, model_validator

from hil.config.tables.model import ConfigModel, Name, Positive, Triple
from hil.config.tables.truth import HIGHEST_DEGREE, check_direction
from hil.core.messages import MAX_AIR_LAYERS, MAX_THIRD_BODIES

_LARGEST: Final = 1e15  # bound of the Sun's gravity and of distances, in km

Layers = Annotated[tuple[float, ...], Field(min_length=1, max_length=MAX_AIR_LAYERS)]


class _AstronomicalModel(ConfigModel):
    """Tables with numbers beyond the range of a bench."""

    @field_validator("*")
    @classmethod
    def _numbers_are_in_range(cls, value: Any) -> Any:
        if isinstance(value, float) and abs(value) > _LARGEST:
            raise ValueError(f"{value:g}: must not exceed {_LARGEST:g}")
        return value


class Atmosphere(_AstronomicalModel):
    """Density that decreases exponentially within each layer; rotates with the body."""

    altitude_km: Layers
    """Base of each layer above `radius_km`, increasing."""
    density_kgpm3: Layers
    """Density at the base."""
    scale_height_km: Layers
    """Altitude over which the density falls to 1/e."""

    @model_validator(mode="after")
    def _layers_fit(self) -> Self:
        n = len(self.altitude_km)
        for name in ("density_kgpm3", "scale_height_km"):
            values = getattr(self, name)
            if len(values) != n:
                raise ValueError(f"{name}: {len(values)} numbers, altitude_km has {n}: one per layer")
            if not all(value > 0.0 for value in values):
                raise ValueError(f"{name}: {min(values):g} must be greater than 0")
        if any(high <= low for low, high in zip(self.altitude_km, self.altitude_km[1:], strict=False)):
            raise ValueError("altitude_km: must increase from layer to layer")
        return self


class ThirdBody(_AstronomicalModel):
    """Another body that pulls spacecraft and central body, on a circle about the central body."""

    name: Name
    """Its name."""
    gm_km3ps2: Positive
    """Gravitational parameter."""
    distance_km: Positive
    """From the central body."""
    period_d: Positive
    """Sidereal period."""
    pole: Triple = (0.0, 0.0, 1.0)
    """Unit vector about which it revolves, inertial."""
    direction: Triple | None = None
    """Unit vector to it at the start of the run, inertial; unless set, that to the Sun, `truth.sun_direction`."""

    @model_validator(mode="after")
    def _directions_are_unit_vectors(self) -> Self:
        check_direction("pole", self.pole)
        if self.direction is not None:
            check_direction("direction", self.direction)
        return self


class CentralBody(_AstronomicalModel):
    """Central body; inertial axes along its equator, z along its axis of rotation."""

    name: Name
    """Name in messages."""
    gm_km3ps2: Positive
    """Gravitational parameter."""
    radius_km: Positive
    """Equatorial radius: reference of `zonal`, of altitudes and of the shadow."""
    rotation_period_d: float
    """Sidereal period of the rotation; negative if it is retrograde."""
    zonal: Annotated[tuple[float, ...], Field(max_length=HIGHEST_DEGREE - 1)] = ()
    """J2, J3, ...: zonal harmonics, not normalised."""
    gravity_file: str | None = None
    """Gravity field instead of `zonal`: ICGEM .gfc, GMAT .cof or PDS SHADR .tab; its gravitational parameter holds."""
    sun_distance_au: Positive = 1.0
    """From the Sun: pressure of its light, and its apparent size."""
    atmosphere: Atmosphere | None = None
    third_bodies: Annotated[tuple[ThirdBody, ...], Field(max_length=MAX_THIRD_BODIES)] = ()
    """Bodies that perturb the orbit."""

    @model_validator(mode="after")
    def _is_a_body(self) -> Self:
        if self.rotation_period_d == 0.0:
            raise ValueError("rotation_period_d: 0 is no period, allowed is any other number")
        if self.zonal and self.gravity_file is not None:
            raise ValueError("zonal and gravity_file: both are given, allowed is one of them")
        if any(abs(value) >= 1.0 for value in self.zonal):
            raise ValueError(f"zonal: {max(self.zonal, key=abs):g} is no harmonic of a body, allowed below 1")
        return self

    @property
    def gm_m3ps2(self) -> float:
        """Gravitational parameter, m^3/s^2."""
        return self.gm_km3ps2 * 1e9

    @property
    def radius_m(self) -> float:
        """Equatorial radius, m."""
        return self.radius_km * 1e3

    @property
    def spin_radps(self) -> float:
        """Rate of the rotation about z, rad/s."""
        return 2.0 * math.pi / (self.rotation_period_d * 86400.0)
