"""Build the GNC of gnc.c as an FMU for co-simulation: python build_fmu.py -o gnc.fmu [--fmi 2|3] [SOURCE.c ...]

Parameters are the fields of hil_gnc_setup, inputs those of hil_gnc_input, outputs those of hil_gnc_output, each under
its own name: the bench needs no mapping file.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hil.core.fields import record_dtype
from hil.core.gnc_records import GNC_INPUT_FIELDS, GNC_OUTPUT_FIELDS, GNC_SETUP_FIELDS
from hil.gnc_backends.c_header import HEADER_FILE
from hil.parts.fmi.mapping import record_fields
from hil.parts.fmi.package import Model, ModelVariable, build

HERE = Path(__file__).parent


def gnc_model(sources: Sequence[Path], name: str = "gnc") -> Model:
    """Return the model of the GNC in ``sources``."""
    variables, offset = [], 0
    blocks = ((GNC_SETUP_FIELDS, "parameter"), (GNC_INPUT_FIELDS, "input"), (GNC_OUTPUT_FIELDS, "output"))
    for fields, causality in blocks:
        for found in record_fields(fields):
            if (causality, found.name) == ("output", "cycle"):
                continue  # the same as in the input
            place = offset + found.offset
            variables.append(ModelVariable(found.name, causality, found.code, place, found.shape, found.unit))
        offset += record_dtype(fields).itemsize
    start = bytes(offset + np.dtype(np.intp).itemsize)
    sources = [HERE / "gnc_fmu.c", *sources]
    return Model(name, "GNC of examples/gnc_c", variables, start, sources, include=[HEADER_FILE.parent])


def main() -> None:
    """Build it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sources", nargs="*", type=Path, default=[HERE / "gnc.c"])
    parser.add_argument("-o", "--out", type=Path, default=Path("gnc.fmu"))
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2)
    arguments = parser.parse_args()
    build(gnc_model(arguments.sources), arguments.fmi, arguments.out)


if __name__ == "__main__":
    main()
