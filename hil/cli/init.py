"""``hil init``: a repository for the tests of a laboratory, with pipelines, or the package of a part or a driver."""

from __future__ import annotations

import keyword
import os
import re
import shutil
from collections.abc import Callable
from functools import reduce
from pathlib import Path
from typing import Final

from hil.core.build_info import VERSION
from hil.core.part import commands_of, declared, parts
from hil.core.surroundings import temporary_folder_in
from hil.errors import BadInput

_PART: Final = "ranging"
_DRIVER: Final = "acme"
"""Names of part and driver in their templates."""
_EXAMPLES: Final = {"gnc/law.py": "lqr.py", "gnc/observer.c": "observer.c"}
"""File of the repository -> example of a backend that it is a copy of."""
_HIDDEN: Final = "dot_"
"""Beginning of the names of files that begin with a dot in the repository."""


def init(folder: str, /, *, part: str | None = None, driver: str | None = None) -> int:
    """Write a repository: scenario, rig, GNC in C and Python, test campaign, pipelines; or a part, or a driver.

    Parameters
    ----------
    folder
        A new or an empty folder.
    part
        Name of a part: write its package instead, with a table, rows, a command, a section of the report and a test.
    driver
        Name of a driver: write its package instead, of rails, with codec, driver, emulator, tests and a page.
    """
    if part is not None and driver is not None:
        raise BadInput.single("--driver", "", "does not go with --part, give one of them")
    if part is not None:
        write_part(part, Path(folder))
    elif driver is not None:
        write_driver(driver, Path(folder))
    else:
        write_repository(Path(folder))
    print(f"{folder}: README.md there names the next commands")  # noqa: T201
    return 0


def write_repository(folder: Path) -> None:
    """Write the repository of a laboratory into ``folder``, completely or not at all. Raises BadInput."""

    def write(made: Path) -> None:
        _copy("lab", made, lambda text: text)
        examples = _template("backends")
        for name, example in _EXAMPLES.items():
            shutil.copyfile(examples / example, made / name)

    _write(folder, write)


def write_part(name: str, folder: Path) -> None:
    """Write the package of the part ``name`` into ``folder``, completely or not at all. Raises BadInput."""
    _check_name("--part", name)
    from hil.config.scenario import Scenario  # slow import

    if name in {*parts().usable, *commands_of(), *Scenario.model_fields, *declared("sections")}:
        raise BadInput.single("--part", "", f"{name}: is the name of a part, command or table of hil, give another")
    _write(folder, lambda made: _copy("part", made, _renamed(_PART, name)))


def write_driver(name: str, folder: Path) -> None:
    """Write the package of the driver ``rails.NAME`` into ``folder``, completely or not at all. Raises BadInput."""
    _check_name("--driver", name)
    from hil.config.tables.driver_registry import registered_drivers  # slow import

    if name in ("mock", "none") or f"rig.rails.driver={name}" in registered_drivers():
        raise BadInput.single("--driver", "", f"{name}: is the name of a driver of rails, give another")
    _write(folder, lambda made: _copy("driver_python", made, _renamed(_DRIVER, name)))


def _check_name(option: str, name: str) -> None:
    if not re.fullmatch(r"[a-z][a-z0-9_]{0,29}", name) or keyword.iskeyword(name):
        text = f"{name!r:.60}: allowed are lower-case letters, digits and _, at most 30, with a letter first"
        raise BadInput.single(option, "", text)


def _renamed(old: str, name: str) -> Callable[[str], str]:
    """Return what replaces the name of a template, in its three spellings."""
    title = "".join(word.capitalize() for word in name.split("_"))
    spellings = ((old, name), (old.capitalize(), title), (old.upper(), name.upper()))
    return lambda text: reduce(lambda renamed, pair: renamed.replace(*pair), spellings, text)


def _write(folder: Path, write: Callable[[Path], None]) -> None:
    _check_empty(folder)
    target = Path(os.path.abspath(folder))
    try:
        with temporary_folder_in(target.parent, "init") as temporary:
            made = Path(temporary, target.name)
            write(made)
            os.replace(made, target)  # of an empty folder, too
    except OSError as error:
        raise BadInput.single("hil init", "", f"{folder}: cannot be written: {error.strerror}") from error


def _check_empty(folder: Path) -> None:
    if not os.path.lexists(folder):
        return
    if not folder.is_dir():
        raise BadInput.single("hil init", "", f"{folder}: is a file, give a new or an empty folder")
    if names := sorted(path.name for path in folder.iterdir()):
        shown = ", ".join(names[:3]) + (", ..." if len(names) > 3 else "")
        raise BadInput.single("hil init", "", f"{folder}: is not empty ({shown}), give a new or an empty folder")


def _copy(name: str, target: Path, named: Callable[[str], str]) -> None:
    """Copy the template ``name``; named: returns its texts and paths with other names."""
    template = _template(name)
    for source in sorted(path for path in template.rglob("*") if path.is_file() and "__pycache__" not in path.parts):
        parts_of_path = [part.replace(_HIDDEN, ".", 1) for part in source.relative_to(template).parts]
        written = target.joinpath(*map(named, parts_of_path))
        written.parent.mkdir(parents=True, exist_ok=True)
        text = source.read_text(encoding="utf-8").replace("HIL_VERSION", VERSION)
        written.write_text(named(text), encoding="utf-8")


def _template(name: str) -> Path:
    """Return a folder of the configs; of the examples, in a checkout, where an installed package has them inside."""
    inside = _configs() / name
    return inside if inside.is_dir() else _configs().parent / "examples" / name


def _configs() -> Path:
    from hil.config.load import configs_folder  # slow import

    return configs_folder()
