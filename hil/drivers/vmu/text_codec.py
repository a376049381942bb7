"""Frames of text of a vision unit by a frame file: lines <-> numbers."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.config.vmu_frame import TextForm, VmuFrame
from hil.core.messages import Array
from hil.drivers.checksums import xor8
from hil.drivers.vmu.codec import Decoded
from hil.drivers.vmu.frame_codec import FrameCodec, FrameDecoder, raw_numbers, si_numbers

_DIGITS: Final = 24  # characters of a number with its separator, at most
_LONGEST: Final = 4096
_WHOLE: Final = ("counter", "leds_left", "leds_right", "status", "constant")


class TextFrameCodec(FrameCodec):
    """Encoder of lines; numbers have all their digits."""

    def __init__(self, frame: VmuFrame) -> None:
        super().__init__(frame)
        self.form = frame.text or TextForm()
        self.size = len(self.form.start) + _DIGITS * sum(field.count for field in frame.fields)

    def decoder(self, of_datagrams: bool = False, by_camera: bool = True) -> FrameDecoder:
        """Return a decoder of lines. of_datagrams: each of which ends one. by_camera: ``checked_pose``."""
        return TextFrameDecoder(self, of_datagrams, by_camera)

    def _bytes_of(self, values: dict[str, object]) -> bytes:
        texts = [
            str(round(value)) if field.name in _WHOLE else repr(value)
            for field in self.frame.fields
            for value in raw_numbers(field, values)
        ]
        line = (self.form.start + self.form.separator.join(texts)).encode()
        return (line + b"*%02X" % xor8(line) if self.frame.checksum.kind == "xor8" else line) + b"\n"


class TextFrameDecoder(FrameDecoder):
    """Decodes lines from a stream with arbitrary splits and damage, or from datagrams; never raises."""

    def __init__(self, frames: TextFrameCodec, of_datagrams: bool, by_camera: bool) -> None:
        super().__init__(frames, by_camera)
        self._form, self._of_datagrams = frames.form, of_datagrams

    def feed(self, data: bytes, received_s: float) -> list[Decoded]:
        """Decode ``data``, whose last byte was received at bench time ``received_s``; return the completed frames."""
        self._buffer += data + (b"\n" if self._of_datagrams else b"")
        *lines, rest = bytes(self._buffer).split(b"\n")
        if len(rest) > _LONGEST:
            self.skipped_bytes, rest = self.skipped_bytes + len(rest), b""
        self._buffer[:] = rest
        frames = []
        for line in lines:
            if not (text := line.strip(b"\r \0")):
                continue
            numbers = self._numbers_of(text)
            decoded = None if numbers is None else self._decode(numbers, received_s)
            if decoded is not None:
                frames.append(decoded)
            elif numbers is not None:
                self.invalid += 1
        return frames

    def _numbers_of(self, line: bytes) -> dict[str, Array] | None:
        """Return the SI values of each field of a line, None for one that is no frame."""
        start = self._form.start.encode()
        if not line.startswith(start):
            self.skipped_bytes += len(line)
            return None
        if self._frames.frame.checksum.kind == "xor8":
            line, star, digits = line.rpartition(b"*")
            if not star or digits.upper() != b"%02X" % xor8(line):
                self.crc_errors += 1
                return None
        text = line[len(start) :].decode("ascii", "replace")
        words = text.split(None if self._form.separator == " " else self._form.separator)
        fields = self._frames.frame.fields
        if len(words) != sum(field.count for field in fields):
            self.wrong_length += 1
            return None
        numbers: dict[str, Array] = {}
        try:
            for field in fields:
                part, words = words[: field.count], words[field.count :]
                if field.name == "ignore":
                    continue
                values = np.array([float(word) for word in part])
                if not np.isfinite(values).all() or (field.name == "constant" and values[0] != field.value):
                    raise ValueError(field.name)
                numbers[field.name] = si_numbers(values, field)
        except ValueError:
            self.invalid += 1
            return None
        return numbers
