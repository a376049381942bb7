"""``hil keys``: the keys of scenario and rig files, as ``--set`` takes them."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hil.cli.options import File
from hil.cli.output import notices, print_columns, say, write_json

if TYPE_CHECKING:
    from hil.config.key_reference import KeyMatch


def keys(pattern: str = "*", /, *, json: File = None) -> int:
    """List the keys of scenario and rig files that --set takes, with unit, range, default and meaning.

    Parameters
    ----------
    pattern
        Part of the name, as deadband, or a name with wildcards, as "rig.*.timeout_s"; by default all keys.
    json
        File for the keys, - for standard output.
    """
    from hil.config.key_reference import UNKNOWN_UNIT, matching_keys

    matches = matching_keys(pattern, _keys_of_sensors())
    if json is not None:
        content = [{"key": key.name, "file": key.file, **key.row._asdict()} for key in matches]
        write_json({"keys": content}, json)
    if json != "-":
        rows = [
            (key.name, key.row.type, key.row.unit, key.row.allowed, key.row.default, key.row.meaning) for key in matches
        ]
        plain = [[text.replace("`", "") for text in row] for row in rows]
        print_columns(("key", "type", "unit", "allowed", "default", "meaning"), plain, left=range(6))
    if any(key.row.unit == UNKNOWN_UNIT for key in matches):
        say(f"unit {UNKNOWN_UNIT}: a number whose name ends in no unit of hil/config/tables/units.py", notices())
    return 0


def _keys_of_sensors() -> list[KeyMatch]:
    """Return the keys that the sensor modules of this program and of installed packages declare."""
    from hil.config.key_reference import KeyMatch, KeyRow
    from hil.sensors.module import SensorKind
    from hil.sensors.registry import kinds

    return [
        KeyMatch(
            f"sensors.NAME.{setting.name}",
            "scenario",
            KeyRow(
                setting.name, "number", setting.unit, setting.allowed, f"{setting.default:g}", f"{kind}: {setting.doc}"
            ),
        )
        for kind, sensor in kinds().items()
        if isinstance(sensor, SensorKind)
        for setting in sensor.settings
    ]
