"""``hil list``: what a command takes by name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from hil.cli.options import File
from hil.cli.output import print_columns, write_json
from hil.core.part import parts
from hil.errors import BadInput, did_you_mean

_FILES: Final = ("scenarios", "rigs", "dispersions", "targets", "bodies", "frames", "protocols")


def list(kind: str | None = None, /, *, json: File = None) -> int:
    """List what a command takes by name: scenarios, rigs, dispersions, drivers, backends, sensors, parts.

    Parameters
    ----------
    kind
        One of the kinds: scenarios, rigs, dispersions, targets, bodies, frames, protocols, drivers, backends,
        sensors, parts; by default all. Of parts alone: each with its version, the package that it is from, its commands
        and its tables in scenario and rig files.
    json
        File for the entries, - for standard output.
    """
    kinds: dict[str, Callable[[], dict[str, str]]] = {each: _of_files(each) for each in _FILES}
    kinds |= {"drivers": _drivers, "backends": _backends, "sensors": _sensors, "parts": _parts}
    if kind == "parts":
        return _list_parts(json)
    if kind is not None and kind not in kinds:
        raise BadInput.single("hil list", "", f"{kind}: {did_you_mean(kind, kinds)}give one of {', '.join(kinds)}")
    listed = {name: entries() for name, entries in kinds.items() if kind in (None, name)}
    write_json(dict(listed), json)
    if json != "-":
        rows = [(name, each, text) for name, entries in listed.items() for each, text in entries.items()]
        print_columns(("kind", "name", ""), rows, left=range(3))
    return 0


def _parts() -> dict[str, str]:
    return {name: each.part.summary for name, each in parts().usable.items()}


def _list_parts(json: str | None) -> int:
    rows = [
        {
            "name": each.part.name,
            "version": each.version,
            "origin": each.origin,
            "commands": [*each.part.commands],
            "tables": [*each.part.tables],
        }
        for each in parts().usable.values()
    ]
    write_json({"parts": rows, "problems": parts().problems}, json)
    if json != "-":
        shown = [[text if isinstance(text, str) else ", ".join(text) for text in each.values()] for each in rows]
        print_columns([*rows[0]], shown, left=range(5))
    return 0


def _of_files(kind: str) -> Callable[[], dict[str, str]]:
    """Return what lists the shipped files of ``kind`` with the first sentence of each."""

    def entries() -> dict[str, str]:
        from hil.config.load import configs_folder, shipped

        return {name: _first_sentence((configs_folder() / kind / f"{name}.toml").read_text()) for name in shipped(kind)}

    return entries


def _first_sentence(text: str) -> str:
    """Return the first sentence of the comment with which a file begins."""
    words = ""
    for line in text.splitlines():
        if not line.startswith("#") or not line.strip("# "):
            break
        words += f" {line.lstrip('# ')}"
    return words.strip().partition(". ")[0].rstrip(".:")


def _drivers() -> dict[str, str]:
    from hil.config.tables.driver_registry import registered_drivers

    return registered_drivers()


def _backends() -> dict[str, str]:
    """Return the backends of the GNC by the key that selects each, and the package that has it."""
    from importlib.metadata import entry_points

    from hil.config.scenario import BUILT_IN

    backends = {f"gnc.{part}.backend={name}": "hil" for part, names in BUILT_IN.items() for name in names}
    for part in BUILT_IN:
        for point in entry_points(group=f"hil.{part}"):
            package = f"{point.dist.name} {point.dist.version}" if point.dist else "unknown package"
            backends[f"gnc.{part}.backend={point.module}:{point.name}"] = package
    return backends


def _sensors() -> dict[str, str]:
    from hil.sensors.registry import kinds

    return {kind: declared if isinstance(declared, str) else declared.summary for kind, declared in kinds().items()}
