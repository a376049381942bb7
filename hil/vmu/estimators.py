"""Pose estimators: the software that a vision unit runs on its images, selected by ``vmu.estimator`` of the rig file.

``_BUILT_IN`` lists the shipped ones. Other packages register theirs by entry points of the group
``hil.pose_estimators``:

    [project.entry-points."hil.pose_estimators"]
    acme = "acme_vision:make_estimator"

The value is a function of the geometry (cameras, LEDs) and of the table ``[vmu.estimator_settings]`` that returns a
``PoseEstimator``. It runs in the vision process of a rig, in that of an emulated unit, and in replays.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Final, Protocol

import numpy as np

from hil.config.vmu_geometry import OFFICIAL, OPENCV, VmuGeometry
from hil.core.messages import Array, PoseFrame
from hil.core.plug_ins import call, raised_text, wrong_return
from hil.errors import BadInput

GROUP: Final = "hil.pose_estimators"
LED_RING: Final = "led_ring"
GEOMETRY: Final = "geometry file"
"""Source of the problems of a geometry, which an estimator raises."""
PRINT: Final = "rejected_print"
"""Status: the target fits several ways to print it, or not the one of the geometry file."""
_BUILT_IN: Final = {
    LED_RING: "hil.vmu.estimators:led_ring",
    "apriltag": "hil.vmu.boards:apriltag",
    "charuco": "hil.vmu.boards:charuco",
}
DRAWN: Final = {"apriltag": OFFICIAL, "charuco": OPENCV}
"""Print of the target that rendered and emulated cameras draw, unless a geometry file states another."""
_UNIT: Final = 1e-6
_DEFINITE: Final = -1e-9  # relative to the largest eigenvalue


@dataclass(frozen=True, slots=True)
class FlatTarget:
    """Printed target, which emulated cameras draw: its image (h, w), uint8, and its size, m.

    Its centre is the origin of t; u of the image is along x_t, v along y_t, and z_t points away from the cameras.
    """

    image: np.ndarray
    width_m: float
    height_m: float


@dataclass(frozen=True, slots=True)
class PoseEstimate:
    """Result of one stereo pair. status: ``ok`` with a pose; any other one names the reason.

    t_v: (3,), m. q_vt: (4,), scalar last, ``p_v = A(q_vt) p_t + t_v``. covariance: (6, 6), m^2, m rad, rad^2, of t_v
    and of the small rotation e about v's axes, ``R_est = exp([e]x) R_true``. noise: (6, 6), the part of it that is
    independent between images; None: all of it. Raises ValueError for a pose that is none.
    """

    t_s: float
    status: str
    t_v: Array | None = None
    q_vt: Array | None = None
    covariance: Array | None = None
    noise: Array | None = None

    def __post_init__(self) -> None:
        if self.status != "ok":
            return
        for name, shape in (("t_v", (3,)), ("q_vt", (4,)), ("covariance", (6, 6)), ("noise", (6, 6))):
            value = getattr(self, name)
            if name == "noise" and value is None:
                continue
            if np.shape(value) != shape or not np.isfinite(value).all():
                raise ValueError(f"{name} of an ok estimate must be {shape} finite numbers, is {value}")
        if abs(float(np.linalg.norm(self.q_vt)) - 1.0) > _UNIT:  # type: ignore[arg-type]
            raise ValueError(f"q_vt must be a unit quaternion, is {self.q_vt}")
        values = np.linalg.eigvalsh(self.covariance)  # type: ignore[arg-type]
        if not values[-1] > 0.0 or values[0] < _DEFINITE * values[-1]:
            raise ValueError(f"covariance must be positive definite, its eigenvalues are {values}")

    def frame(self, counter: int, received_s: float, only_noise: bool = False) -> PoseFrame | None:
        """Return the pose as the bench's message, None without one. only_noise: with the covariance ``noise``."""
        if self.status != "ok":
            return None
        covariance = self.noise if only_noise and self.noise is not None else self.covariance
        return PoseFrame(counter, self.t_s, received_s, self.t_v, self.q_vt, covariance)  # type: ignore[arg-type]


class Solved(Protocol):
    """What an estimator returns: an ``PoseEstimate``, or the ``Solution`` of the LED ring."""

    @property
    def status(self) -> str:
        """``ok``, or the reason why there is no pose."""

    def frame(self, counter: int, received_s: float, only_noise: bool = False) -> PoseFrame | None:
        """Return the pose as the bench's message, None without one."""


class PoseEstimator(Protocol):
    """Software of a vision unit. ``board``, if it has one: FlatTarget that emulated cameras draw; else the LED ring."""

    def warm_up(self) -> None:
        """Load and compile all that the first pair would wait for."""

    def solve(self, left: np.ndarray | None, right: np.ndarray | None, t_s: float) -> Solved:
        """Return the pose by the images (h, w), uint8, exposed at ``t_s``, s; None for a missing one. Never waits."""


Factory = Callable[[VmuGeometry, Mapping[str, Any]], PoseEstimator]


def make_estimator(
    name: str, geometry: VmuGeometry, settings: Mapping[str, Any], source: str | None = None
) -> PoseEstimator:
    """Return the estimator ``name``. Raises BadInput that names key, value and what is allowed.

    source: path of the geometry file, if it is from one, for errors.
    """
    try:
        return _factory(name)(geometry, settings)
    except BadInput as error:
        if source is None:
            raise
        problems = [replace(each, source=source) if each.source == GEOMETRY else each for each in error.problems]
        raise BadInput(problems) from error
    except Exception as cause:
        text = f'estimator "{name}" cannot be made: {raised_text("", cause)}'
        raise BadInput.single("rig", "vmu.estimator_settings", text) from cause


def _factory(name: str) -> Factory:
    if name in _BUILT_IN:
        module, _, attribute = _BUILT_IN[name].partition(":")
        factory: Factory = getattr(import_module(module), attribute)
        return factory
    points = [point for point in entry_points(group=GROUP) if point.name == name]
    if len(points) != 1:
        what = "of several packages" if points else "unknown estimator"
        names = ", ".join([*_BUILT_IN, *sorted({point.name for point in entry_points(group=GROUP)})])
        raise BadInput.single("rig", "vmu.estimator", f'"{name}": {what}, known: {names}')
    try:
        loaded: Factory = points[0].load()
    except Exception as cause:
        text = f'"{name}": {points[0].value} cannot be imported: {type(cause).__name__}: {cause}'
        raise BadInput.single("rig", "vmu.estimator", text) from cause
    return loaded


def board_of(estimator: PoseEstimator) -> FlatTarget | None:
    """Return the printed target of ``estimator``, None if it measures the LED ring."""
    board: FlatTarget | None = getattr(estimator, "board", None)
    return board


def solve_pair(estimator: PoseEstimator, left: np.ndarray | None, right: np.ndarray | None, t_s: float) -> Solved:
    """Return the result of ``estimator``. Raises PlugInError if it raises, or returns no result."""
    solved = call("vmu", estimator.solve, left, right, t_s)
    if not (isinstance(getattr(solved, "status", None), str) and callable(getattr(solved, "frame", None))):
        raise wrong_return("vmu", estimator.solve, f"{solved!r:.60}, expected PoseEstimate")
    return solved


def led_ring(geometry: VmuGeometry, settings: Mapping[str, Any]) -> PoseEstimator:
    """Return the estimator of the LED ring. Raises BadInput if there are settings: it has none."""
    from hil.vmu.unit import VisionUnit

    if settings:
        raise BadInput.single("rig", "vmu.estimator_settings", f"{', '.join(settings)}: led_ring has no settings")
    return VisionUnit(geometry)
