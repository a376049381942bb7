"""``hil replay --vmu`` and ``--monitor``: recorded images through the present vision unit and docking monitor."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, Final

from hil.cli.output import deliver, notices, print_columns, say
from hil.config.camera_identity import MONITOR_CAMERA, PROVEN, check_same
from hil.config.load import load_geometry, load_scene
from hil.config.scene import Scene
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import GEOMETRY_FILE, SCENE_FILE
from hil.errors import BadInput
from hil.parts.monitor.results import QUANTITIES
from hil.parts.vision.replay_images import ImageComponent, ImagesReplayed, replay_monitor, replay_vision_unit
from hil.recording.read import Recorded, load

_SAME, _DIFFERS = 0, 1
_RECORDED: Final = "the recording has"
Replayed = tuple[ImagesReplayed, bool, str]
"""A replay, whether its geometry or scene was given, and a doubt about the identity of the cameras, or ""."""
_SHOWN: Final = {"m": ("mm", 1e3), "rad": ("deg", math.degrees(1.0)), "m/s": ("mm/s", 1e3)}


def replay_images(
    recording: str, vmu: bool, geometry: str | None, monitor: bool, scene: str | None, json_path: str | None
) -> int:
    """Replay the images of a recording; return the exit code. Raises BadInput if it has none."""
    recorded = load(Path(recording))
    replays: dict[str, Replayed] = {}
    with notices().status("replaying the images"):
        if vmu:
            stated, doubt = _geometry(recorded, geometry)
            replays["vmu"] = (replay_vision_unit(recorded, stated, geometry), geometry is not None, doubt)
        if monitor:
            shown, doubt = _scene(recorded, scene)
            replays["monitor"] = (replay_monitor(recorded, shown), scene is not None, doubt)
    deliver(_as_json(recorded, replays), json_path, lambda: _print(recorded, replays))
    same = all(replayed.identical or changed for replayed, changed, _ in replays.values())
    return _SAME if same else _DIFFERS


def _geometry(recorded: Recorded, path: str | None) -> tuple[VmuGeometry, str]:
    if path is None and recorded.scenario.vmu.source != "rendered":
        raise BadInput.single(str(recorded.path), "", 'holds no images of the vision unit: vmu.source was "model"')
    then = recorded.calibration(GEOMETRY_FILE, VmuGeometry) if path is None or GEOMETRY_FILE in recorded.files else None
    given = then if path is None else load_geometry(path).value
    assert given is not None
    at_run = then.identities if then else {}
    return given, check_same(given.identities, at_run, path or str(recorded.path), _RECORDED)


def _scene(recorded: Recorded, name: str | None) -> tuple[Scene, str]:
    monitor = recorded.scenario.monitor
    if not monitor.has_images:
        text = f'holds no images of a docking monitor: monitor.source was "{monitor.source}"'
        raise BadInput.single(str(recorded.path), "", text)
    then = recorded.calibration(SCENE_FILE, Scene) if name is None or SCENE_FILE in recorded.files else None
    given = then if name is None else load_scene(name).value
    assert given is not None
    now, at_run = ({MONITOR_CAMERA: None if each is None else each.camera.identity} for each in (given, then))
    return given, check_same(now, at_run, name or str(recorded.path), _RECORDED)


def _as_json(recorded: Recorded, replays: dict[str, Replayed]) -> dict[str, Any]:
    return {
        "recording": str(recorded.path),
        "run": recorded.run["run"],
        "intact": recorded.intact,
        **{
            name: {
                "changed": changed,
                "identical": replayed.identical,
                "exposures": replayed.images,
                "compared": replayed.compared,
                "missing": replayed.missing,
                "new": replayed.new,
                "statuses": [
                    {"recorded": original, "replayed": now, "count": count}
                    for (original, now), count in sorted(replayed.statuses.items())
                ],
                "differences": [difference.as_json() for difference in replayed.differences],
                "remarks": replayed.remarks,
                "identity": doubt or PROVEN,
            }
            for name, (replayed, changed, doubt) in replays.items()
        },
    }


def _print(recorded: Recorded, replays: dict[str, Replayed]) -> None:
    for name, (replayed, changed, doubt) in replays.items():
        what = "poses" if name == "vmu" else "portions"
        of = f"{replayed.of}, {replayed.images} exposures, {replayed.compared} {what}"
        for remark in (*replayed.remarks, *([doubt] if changed and doubt else [])):
            say(remark)
        if replayed.identical:
            say(f"identical, bit by bit: {of}")
            continue
        _print_tables(replayed, what)
        if replayed.missing:
            say(f"{replayed.missing} recorded {what} are missing in the replay")
        if replayed.new:
            say(f"{replayed.new} {what} of the replay are not in the recording")
        firsts = [d.first_s for d in replayed.differences if d.first_s is not None]
        since = f" from {min(firsts):.2f} s on" if firsts else ""
        say(f"differs{since}: {of}")


def _print_tables(replayed: ImagesReplayed, what: str) -> None:
    rows = [(original, now, str(count)) for (original, now), count in sorted(replayed.statuses.items())]
    print_columns(("status, recorded", "now", "exposures"), rows, left=(0, 1))
    if replayed.differences:
        head = ("differs", "unit", what, "from, s", "at most by", "sigmas", "at, s")
        print_columns(head, [_row(d) for d in replayed.differences], left=(0, 1))


def _row(d: ImageComponent) -> tuple[str, ...]:
    unit, factor = _SHOWN.get(d.unit, (d.unit, 1.0))
    largest = None if d.largest is None else factor * d.largest
    size = _number(largest) if d.unit else "-"
    name = d.name.rpartition("_")[0].replace("_", " ") if d.name in QUANTITIES else d.name
    return (name, unit or "-", str(d.count), _time(d.first_s), size, _number(d.largest_sigmas), _time(d.largest_s))


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


def _time(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
