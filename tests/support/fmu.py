"""FMUs for the tests: the C example, with faults put in, and archives with changed contents."""

from __future__ import annotations

import importlib.util
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

from hil.parts.fmi.archive import DESCRIPTION
from hil.parts.fmi.package import build
from tests.support.external_gnc import C_EXAMPLE, changed

BINARY = "binaries/linux64/gnc.so"


def script(path: Path) -> ModuleType:
    """Return the script at ``path``, imported."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def example_fmu(folder: Path, version: int = 2, *replacements: str, step_s: float | None = None) -> Path:
    """Return the example as an FMU in ``folder``. replacements: in gnc.c, see ``changed``; step_s: the only step."""
    source = folder / "gnc.c"
    source.write_text(changed((C_EXAMPLE / "gnc.c").read_text(), *replacements))
    out = folder / f"gnc-{version}.fmu"
    build(replace(script(C_EXAMPLE / "build_fmu.py").gnc_model([source]), step_s=step_s), version, out)
    return out


def repacked(fmu: Path, out: Path, change: Callable[[dict[str, bytes]], None]) -> Path:
    """Return ``out``, the archive ``fmu`` after ``change`` of its files."""
    with zipfile.ZipFile(fmu) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(out, "w") as archive:
        for name, content in files.items():
            archive.writestr(name, content)
    return out


def described(fmu: Path, out: Path, *replacements: str) -> Path:
    """Return ``out``, the archive ``fmu`` with ``old => new`` in its model description."""

    def change(files: dict[str, bytes]) -> None:
        files[DESCRIPTION] = changed(files[DESCRIPTION].decode(), *replacements).encode()

    return repacked(fmu, out, change)
