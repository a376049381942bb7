"""The C example built for the tests, as it is and with faults put in."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from hil.gnc_backends.c_header import HEADER_FILE

ROOT = Path(__file__).resolve().parents[2]
C_EXAMPLE = ROOT / "examples" / "gnc_c"
PYTHON_EXAMPLE = ROOT / "examples" / "gnc_python" / "gnc.py"
_FLAGS = ("-std=c11", "-O1", "-Wall", "-Wextra", "-Werror", "-pedantic", f"-I{HEADER_FILE.parent}")


def compile_c(sources: Sequence[Path], out: Path, *options: str) -> Path:
    """Return ``out``, compiled from ``sources`` without a warning."""
    command = ["cc", *_FLAGS, *options, *map(str, sources), "-o", str(out), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return out


def c_example(folder: Path, name: str = "mygnc.so", *replacements: str) -> Path:
    """Return the example as a shared library in ``folder``; replacements: see ``changed``."""
    source = folder / f"{name}.c"
    source.write_text(changed((C_EXAMPLE / "gnc.c").read_text(), *replacements))
    lenient = ("-w",) if replacements else ()
    return compile_c([source], folder / name, "-fPIC", "-shared", *lenient)


def changed(text: str, *replacements: str) -> str:
    """Return ``text`` with each ``old => new`` of ``replacements`` made, each of which is found."""
    for replacement in replacements:
        old, _, new = replacement.partition(" => ")
        assert old in text, old
        text = text.replace(old, new)
    return text
