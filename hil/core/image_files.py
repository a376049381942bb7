"""Image files: their size, and their decoder."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.files import MIB

IMAGE_BYTES: Final = 64 * MIB
VIDEO_BYTES: Final = 1 << 40


def decode_grey(data: bytes) -> np.ndarray | None:
    """Return the image in ``data`` as (h, w), uint8; None if it is none, or too large.

    Other depths are converted to 8 bit, colours to grey.
    """
    import cv2

    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE) if data else None
    except cv2.error:
        return None
    return None if image is None or image.ndim != 2 else np.asarray(image, dtype=np.uint8)
