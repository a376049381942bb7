"""Mechanics of emulated axes: what distinguishes a machine from its ideal servo."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Final, Self

from pydantic import Field, model_validator

from hil.config.tables.model import ConfigModel, NotNegative, Positive
from hil.maths.elementary import square

_HIGHEST_HZ: Final = 500.0  # highest frequency of the model, which is integrated in steps of 0.1 ms

Fraction = Annotated[float, Field(ge=0.0, le=1.0)]
Frequency = Annotated[float, Field(ge=0.0, le=_HIGHEST_HZ)]


class DriveMechanics(ConfigModel):
    """Effects of the mechanics of emulated axes, each switched off by 0."""

    force: ClassVar[str]  # unit of the keys
    si_per_length: ClassVar[float]

    enabled: bool = True
    """false: the ideal servo, without any of the effects below."""
    loop_delay_s: Annotated[float, Field(ge=0.0, le=0.1)] = 0.0
    """From the receipt of a setpoint until the drive acts on it: interpolation and control cycles."""
    velocity_bandwidth_hz: Annotated[float, Field(gt=0.0, le=_HIGHEST_HZ)] = 40.0
    """Bandwidth of the drive's velocity loop, which works against friction and cogging."""
    force_reserve_fraction: Positive = 1.0
    """Force of the drive beyond that for the acceleration limit, as a fraction of it."""
    resonance_hz: Frequency = 0.0
    """Frequency of the load on its transmission while the motor is held; 0: rigid."""
    load_ratio: Positive = 1.0
    """Ratio of load to motor, mass or inertia, at the load's side of the gear."""
    damping_ratio: Fraction = 0.05
    """Damping of that resonance."""

    @property
    def mass(self) -> float:
        """Moved mass, kg, or inertia, kg m^2."""
        raise NotImplementedError

    def si(self, key: str) -> float:
        """Return ``key``, named without its unit, in SI units; forces divided by ``mass``."""
        value: float = super().si(key)
        return value / self.mass if self.key_of(key).endswith(f"_{self.force}") else value

    @property
    def viscous(self) -> float:
        """Viscous friction, 1/s."""
        raise NotImplementedError

    @model_validator(mode="after")
    def _the_model_can_be_integrated(self) -> Self:
        breakaway = self.si("friction_breakaway")
        if breakaway < self.si("friction_coulomb"):
            raise ValueError(
                f"friction_breakaway_{self.force} {self.in_file('friction_breakaway'):g}: allowed from "
                f"friction_coulomb_{self.force} {self.in_file('friction_coulomb'):g}"
            )
        load = self.load_ratio / (1.0 + self.load_ratio) if self.resonance_hz else 1.0
        least = breakaway / load / square(math.tau * _HIGHEST_HZ)
        if self.si("presliding") < least:
            raise ValueError(
                f"{self.key_of('presliding')} {self.in_file('presliding'):g}: allowed from "
                f"{least / self.si_per_length:.3g} with this friction: else it is stiffer than {_HIGHEST_HZ:g} Hz"
            )
        return self


class RailMechanics(DriveMechanics):
    """Mechanics of the emulated rails."""

    force: ClassVar = "n"
    si_per_length: ClassVar = 1.0

    mass_kg: Positive = 200.0
    """Moved mass, motors included."""
    friction_coulomb_n: NotNegative = 0.0
    """Friction while the axis slides."""
    friction_breakaway_n: NotNegative = 0.0
    """Friction at which it begins to slide; more than the former makes it stick and slip. 0: no friction."""
    friction_stribeck_mps: Positive = 0.001
    """Speed at which break-away friction has fallen to sliding friction."""
    friction_viscous_n_per_mps: NotNegative = 0.0
    """Increase of the friction per speed."""
    presliding_m: Positive = 1.5e-5
    """Elastic deflection of the contacts at break-away."""
    backlash_m: NotNegative = 0.0
    """Gap between motor and load."""
    cogging_n: NotNegative = 0.0
    """Amplitude of the motor's cogging."""
    cogging_period_m: Positive = 0.001
    """Its period along the axis."""
    encoder_step_m: NotNegative = 0.0
    """Resolution of the encoder, at the motor."""

    @property
    def mass(self) -> float:
        return self.mass_kg

    @property
    def viscous(self) -> float:
        return self.friction_viscous_n_per_mps / self.mass


class GimbalMechanics(DriveMechanics):
    """Mechanics of the emulated turntable."""

    force: ClassVar = "nm"
    si_per_length: ClassVar = math.pi / 180.0

    inertia_kg_m2: Positive = 2.0
    """Moved inertia, motors included."""
    friction_coulomb_nm: NotNegative = 0.0
    """Friction while the axis turns."""
    friction_breakaway_nm: NotNegative = 0.0
    """Friction at which it begins to turn; more than the former makes it stick and slip. 0: no friction."""
    friction_stribeck_degps: Positive = 0.05
    """Rate at which break-away friction has fallen to sliding friction."""
    friction_viscous_nm_per_degps: NotNegative = 0.0
    """Increase of the friction per rate."""
    presliding_deg: Positive = 0.001
    """Elastic deflection of the contacts at break-away."""
    backlash_deg: NotNegative = 0.0
    """Gap between motor and load."""
    cogging_nm: NotNegative = 0.0
    """Amplitude of the motor's cogging."""
    cogging_period_deg: Positive = 1.0
    """Its period along the axis."""
    encoder_step_deg: NotNegative = 0.0
    """Resolution of the encoder, at the motor."""

    @property
    def mass(self) -> float:
        return self.inertia_kg_m2

    @property
    def viscous(self) -> float:
        return self.friction_viscous_nm_per_degps / self.si_per_length / self.mass
