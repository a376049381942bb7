"""Backends of the tests: the examples, and files written for one test."""

from __future__ import annotations

import shutil
from pathlib import Path

from tests.support.external_gnc import ROOT, changed, compile_c

EXAMPLES = ROOT / "examples" / "backends"
LQR = f"{EXAMPLES / 'lqr.py'}:lqr"
OBSERVER = f"{EXAMPLES / 'observer.py'}:observer"
EKF = f"{EXAMPLES / 'ekf.py'}:Ekf"
DEAD_BAND = f"{EXAMPLES / 'controller.py'}:DeadBand"
EXACT = "-ffp-contract=off"


def observer_library(folder: Path, name: str = "observer.so", *replacements: str) -> Path:
    """Return the C example as a shared library in ``folder``; replacements: see ``changed``."""
    source = folder / f"{name}.c"
    source.write_text(changed((EXAMPLES / "observer.c").read_text(), *replacements))
    return compile_c([source], folder / name, "-fPIC", "-shared", EXACT, *(("-w",) if replacements else ()))


def kernel_file(folder: Path, body: str, head: str = "settings, inp, out, memory", options: str = "") -> str:
    """Return the name of a kernel with ``body``, written to a file. options: of the decorator."""
    path = folder / "law.py"
    path.write_text(f"import hil\n\n\n@hil.kernel_backend({options})\ndef law({head}):\n    {body}\n")
    return f"{path}:law"


def copied(example: str, folder: Path) -> Path:
    """Return a copy of the file of ``example`` in ``folder``."""
    return Path(shutil.copy(example.rpartition(":")[0], folder))
