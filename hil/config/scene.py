"""Scene files of the docking monitor: television camera, frame rate and target.

Lengths are metres in the frame C y1 y2 y3 of the target (monitor paper 3.1): the origin is the disc's centre, y3 is
the disc's normal towards the camera. ``level`` is the grey value of a part in rendered images; the
measurement does not use it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Final, Literal, Self

from pydantic import Field, model_validator

from hil.config.camera_identity import CameraIdentity
from hil.config.tables.model import ConfigModel, Name, Positive
from hil.maths import elementary, linear

LONGEST_M: Final = 100.0  # a longer part was probably given in millimetres
LABELS_AT_MOST: Final = 16
BOXES_AT_MOST: Final = 16
CORNERS_AT_MOST: Final = 32
REGION_PX_MIN: Final = 32

Level = Annotated[float, Field(ge=0.0, le=255.0)]
Length = Annotated[float, Field(gt=0.0, le=LONGEST_M)]
Place = Annotated[float, Field(ge=-LONGEST_M, le=LONGEST_M)]
Size = Annotated[int, Field(ge=32, le=8192)]
Point = tuple[Place, Place]
Tolerance = Annotated[float, Field(ge=0.0, le=100.0)]


class PixelNoise(ConfigModel):
    """Noise of a pixel of ``level`` grey values: its variance is ``read**2 + k * level``."""

    read: Annotated[float, Field(ge=0.0, le=64.0)] = 2.0
    """Read noise, 1 sigma."""
    k: Annotated[float, Field(ge=0.0, le=16.0)] = 0.0
    """Variance per grey level."""


class CameraTolerances(ConfigModel):
    """Errors of camera and optics, 1 sigma, that the sigmas of the results include; 0: exact, for rendered images.

    Default: a television camera whose focal length has been measured once, without a calibration.
    """

    focal_fraction: Tolerance = 2e-3
    """Focal length, relative."""
    aspect_fraction: Tolerance = 1e-3
    """Height of a pixel, relative to its width."""
    principal_point_px: Tolerance = 0.5
    """Principal point, along u and v."""
    distortion_px: Tolerance = 0.5
    """Radial distortion at the image's corner."""
    tone_px: Tolerance = 0.2
    """Shift of an edge of half the grey range towards its darker side by the camera's tone curve (all television has
    gamma); above 0 the curve is estimated."""
    time_s: Tolerance | None = None
    """Time of a portion's last frame: fields, lost frames; half an image period unless stated."""
    rate_fraction: Tolerance = 1e-3
    """Image rate, relative, on which all velocities rest."""
    focal_drift_per_s: Tolerance = 2e-5
    """Change of the focal length per second, relative: zoom, focus, warming up. It looks like a closing rate."""


class SceneCamera(ConfigModel):
    """A pinhole: ``u = cx + f x1/x3``, ``v = cy - f x2/x3``, px; pixel centres at whole numbers."""

    f: Positive
    """Focal length."""
    cx: float
    """Principal point."""
    cy: float
    """Principal point."""
    width: Size
    """Image width."""
    height: Size
    """Image height."""
    sky: Level = 12.0
    """Grey value behind everything, for rendering."""
    noise: PixelNoise = PixelNoise.model_construct()
    tolerances: CameraTolerances = CameraTolerances.model_construct()
    identity: CameraIdentity | None = None
    """The camera that this was measured of."""

    @model_validator(mode="after")
    def _is_a_camera(self) -> Self:
        for key, value, side in (("cx", self.cx, self.width), ("cy", self.cy, self.height)):
            if not -0.5 <= value <= side - 0.5:
                raise ValueError(f"{key} = {value:g}: the principal point must be in the image, -0.5 to {side - 0.5:g}")
        longer = max(self.width, self.height)
        if not 0.2 * longer <= self.f <= 200.0 * longer:
            raise ValueError(
                f"f = {self.f:g}: must be {0.2 * longer:g} to {200.0 * longer:g} px"
                f" for an image of {self.width} x {self.height}"
            )
        return self

    def region_error(self, box: Sequence[int]) -> str:
        """Return what is allowed for a region of search (u, v, width, height), px, if ``box`` is none; else ""."""
        u, v, width, height = box
        inside = u >= 0 and v >= 0 and u + width <= self.width and v + height <= self.height
        if inside and min(width, height) >= REGION_PX_MIN:
            return ""
        return (
            f"must be u,v,width,height in whole px within the image of {self.width} x {self.height},"
            f" at least {REGION_PX_MIN} x {REGION_PX_MIN}"
        )


