"""Image files: depths that cameras write, and names of numbered images."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from hil.core.image_files import decode_grey, depth_note
from hil.vmu.sources import ImageFolder


def png(image: np.ndarray) -> bytes:
    """Return ``image`` as a PNG file."""
    return bytes(cv2.imencode(".png", image)[1])


@pytest.mark.parametrize(
    ("largest", "note"),
    [(4000, "images of 12 bits in 16, brightest 4000"), (64000, "images of 16 bits in 16, brightest 64000")],
)
def test_images_of_twelve_bits_in_sixteen_keep_their_levels(largest: int, note: str) -> None:
    data = png(np.linspace(0, largest, 64 * 64).reshape(64, 64).astype(np.uint16))
    image = decode_grey(data)
    assert image is not None
    assert int(image.max()) == 250
    assert depth_note(data).startswith(note)


def test_images_of_eight_bits_are_read_as_they_are() -> None:
    image = np.arange(64, dtype=np.uint8).reshape(8, 8)
    assert np.array_equal(decode_grey(png(image)), image)
    assert depth_note(png(image)) == ""
    assert decode_grey(b"no image") is None


def test_images_whose_names_end_in_a_number_are_frames(tmp_path: Path) -> None:
    for side in ("left", "right"):
        (tmp_path / side).mkdir()
        for number in (1, 2):
            cv2.imwrite(str(tmp_path / side / f"img_{number:04d}.jpg"), np.full((16, 16), 90, np.uint8))
    assert [pair.frame for pair in ImageFolder(tmp_path) if pair.left is not None and pair.right is not None] == [1, 2]
