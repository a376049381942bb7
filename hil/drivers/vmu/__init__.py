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

CAMERA_COUNTERS: Final = (
    "frames",
    "no_pose",
    "clock_jumps",
    "pairs",
    "left_only",
    "right_only",
    "incomplete",
    "late",
    "odd_numbers",
    "lost",
    "skipped",
    "pair_skew_max_us",
    "identity_proven",
    *(
        f"{stage}_{percentile}_us"
        for stage in ("exposure_to_image", "image_to_solver", "solver", "exposure_to_pose")
        for percentile in ("p50", "p99")
    ),
)
"""Counters with cameras of this host, and percentiles of the last 2048 poses.

frames: poses returned. no_pose: pairs without a pose. clock_jumps: images discarded for an impossible time of exposure.
pairs: both images of an exposure arrived. left_only, right_only: the other image did not arrive in time. incomplete:
images with missing packets, which are not used. late: images that arrived after their pair was solved. odd_numbers:
pairs that were not used because frame numbers contradict times. lost: exposures without any image. skipped: images that
were overwritten before they were solved. pair_skew_max_us: largest difference of the exposures of a pair.
identity_proven: 1 if the cameras are those of the geometry file by serial number and region of the sensor.
exposure_to_image: until both images have arrived. image_to_solver: from there until the solver begins. solver: from
there to the pose in shared memory. exposure_to_pose: all of this.
"""
