"""Packages of the examples, installed for a test: their files with the metadata that pip writes."""

from __future__ import annotations

import tomllib
from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FOLDER, SENSOR = EXAMPLES / "driver_python", EXAMPLES / "sensor_python"
RIG = str(FOLDER / "rig.toml")


def install(target: Path, folder: Path = FOLDER) -> Path:
    """Install the package in ``folder`` in ``target``; return the folder to be put on the path."""
    project = tomllib.loads((folder / "pyproject.toml").read_text())["project"]
    name, version = project["name"], project["version"]
    info = target / f"{name.replace('-', '_')}-{version}.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: {version}\n")
    points = [
        line
        for group, entries in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{key} = {value}" for key, value in entries.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(points) + "\n")
    for path in (*(each.parent for each in folder.glob("*/__init__.py")), *folder.glob("*.py")):
        (target / path.name).symlink_to(path)
    return target
