"""Image files: their size, and their decoder."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.core.files import MIB

IMAGE_BYTES: Final = 64 * MIB
IMAGE_SUFFIXES: Final = frozenset((".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".pgm"))
VIDEO_BYTES: Final = 1 << 40


_TWELVE_BITS: Final = 4096  # levels: cameras write 12 bits into files of 16


def decode_grey(data: bytes) -> np.ndarray | None:
    """Return the image in ``data`` as (h, w), uint8; None if it is none, or too large.

    Colours are converted to grey. Of 16 bits the upper eight are used, of an image whose levels have twelve of them the
    upper eight of these.
    """
    image = _decode(data)
    if image is None or image.dtype == np.uint8:
        return image
    return np.asarray(image >> (4 if image.max() < _TWELVE_BITS else 8), dtype=np.uint8)


def depth_note(data: bytes) -> str:
    """Return how the levels of the image in ``data`` are read, "" for 8 bits."""
    image = _decode(data)
    if image is None or image.dtype == np.uint8:
        return ""
    bits = 12 if image.max() < _TWELVE_BITS else 16
    return f"images of {bits} bits in 16, brightest {int(image.max())}: read by the upper 8 of the {bits}"


def _decode(data: bytes) -> np.ndarray | None:
    """Return the image in ``data`` as (h, w), uint8 or uint16, None if it is none."""
    import cv2

    try:
        flags = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH
        image = cv2.imdecode(np.frombuffer(data, np.uint8), flags) if data else None
    except cv2.error:
        return None
    if image is None or image.ndim != 2 or image.dtype not in (np.uint8, np.uint16):
        return None
    return np.asarray(image)
