"""One definition of the records: headers, pages, C compiler, kernels and Python objects have the same layout."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from docs import record_pages
from docs.c_headers import BACKEND_STRUCTS, STRUCTS, backends_header, c_header
from docs.record_pages import markdown_table
from hil.cli.main import execute
from hil.core.fields import leaf_fields, record_dtype
from hil.core.gnc_records import (
    GNC_INPUT,
    GNC_INPUT_3,
    GNC_ORBIT,
    GNC_OUTPUT,
    GNC_POSE,
    GNC_SETUP,
    GNC_SETUP_2,
    INPUTS,
    MEASURED_FIELDS,
    OBJECTS,
    OUTPUT_FIELDS,
    OUTPUTS,
)
from hil.frmn.mailboxes import MAILBOXES
from hil.frmn.wire import HEADER, LARGEST
from hil.gnc_backends.c_header import BACKENDS_HEADER_FILE, HEADER_FILE
from tests.support.external_gnc import PYTHON_EXAMPLE, compile_c

ALL = {**STRUCTS, **BACKEND_STRUCTS}


def test_shipped_headers_are_those_of_the_records(capsys: pytest.CaptureFixture[str]) -> None:
    assert HEADER_FILE.read_text() == c_header(), "python -m docs.c_headers writes it"
    assert BACKENDS_HEADER_FILE.read_text() == backends_header(), "python -m docs.c_headers writes it"
    for options, text in (([], c_header()), (["--backends"], backends_header())):
        assert execute(["gnc", "header", *options]) == 0
        assert capsys.readouterr().out == text


@pytest.mark.parametrize("struct", ALL)
def test_pages_show_the_layout_of_the_records(struct: str) -> None:
    page = record_pages.gnc_records() if struct in STRUCTS else record_pages.backend_records()
    assert markdown_table(ALL[struct]) in page


def test_c_compiler_places_every_field_where_the_bench_has_it(tmp_path: Path) -> None:
    lines, expected = [], []
    for struct, fields in ALL.items():
        dtype = record_dtype(fields)
        lines.append(f'printf("{struct} %zu\\n", sizeof({struct}));')
        expected.append(f"{struct} {dtype.itemsize}")
        for name, place in (dtype.fields or {}).items():
            lines.append(f'printf("{name} %zu\\n", offsetof({struct}, {name}));')
            expected.append(f"{name} {place[1]}")
    source = tmp_path / "places.c"
    source.write_text("\n".join(["#include <stdio.h>", '#include "hil_backends.h"', "int main(void) {", *lines, "}"]))
    found = subprocess.run([compile_c([source], tmp_path / "places")], capture_output=True, text=True, check=True)
    assert found.stdout.split("\n")[:-1] == expected


@pytest.mark.parametrize("part", INPUTS)
def test_kernels_libraries_and_python_objects_have_one_layout(part: str) -> None:
    library = record_dtype(ALL[f"hil_{part}_input"])
    for other in (INPUTS[part], OBJECTS[part]):
        assert _offsets(other) == _offsets(library)
    assert _offsets(OUTPUTS[part]) == _offsets(record_dtype(OUTPUT_FIELDS[part]))


def test_whole_gnc_and_navigation_have_the_same_fields_of_what_is_measured() -> None:
    """The same kernel writes both."""
    measured, navigation = record_dtype(MEASURED_FIELDS), INPUTS["navigation"]
    assert all(measured[name] == navigation[name] for name in measured.names or ())


def test_records_on_the_wire_fit_one_datagram_and_setup_and_input_are_first_fields() -> None:
    assert max(box.dtype.itemsize for box in MAILBOXES.values()) + HEADER.size <= LARGEST
    assert GNC_SETUP_2.itemsize + GNC_ORBIT.itemsize == GNC_SETUP.itemsize
    for whole, first in ((GNC_SETUP, GNC_SETUP_2), (GNC_INPUT, GNC_INPUT_3)):
        assert _places(whole)[: len(first.names or ())] == _places(first)


def test_python_example_has_the_layout_of_the_bench_and_does_not_import_it() -> None:
    text = PYTHON_EXAMPLE.read_text()
    assert "import hil" not in text
    assert "from hil" not in text
    there: dict[str, object] = {"__name__": "example"}
    exec(compile(text, str(PYTHON_EXAMPLE), "exec"), there)
    layouts = {"setup": GNC_SETUP_2, "orbit": GNC_ORBIT, "pose": GNC_POSE, "input": GNC_INPUT_3, "output": GNC_OUTPUT}
    for name, dtype in layouts.items():
        assert _places(there[name.upper()]) == _places(dtype)


def test_every_field_has_a_meaning_and_every_number_a_unit() -> None:
    fields = [field for table in ALL.values() for field in leaf_fields(table)]
    assert [field.name for field in fields if not field.meaning] == []
    assert [field.name for field in fields if not field.unit and not str(field.type).startswith("S")] == []


def _offsets(dtype: object) -> dict[str, int]:
    return {name: place[1] for name, place in dtype.fields.items()}  # type: ignore[attr-defined]


def _places(dtype: np.dtype) -> list[tuple[str, int, str]]:
    return [
        (name, place[1], str(place[0].shape) + ("" if place[0].base.names else place[0].base.str))
        for name, place in dtype.fields.items()
    ]
