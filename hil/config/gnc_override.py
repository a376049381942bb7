"""Override of the GNC of a recorded scenario for a replay."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from hil.config.load import Loaded, apply_settings, check_table, load_scenario, merge_tables, read_with_bases, shipped
from hil.config.scenario import GncConfig, Scenario
from hil.errors import BadInput, Problem

_TABLES: Final = ("gnc", "requirements")
"""Tables of a scenario that a replay can change: the others determined the recording."""


def with_other_gnc(flown: Scenario, source: str, file: str | None, settings: Sequence[str]) -> Loaded[Scenario]:
    """Return ``flown`` with the GNC of ``file`` and then ``settings`` merged over it; raise BadInput.

    file: a TOML file with ``[gnc...]`` tables, or with the tables of gnc themselves (``[pkf]``), merged key by key; or
    a scenario, shipped or one that extends another, whose ``gnc`` and ``requirements`` replace those of ``flown``.
    source: name of the recording.
    """
    table: dict[str, Any] = flown.model_dump(mode="json", exclude_none=True)
    origin: dict[str, str] = {}
    if file is not None:
        for name, content in _tables_of(file).items():
            merge_tables(table[name], content, file, origin, f"{name}.")
    foreign = [text for text in settings if text.split("=")[0].split(".")[0].strip() not in _TABLES]
    if foreign:
        text = f"cannot be changed in a replay: allowed are keys of {' and '.join(_TABLES)}, as gnc.pkf...=..."
        raise BadInput([Problem("--set", setting, text) for setting in foreign])
    apply_settings(table, settings, Scenario, origin)
    for part in ("navigation", "control"):
        if table["gnc"][part]["backend"] != getattr(flown.gnc, part).backend:  # settings of another one mean nothing
            own = table["gnc"][part]["settings"]
            table["gnc"][part]["settings"] = {k: v for k, v in own.items() if f"gnc.{part}.settings.{k}" in origin}
    return check_table(table, Scenario, source, origin)


def _tables_of(file: str) -> dict[str, Any]:
    """Return the tables gnc and requirements of ``file``, if it has them."""
    if file in shipped("scenarios"):
        return _of_scenario(file)
    path = Path(file)
    if path.suffix != ".toml" or not path.is_file():
        names = ", ".join(shipped("scenarios"))
        raise BadInput.single("--gnc", file, f"no such file: give a TOML file with [gnc...] tables, or {names}")
    origin: dict[str, str] = {}
    own = read_with_bases(path, "scenarios", Scenario, origin)
    if any(source != str(path) for source in origin.values()):  # it extends another file
        return _of_scenario(file)
    if own and set(own) <= set(GncConfig.model_fields):
        return {"gnc": own}
    foreign = sorted(set(own) - {*_TABLES, "name"})
    if foreign:
        text = f"cannot be changed in a replay: allowed are {', '.join(_TABLES)}, or the tables of gnc themselves"
        raise BadInput([Problem(file, key, text) for key in foreign])
    return {name: own[name] for name in _TABLES if name in own}


def _of_scenario(file: str) -> dict[str, Any]:
    whole = load_scenario(file).value.model_dump(mode="json", exclude_none=True)
    return {name: whole[name] for name in _TABLES}
