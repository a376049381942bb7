"""Records of the vision unit's kernels: spot, spot with ray, hypothesis, scene and stereo view."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.messages import Array

MAX_LEDS: Final = 32
MAX_SPOTS: Final = 64
"""Spots per image used by identification."""
CELLS: Final = 64
"""Cells along each side of an image."""
SHARED: Final = 24
"""Considered parameters that all LEDs share: 9 of each lens, rotation and position of the right camera."""

SPOT = np.dtype(
    [
        ("u", "f8"),  # px, centre; pixel centres at whole numbers
        ("v", "f8"),
        ("var_u", "f8"),  # px^2, covariance of the centre
        ("var_v", "f8"),
        ("cov_uv", "f8"),
        ("flux", "f8"),  # grey levels, sum above the background (a lower bound when saturated)
        ("peak", "f8"),  # grey levels above the background
        ("size", "f8"),  # px, RMS extent along one axis: a Gaussian's sigma
        ("blur", "f8"),  # px, sigma of the blur of a disc; 0 for a point of light
        ("pixels", "i8"),  # above the threshold
        ("flags", "i8"),
        ("elongation", "f8", 2),  # px^2, half of the variance along u minus that along v, and their covariance; NaN
        ("shape_sigma", "f8", 2),  # px^2, standard deviation of each elongation, and of the square of the size
    ],
    align=True,
)
"""One spot of light in one image, as detected."""

SATURATED: Final = 1  # some pixels are at full scale
AT_BORDER: Final = 2  # the image's edge cuts the spot; its covariance is larger
MERGED: Final = 4  # two lights overlap

SPOT_RAY = np.dtype(
    [
        ("u", "f8"),  # px, centre of the spot
        ("v", "f8"),
        ("noise_uu", "f8"),  # px^2, covariance of its noise
        ("noise_vv", "f8"),
        ("noise_uv", "f8"),
        ("var_u", "f8"),  # px^2, the same plus what gates and the search allow for calibration and optics
        ("var_v", "f8"),
        ("cov_uv", "f8"),
        ("w_uu", "f8"),  # px^-2, inverse of the latter
        ("w_uv", "f8"),
        ("w_vv", "f8"),
        ("ray", "f8", 3),  # unit vector to the light in the camera's axes; NaN if the distortion cannot be inverted
        ("flux", "f8"),  # grey levels
        ("shape", "f8", 3),  # px^2, elongation and square of the size
        ("shape_sigma", "f8", 2),
    ],
    align=True,
)
"""One spot with its weight and its direction."""

FIT = np.dtype(
    [
        ("r", "f8", (3, 3)),  # p_v = r p_t + t
        ("t", "f8", 3),  # m
        ("covariance", "f8", (6, 6)),  # covariance of t and of the small rotation e about v's axes
        ("noise", "f8", (6, 6)),  # the part of it that is independent between images
        ("spot", "i2", (2, MAX_LEDS)),  # spot of each camera and LED, -1: none
        ("chi2", "f8"),
        ("misfit", "f8"),  # chi2 with the least floor
        ("floor", "f8"),  # px, estimated error of a spot beyond noise and tolerances
        ("shift", "f8", 2),  # of the right image against the left one along u and v, in sigmas
        ("shift_px", "f8"),  # the same along v, and its variance by noise, px^2
        ("shift_noise", "f8"),
        ("points", "i8"),  # spots used
        ("removed", "i8"),  # spots within the gates that were removed as outliers
        ("unseen", "i8"),  # predicted LED images without a spot
        ("score", "f8"),  # log likelihood ratio of all spots against stray lights only, integrated over the pose
        ("valid", "i8"),  # the refinement converged, all LEDs in front of the cameras
    ],
    align=True,
)
"""One hypothesis: spot of each LED, and the resulting pose."""


class RingScene(NamedTuple):
    """Constants of a vision unit: two cameras and the LEDs.

    lens: (2,) of LENS. rotation: (2, 3, 3) and translation: (2, 3), m, from v to each camera's axes. leds: (n, 3), m,
    in t. squares: (n, n), m^2, of the LEDs' distances. sides: (n, n, n), orientation in which three LEDs appear to a
    camera in front, 1 or -1; 0 if it depends on the pose. tolerance: (24 + 3 n, 24 + 3 n), covariance of the considered
    parameters: fx fy cx cy k1 k2 p1 p2 k3 of the left and of the right camera, small rotation of the right one about
    its axes, its position, positions of the LEDs. floors: (k,), px, floors of a spot's error, ascending. motion:
    (7, 6), velocity and rotation rate of the target about v's axes, m/s, rad/s, and below their covariance: with a
    rolling shutter the LEDs move between the rows, of which the middle one is exposed at the time of the image.
    vibration: rad^2, the part of the tolerance of the right camera's rotation about its u and v axes that is another
    one in each pair.
    """

    lens: np.ndarray
    rotation: Array
    translation: Array
    leds: Array
    squares: Array
    sides: npt.NDArray[np.int64]
    tolerance: Array
    floors: Array
    motion: Array
    vibration: float


class View(NamedTuple):
    """Spots of a stereo pair. spots: (2, MAX_SPOTS) of SPOT_RAY. counts: (2,), number in use.

    order: (2, MAX_SPOTS), index of each into the detector's spots. near: (2, CELLS, CELLS), of uint8: cells of
    each image that have a spot in them or next to them are 1.
    """

    spots: np.ndarray
    counts: npt.NDArray[np.int64]
    order: npt.NDArray[np.int64]
    near: npt.NDArray[np.uint8]
