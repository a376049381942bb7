"""The one message that a page gets: state, plotted rows and picture of the same moment in one binary packet.

    4 bytes  length of the header, little-endian
    header   JSON, padded by spaces to a multiple of 4
    rows     rows x columns 32-bit floats, little-endian (``hil.console.columns.NAMES``)
    picture  a JPEG, where the header has one

The header: ``now`` (what changes all the time), ``page`` (the rest, where it has changed), ``rows``, ``columns``,
``first`` (number of the first row since the session began; 0 lets the page forget what it had), ``picture``.
"""

from __future__ import annotations

import json
import struct
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

_LENGTH: Final = struct.Struct("<I")


@dataclass(frozen=True, slots=True)
class Picture:
    """A camera's picture and what is drawn over it. t_s: time of the run at which it was exposed.

    overlay: shapes in pixels of the picture: ``{"kind": "circle", "at": [u, v], "radius": r}``,
    ``{"kind": "cross", "at": [u, v]}``, ``{"kind": "line", "from": [u, v], "to": [u, v]}`` or
    ``{"kind": "text", "at": [u, v], "text": "..."}``, each with ``"good": true`` or ``false``. jpeg: empty where there
    is nothing but the overlay.
    """

    name: str
    t_s: float
    width_px: int
    height_px: int
    jpeg: bytes = b""
    overlay: tuple[dict[str, Any], ...] = ()


def pack(
    now: dict[str, Any],
    page: dict[str, Any] | None,
    rows: np.ndarray[Any, Any],
    first: int,
    picture: Picture | None = None,
) -> bytes:
    """Return the message; rows: (n, m) of 32-bit floats."""
    header: dict[str, Any] = {"now": now, "rows": len(rows), "columns": rows.shape[1], "first": first}
    if page is not None:
        header["page"] = page
    if picture is not None:
        header["picture"] = {
            "name": picture.name,
            "t_s": picture.t_s,
            "width_px": picture.width_px,
            "height_px": picture.height_px,
            "bytes": len(picture.jpeg),
            "overlay": picture.overlay,
        }
    text = json.dumps(header, allow_nan=False, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    return b"".join(
        (_LENGTH.pack(len(text)), text, np.ascontiguousarray(rows, "<f4").tobytes(), picture.jpeg if picture else b"")
    )


def unpack(message: bytes) -> tuple[dict[str, Any], np.ndarray[Any, Any], bytes]:
    """Return header, rows (n, m) and JPEG of a message: for clients that are no page."""
    (length,) = _LENGTH.unpack_from(message)
    header = json.loads(message[4 : 4 + length])
    n, m = header["rows"], header["columns"]
    rows = np.frombuffer(message, "<f4", n * m, 4 + length).reshape(n, m)
    return header, rows, message[4 + length + 4 * n * m :]
