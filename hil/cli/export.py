"""``hil export``: the numbers of a recording for other tools."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from rich.console import Console

from hil.cli.output import check_json_path
from hil.core.camera_images import LEFT, MONITOR
from hil.errors import BadInput
from hil.recording.export import export
from hil.recording.export_images import FOLDERS, export_pictures
from hil.recording.read import load
from hil.recording.schema import GEOMETRY_FILE, SCENE_FILE


def export_command(recording: str, form: Literal["parquet", "csv"], out: str | None) -> int:
    """Do ``hil export``; return its exit code. Raises BadInput."""
    target = Path(out) if out is not None else Path(recording).with_suffix(f".{form}")
    if problems := check_json_path("--out", str(target)):
        raise BadInput(problems)
    for path, rows in export(Path(recording), form, target):
        Console().print(f"{path}: {rows} rows", highlight=False, soft_wrap=True, markup=False)
    return 0


def export_pictures_command(recording: str, folder: str, out: str | None) -> int:
    """Do ``hil export --pictures``; return its exit code. Raises BadInput."""
    if out is not None:
        raise BadInput.single("--out", "", "goes with the numbers of a recording, not with --pictures")
    recorded = load(Path(recording))
    found = export_pictures(recorded, Path(folder))

    def say(text: str) -> None:
        Console().print(text, highlight=False, soft_wrap=True, markup=False)

    for camera, count in found.pictures.items():
        if count:
            say(f"{found.folder / FOLDERS[camera]}: {count} pictures")
    if found.jpeg:
        say("recorded as JPEG: they are not what was looked at then")
    root = found.folder
    if found.pictures[LEFT]:
        rate_hz = recorded.rig.vmu.rate_hz
        say(f"hil vmu {root} --geometry {root / GEOMETRY_FILE} --rate-hz {rate_hz} --out poses.csv")
    if found.pictures[MONITOR]:
        say(f"hil monitor {root / FOLDERS[MONITOR]} --scene {root / SCENE_FILE} --out monitor.csv")
        if not found.whole:
            say("not every frame was recorded: hil monitor takes frames for evenly spaced that are not")
    return 0
