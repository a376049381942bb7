"""``hil export``: numbers and images of a recording for other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, get_args

from cyclopts import Parameter

from hil.cli.output import file_path_problem, say
from hil.errors import BadInput

Form = Literal["parquet", "csv", "ros2"]


def export(
    recording: str,
    /,
    *,
    form: Annotated[Form | None, Parameter(name="--format")] = None,
    out: Annotated[str | None, Parameter(name=("--out", "-o"))] = None,
    images: str | None = None,
) -> int:
    """Write the numbers of a recording as Parquet or CSV, its camera images, or all of it as a bag of ROS 2.

    Parameters
    ----------
    recording
        File of hil run --record, of any version.
    form
        Default: that of the ending of --out, or csv. parquet requires the extra of that name: pip install
        'hil-bench[parquet]'.
    out
        File, or of ros2 the new folder, to write; default: the recording's name with the format's ending.
    images
        Folder for the camera images, with their times and calibration, instead of the numbers.
    """
    if images is not None:
        return _export_images(recording, images, out)
    ending = Path(out).suffix[1:] if out is not None else ""
    endings: dict[str, Form] = {each: each for each in get_args(Form)}
    chosen = form or endings.get(ending, "csv")
    if ending != chosen and ending in endings:
        raise BadInput.single("--out", "", f"{out} ends in .{ending}, and the format is {chosen}")
    target = Path(out) if out is not None else Path(recording).with_suffix(f".{chosen}")
    if chosen == "ros2":
        from hil.parts.export.ros2 import export_ros2

        for topic, count in export_ros2(Path(recording), target).items():
            say(f"{target}: {topic} {count} messages")
        return 0
    if problem := file_path_problem(str(target)):
        raise BadInput.single("--out", "", problem)

    from hil.parts.export import table as numbers

    for path, rows in numbers.export(Path(recording), chosen, target):
        say(f"{path}: {rows} rows")
    return 0


def _export_images(recording: str, folder: str, out: str | None) -> int:
    if out is not None:
        raise BadInput.single("--out", "", "goes with the numbers of a recording, not with --images")

    from hil.core.camera_images import GEOMETRY_FILE, LEFT, MONITOR, SCENE_FILE
    from hil.parts.export.images import FOLDERS, export_images
    from hil.recording.read import load

    recorded = load(Path(recording))
    exported = export_images(recorded, Path(folder))

    for camera, count in exported.images.items():
        if count:
            say(f"{exported.folder / FOLDERS[camera]}: {count} images")
    if exported.jpeg:
        say("recorded as JPEG: not identical with the images that were evaluated")
    root = exported.folder
    if exported.images[LEFT]:
        rate_hz = recorded.rig.vmu.rate_hz
        say(f"hil vmu {root} --geometry {root / GEOMETRY_FILE} --rate-hz {rate_hz} --out poses.csv")
    if exported.images[MONITOR]:
        say(f"hil monitor {root / FOLDERS[MONITOR]} --scene {root / SCENE_FILE} --out monitor.csv")
        if not exported.whole:
            say("not every frame was recorded: hil monitor assumes evenly spaced frames")
    return 0
