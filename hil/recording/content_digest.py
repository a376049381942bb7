"""Content of a recording by topic: number and digest of the messages, in its end.

The digest is the sum of those of the messages, so it does not depend on their order in the file: a program that
rewrites a recording in other blocks, or sorted by time, keeps it. It finds each message that was removed, added, edited
or given another time. As the chain of the audit, it is no secret: a user who may write the file can write another one.
"""

from __future__ import annotations

import hashlib
from typing import Final

KEY: Final = "content:"
"""Beginning of the keys in the end of a recording, of which each names a topic; values: count and digest."""
_BYTES: Final = 32


class ContentDigest:
    """Number and digest of the messages of each topic."""

    def __init__(self) -> None:
        self._topics: dict[str, tuple[int, int]] = {}

    def add(self, topic: str, time_ns: int, message: bytes) -> None:
        """Count ``message`` at ``time_ns``."""
        digest = hashlib.sha256(time_ns.to_bytes(8, "little"))
        digest.update(message)
        count, total = self._topics.get(topic, (0, 0))
        self._topics[topic] = count + 1, total + int.from_bytes(digest.digest(), "little")

    @property
    def keys(self) -> dict[str, str]:
        """Return the keys of the end of a recording."""
        mask = (1 << 8 * _BYTES) - 1
        return {f"{KEY}{topic}": f"{count} {total & mask:064x}" for topic, (count, total) in self._topics.items()}
