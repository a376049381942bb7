"""Geometry of the bench: its scale, table ``[bench]`` of a scenario, and its errors.

These are the tables ``bench.errors`` of rig and scenario, and the parameters of a geometry file.
"""

from __future__ import annotations

from typing import Annotated, Final, Self

import numpy as np
from pydantic import Field, model_validator

from hil.config.tables.model import ConfigModel, NotNegative, Positive, Triple
from hil.config.tables.units import si_factor
from hil.core.messages import Array

_NONE3: Final = (0.0, 0.0, 0.0)
_NONE4: Final = (*_NONE3, 0.0)
_NONE9: Final = 3 * _NONE3
Pair = tuple[float, float]
Four = tuple[float, float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]


class MachineGeometry(ConfigModel):
    """Parameters of the geometry: by how much the bench differs from an ideal one with the numbers of its rig file.

    Functions of a rail's travel are Legendre polynomials P1, P2, P3, from -1 at its low to 1 at its high end. A rail
    displaces and rotates all that it carries (`bench.rails_order`). Gauge: positions of the rails, and P1 of their
    straightness, are in `base` and `squareness`; tracked bodies are c and H.
    """

    base_m: Triple = _NONE3
    """Origin of the rails in L."""
    base_deg: Triple = _NONE3
    """Rotation vector of the rails' axes against L."""
    x_position_m: Triple = _NONE3
    """Positioning error of rail x: P1 (scale), P2, P3."""
    x_straightness_m: Four = _NONE4
    """Straightness of rail x: P2, P3 along y, P2, P3 along z."""
    x_rotation_deg: Nine = _NONE9
    """Rotation of the carriage of rail x: P1, P2, P3 about x (roll), about y, about z."""
    y_position_m: Triple = _NONE3
    """The same of rail y."""
    y_straightness_m: Four = _NONE4
    """P2, P3 along x, P2, P3 along z."""
    y_rotation_deg: Nine = _NONE9
    """P1, P2, P3 about x, about y (roll), about z."""
    z_position_m: Triple = _NONE3
    """The same of rail z."""
    z_straightness_m: Four = _NONE4
    """P2, P3 along x, P2, P3 along y."""
    z_rotation_deg: Nine = _NONE9
    """P1, P2, P3 about x, about y, about z (roll)."""
    squareness_deg: Triple = _NONE3
    """Excess over 90 deg of the angles between rails x and y, y and z, z and x."""
    turntable_deg: Triple = _NONE3
    """Rotation of the turntable on the last carriage: zero offset of the outer gimbal, and the tilt of its axis."""
    middle_m: float = 0.0
    """Distance of the middle gimbal's axis from the outer one."""
    middle_deg: Pair = (0.0, 0.0)
    """Angle by which outer and middle axis are not orthogonal, and zero offset of the middle gimbal."""
    inner_m: Pair = (0.0, 0.0)
    """Distance of the inner gimbal's axis from the middle one, and displacement along that."""
    inner_deg: float = 0.0
    """Angle by which middle and inner axis are not orthogonal."""
    reference_m: Triple = _NONE3
    """Displacement of the chaser's reference point in c: error of `bench.lever_arm_m`."""
    reference_deg: Triple = _NONE3
    """Rotation of c on the inner gimbal, the zero offset of which it contains."""
    camera_m: Triple = _NONE3
    """In c: error of `bench.camera_position_m`."""
    camera_deg: Triple = _NONE3
    """Rotation of the camera about the axes of c."""
    ring_m: Triple = _NONE3
    """In H: error of `bench.led_ring_position_m`."""
    ring_deg: Triple = _NONE3
    """Rotation of the LED ring about the axes of H."""

    @property
    def vector(self) -> Array:
        """All parameters, (PARAMETERS,), in the order above, m and rad."""
        values = [getattr(self, name) for name in _SIZES]
        flat = [each for value in values for each in (value if isinstance(value, tuple) else (value,))]
        vector: Array = np.array(flat) * _FACTORS
        return vector

    @classmethod
    def tables_of(cls, vector: Array) -> dict[str, float | list[float]]:
        """Return the keys and values, in units of the file, of ``vector`` (PARAMETERS,), m and rad."""
        values = iter((vector / _FACTORS).tolist())
        return {
            name: next(values) if size == 1 else [next(values) for _ in range(size)] for name, size in _SIZES.items()
        }


_SIZES: Final = {
    name: len(field.default) if isinstance(field.default, tuple) else 1
    for name, field in MachineGeometry.model_fields.items()
}
NAMES: Final = tuple(name if size == 1 else f"{name}[{k}]" for name, size in _SIZES.items() for k in range(size))
"""Names of the parameters, in the order of ``MachineGeometry.vector``."""
PARAMETERS: Final = len(NAMES)
ROTATIONS: Final = np.array(["_deg" in name for name in NAMES])
"""Which of them are rotations, rad; the others are m."""
_FACTORS: Final = np.array([si_factor(name.partition("[")[0]) for name in NAMES])


def parts_of(vector: Array) -> dict[str, Array]:
    """Return the parameters of ``vector`` (PARAMETERS,) by their keys, each an array, m and rad."""
    ends = np.cumsum([*_SIZES.values()])
    return {name: vector[end - size : end] for (name, size), end in zip(_SIZES.items(), ends, strict=True)}


class MachineErrors(MachineGeometry):
    """How mock and emulated rigs are built wrong: their encoders read as if they were right.

    Unless set here, they are built as in `bench.geometry_file`. The scenario's errors are added to the rig's.
    """

    seed: Annotated[int, Field(ge=0)] | None = None
    """Draw random errors of all parameters with this seed, in addition."""
    random_m: NotNegative = 1e-3
    """Their standard deviation."""
    random_deg: Annotated[float, Field(ge=0.0, le=5.0)] = 0.05
    """Their standard deviation."""

    @property
    def vector(self) -> Array:
        vector = super().vector
        if self.seed is not None:
            from hil.maths.random_streams import noise_source  # imports the compiler

            sigma = np.where(ROTATIONS, si_factor("random_deg") * self.random_deg, self.random_m)
            vector = vector + sigma * noise_source(self.seed, "geometry").standard_normal((PARAMETERS,))
        return vector

    @property
    def is_empty(self) -> bool:
        """Whether the machine has no errors."""
        return not self.vector.any()

    @model_validator(mode="after")
    def _errors_are_small(self) -> Self:
        size = float(np.abs(self.vector).max())
        if size > 0.2:
            name = NAMES[int(np.abs(self.vector).argmax())]
            raise ValueError(f"{name}: {size:g} m or rad, allowed 0.2: an error of the geometry, not the geometry")
        return self


class BenchScale(ConfigModel):
    """Scale of the bench: at a distance it moves a fraction of the way, along the same line of sight.

    Nearer than `scaled_beyond_m` the bench shows the relative motion as it is. Beyond it shows the direction of the
    target and a fraction of the additional distance, without a jump of position or velocity. What is measured on the
    bench there is converted back, except poses of the vision unit: these are not used.
    """

    scaled_beyond_m: Positive | None = None
    """Distance of the reference points beyond which the bench is scaled; unless set, nowhere."""
    scale: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """Part of the additional distance that the bench moves, between 0 and 1."""
    errors: MachineErrors = MachineErrors.model_construct()
    """Errors of the geometry of mock and emulated rigs, in addition to those of the rig."""


FULL_SCALE: Final = BenchScale.model_construct()
