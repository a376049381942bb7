"""Build a part of the plant as an FMU: python build_fmu.py thrusters.c|truth.c|imu.c -o OUT.fmu [--fmi 2|3]"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from hil.core.fields import record_dtype
from hil.parts.fmi.mapping import record_fields
from hil.parts.fmi.model_stage import RECORDS
from hil.parts.fmi.package import Model, ModelVariable, build


def part_model(source: Path) -> Model:
    """Return the model of the part that the name of ``source`` gives; its block is setup, input, output, state."""
    records = RECORDS[source.stem]
    variables, offset = [], 0
    for fields, causality in ((records.setup, "parameter"), (records.inputs, "input"), (records.outputs, "output")):
        for found in record_fields(fields):
            place = offset + found.offset
            variables.append(ModelVariable(found.name, causality, found.code, place, found.shape, found.unit))
        offset += record_dtype(fields).itemsize
    start = bytes(offset + 64 * np.dtype(float).itemsize)
    return Model(source.stem, f"{source.stem} of examples/models_c", variables, start, [source])


def main() -> None:
    """Build it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("source", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    parser.add_argument("--fmi", type=int, choices=(2, 3), default=2)
    arguments = parser.parse_args()
    build(part_model(arguments.source), arguments.fmi, arguments.out)


if __name__ == "__main__":
    main()
