"""Configuration of the documentation site; ``make docs`` builds it."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT))

from hil import __version__  # noqa: E402

project = "hil-bench"
version = release = __version__
language = "en"

extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]

# pages are read on the site and in the repository: links are relative paths with GitHub's anchors
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]

# notebooks are executed at each build; an error in a cell is an error of the build
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 900  # the first one compiles the kernels

napoleon_google_docstring = False  # only sections with an underlined title
autodoc_member_order = "bysource"
autodoc_typehints = "signature"

# types without a page here: of other packages, and of this one where a caller needs only the documented fields
nitpick_ignore_regex = [
    ("py:.*", r"(collections|enum|matplotlib|numpy|pa|pathlib|pyarrow|pydantic|typing)\..*"),
    ("py:class", r"Figure|Job|Recorded|RunData|Path|Overrides|(Campaign|Study)Arguments"),
    ("py:class", r"hil\.api\.\w+\.\w+Arguments"),
    ("py:class", r"hil\.(recording\.read\.Recorded|recording\.replay\.\w+|report\.verdict\.Verdict)"),
    (
        "py:class",
        r"hil\.(config\.tables\.model\.ConfigModel|config\.vmu_geometry\.VmuGeometry|config\.scene\.Scene|vmu\.track\.TrackSettings)",
    ),
    (
        "py:class",
        r"hil\.(vmu\.(pose\.\w+|unit\.Pose|ghosts\.LensGhosts)|core\.modes\.Mode|core\.alarms\.AlarmKind)",
    ),
    ("py:class", r"hil\.parts\.monitor\.(sources\.VideoFrame|settings\.Region)"),
]

html_theme = "furo"
html_title = f"hil-bench {release}"
html_copy_source = False
html_show_copyright = False
html_static_path: list[str] = []


def prepare(_app: Any) -> None:
    """Copy the notebooks of ``examples/``."""
    for notebook in sorted((ROOT / "examples").glob("*.ipynb")):
        target = DOCS / "tutorials" / "notebooks" / notebook.name
        if not target.exists() or target.read_bytes() != notebook.read_bytes():
            target.parent.mkdir(exist_ok=True)
            shutil.copyfile(notebook, target)


def keep_sentence(_app: Any, what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Keep napoleon from taking the words before the first colon of a property for its type."""
    if what in ("attribute", "property"):
        lines[:0] = ["..", ""]  # an empty comment, which is not shown


def setup(app: Any) -> None:
    """Connect the steps of a build."""
    app.connect("builder-inited", prepare)
    app.connect("autodoc-process-docstring", keep_sentence, priority=400)
