"""Build hook of hatchling: writes the commit of the sources into wheel and sdist, and kernels into tagged wheels.

A wheel is pure, for any computer, and compiles its kernels at their first use. HIL_WHEEL_KERNELS=1 adds those in
``hil/kernels``, machine code for one version of Python and one kind of processor, and has the tags of both.
"""

from __future__ import annotations

import os
import runpy
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

MODULE = Path("hil", "core", "build_info.py")
KERNELS = "hil/kernels"


class CommitHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the file that ``hil.core.build_info`` reads; an editable install reads the checkout instead."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the file to a temporary folder and include it; an sdist has it already."""
        if self.target_name == "wheel" and version != "editable" and os.environ.get("HIL_WHEEL_KERNELS") == "1":
            if not any(Path(self.root, KERNELS).glob("*")):
                raise FileNotFoundError(f"{KERNELS}: holds no kernels, HIL_CACHE_DIR=hil hil warm-up compiles them")
            build_data["artifacts"].append(f"{KERNELS}/")
            build_data["pure_python"], build_data["infer_tag"] = False, True
        build = runpy.run_path(str(Path(self.root, MODULE)))
        target = MODULE.with_name(build["COMMIT_FILE"])
        if version == "editable" or Path(self.root, target).is_file():
            return
        self._folder = tempfile.TemporaryDirectory()
        source = Path(self._folder.name, target.name)
        source.write_text(build["build_info"]().commit + "\n", encoding="utf-8")
        build_data["force_include"][str(source)] = target.as_posix()
