"""What the detector says of one spot of light in one image."""

from __future__ import annotations

from typing import Final

import numpy as np

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

SATURATED: Final = 1  # some pixels are at full scale
AT_BORDER: Final = 2  # the image's edge cuts the spot: its centre is less certain, as its covariance says
MERGED: Final = 4  # two lights run into each other
