"""Configuration of the documentation site; ``make docs`` builds it."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path
from typing import Any

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
sys.path.insert(0, str(ROOT))

from docs import generate  # noqa: E402
from hil import __version__  # noqa: E402

project = "hil-bench"
version = release = __version__
language = "en"

extensions = ["myst_nb", "sphinx.ext.autodoc"]

# pages are read on the site and in the repository: links are relative paths with GitHub's anchors
myst_heading_anchors = 4
myst_enable_extensions = ["colon_fence"]

# notebooks are executed at each build; an error in a cell is an error of the build
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True

# types of other packages have no pages here
nitpick_ignore_regex = [("py:.*", r"(collections|enum|matplotlib|numpy|pathlib|pyarrow|pydantic|typing)\..*")]

html_theme = "furo"
html_title = f"hil-bench {release}"
html_copy_source = False
html_show_copyright = False
html_static_path: list[str] = []


def prepare(_app: Any) -> None:
    """Write the generated pages, and copy the notebooks of ``examples/``."""
    generate.write(DOCS)
    for notebook in sorted((ROOT / "examples").glob("*.ipynb")):
        target = DOCS / "tutorials" / "notebooks" / notebook.name
        if not target.exists() or target.read_bytes() != notebook.read_bytes():
            target.parent.mkdir(exist_ok=True)
            shutil.copyfile(notebook, target)


def setup(app: Any) -> None:
    """Connect the preparation to the start of a build."""
    app.connect("builder-inited", prepare)
