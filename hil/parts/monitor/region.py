"""Rectangles of an image."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Region:
    """A rectangle of the image, px: columns left..right, lines top..bottom, the ends excluded."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def of_box(cls, u: int, v: int, width: int, height: int) -> Region:
        """Return the region whose first pixel is (u, v), px."""
        return cls(u, v, u + width, v + height)

    @property
    def width(self) -> int:
        """Columns."""
        return self.right - self.left

    @property
    def height(self) -> int:
        """Lines."""
        return self.bottom - self.top

    def contains(self, u: float, v: float) -> bool:
        """Return whether the point (u, v), px, is in the region."""
        return self.left <= u < self.right and self.top <= v < self.bottom
