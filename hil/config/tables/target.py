"""Table ``[target]`` of a scenario: motion of the target about its centre of mass."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.model import AngleTriple, ConfigModel, NotNegative, Positive, Triple
from hil.maths import linear

RATE_MAX_DEGPS = 30.0
Amplitude = Annotated[float, Field(ge=0.0, le=20.0)]
DriftRate = Annotated[float, Field(ge=0.0, le=1.0)]
Cycles = Annotated[float, Field(ge=-1.0, le=1.0)]
TumbleRate = Annotated[float, Field(ge=-RATE_MAX_DEGPS, le=RATE_MAX_DEGPS)]


class LimitCycle(ConfigModel):
    """Limit cycle of the target's own attitude control: it drifts between two ends, where burns reverse it."""

    amplitude_deg: tuple[Amplitude, Amplitude, Amplitude] = (0.0, 0.0, 0.0)
    """Largest angle about each axis of the Hill frame."""
    rate_degps: tuple[DriftRate, DriftRate, DriftRate] = (0.0, 0.0, 0.0)
    """Rate of the drift."""
    acceleration_degps2: Positive = 0.1
    """Angular acceleration of a burn."""
    phase_cycles: tuple[Cycles, Cycles, Cycles] = (0.0, 0.0, 0.0)
    """Place in the cycle at the start of the run; at 0 the angle is 0 and increases."""

    @model_validator(mode="after")
    def _burns_fit_into_the_cycle(self) -> Self:
        for amplitude, rate in zip(self.amplitude_deg, self.rate_degps, strict=True):
            if (amplitude == 0.0) != (rate == 0.0):
                raise ValueError(f"amplitude_deg {amplitude:g} and rate_degps {rate:g}: must both be 0, or neither")
            least = 0.5 * rate * rate / self.acceleration_degps2
            if amplitude < least:
                raise ValueError(
                    f"amplitude_deg {amplitude:g}: a burn of acceleration_degps2 {self.acceleration_degps2:g} "
                    f"takes {least:.3g} deg to stop rate_degps {rate:g}, allowed from there"
                )
        return self


class MovingTarget(ConfigModel):
    """Motion of the target; its body axes take the place of the Hill frame H if they rotate against it."""

    motion: Literal["aligned", "tumble", "limit_cycle"] = "aligned"
    """Aligned with the Hill frame, tumbling without torque, or held about the Hill frame within a dead band."""
    rate_degps: tuple[TumbleRate, TumbleRate, TumbleRate] = (0.0, 0.0, 0.0)
    """Of a tumble: rate against inertial space at the start, in the body axes."""
    attitude_deg: AngleTriple = (0.0, 0.0, 0.0)
    """Of a tumble: 3-2-1 angles from the Hill frame to the body axes at the start."""
    moments_kg_m2: tuple[Positive, Positive, Positive] = (1.0, 1.0, 1.0)
    """Principal moments of inertia; only their ratios count."""
    principal_axes_deg: AngleTriple = (0.0, 0.0, 0.0)
    """3-2-1 angles from the body axes to the principal ones."""
    limit_cycle: LimitCycle = LimitCycle.model_construct()

    @model_validator(mode="after")
    def _moments_are_those_of_a_body(self) -> Self:
        largest = max(self.moments_kg_m2)
        others = linear.total(self.moments_kg_m2) - largest
        if largest > others * (1.0 + 1e-9):
            raise ValueError(f"moments_kg_m2: {largest:.6g} must not exceed the sum of the others, {others:.6g}")
        return self

    @model_validator(mode="after")
    def _keys_suit_the_motion(self) -> Self:
        if self.motion != "tumble" and any(self.rate_degps):
            raise ValueError(f'rate_degps does not go with motion = "{self.motion}", allowed "tumble"')
        if self.motion != "limit_cycle" and any(self.limit_cycle.rate_degps):
            raise ValueError(f'limit_cycle does not go with motion = "{self.motion}", allowed "limit_cycle"')
        return self


class KnownTarget(ConfigModel):
    """The target's rotation in the GNC at the start; it estimates rate and moments of a tumble from the poses.

    Of a limit cycle it is given the mean, the orbit's rate, and estimates the rate.
    """

    rate_error_degps: Triple = (0.0, 0.0, 0.0)
    """Error of the rate at the start, in the body axes: its value minus the true one."""
    rate_sigma_degps: NotNegative = 0.1
    """Standard deviation of such an error, about each axis; 0: the rate is not estimated."""
    rate_walk_degps: NotNegative = 0.0
    """Random walk of the rate over a minute, by torques on the target."""
    moments_sigma: NotNegative = 0.02
    """Standard deviation of the relative error of each principal moment; 0: they are known."""
