"""Codec of the frames that a vision unit sends: those of this package, or those of a frame file."""

from __future__ import annotations

from functools import cache

from hil.config.load import load_frame
from hil.drivers.vmu.frame_codec import FrameCodec
from hil.drivers.vmu.text_codec import TextFrameCodec


def frame_codec(name: str = "hil") -> FrameCodec:
    """Return the codec of the frames ``name``, as in ``VmuLine``; files are read again. Raises BadInput."""
    return _own_codec() if name == "hil" else _codec_of(name)


@cache
def _own_codec() -> FrameCodec:
    return _codec_of("hil")


def _codec_of(name: str) -> FrameCodec:
    frame = load_frame(name).value
    return FrameCodec(frame) if frame.text is None else TextFrameCodec(frame)