class Disc(ConfigModel):
    """The target's circle, centred at the origin, in the plane y3 = 0."""

    radius_m: Length
    """Radius."""
    level: Level = 205.0
    """Grey value in rendered images."""


class Plate(ConfigModel):
    """The rectangle behind the disc, centred on its axis."""

    width_m: Length
    """Width."""
    height_m: Length
    """Height."""
    offset_m: Annotated[float, Field(ge=-LONGEST_M, le=0.0)] = 0.0
    """Along y3; negative behind the disc."""
    level: Level = 70.0
    """Grey value in rendered images."""


class Cross(ConfigModel):
    """Two bars along y1 and y2, ``offset_m`` in front of the disc; ``arm_length_m`` counts from the centre."""

    offset_m: Length
    """In front of the disc."""
    arm_length_m: Length
    """From the centre."""
    arm_width_m: Length
    """Full width of a bar."""
    level: Level = 25.0
    """Grey value in rendered images."""

    @model_validator(mode="after")
    def _bars_are_longer_than_wide(self) -> Self:
        if self.arm_width_m >= self.arm_length_m:
            raise ValueError(
                f"arm_width_m = {self.arm_width_m:g}: must be less than arm_length_m = {self.arm_length_m:g}"
            )
        return self


class Labels(ConfigModel):
    """Round dots on the disc."""

    radius_m: Length
    """Radius of a dot."""
    centers_m: Annotated[tuple[Point, ...], Field(min_length=1, max_length=LABELS_AT_MOST)]
    """Centres."""
    level: Level = 40.0
    """Grey value in rendered images."""

    @model_validator(mode="after")
    def _stand_apart(self) -> Self:
        for i, one in enumerate(self.centers_m):
            for j in range(i):
                if linear.length(a - b for a, b in zip(one, self.centers_m[j], strict=True)) <= 2.0 * self.radius_m:
                    raise ValueError(
                        f"centers_m[{i}] = {list(one)}: must be more than {2.0 * self.radius_m:g} from centers_m[{j}]"
                    )
        return self


class Box(ConfigModel):
    """A rectangle next to the target, parallel to the disc, ``offset_m`` along y3 from it."""

    x_m: Place
    """Centre along y1."""
    y_m: Place
    """Centre along y2."""
    width_m: Length
    """Width."""
    height_m: Length
    """Height."""
    offset_m: Place = 0.0
    """Along y3 from the disc."""
    level: Level = 225.0
    """Grey value in rendered images."""

    @property
    def clearance_m(self) -> float:
        """Distance of the rectangle's nearest point from the axis y3, m; 0 if the axis passes through it."""
        across = max(abs(self.x_m) - 0.5 * self.width_m, 0.0)
        up = max(abs(self.y_m) - 0.5 * self.height_m, 0.0)
        return elementary.hypot(across, up)


