"""Mailboxes of the reflective memory: number on the wire, layout, and the side that writes each.

A mailbox has one writer. Its newest value wins; lost values are not sent again. The records are those of
``hil/core/messages.py`` and ``hil/core/gnc_records.py``, little-endian and aligned as a C compiler aligns them.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np

from hil.core.fields import record_dtype
from hil.core.gnc_records import BACKEND_POSE_FIELDS, GNC_INPUT_3, GNC_ORBIT, GNC_OUTPUT, GNC_SETUP_2
from hil.core.messages import AXES, COMMAND, IMU, MAX_POSES, NAVIGATION, POSE, TRUTH
from hil.core.sensor_records import SENSOR_SAMPLE


class Role(IntEnum):
    """Side of a link."""

    DSS = 1  # dynamics, bench and vision unit: the side with the truth
    GNC = 2


HEALTH: Final = np.dtype(
    [
        ("cycle", "i8"),  # of the run, -1 before the first
        ("t_s", "f8"),  # time of the run
        ("mode", "S16"),  # of the bench: off, standby, ..., running, hold, safe-stop
        ("lateness_s", "f8"),  # of the cycle's wake-up
        ("overruns", "i8"),  # cycles that ended after the next one's deadline
    ],
    align=True,
)

IMU_SAMPLES_MAX: Final = 24
"""Samples of the IMU per cycle that the other side can get: with them the datagram stays below 1500 bytes."""
IMU_SAMPLES: Final = np.dtype(
    [
        ("cycle", "i8"),  # of the input that follows
        ("n", "i8"),  # the first n are valid
        ("rate_C", "f8", (IMU_SAMPLES_MAX, 3)),
        ("force_C", "f8", (IMU_SAMPLES_MAX, 3)),
    ],
    align=True,
)
"""Samples of an IMU that is faster than the cycle, since the last cycle; the input has their mean."""

GNC_POSES: Final = np.dtype(
    [
        ("cycle", "i8"),  # of the input that follows
        ("n", "i8"),  # the first n are valid
        ("poses", record_dtype(BACKEND_POSE_FIELDS), MAX_POSES),
    ],
    align=True,
)
"""Poses of a cycle that has some, with their status: positions without attitude as well."""

MEASUREMENTS_MAX: Final = 3
GNC_MEASUREMENTS: Final = np.dtype(
    [
        ("cycle", "i8"),  # of the input that follows
        ("first", "i8"),  # number of the first one here, from 0
        ("n", "i8"),  # of the cycle; a datagram has the next MEASUREMENTS_MAX of them
        ("measurements", SENSOR_SAMPLE, MEASUREMENTS_MAX),
    ],
    align=True,
)
"""Measurements of further sensors of a cycle that has some, in one or more datagrams."""

GNC_FLIGHT: Final = np.dtype([("output", GNC_OUTPUT), ("navigation", NAVIGATION), ("command", COMMAND)], align=True)
"""Output of the built-in GNC, sent instead of GNC_OUTPUT: everything that ``hil run`` records of it."""

GNC_FILTERS: Final = np.dtype(
    [
        ("cycle", "i8"),
        ("attitude_x", "f8", 7),  # q_CH, gyro drift in rad/s
        ("attitude_p", "f8", (6, 6)),
        ("position_x", "f8", 9),  # r_CT_H, v_CT_H, accelerometer bias
        ("position_p", "f8", (9, 9)),
    ],
    align=True,
)
"""State of the built-in filters in a cycle with a pose; the bench, which has the truth, computes their NEES from it."""


@dataclass(frozen=True)
class MailboxSpec:
    """A mailbox. number: on the wire. layout: two bytes of the digest of its fields, never 0."""

    number: int
    name: str
    dtype: np.dtype
    writer: Role
    layout: int


def layout_of(dtype: np.dtype) -> int:
    """Return the low 16 bits of the CRC-32 of the layout's text, 1 where they are zero.

    The text has one line per plain field: offset in bytes, type as in numpy, and shape; nested records are expanded.
    Names do not count: the same bytes may have other names.
    """
    return (zlib.crc32("\n".join(_lines(dtype, 0)).encode()) & 0xFFFF) or 1


def _lines(dtype: np.dtype, start: int) -> list[str]:
    if dtype.names is None:
        return [f"{start} {dtype.base.str.lstrip('<|=')} {'x'.join(map(str, dtype.shape))}".rstrip()]
    lines = []
    for inner, offset, *_ in (dtype.fields or {}).values():
        if inner.base.names is None:
            lines += _lines(inner, start + offset)
            continue
        for i in range(int(np.prod(inner.shape))):
            lines += _lines(inner.base, start + offset + i * inner.base.itemsize)
    return lines


def _mailbox(number: int, name: str, dtype: np.dtype, writer: Role) -> MailboxSpec:
    return MailboxSpec(number, name, dtype, writer, layout_of(dtype))


_ALL: Final = (
    _mailbox(1, "gnc.setup", GNC_SETUP_2, Role.DSS),
    _mailbox(2, "gnc.input", GNC_INPUT_3, Role.DSS),
    _mailbox(3, "gnc.output", GNC_OUTPUT, Role.GNC),
    _mailbox(4, "gnc.flight", GNC_FLIGHT, Role.GNC),
    _mailbox(5, "gnc.filters", GNC_FILTERS, Role.GNC),
    _mailbox(16, "truth", TRUTH, Role.DSS),
    _mailbox(17, "imu", IMU, Role.DSS),
    _mailbox(18, "pose", POSE, Role.DSS),
    _mailbox(19, "command", COMMAND, Role.DSS),
    _mailbox(20, "setpoint", AXES, Role.DSS),
    _mailbox(21, "feedback", AXES, Role.DSS),
    _mailbox(22, "health", HEALTH, Role.DSS),
    _mailbox(23, "imu.samples", IMU_SAMPLES, Role.DSS),
    _mailbox(24, "gnc.orbit", GNC_ORBIT, Role.DSS),
    _mailbox(25, "gnc.poses", GNC_POSES, Role.DSS),
    _mailbox(26, "gnc.measurements", GNC_MEASUREMENTS, Role.DSS),
)
MAILBOXES: Final[dict[str, MailboxSpec]] = {box.name: box for box in _ALL}
BY_NUMBER: Final[dict[int, MailboxSpec]] = {box.number: box for box in _ALL}
