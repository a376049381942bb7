"""One definition of the records of backends: header, page, C compiler and Python objects agree with the dtypes."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from docs import record_pages
from hil.cli.main import execute
from hil.core.backend_records import INPUTS, OBJECTS, OUTPUT_FIELDS, OUTPUTS
from hil.core.fields import leaf_fields, markdown_table, record_dtype
from hil.gnc_backends.c_header import BACKEND_STRUCTS, BACKENDS_HEADER_FILE, backends_header
from tests.support.external_gnc import compile_c


def test_shipped_header_is_the_one_of_the_records(capsys: pytest.CaptureFixture[str]) -> None:
    assert BACKENDS_HEADER_FILE.read_text() == backends_header(), "write the text of backends_header() to it"
    assert execute(["gnc", "header", "--backends"]) == 0
    assert capsys.readouterr().out == backends_header()


@pytest.mark.parametrize("struct", BACKEND_STRUCTS)
def test_page_shows_the_layout_of_the_records(struct: str) -> None:
    assert markdown_table(BACKEND_STRUCTS[struct]) in record_pages.backend_records()


def test_c_compiler_places_every_field_where_the_bench_has_it(tmp_path: Path) -> None:
    lines, expected = [], []
    for struct, fields in BACKEND_STRUCTS.items():
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
    library = record_dtype(BACKEND_STRUCTS[f"hil_{part}_input"])
    for other in (INPUTS[part], OBJECTS[part]):
        assert _places(other) == _places(library)
    assert _places(OUTPUTS[part]) == _places(record_dtype(OUTPUT_FIELDS[part]))


def _places(dtype: object) -> dict[str, int]:
    return {name: place[1] for name, place in dtype.fields.items()}  # type: ignore[attr-defined]


def test_every_field_has_a_meaning_and_every_number_a_unit() -> None:
    fields = [field for table in BACKEND_STRUCTS.values() for field in leaf_fields(table)]
    assert [field.name for field in fields if not field.meaning] == []
    assert [field.name for field in fields if not field.unit and not str(field.type).startswith("S")] == []