class Outline(ConfigModel):
    """Silhouette of the ship against the sky: a circle, or a polygon with straight edges.

    ``offset_m`` along y3, negative behind the disc.
    """

    radius_m: Length | None = None
    """Radius of a circle."""
    center_m: Point = (0.0, 0.0)
    """Centre of a circle."""
    corners_m: Annotated[tuple[Point, ...], Field(max_length=CORNERS_AT_MOST)] = ()
    """Corners of a polygon, in order along its border, instead of ``radius_m``."""
    offset_m: Annotated[float, Field(ge=-LONGEST_M, le=0.0)] = 0.0
    """Along y3; negative behind the disc."""
    level: Level = 120.0
    """Grey value in rendered images."""

    @model_validator(mode="after")
    def _is_circle_or_polygon(self) -> Self:
        corners = self.corners_m
        if (self.radius_m is None) != bool(corners):
            raise ValueError("radius_m and corners_m: give one of them, of a circle or of a polygon")
        if not corners:
            return self
        if self.center_m != (0.0, 0.0):
            raise ValueError(f"center_m = {list(self.center_m)}: is the centre of a circle, not for corners_m")
        if len(corners) < 3:
            raise ValueError(f"corners_m with {len(corners)} corners: must be 3 or more")
        for i, edge in enumerate(self._edges):
            if edge[0] == edge[1]:
                raise ValueError(f"corners_m[{i}] = {list(edge[0])}: must not be equal to the next corner")
            for k, other in enumerate(self._edges[:i]):
                if i - k not in (1, len(corners) - 1) and _cross(edge, other):
                    raise ValueError(f"corners_m: the edges from corners_m[{k}] and corners_m[{i}] must not cross")
        if abs(self._doubled_area) < 1e-6:
            raise ValueError("corners_m: the corners must not lie on one line")
        return self

    @property
    def _edges(self) -> list[tuple[Point, Point]]:
        corners = self.corners_m
        return [(one, corners[(i + 1) % len(corners)]) for i, one in enumerate(corners)]

    @property
    def _doubled_area(self) -> float:
        """Twice the area of the polygon, m^2, negative if its corners run from y2 to y1."""
        return linear.total(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in self._edges)

    @property
    def ordered_corners_m(self) -> tuple[Point, ...]:
        """Corners of the polygon from y1 to y2, m."""
        return self.corners_m if self._doubled_area > 0.0 else self.corners_m[::-1]

    @property
    def middle_m(self) -> Point:
        """Centre of the circle or centroid of the polygon, m."""
        if not self.corners_m:
            return self.center_m
        parts = [(one, two, one[0] * two[1] - two[0] * one[1]) for one, two in self._edges]
        x, y = (linear.total((one[i] + two[i]) * part for one, two, part in parts) for i in (0, 1))
        return x / (3.0 * self._doubled_area), y / (3.0 * self._doubled_area)

    @property
    def mean_radius_m(self) -> float:
        """Radius of the circle, or of the circle of the polygon's area, m."""
        return math.sqrt(0.5 * abs(self._doubled_area) / math.pi) if self.radius_m is None else self.radius_m

    @property
    def clearance_m(self) -> float:
        """Distance of the axis y3 from the polygon's border, m; negative if the axis is outside."""
        # the ray from the axis along y1 crosses the border an odd number of times if the axis is inside
        inside = False
        for (x0, y0), (x1, y1) in self._edges:
            if (y0 > 0.0) != (y1 > 0.0) and x0 - y0 * (x1 - x0) / (y1 - y0) > 0.0:
                inside = not inside
        least = min(_from_origin(*edge) for edge in self._edges)
        return least if inside else -least


def _from_origin(one: Point, two: Point) -> float:
    """Return the distance of the origin from the straight edge between two points."""
    dx, dy = two[0] - one[0], two[1] - one[1]
    share = min(max(-(one[0] * dx + one[1] * dy) / (dx * dx + dy * dy), 0.0), 1.0)
    return elementary.hypot(one[0] + share * dx, one[1] + share * dy)


def _cross(edge: tuple[Point, Point], other: tuple[Point, Point]) -> bool:
    """Return whether two straight edges have a point in common."""

    def side(p: Point, q: Point, r: Point) -> float:
        return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

    (a, b), (c, d) = edge, other
    return side(a, b, c) * side(a, b, d) <= 0.0 and side(c, d, a) * side(c, d, b) <= 0.0


