"""Where in the images the LEDs of a predicted pose are to be looked for."""

from __future__ import annotations

import numpy as np

from hil.core.messages import Array
from hil.vmu.kernels.led_windows import led_windows
from hil.vmu.kernels.records import RingScene


def windows(scene: RingScene, r: Array, t: Array, covariance: Array) -> tuple[Array, Array]:
    """Return for each camera the windows (k, 4), px, of the LEDs: u and v of the first pixel and past the last."""
    out, counts = np.empty((2, len(scene.leds), 4)), np.zeros(2, np.int64)
    led_windows(scene, r, t, covariance, out, counts)
    return out[0, : counts[0]], out[1, : counts[1]]
