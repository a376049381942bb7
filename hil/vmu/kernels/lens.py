"""Camera model: pinhole with Brown-Conrady distortion (OpenCV's k1 k2 p1 p2 k3), and a pair of cameras.

Camera axes: x right, y down, z along the optical axis; pixel centres at integers. The left camera's
axes are v; camera i sees a point p_v at ``rotation[i] @ p_v + translation[i]``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hil.core.jit import kernel
from hil.core.messages import Array

LENS = np.dtype(
    [
        ("fx", "f8"),  # px
        ("fy", "f8"),
        ("cx", "f8"),
        ("cy", "f8"),
        ("k1", "f8"),
        ("k2", "f8"),
        ("p1", "f8"),
        ("p2", "f8"),
        ("k3", "f8"),
        ("width", "f8"),  # px
        ("height", "f8"),
        ("row_s", "f8"),  # s, from the exposure of a row to that of the next; 0: a global shutter
    ],
    align=True,
)


@dataclass(frozen=True, slots=True)
class CameraPair:
    """Left (index 0) and right (index 1) camera.

    lens: (2,) of LENS. rotation: (2, 3, 3), v to the camera's axes; the left one is the identity.
    translation: (2, 3), m, in the camera's axes.
    """

    lens: np.ndarray
    rotation: Array
    translation: Array

    @property
    def shape(self) -> tuple[int, int]:
        """Return height and width of the left image, px."""
        return int(self.lens["height"][0]), int(self.lens["width"][0])


@kernel
def distort(lens, x, y):
    """Return the distorted image point of the ideal one (x, y) = (X/Z, Y/Z), two numbers (Brown-Conrady)."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    xd = x * radial + 2.0 * lens.p1 * x * y + lens.p2 * (r2 + 2.0 * x * x)
    yd = y * radial + lens.p1 * (r2 + 2.0 * y * y) + 2.0 * lens.p2 * x * y
    return xd, yd


@kernel
def distort_slopes(lens, x, y):
    """Return the derivatives of ``distort``: dxd/dx, dxd/dy, dyd/dx, dyd/dy."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3))
    slope = 2.0 * (lens.k1 + r2 * (2.0 * lens.k2 + 3.0 * lens.k3 * r2))  # of radial, divided by x or y
    cross = slope * x * y + 2.0 * lens.p1 * x + 2.0 * lens.p2 * y
    xx = radial + slope * x * x + 2.0 * lens.p1 * y + 6.0 * lens.p2 * x
    yy = radial + slope * y * y + 6.0 * lens.p1 * y + 2.0 * lens.p2 * x
    return xx, cross, cross, yy


@kernel
def project(lens, x, y, z):
    """Return the pixel (u, v) of the point (x, y, z), m, in the camera's axes; NaN if z is not positive."""
    if not z > 0.0:
        return np.nan, np.nan
    xd, yd = distort(lens, x / z, y / z)
    return lens.fx * xd + lens.cx, lens.fy * yd + lens.cy


@kernel
def project_slopes(lens, x, y, z, out):
    """Write the derivative of ``project`` with respect to (x, y, z) to out (2, 3), px/m; z > 0."""
    a, b = x / z, y / z
    xx, xy, yx, yy = distort_slopes(lens, a, b)
    out[0, 0] = lens.fx * xx / z
    out[0, 1] = lens.fx * xy / z
    out[0, 2] = -lens.fx * (xx * a + xy * b) / z
    out[1, 0] = lens.fy * yx / z
    out[1, 1] = lens.fy * yy / z
    out[1, 2] = -lens.fy * (yx * a + yy * b) / z


@kernel
def lens_slopes(lens, x, y, out):
    """Write the derivatives of the pixel of the ideal point (x, y) by fx fy cx cy k1 k2 p1 p2 k3 to out (2, 9)."""
    xd, yd = distort(lens, x, y)
    r2 = x * x + y * y
    for m in range(2):
        for n in range(9):
            out[m, n] = 0.0
    out[0, 0] = xd
    out[1, 1] = yd
    out[0, 2] = 1.0
    out[1, 3] = 1.0
    power = r2
    for n in (4, 5, 8):
        out[0, n] = lens.fx * x * power
        out[1, n] = lens.fy * y * power
        power *= r2
    out[0, 6] = lens.fx * 2.0 * x * y
    out[1, 6] = lens.fy * (r2 + 2.0 * y * y)
    out[0, 7] = lens.fx * (r2 + 2.0 * x * x)
    out[1, 7] = lens.fy * 2.0 * x * y


@kernel
def undistort(lens, u, v):
    """Return the ideal image point (X/Z, Y/Z) of pixel (u, v): Newton's method on ``distort``.

    NaN if the distortion cannot be inverted (beyond the radius at which it folds over).
    """
    xd, yd = (u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy
    x, y = xd, yd
    for _ in range(20):
        gx, gy = distort(lens, x, y)
        gx -= xd
        gy -= yd
        xx, xy, yx, yy = distort_slopes(lens, x, y)
        det = xx * yy - xy * yx
        if not det > 1e-6:
            return np.nan, np.nan
        dx, dy = (gx * yy - gy * xy) / det, (gy * xx - gx * yx) / det
        x -= dx
        y -= dy
        if abs(dx) + abs(dy) < 1e-13:
            return x, y
    return np.nan, np.nan


@kernel
def in_image(lens, u, v, margin):
    """Return whether (u, v) is at least ``margin`` px inside the image's edge; False for NaN."""
    return margin - 0.5 <= u <= lens.width - 0.5 - margin and margin - 0.5 <= v <= lens.height - 0.5 - margin
