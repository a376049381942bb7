"""``hil keys``: the keys of scenario and rig files, as ``--set`` takes them."""

from __future__ import annotations

from hil.cli.options import File
from hil.cli.output import print_columns, write_json


def keys(pattern: str = "*", /, *, json: File = None) -> int:
    """List the keys of scenario and rig files that --set takes, with unit, range, default and meaning.

    Parameters
    ----------
    pattern
        Part of the name, as deadband, or a name with wildcards, as "rig.*.timeout_s"; by default all keys.
    json
        File for the keys, - for standard output.
    """
    from hil.config.key_reference import matching_keys

    found = matching_keys(pattern)
    if json is not None:
        content = [{"key": key.name, "file": key.file, **key.row._asdict()} for key in found]
        write_json({"keys": content}, json)
    if json != "-":
        rows = [
            (key.name, key.row.type, key.row.unit, key.row.allowed, key.row.default, key.row.meaning) for key in found
        ]
        plain = [[text.replace("`", "") for text in row] for row in rows]
        print_columns(("key", "type", "unit", "allowed", "default", "meaning"), plain, left=range(6))
    return 0
