"""Newest-sample box between a device's own thread and the cycle, which never waits for a wire."""

from __future__ import annotations

import threading
from typing import Generic, TypeVar

from hil.errors import DeviceError, LinkTimeout

Sample = TypeVar("Sample")


class Latest(Generic[Sample]):
    """Newest sample with its time, or the error that ended the link.

    One thread puts, another gets. An error is permanent: a failed link does not recover.
    """

    def __init__(self, device: str) -> None:
        self.device = device
        self._lock = threading.Lock()
        self._sample: Sample | None = None
        self._t_s = 0.0
        self._error: DeviceError | None = None

    def put(self, sample: Sample, t_s: float) -> None:
        with self._lock:
            self._sample = sample
            self._t_s = t_s

    def fail(self, error: DeviceError) -> None:
        """Store ``error`` for the cycle; later errors are ignored."""
        with self._lock:
            if self._error is None:
                self._error = error

    def check(self) -> None:
        """Raise the stored error, if any."""
        with self._lock:
            if self._error is not None:
                raise self._error

    def get(self, now_s: float, max_age_s: float) -> Sample:
        """Return the newest sample; raise LinkTimeout if it is older than ``max_age_s``."""
        with self._lock:
            if self._error is not None:
                raise self._error
            if self._sample is None:
                raise LinkTimeout(self.device, "has not answered yet")
            age = now_s - self._t_s
            if age > max_age_s:
                raise LinkTimeout(self.device, f"no answer for {age:.3f} s, allowed {max_age_s:g} s")
            return self._sample

    @property
    def t_s(self) -> float:
        """Time of the newest sample."""
        with self._lock:
            return self._t_s

    def peek(self) -> Sample | None:
        """Return the newest sample of any age, or None."""
        with self._lock:
            return self._sample
