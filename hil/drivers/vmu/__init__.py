"""The vision measurement unit (VMU): binary pose frames over RS-422, its emulator and its mock."""

from __future__ import annotations

from typing import Final

NAME: Final = "vmu"

COUNTERS: Final = (
    "frames",
    "no_pose",
    "crc_errors",
    "wrong_length",
    "skipped_bytes",
    "invalid",
    "lost",
    "duplicates",
    "late",
    "clock_jumps",
    "clock_ahead_us",
    "clock_drift_ppb",
    "clock_step_us",
)
"""Counters of every backend since ``open``, and the estimate of the unit's clock.

frames: poses returned. no_pose: frames without a pose. crc_errors: wrong checksum, including truncated frames.
wrong_length: sync and type of a frame with a wrong length. skipped_bytes: bytes outside frames. invalid: correct
checksum, impossible content. lost: gaps of the unit's frame counter, including frames rejected by checksum or content.
duplicates: repeated frames. late: overtaken by others, or sent before ``open``. clock_jumps: frames discarded for an
impossible time of exposure. clock_ahead_us, clock_drift_ppb, clock_step_us: of ``UnitClock``; zero in memory.
"""
