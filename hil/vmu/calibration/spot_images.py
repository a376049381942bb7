"""From the images of a view to spots of light."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.config.vmu_geometry import Sensor
from hil.core.messages import Array
from hil.vmu.calibration.leds import Spots, SpotViews
from hil.vmu.calibration.views import Views, read_pair
from hil.vmu.detect import SpotDetector
from hil.vmu.spots import AT_BORDER, MERGED

FLOOR_PX = 0.01
"""what no centre is known better than, whatever the grey levels say: pixels are not all alike"""


def spot_views(views: Views, sizes: Array, sensor: Sensor | None, tell: Callable[[str, float], None]) -> SpotViews:
    """Return the spots in both images of all views; those cut by the edge or run together are left out.

    sizes: (2, 2), width and height, px. Raises BadInput for images of another size.
    """
    detectors = [SpotDetector((int(height), int(width)), sensor=sensor) for width, height in sizes]
    found = []
    for k, name in enumerate(views.names):
        tell(f"spots of view {name}", k / len(views.names))
        pair = read_pair(views, k, sizes)
        found.append(tuple(_spots(detector, image) for detector, image in zip(detectors, pair, strict=True)))
    return SpotViews(views.names, views.axes, tuple((left, right) for left, right in found))


def _spots(detector: SpotDetector, image: np.ndarray) -> Spots:
    spots = detector.spots(image, None)
    spots = spots[(spots["flags"] & (AT_BORDER | MERGED)) == 0]
    covariance = np.empty((len(spots), 2, 2))
    covariance[:, 0, 0], covariance[:, 1, 1] = spots["var_u"] + FLOOR_PX**2, spots["var_v"] + FLOOR_PX**2
    covariance[:, 0, 1] = covariance[:, 1, 0] = spots["cov_uv"]
    return Spots(np.stack([spots["u"], spots["v"]], axis=1), covariance)
