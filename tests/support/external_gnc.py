"""The C example built for the tests, as it is and with faults put in."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from hil.gnc_backends.c_header import HEADER_FILE

USES_ALL = """    gnc_state *g = gnc; =>     gnc_state *g = gnc;
    const hil_measured *m = &input->measured;
    if (m->n_samples > 1)
        g->bias[0] += 1e-3 * m->samples[1].force_mps2[0];
    if (m->n_poses > 0)
        g->bias[1] += 1e-6 * m->poses[m->n_poses - 1].r_TC_C_m[0];
    if (m->n_measurements > 0)
        g->bias[2] += 1e-6 * m->measurements[m->n_measurements - 1].value[0];"""
"""Change of the C example: its estimate depends on everything that is measured."""
MEASURED = ("imu.rate_hz=200.0", "sensors.ranger.kind=range_finder")
"""Settings with samples of a fast IMU and a further sensor."""
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
