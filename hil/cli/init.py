"""``hil init``: a repository for the tests of a laboratory, with pipelines."""

from __future__ import annotations

import os
import shutil
from pathlib import Path
from typing import Final

from hil.core.build_info import VERSION
from hil.core.surroundings import temporary_folder_in
from hil.errors import BadInput

_TEMPLATE: Final = "lab"
_EXAMPLES: Final = {"gnc/law.py": "lqr.py", "gnc/observer.c": "observer.c"}
"""File of the repository -> example of a backend that it is a copy of."""
_HIDDEN: Final = "dot_"
"""Beginning of the names of files that begin with a dot in the repository."""


def init(folder: str, /) -> int:
    """Write a repository: scenario, rig, GNC in C and Python, requirements, test campaign, and pipelines.

    Parameters
    ----------
    folder
        A new or an empty folder.
    """
    write_repository(Path(folder))
    print(f"{folder}: README.md there names the next commands")  # noqa: T201
    return 0


def write_repository(folder: Path) -> None:
    """Write the repository of a laboratory into ``folder``, completely or not at all. Raises BadInput."""
    _check_empty(folder)
    target = Path(os.path.abspath(folder))
    try:
        with temporary_folder_in(target.parent, "init") as temporary:
            made = Path(temporary, target.name)
            _copy(made)
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


def _copy(target: Path) -> None:
    from hil.config.load import configs_folder  # slow import

    template = configs_folder() / _TEMPLATE
    for source in sorted(path for path in template.rglob("*") if path.is_file() and "__pycache__" not in path.parts):
        parts = [part.replace(_HIDDEN, ".", 1) for part in source.relative_to(template).parts]
        written = target.joinpath(*parts)
        written.parent.mkdir(parents=True, exist_ok=True)
        written.write_text(source.read_text(encoding="utf-8").replace("HIL_VERSION", VERSION), encoding="utf-8")
    inside = configs_folder() / "backends"  # of an installed package; else those of the checkout
    examples = inside if inside.is_dir() else configs_folder().parent / "examples" / "backends"
    for name, example in _EXAMPLES.items():
        shutil.copyfile(examples / example, target / name)
