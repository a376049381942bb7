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
)
"""What every backend counts since ``open``.

frames: poses handed out. no_pose: frames in which the unit says that it has none. crc_errors: wrong
checksum; frames cut short are in it. wrong_length: sync and type of a frame beside a length that it does
not have. skipped_bytes: what belongs to no frame. invalid: right checksum, impossible content. lost: gaps
of the unit's frame counter, so frames refused by checksum or content are in it too. duplicates: repeated
ones. late: overtaken by others, or left over from before ``open``. clock_jumps: frames dropped because
their time of exposure cannot be.
"""
