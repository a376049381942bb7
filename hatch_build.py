"""Build hooks of hatchling: commit of the sources in wheel and sdist, kernels in tagged wheels, README of the index.

A wheel is pure, for any computer, and compiles its kernels at their first use. HIL_WHEEL_KERNELS=1 adds those in
``hil/kernels``, machine code for one version of Python and one kind of processor, and has the tags of both; it requires
the compiler's versions by which its kernels are named, since any other version would compile them again.
"""

from __future__ import annotations

import os
import platform
import re
import runpy
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any, Final

from hatchling.builders.hooks.plugin.interface import BuildHookInterface
from hatchling.metadata.plugin.interface import MetadataHookInterface

COMPILER: Final = ("numba", "llvmlite", "numpy")
"""Packages whose versions are in the name of each kernel (``hil.core.kernel_digest``)."""
PLATFORM: Final = "manylinux_2_28"
MODULE = Path("hil", "core", "build_info.py")
KERNELS = "hil/kernels"


class ReadmeHook(MetadataHookInterface):
    """The README as the description of the package: a link of the repository is the text that it stands under.

    HIL_PROJECT_URL: address of the files of the repository, by which links are completed; pictures have /raw/ in it
    for /blob/, which is a page about the picture.
    """

    def update(self, metadata: dict[str, Any]) -> None:
        """Set the description."""
        text = Path(self.root, "README.md").read_text(encoding="utf-8")
        metadata["readme"] = {
            "content-type": "text/markdown",
            "text": described(text, os.environ.get("HIL_PROJECT_URL", "")),
        }


def described(text: str, url: str) -> str:
    """Return the README ``text`` with complete links, without relative ones if there is no ``url`` before them."""
    link = re.compile(r"(!?)\[([^\]]*)\]\((?!https?:)([^)\s]+)\)")

    def complete(found: re.Match[str]) -> str:
        picture, shown, path = found.groups()
        if url:
            base = url.rstrip("/").replace("/blob/", "/raw/") if picture else url.rstrip("/")
            return f"{picture}[{shown}]({base}/{path})"
        return "" if picture else shown

    return link.sub(complete, text)


class CommitHook(BuildHookInterface):  # type: ignore[type-arg]
    """Adds the file that ``hil.core.build_info`` reads; an editable install reads the checkout instead."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Write the file to a temporary folder and include it; an sdist has it already."""
        if self.target_name == "wheel" and version != "editable" and os.environ.get("HIL_WHEEL_KERNELS") == "1":
            if not any(Path(self.root, KERNELS).glob("*")):
                raise FileNotFoundError(f"{KERNELS}: holds no kernels, HIL_CACHE_DIR=hil hil warm-up compiles them")
            build_data["artifacts"].append(f"{KERNELS}/")
            python = f"cp{sys.version_info.major}{sys.version_info.minor}"
            # no shared library is in it: the code of a kernel calls nothing outside of the process
            build_data["pure_python"], build_data["tag"] = False, f"{python}-{python}-{PLATFORM}_{platform.machine()}"
            build_data["dependencies"] += [f"{name}=={metadata.version(name)}" for name in COMPILER]
        build = runpy.run_path(str(Path(self.root, MODULE)))
        target = MODULE.with_name(build["COMMIT_FILE"])
        if version == "editable" or Path(self.root, target).is_file():
            return
        self._folder = tempfile.TemporaryDirectory()
        source = Path(self._folder.name, target.name)
        source.write_text(build["build_info"]().commit + "\n", encoding="utf-8")
        build_data["force_include"][str(source)] = target.as_posix()
