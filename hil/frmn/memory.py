"""A stretch of anonymous shared memory: it has no name in the system and dies with its last user."""

from __future__ import annotations

import hashlib
import mmap
import os
from typing import Final

from hil.errors import ProtocolError

HEADER: Final = 64  # one cache line: digest of the layout
_DIGEST: Final = 8


class Memory:
    """``content`` holds ``size`` bytes that all processes with the ``descriptor`` share (``pass_fds``).

    The descriptor belongs to this object from now on. name: what errors call it. layout: text that tells what
    lies where; writer and readers must agree on it. Raises ProtocolError for a descriptor of another layout.
    """

    def __init__(self, descriptor: int, name: str, layout: str, size: int) -> None:
        self.descriptor = descriptor
        self.name = name
        found, expected = os.fstat(descriptor).st_size, HEADER + size
        if found != expected:
            raise ProtocolError(name, f"shared memory of {found} bytes, expected {expected}: another layout")
        self._map = mmap.mmap(descriptor, expected)
        if self._map[:_DIGEST] != _digest(layout):
            self._map.close()
            raise ProtocolError(name, f"shared memory of another layout, expected {layout}")
        self._whole = memoryview(self._map)
        self.content = self._whole[HEADER:]

    @staticmethod
    def create(name: str, layout: str, size: int) -> int:
        """Make new memory, all zero; return its descriptor."""
        descriptor = os.memfd_create(name)
        os.ftruncate(descriptor, HEADER + size)
        os.pwrite(descriptor, _digest(layout), 0)
        return descriptor

    def close(self) -> None:
        """Let go of it; whoever took views of ``content`` releases them first. Idempotent."""
        if not self._map.closed:
            self.content.release()
            self._whole.release()
            self._map.close()
            os.close(self.descriptor)


def _digest(layout: str) -> bytes:
    return hashlib.blake2b(layout.encode(), digest_size=_DIGEST).digest()
