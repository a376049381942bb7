"""Build hook of hatchling: writes the commit of the sources into wheel and sdist."""

from __future__ import annotations

import runpy
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MODULE = Path("hil", "core", "build_info.py")


class CommitHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the file that ``hil.core.build_info`` reads; an editable install reads the checkout instead."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the file to a temporary folder and include it; an sdist has it already."""
        build = runpy.run_path(str(Path(self.root, MODULE)))
        target = MODULE.with_name(build["COMMIT_FILE"])
        if version == "editable" or Path(self.root, target).is_file():
            return
        self._folder = tempfile.TemporaryDirectory()
        source = Path(self._folder.name, target.name)
        source.write_text(build["build_info"]().commit + "\n", encoding="utf-8")
        build_data["force_include"][str(source)] = target.as_posix()
