"""Limits of the bench guard, the volume about the target that no run may enter, and convex bodies."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from hil.config.tables.model import ConfigModel, NotNegative, Positive, Triple

BODIES_MAX: Final = 8  # bodies of each kind


class Body(ConfigModel):
    """Convex hull of points, widened by a radius: one point is a sphere, two are a rod with round ends, eight a box."""

    vertices_m: Annotated[tuple[Triple, ...], Field(min_length=1, max_length=16)]
    """Its points, 1 to 16, in the frame of `on`."""
    radius_m: NotNegative = 0.0
    """Radius by which the hull is widened."""


class SpacecraftBody(Body):
    """Part of a spacecraft that stands forward of its interface."""

    on: Literal["chaser", "target"]
    """`chaser`: in c, from the chaser's reference point; `target`: in H, from the target's."""


class BenchBody(Body):
    """Part of the bench or of the lab."""

    on: Literal["carriage", "turntable", "lab", "target"]
    """`carriage`: moves with the rails, in L from the turntable's centre of rotation; `turntable`: rotates with it, in
    c from the chaser's reference point; `lab`: stands still, in L from the target's reference point, there at 0;
    `target`: moves with the target of `target_manipulator.sharing`, in L from its reference point."""


def check_kinds(bodies: Sequence[SpacecraftBody | BenchBody], *fixed: str) -> None:
    """Raise ValueError if there are too many bodies of a kind, or none that can meet. fixed: kinds that others meet."""
    kinds = [body.on for body in bodies]
    for kind in kinds:
        if kinds.count(kind) > BODIES_MAX:
            raise ValueError(f'bodies: {kinds.count(kind)} with on = "{kind}", allowed {BODIES_MAX}')
    if kinds and (not {*fixed} & {*kinds} or len({*kinds}) == 1):
        shown = ", ".join(f'"{kind}"' for kind in sorted(set(kinds)))
        raise ValueError(f'bodies: all have on = {shown}, allowed is "{fixed[0]}" together with one that moves')


Count = Annotated[int, Field(ge=1, le=10_000)]


class KeepOut(ConfigModel):
    """Guard volume: sphere and half-space that the chaser's reference point must not enter, bodies that must not meet.

    It holds for the truth of a run, and for the encoders whenever axes are commanded.
    """

    radius_m: Annotated[float, Field(ge=0.0, le=1000.0)] = 0.25
    """Radius of the sphere about the target's reference point, and distance of the half-space behind it, along
    `gnc.corridor.axis`; 0 for a scenario that docks without them."""
    docks: bool = False
    """Whether the chaser comes to contact: sphere and half-space do not hold within `gnc.corridor.minimum_radius_m` of
    the docking axis. 0 as `radius_m` implies it."""
    inspects: bool = False
    """Whether the chaser goes around the target: there is no half-space, only sphere and bodies."""
    bodies: tuple[SpacecraftBody, ...] = ()
    """`[[keep_out.bodies]]`: parts forward of the interfaces of chaser and target, at most 8 of each."""
    distance_m: Positive = 0.05
    """Least distance between a body of the chaser and one of the target."""

    @model_validator(mode="after")
    def _bodies_can_meet(self) -> Self:
        check_kinds(self.bodies, "target")
        return self

    @property
    def has_corridor(self) -> bool:
        """Whether sphere and half-space are open along the docking axis."""
        return self.docks or self.radius_m == 0.0


class GuardConfig(ConfigModel):
    """Bench guard: checks of each cycle of a run, for any GNC; a violated limit is a safe stop."""

    enabled: bool = True
    """Whether the guard acts; hardware without it is a waiver."""
    reaction_s: NotNegative = 0.1
    """Time from a violated keep-out to braking axes, for the least range at a closing rate."""
    pose_error_max_m: Positive = 0.005
    """Largest distance of the bench, by its encoders, from the truth at rest."""
    pose_error_max_deg: Positive = 0.3
    """The same for the attitude."""
    pose_error_per_speed_s: NotNegative = 0.1
    """Increase of both per speed and rate of the truth."""
    pose_error_cycles: Count = 5
    """Consecutive cycles beyond it that trip."""
    limited_max_s: Positive = 0.5
    """Longest time for which setpoints may be limited without a break."""
    axis_error_max_m: Positive = 0.0006
    """Largest distance of a rail from the demand through the model of its drive, at rest."""
    axis_error_max_deg: Positive = 0.03
    """The same for a gimbal."""
    axis_error_per_speed_s: NotNegative = 0.05
    """Increase of both per demanded speed: uncertainty of the drive's delay."""
    axis_error_cycles: Count = 3
    """Consecutive cycles beyond it that trip."""
    vision_sigmas: Positive = 5.0
    """Standard deviations by which a pose may differ from the encoders, in addition to the calibration."""
    vision_error_max_m: NotNegative = 0.003
    """Error of the calibration between cameras and axes: position."""
    vision_error_max_deg: NotNegative = 0.1
    """The same for the attitude."""
    vision_frames_max: Count = 5
    """Consecutive poses beyond it that trip."""
    estimate_error_max_m: Positive = 0.028
    """Largest mean error of any GNC's estimate against the encoders, per axis, in addition to three standard deviations
    of it; at most the protection level that it reports. Beyond it: `gnc.reactions.bench_disagrees`."""
    estimate_error_max_deg: Positive = 0.5
    """The same for the attitude."""
    calibration_m: NotNegative = 0.001
    """What the calibration between camera and axes leaves, by which estimate and encoders may differ."""
    calibration_deg: NotNegative = 0.02
    """The same for the attitude."""
    startup_s: NotNegative = 2.0
    """Longest time at the start, and after a hold, in which the axes catch up with a chaser in motion."""
