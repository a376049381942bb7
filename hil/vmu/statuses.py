"""Statuses of a frame of the vision unit: what each means, and whether there is a pose with it."""

from __future__ import annotations

from typing import Final, NamedTuple


class Status(NamedTuple):
    """Meaning, and whether the frame has a pose."""

    meaning: str
    has_pose: bool = False


STATUSES: Final = {
    "ok": Status("measured in this frame", has_pose=True),
    "predicted": Status(
        "no measurement, but a track of at least two poses: propagated at constant rates, with growing covariance, "
        "for at most 1 s",
        has_pose=True,
    ),
    "suspect": Status(
        "measured, but the images contradict it; not sent to the bench. `reflection`: lights where a plate behind "
        "the LEDs shows their reflections; `doubled_lights`: spots elongated as by reflections that merge with "
        "their LEDs, with the depth by which these displace the foremost LED; `partly_hidden`: LED whose spots are "
        "elongated otherwise than the rest; `residuals`: larger than stated by this factor; "
        "`size_against_disparity`, `epipolar`, `radial`, `shape`: [many poses "
        "together](../../explanation/vision-unit.md#many-poses-together) contradict the geometry file",
        has_pose=True,
    ),
    "ok_position": Status(
        "which LED is which, or the tilt, is open (three LEDs); the position is good, its sigma covers all poses "
        "that fit. Fused alone"
    ),
    "ok_sight": Status("as `ok_position`, and the range is not known to 5 %: the line of sight"),
    "ambiguous": Status(
        "more than one pose fits the spots, or the other lights show a second pattern of LEDs, and no track "
        "decides; the tilt is hardly observable, or the pose does not continue a track of at least eight poses "
        "(accepted after three in a row)"
    ),
    "too_few": Status("fewer spots than a pose needs, or so few that the pattern could be random"),
    "rejected_no_match": Status("lights, but no pattern of the LEDs among them"),
    "rejected_geometry": Status("the pattern is out of range, or seen from behind"),
    "rejected_sync": Status(
        "both cameras see the LEDs, but not at one place: images of different moments, or a camera that has been moved"
    ),
    "rejected_geometry_file": Status(
        "the images contradict the geometry file: cameras swapped, a ring of another size, or images of different "
        "moments of a target that moves along the baseline"
    ),
    "rejected_print": Status(
        "tags fit several ways to print them, or not the stated one: key `print` of the geometry file"
    ),
    "rejected_bright": Status(
        "no pose, and more than a tenth of an image is above nine tenths of full scale: the background is overexposed"
    ),
    "rejected_dark": Status("no light in valid images, which are dark"),
    "rejected_background": Status("no light in valid images, which are bright"),
    "rejected_time": Status("more lights than can be tried in the time of a pair"),
    "rejected_crowded": Status(
        "more than 512 lights in an image, whatever the threshold: a background or a sensor with many defects"
    ),
    "rejected_image": Status("no image can be read"),
    "rejected_size": Status("an image does not have the size of the geometry file"),
}
