"""What the kernels of identification and pose hand to each other."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from hil.core.messages import Array

MAX_LEDS: Final = 8
MAX_SPOTS: Final = 16
"""of an image, that identification looks at"""

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
        ("pixels", "i8"),  # above the threshold
        ("flags", "i8"),
    ],
    align=True,
)
"""One spot of light in one image, as detected."""

SATURATED: Final = 1  # some pixels are at full scale
AT_BORDER: Final = 2  # the image's edge cuts the spot: its centre is less certain, as its covariance says
MERGED: Final = 4  # two lights run into each other

SPOT_RAY = np.dtype(
    [
        ("u", "f8"),  # px, centre of the spot
        ("v", "f8"),
        ("var_u", "f8"),  # px^2, its covariance
        ("var_v", "f8"),
        ("cov_uv", "f8"),
        ("w_uu", "f8"),  # px^-2, the covariance's inverse
        ("w_uv", "f8"),
        ("w_vv", "f8"),
        ("ray", "f8", 3),  # unit vector to the light in the camera's axes; NaN where the lens cannot be undone
        ("flux", "f8"),  # grey levels
    ],
    align=True,
)
"""One spot as a direction."""

FIT = np.dtype(
    [
        ("r", "f8", (3, 3)),  # p_v = r p_t + t
        ("t", "f8", 3),  # m
        ("covariance", "f8", (6, 6)),  # of t and of the small rotation e about v's axes
        ("spot", "i8", (2, MAX_LEDS)),  # of each camera and LED, -1: none
        ("chi2", "f8"),
        ("points", "i8"),  # spots used
        ("removed", "i8"),  # spots that fell within the gates and were left out as outliers
        ("unseen", "i8"),  # places in the images where an LED should be and no spot is
        ("score", "f8"),  # logarithm of the likelihood against a picture of stray lights
        ("valid", "i8"),  # the refinement ended, all LEDs in front of the cameras
    ],
    align=True,
)
"""One hypothesis: which spot is which LED, and the pose that follows."""


class RingScene(NamedTuple):
    """What is known before any image is taken.

    lens: (2,) of LENS. rotation: (2, 3, 3) and translation: (2, 3), m, from v to each camera's axes. leds: (n, 3),
    m, in t. squares: (n, n), m^2, of the LEDs' distances. sides: (n, n, n), in which sense a camera in front sees
    three LEDs, 1 or -1; 0 where that depends on the pose.
    """

    lens: np.ndarray
    rotation: Array
    translation: Array
    leds: Array
    squares: Array
    sides: npt.NDArray[np.int64]


class View(NamedTuple):
    """What the two images show. spots: (2, MAX_SPOTS) of SPOT_RAY. counts: (2,), how many are in use.

    order: (2, MAX_SPOTS), which of the detector's spots each one is.
    """

    spots: np.ndarray
    counts: npt.NDArray[np.int64]
    order: npt.NDArray[np.int64]
