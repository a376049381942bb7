"""One definition of the records: the header, the page and a C compiler agree with the bench's dtypes."""

from __future__ import annotations

import subprocess
from pathlib import Path

import numpy as np
import pytest

from docs import record_pages
from hil.core.fields import markdown_table, record_dtype
from hil.core.gnc_records import GNC_ORBIT, GNC_SETUP, GNC_SETUP_2
from hil.frmn.mailboxes import MAILBOXES
from hil.frmn.wire import HEADER, LARGEST
from hil.gnc_backends.c_header import HEADER_FILE, RECORDS, c_header
from tests.support.external_gnc import PYTHON_EXAMPLE, compile_c

LAYOUTS = {name: record_dtype(fields) for name, fields in RECORDS.items()}


def test_shipped_header_is_the_one_of_the_records() -> None:
    assert HEADER_FILE.read_text() == c_header(), f"{HEADER_FILE}: write the text of c_header() to it"


@pytest.mark.parametrize("record", RECORDS)
def test_page_shows_the_layout_of_the_records(record: str) -> None:
    assert markdown_table(RECORDS[record]) in record_pages.gnc_records()


def test_c_compiler_places_every_field_where_the_bench_has_it(tmp_path: Path) -> None:
    lines = []
    for name, dtype in LAYOUTS.items():
        lines.append(f'printf("{name} %zu\\n", sizeof(hil_gnc_{name}));')
        lines += [f'printf("{name}.{f} %zu\\n", offsetof(hil_gnc_{name}, {f}));' for f in dtype.names or ()]
    source = tmp_path / "places.c"
    source.write_text("\n".join(["#include <stdio.h>", '#include "hil_gnc.h"', "int main(void) {", *lines, "}"]))
    said = subprocess.run([compile_c([source], tmp_path / "places")], capture_output=True, text=True, check=True)
    expected = []
    for name, dtype in LAYOUTS.items():
        expected.append(f"{name} {dtype.itemsize}")
        expected += [f"{name}.{f} {dtype.fields[f][1]}" for f in dtype.names or ()]  # type: ignore[index]
    assert said.stdout.split("\n")[:-1] == expected


def test_records_on_the_wire_fit_one_datagram_and_the_setup_is_two_of_them() -> None:
    assert max(box.dtype.itemsize for box in MAILBOXES.values()) + HEADER.size <= LARGEST
    assert GNC_SETUP_2.itemsize + GNC_ORBIT.itemsize == GNC_SETUP.itemsize
    assert _places(GNC_SETUP)[: len(GNC_SETUP_2.names or ())] == _places(GNC_SETUP_2)


def test_python_example_has_the_layout_of_the_bench_and_does_not_import_it() -> None:
    text = PYTHON_EXAMPLE.read_text()
    assert "import hil" not in text
    assert "from hil" not in text
    there: dict[str, object] = {"__name__": "example"}
    exec(compile(text, str(PYTHON_EXAMPLE), "exec"), there)
    for name, dtype in (LAYOUTS | {"setup": GNC_SETUP_2, "orbit": GNC_ORBIT}).items():
        assert _places(there[name.upper()]) == _places(dtype)


def _places(dtype: np.dtype) -> list[tuple[str, int, str]]:
    return [
        (name, place[1], str(place[0].shape) + ("" if place[0].base.names else place[0].base.str))
        for name, place in dtype.fields.items()
    ]
