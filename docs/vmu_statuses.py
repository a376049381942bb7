"""Statuses of a frame of the vision unit: what each means, and whether there is a pose with it."""

from __future__ import annotations

from typing import Final, NamedTuple


class VmuStatus(NamedTuple):
    """Meaning, and whether the frame has a pose."""

    meaning: str
    has_pose: bool = False


STATUSES: Final = {
    "ok": VmuStatus("measured in this frame", has_pose=True),
    "predicted": VmuStatus(
        "no measurement, but a track of at least two poses: propagated at constant rates, with growing covariance, "
        "for at most 1 s",
        has_pose=True,
    ),
    "suspect": VmuStatus(
        "measured, but the images contradict it; not sent to the bench. `reflection`: lights where a plate behind "
        "the LEDs shows their reflections; `doubled_lights`: spots elongated as by reflections that merge with "
        "their LEDs, with the depth by which these displace the foremost LED; `partly_hidden`: LED whose spots are "
        "elongated otherwise than the rest; `residuals`: larger than stated by this factor; "
        "`size_against_disparity`, `epipolar`, `radial`, `shape`: [many poses "
        "together](../../explanation/vision-unit.md#many-poses-together) contradict the geometry file",
        has_pose=True,
    ),
    "ok_position": VmuStatus(
        "which LED is which, or the tilt, is open (three LEDs); the position is good, its sigma covers all poses "
        "that fit. Fused alone"
    ),
    "ok_sight": VmuStatus("as `ok_position`, and the range is not known to 5 %: the line of sight"),
    "ambiguous": VmuStatus(
        "more than one pose fits the spots, or the other lights show a second pattern of LEDs, and no track "
        "decides; the tilt is hardly observable, or the pose does not continue a track of at least eight poses "
        "(accepted after three in a row)"
    ),
    "too_few": VmuStatus("fewer spots than a pose needs, or so few that the pattern could be random"),
    "rejected_no_match": VmuStatus("lights, but no pattern of the LEDs among them"),
    "rejected_geometry": VmuStatus("the pattern is out of range, or seen from behind"),
    "rejected_sync": VmuStatus(
        "both cameras see the LEDs, but not at one place: images of different moments, or a camera that has been moved"
    ),
    "rejected_geometry_file": VmuStatus(
        "the images contradict the geometry file: cameras swapped, a ring of another size, or images of different "
        "moments of a target that moves along the baseline"
    ),
    "rejected_print": VmuStatus(
        "tags fit several ways to print them, or not the stated one: key `print` of the geometry file"
    ),
    "rejected_bright": VmuStatus(
        "no pose, and more than a tenth of an image is above nine tenths of full scale: the background is overexposed"
    ),
    "rejected_dark": VmuStatus("no light in valid images, which are dark"),
    "rejected_background": VmuStatus("no light in valid images, which are bright"),
    "rejected_time": VmuStatus("more lights than can be tried in the time of a pair"),
    "rejected_crowded": VmuStatus(
        "more than 512 lights in an image, whatever the threshold: a background or a sensor with many defects"
    ),
    "rejected_image": VmuStatus("no image can be read"),
    "rejected_frozen": VmuStatus("both images are those of the frame before: no new measurement"),
    "rejected_size": VmuStatus("an image does not have the size of the geometry file"),
}
