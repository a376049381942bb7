"""``hil replay``: recorded inputs through the present GNC, vision unit or docking monitor, and the differences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from hil.cli.options import File, Flag, Group, Settings, refuse
from hil.cli.output import deliver, print_columns, say
from hil.core.arithmetic import why_bits_may_differ
from hil.core.part import provided
from hil.errors import Problem

if TYPE_CHECKING:
    from hil.config.scenario import Scenario
    from hil.recording.read import Recorded
    from hil.recording.replay import Difference, Replayed

_SAME, _DIFFERS = 0, 1
_ROWS = (
    ("position_rmse_m", "position rmse", "mm", 1e3),
    ("velocity_rmse_mps", "velocity rmse", "mm/s", 1e3),
    ("attitude_rmse_deg", "attitude rmse", "deg", 1.0),
    ("position_sigma_m", "position sigma", "mm", 1e3),
    ("attitude_sigma_deg", "attitude sigma", "deg", 1.0),
)


@dataclass(frozen=True)
class ImageOptions:
    """Options of a replay of images."""

    vmu: Flag = False
    """Replay the recorded stereo images through the vision unit instead."""
    geometry: str | None = None
    """With --vmu: geometry file (hil calibrate) instead of the recorded one."""
    monitor: Flag = False
    """Replay the recorded frames of the docking monitor instead."""
    scene: str | None = None
    """With --monitor: scene, shipped or a file, instead of the recorded one."""


_NO_IMAGES = ImageOptions()


def replay(
    recording: str,
    /,
    *,
    gnc: str | None = None,
    settings: Settings = (),
    trust_code: Flag = False,
    images: Group[ImageOptions] = _NO_IMAGES,
    json: File = None,
) -> int:
    """Replay the recorded inputs of a run through the present GNC and compare bit by bit.

    Parameters
    ----------
    recording
        File of hil run --record.
    gnc
        TOML file with other [gnc...] tables, or a scenario whose GNC is used.
    trust_code
        Load the library, Python file or FMU that the recording names, which is code of unknown origin.
    json
        File for the differences, - for standard output.
    """
    problems = []
    vmu, geometry, monitor, scene = images.vmu, images.geometry, images.monitor, images.scene
    if not (vmu or monitor or geometry is not None or scene is not None):
        return _replay_gnc(recording, gnc, settings, json, trust_code)
    if geometry is not None and not vmu:
        problems.append(Problem("--geometry", "", "goes with --vmu"))
    if scene is not None and not monitor:
        problems.append(Problem("--scene", "", "goes with --monitor"))
    for option, given in (("--gnc", gnc is not None), ("--set", bool(settings))):
        if given:
            problems.append(Problem(option, "", "goes with a replay of the GNC, not with --vmu or --monitor"))
    refuse(problems)

    status: int = provided("replay of images", "hil replay")(recording, vmu, geometry, monitor, scene, json)
    return status


def _replay_gnc(
    recording: str, gnc: str | None, settings: Sequence[str], json_path: str | None, trust_code: bool
) -> int:
    from hil.api.recordings import replay_file

    recorded, scenario, changed, replayed, errors = replay_file(Path(recording), gnc, settings, trust_code)
    deliver(
        _as_json(recorded, replayed, changed, errors),
        json_path,
        lambda: _print(recorded, scenario, replayed, changed, errors),
    )
    return _SAME if replayed.identical or (changed and not replayed.ended) else _DIFFERS


def _as_json(recorded: Recorded, replayed: Replayed, changed: bool, errors: dict[str, Any]) -> dict[str, Any]:
    return {
        "recording": str(recorded.path),
        "run": recorded.run["run"],
        "intact": recorded.intact,
        "changed": changed,
        "identical": replayed.identical,
        "why_bits_may_differ": why_bits_may_differ(recorded.run) or None,
        "cycles_recorded": replayed.recorded,
        "cycles_replayed": replayed.cycles,
        "ended": replayed.ended,
        "first_difference_cycle": min((d.first_cycle for d in replayed.differences), default=None),
        "first_difference_s": min((d.first_s for d in replayed.differences), default=None),
        "differences": [difference.as_json() for difference in replayed.differences],
        "missing_events": [_event(event) for event in replayed.missing_events],
        "new_events": [_event(event) for event in replayed.new_events],
        "navigation": errors,
    }


def _event(event: tuple[float, str, str]) -> dict[str, Any]:
    return dict(zip(("t_s", "source", "text"), event, strict=True))


def _print(recorded: Recorded, scenario: Scenario, replayed: Replayed, changed: bool, errors: dict[str, Any]) -> None:
    from hil.recording.replay import follows

    if replayed.ended:
        say(replayed.ended)
    for note in recorded.log:
        if note["kind"] == "setting":
            applied = follows(recorded, scenario, note["message"])
            suffix = "" if applied else "; not in this replay, which has another value"
            say(f"changed in flight by {note['name']}, from cycle {note['cycle']} on: {note['message']}{suffix}")
    of = f"{recorded.run['scenario']} on {recorded.run['rig']}, seed {recorded.run['seed']}, {replayed.cycles} cycles"
    if replayed.identical:
        say(f"identical, bit by bit: {of}")
        return
    if bits := why_bits_may_differ(recorded.run):
        say(bits)
    if replayed.differences:
        _print_differences(replayed.differences)
    for word, events in (("no longer", replayed.missing_events), ("new", replayed.new_events)):
        for t_s, source, text in events:
            say(f"{word:<9} {t_s:.2f} s {source}: {text}")
    if changed:
        _print_navigation(errors)
    if replayed.differences:
        first = min(replayed.differences, key=lambda d: d.first_cycle)
        say(f"differs from cycle {first.first_cycle} on, {first.first_s:.2f} s: {of}")
    elif replayed.ended:
        say(f"identical as far as it was replayed: {of}")


def _print_differences(differences: Sequence[Difference]) -> None:
    from hil.core.fields import leaf_fields
    from hil.core.messages import CYCLE_FIELDS

    units = {field.name: field.unit for field in leaf_fields(CYCLE_FIELDS)}
    rows = [
        (
            d.field,
            units[d.field],
            str(d.cycles),
            str(d.first_cycle),
            f"{d.first_s:.2f}",
            _size(d.first_size),
            _size(d.largest),
            f"{d.largest_s:.2f}",
        )
        for d in differences
    ]
    head = ("differs", "unit", "cycles", "from cycle", "at, s", "initially by", "at most by", "at, s")
    print_columns(head, rows, left=(0, 1))


def _size(value: float | None) -> str:
    return "nan" if value is None else f"{value:.3g}"


def _print_navigation(errors: dict[str, Any]) -> None:
    both = ("recorded", "replayed")
    rows = [(f"{label}, {unit}", *(_three(errors[w][key], scale) for w in both)) for key, label, unit, scale in _ROWS]
    for key, label in (("nees_pkf", "mean NEES, position"), ("nees_akf", "mean NEES, attitude")):
        values = [errors[which][key] for which in both]
        rows.append((label, *("-" if value is None else f"{value:.2f}" for value in values)))
    print_columns(("estimate against truth, x y z", *both), rows)


def _three(values: list[float] | None, scale: float) -> str:
    return "-" if values is None else " ".join(f"{scale * value:.4g}" for value in values)
