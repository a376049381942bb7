"""Update message of the console: state, plotted rows and image of the same time in one binary packet.

    4 bytes  length of the header, little-endian
    header   JSON, padded by spaces to a multiple of 4
    rows     rows x columns 32-bit floats, little-endian (``hil.parts.console.columns.NAMES``)
    image    a JPEG or PNG file, if the header has one

The header: ``now`` (the live state), ``page`` (the rest, if changed), ``rows``, ``columns``, ``first`` (number of the
first row since the session started; 0 clears the page's rows), ``picture``, and, with their own ``first``, if there are
new ones, ``portions`` (batches of the docking monitor) and ``offsets`` (positions by trackers less the encoders').
"""

from __future__ import annotations

import json
import math
import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hil.core.camera_images import Shape

_LENGTH: Final = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class ImageMessage:
    """Camera image and its overlay, see ``hil.core.camera_images``.

    t_s: run time of the exposure. data: empty for an overlay without an image. status: reported by its source.
    exposed_s: wall-clock time of the exposure, nan if unknown.
    """

    name: str
    t_s: float
    width_px: int
    height_px: int
    data: bytes = b""
    overlay: tuple[Shape, ...] = ()
    encoding: str = "jpeg"
    status: str = ""
    exposed_s: float = math.nan

    def header(self, now_s: float) -> dict[str, Any]:
        """Return its part of the header at ``now_s`` of wall-clock time."""
        age_s = now_s - self.exposed_s
        return {
            "name": self.name,
            "t_s": self.t_s if math.isfinite(self.t_s) else None,
            "age_s": age_s if math.isfinite(age_s) else 0.0,
            "width_px": self.width_px,
            "height_px": self.height_px,
            "encoding": self.encoding,
            "status": self.status,
            "bytes": len(self.data),
            "overlay": self.overlay,
        }


def pack(
    now: dict[str, Any],
    page: dict[str, Any] | None,
    rows: np.ndarray[Any, Any],
    first: int,
    picture: ImageMessage | None = None,
    news: dict[str, Any] | None = None,
) -> bytes:
    """Return the message; rows: (n, m) of 32-bit floats."""
    header: dict[str, Any] = {"now": now, "rows": len(rows), "columns": rows.shape[1], "first": first}
    if page is not None:
        header["page"] = page
    if picture is not None:
        header["picture"] = picture.header(now["wall_s"])
    header |= news or {}
    text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join(
        (_LENGTH.pack(len(text)), text, np.ascontiguousarray(rows, "<f4").tobytes(), picture.data if picture else b"")
    )


def unpack(message: bytes) -> tuple[dict[str, Any], np.ndarray[Any, Any], bytes]:
    """Return header, rows (n, m) and image data of a message, for clients other than the page."""
    (length,) = _LENGTH.unpack_from(message)
    header = json.loads(message[4 : 4 + length])
    n, m = header["rows"], header["columns"]
    rows = np.frombuffer(message, "<f4", n * m, 4 + length).reshape(n, m)
    return header, rows, message[4 + length + 4 * n * m :]
