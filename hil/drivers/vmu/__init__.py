"""The vision measurement unit (VMU): binary pose frames over RS-422, its emulator and its mock."""

from __future__ import annotations

from typing import Final

NAME: Final = "vmu"

# What every backend counts since ``open``. frames: poses handed out. lost: gaps of the unit's frame
# counter, so frames refused by CRC or content are in it too. late: not newer than one already seen.
COUNTERS: Final = ("frames", "no_pose", "crc_errors", "skipped_bytes", "invalid", "lost", "duplicates", "late")
