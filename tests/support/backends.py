"""Backends of the tests: the examples, and files written for one test."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from hil.core.fields import record_dtype
from hil.core.gnc_records import GNC_SETUP_FIELDS, NAVIGATION_INPUT_FIELDS, NAVIGATION_OUTPUT_FIELDS
from hil.gnc_backends.c_header import HEADER_FILE
from hil.parts.fmi.mapping import record_fields
from hil.parts.fmi.package import Model, ModelVariable, build
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


_SETTINGS = {
    "position_gain": ("1", 0.04),
    "velocity_gain_per_s": ("1/s", 0.003),
    "bias_gain_per_s2": ("1/s^2", 0.0001),
    "attitude_gain": ("1", 0.01),
}
_OBSERVER_FMU = """
#include <math.h>
#include <string.h>

#include "fmi_shell.h"
#include "hil_backends.h"

typedef struct {
    hil_gnc_setup setup;
    hil_navigation_input input;
    hil_navigation_output output;
    double settings[4];
    void *observer;
} model;

int model_open(void *block, const char *resources, char *reason)
{
    model *m = block;
    (void)resources;
    m->observer = hil_navigation_open(&m->setup, m->settings, reason);
    m->input.setup = m->setup;
    return m->observer == NULL;
}

int model_step(void *block, double t_s, double step_s, char *reason)
{
    model *m = block;
    (void)t_s, (void)step_s;
    m->output.state = HIL_GNC_WORKING;
    m->output.nis_position = m->output.nis_attitude = NAN;
    for (int i = 0; i < 3; i++)
        m->output.sigma_attitude_rad[i] = NAN;
    const int code = hil_navigation_step(&m->input, &m->output, m->observer);
    if (code != 0)
        memcpy(reason, m->output.text, sizeof m->output.text);
    return code;
}

void model_close(void *block)
{
    model *m = block;
    hil_navigation_close(m->observer);
    m->observer = NULL;
}
"""


def observer_fmu(folder: Path, version: int = 2) -> Path:
    """Return the C example of navigation as an FMU in ``folder``, its settings tunable parameters."""
    shell = folder / "observer_fmu.c"
    shell.write_text(_OBSERVER_FMU)
    variables, offset = [], 0
    blocks = (
        (GNC_SETUP_FIELDS, "parameter"), (NAVIGATION_INPUT_FIELDS, "input"), (NAVIGATION_OUTPUT_FIELDS, "output"),
    )  # fmt: skip
    for fields, causality in blocks:
        for found in record_fields(fields):
            if not found.name.startswith("setup."):
                place = offset + found.offset
                variables.append(ModelVariable(found.name, causality, found.code, place, found.shape, found.unit))
        offset += record_dtype(fields).itemsize
    for i, (name, (unit, _)) in enumerate(_SETTINGS.items()):
        variables.append(ModelVariable(name, "parameter", "f8", offset + 8 * i, (), unit, tunable=True))
    values = np.array([value for _, value in _SETTINGS.values()]).tobytes()
    model = Model(
        "observer", "observer of examples/backends", variables, bytes(offset) + values + bytes(8),
        [shell, EXAMPLES / "observer.c"], include=[HEADER_FILE.parent],
    )  # fmt: skip
    out = folder / f"observer-{version}.fmu"
    build(model, version, out)
    return out
