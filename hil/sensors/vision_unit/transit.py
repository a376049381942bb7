"""Frames of a simulated vision unit between exposure and arrival: kept in an array, of VMU_FRAME, in any order."""

from __future__ import annotations

import math

import numpy as np

from hil.core.jit import kernel
from hil.maths.record_view import copy_record
from hil.models.camera_timing import TIME_SLACK_S

FRAME_TRANSIT = np.dtype(
    [
        ("next_exposure", "i8"),  # numbers of exposures
        ("first_exposure", "i8"),
        ("in_transit", "i8"),  # frames exposed and not received yet
        ("last_rx_s", "f8"),  # when the last frame was received, bench time
        ("received", "i8"),  # frames with a pose so far
        ("without_pose", "i8"),  # frames without one
    ],
    align=True,
)
SPARE_FRAMES = 3
"""Places of the array beyond the frames that can be on their way at once: two of an exposure, one to exchange two."""
_COUNTER_MASK = 0xFFFF_FFFF


@kernel
def next_arrival(frames, first, n):
    """Return the index of the frame of ``first`` to ``n`` - 1 that arrives first, of equals the one exposed first; -1
    if there are none."""
    earliest = -1
    for i in range(first, n):
        if (
            earliest < 0
            or frames[i].received_s < frames[earliest].received_s
            or (frames[i].received_s == frames[earliest].received_s and frames[i].counter < frames[earliest].counter)
        ):
            earliest = i
    return earliest


@kernel
def put_exposure(transit, frames, t_s, late, copies):
    """Send the frame ``frames[transit.in_transit]``, exposed at ``t_s``, on its way, ``copies`` times.

    late: (2,), s, of each copy. transit: FRAME_TRANSIT, whose next exposure it is. A lost pose, without copies, is
    reported as none: the unit is alive.
    """
    if copies == 0:
        frames[transit.in_transit].t_v[0] = np.nan
        copies = 1
    for copy in range(copies):
        sent = frames[transit.in_transit]
        if copy > 0:
            copy_record(frames[transit.in_transit - 1], sent)
        sent.t_s = t_s
        sent.received_s = t_s + late[copy]
        sent.counter = (transit.next_exposure - transit.first_exposure) & _COUNTER_MASK
        transit.in_transit += 1
    transit.next_exposure += 1


@kernel
def receive_frames(transit, now_s, frames):
    """Put the frames with a pose that arrive by ``now_s`` first, in the order of arrival; return their number.

    Those without a pose are counted and forgotten. ``forget_frames`` removes the others.
    """
    n = 0
    while True:
        i = next_arrival(frames, n, transit.in_transit)
        if i < 0 or frames[i].received_s > now_s + TIME_SLACK_S:
            return n
        transit.last_rx_s = frames[i].received_s
        last = transit.in_transit - 1
        if math.isnan(frames[i].t_v[0]):
            transit.without_pose += 1
            if i < last:
                copy_record(frames[last], frames[i])
            transit.in_transit = last
            continue
        transit.received += 1
        if i > n:
            spare = frames[last + 1]
            copy_record(frames[n], spare)
            copy_record(frames[i], frames[n])
            copy_record(spare, frames[i])
        n += 1


@kernel
def forget_frames(transit, n, frames):
    """Remove the first ``n`` frames, which were received."""
    if n == 0:
        return
    for i in range(n, transit.in_transit):
        copy_record(frames[i], frames[i - n])
    transit.in_transit -= n
