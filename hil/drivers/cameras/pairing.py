"""Pairs of frames of two cameras with common exposures: by camera time and frame number, never by arrival."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from math import fsum
from typing import Final

import numpy as np

FRAME_NUMBERS: Final = 65535
"""Frame numbers of GigE Vision 1 are 1 to 65535; 0 is skipped."""
_HALF: Final = FRAME_NUMBERS // 2
_SHIFT_AGREED: Final = 3  # pairs with a new shift of the frame numbers until it is accepted
_KEPT: Final = 8  # frames of one camera
_SAME_TRIGGER: Final = 0.75  # fraction of the period: frames further apart have two triggers, whatever their numbers


@dataclass(frozen=True, slots=True)
class TimedFrame:
    """A frame with bench times of exposure and arrival, s. image: None if it arrived incomplete."""

    exposed_s: float
    arrived_s: float
    number: int
    image: np.ndarray | None


@dataclass(frozen=True, slots=True)
class FramePair:
    """Frames of one exposure; None for a frame that did not arrive in time."""

    left: TimedFrame | None
    right: TimedFrame | None

    @property
    def exposed_s(self) -> float:
        """Return the mean time of exposure, s."""
        times = [frame.exposed_s for frame in (self.left, self.right) if frame is not None]
        return fsum(times) / len(times)

    @property
    def arrived_s(self) -> float:
        """Return the time at which the pair was complete, s."""
        return max(frame.arrived_s for frame in (self.left, self.right) if frame is not None)


class Pairing:
    """Makes pairs of the frames of two cameras.

    Two frames are of one exposure if their times differ by at most ``within_s`` and the difference of their numbers is
    that of the pairs before. Another difference (a camera missed a trigger, or its times are wrong by a period) is
    accepted when three pairs in a row have it; until then those frames are not used. A frame whose partner does not
    arrive within ``wait_s`` is passed on alone; two of the same trigger that are further apart, one after the other.
    rate_hz: of the exposures.
    """

    def __init__(self, within_s: float, wait_s: float, rate_hz: float) -> None:
        self._within_s = within_s
        self._same_trigger_s = _SAME_TRIGGER / rate_hz
        self._wait_s = wait_s
        self._waiting: tuple[deque[TimedFrame], deque[TimedFrame]] = (deque(), deque())
        self._done_s = -float("inf")  # exposure of the newest pair
        self._alone: tuple[int, TimedFrame] | None = None  # camera and frame that was passed on without a partner
        self._shift: int | None = None
        self._other: tuple[int, int] = (0, 0)  # another shift, and how often it came in a row
        self.counters = dict.fromkeys(("pairs", "left_only", "right_only", "late", "odd_numbers"), 0)

    def put(self, side: int, frame: TimedFrame) -> None:
        """Add a frame of the left (0) or right (1) camera."""
        if frame.exposed_s <= self._done_s + self._within_s:
            self.counters["late"] += 1  # its partner has been used without it, or newer frames have
            return
        waiting = self._waiting[side]
        if len(waiting) == _KEPT:
            waiting.popleft()
        waiting.append(frame)

    def pairs(self, now_s: float) -> Iterator[FramePair]:
        """Yield what is complete at ``now_s``, oldest first."""
        left, right = self._waiting
        while left or right:
            apart_s = left[0].exposed_s - right[0].exposed_s if left and right else 0.0
            if left and right and abs(apart_s) <= self._within_s:
                pair = FramePair(left.popleft(), right.popleft())
                self._done_s = max(pair.left.exposed_s, pair.right.exposed_s)  # type: ignore[union-attr]
                if self._numbers_agree(pair):
                    self.counters["pairs"] += 1
                    yield pair
                continue
            side = 0 if left and (not right or apart_s < 0.0) else 1
            oldest = self._waiting[side][0]
            is_waited_for = not (left and right) and not self._partner_has_gone(side, oldest)
            if is_waited_for and now_s - oldest.arrived_s < self._wait_s:
                return
            self._waiting[side].popleft()
            self._done_s = oldest.exposed_s
            self._alone = side, oldest
            self.counters[("left_only", "right_only")[side]] += 1
            yield FramePair(oldest, None) if side == 0 else FramePair(None, oldest)

    def _partner_has_gone(self, side: int, frame: TimedFrame) -> bool:
        """Return whether the frame that was passed on last is of the same trigger as ``frame``, by its number."""
        if self._alone is None or self._alone[0] == side:
            return False
        other = self._alone[1]
        left, right = (frame, other) if side == 0 else (other, frame)
        return abs(frame.exposed_s - other.exposed_s) < self._same_trigger_s and _shift(left, right) == self._shift

    def _numbers_agree(self, pair: FramePair) -> bool:
        assert pair.left is not None
        assert pair.right is not None
        shift = _shift(pair.left, pair.right)
        if self._shift is None or shift == self._shift:
            self._shift, self._other = shift, (0, 0)
            return True
        previous, count = self._other
        self._other = (shift, count + 1 if shift == previous else 1)
        if self._other[1] >= _SHIFT_AGREED:
            self._shift, self._other = shift, (0, 0)
            return True
        self.counters["odd_numbers"] += 1
        return False


def _shift(left: TimedFrame, right: TimedFrame) -> int:
    """Return the difference of the numbers of two frames."""
    return (left.number - right.number + _HALF) % FRAME_NUMBERS - _HALF