class Target(ConfigModel):
    """Features of the target: disc and cross (near), outline (far), or all of them; the others are for validation."""

    disc: Disc | None = None
    plate: Plate | None = None
    cross: Cross | None = None
    labels: Labels | None = None
    boxes: Annotated[tuple[Box, ...], Field(max_length=BOXES_AT_MOST)] = ()
    outline: Outline | None = None

    @property
    def near(self) -> bool:
        """Whether the target has the features of the near mode."""
        return self.disc is not None

    @property
    def far(self) -> bool:
        """Whether the target has the features of the far mode."""
        return self.outline is not None

    @model_validator(mode="after")
    def _is_possible(self) -> Self:
        if self.disc is None:
            for key, part in (("cross", self.cross), ("labels", self.labels), ("plate", self.plate)):
                if part is not None:
                    raise ValueError(f"disc is missing: {key} needs it")
            if self.outline is None:
                raise ValueError("disc with cross, and outline, are missing: give one or both")
            return self
        if self.cross is None:
            raise ValueError("cross is missing: disc needs it (their offset gives the camera position)")
        self._check_disc(self.disc, self.cross)
        return self

    def _check_disc(self, disc: Disc, cross: Cross) -> None:
        radius = f"disc.radius_m = {disc.radius_m:g}"
        reach = elementary.hypot(cross.arm_length_m, 0.5 * cross.arm_width_m)
        if reach >= disc.radius_m:
            raise ValueError(f"cross.arm_length_m = {cross.arm_length_m:g}: the arms must end inside {radius}")
        if self.plate is not None:
            for key, side in (("width_m", self.plate.width_m), ("height_m", self.plate.height_m)):
                if side < 2.0 * disc.radius_m:
                    raise ValueError(f"plate.{key} = {side:g}: must be {2.0 * disc.radius_m:g} or more, for {radius}")
        if self.labels is not None:
            for number, centre in enumerate(self.labels.centers_m):
                if linear.length(centre) + self.labels.radius_m > disc.radius_m:
                    raise ValueError(
                        f"labels.centers_m[{number}] = {list(centre)}: with labels.radius_m = {self.labels.radius_m:g}"
                        f" it must end inside {radius}"
                    )
        for number, box in enumerate(self.boxes):
            if box.clearance_m < disc.radius_m:
                raise ValueError(f"boxes[{number}] at x_m = {box.x_m:g}, y_m = {box.y_m:g}: must not lie over {radius}")
        if self.outline is not None:
            inner = linear.length(self.outline.center_m) + disc.radius_m
            if self.outline.corners_m and self.outline.clearance_m <= disc.radius_m:
                raise ValueError(f"outline.corners_m: must lie around {radius}")
            if self.outline.radius_m is not None and self.outline.radius_m <= inner:
                raise ValueError(
                    f"outline.radius_m = {self.outline.radius_m:g}: must be more than {inner:g}, around {radius}"
                )


class Scene(ConfigModel):
    """One camera, one ship. The upper field of a half frame has the lines 0, 2, 4 ..."""

    name: Name = ""
    """Name in reports."""
    camera: SceneCamera
    fps: Annotated[float, Field(gt=0.0, le=1000.0)]
    """Images per second; determines all times."""
    fields: Literal["whole", "upper_first", "lower_first"] = "whole"
    """Whole frames, or half frames: which field is exposed first, the other half a period later."""
    roll_max_deg: Annotated[float, Field(gt=0.0, le=180.0)] = 180.0
    """Largest roll of the ship in the image, either way. The cross looks the same when rolled by 90 deg: a roll up to
    this one that no other part excludes makes a portion ``ambiguous``."""
    target: Target
    """The target; disc and cross (near), the outline (far), or all three."""
    backup: Target | None = None
    """Second target, in its own frame C."""

    def chosen(self, which: Literal["basic", "backup"]) -> Target:
        """Return the basic or the backup target; ValueError if the scene has no backup target."""
        if which == "basic":
            return self.target
        if self.backup is None:
            raise ValueError("backup: the scene has no backup target")
        return self.backup
