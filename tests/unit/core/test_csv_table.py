"""Tables as spreadsheets of several countries write them."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.core.csv_table import CsvTable, read_csv
from hil.errors import BadInput


def read(path: Path, content: bytes) -> CsvTable:
    path.write_bytes(content)
    return read_csv(path, 1 << 20, ("view", "x_m"), ("left",))


@pytest.mark.parametrize(
    "content",
    [
        b"view,x_m\na,1.5\nb,-2e-3\n",
        b"\xef\xbb\xbfview,x_m\r\na,1.5\r\nb,-2e-3\r\n",
        b"view;x_m\r\na;1,5\r\nb;-2e-3\r\n",
        b"view;x_m\na;1,5\nb;-0,2e-2\n\n",
        b"view\tx_m\na\t1,5\nb\t-,002\n",
        b'"view", "x_m"\n"a", "1.5"\n , \n"b", "-2E-3"',
        b"x_m,view\n1.5,a\n-0.002,b\n",
    ],
)
def test_numbers_are_those_of_the_spreadsheet(tmp_path: Path, content: bytes) -> None:
    table = read(tmp_path / "a.csv", content)
    found = {row["view"]: table.number(line, "x_m", row["x_m"]) for line, row in table.rows}
    table.check()
    assert found == {"a": 1.5, "b": -0.002}


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"view,x_m\na,1,5\n", "line 2: has 3 cells, the header 2: decimal commas?"),
        (b"view;x_m\na\n", "line 2: has 1 cells, the header 2"),
        (b"view;x_m\na;1.234,5\n", "line 2, x_m: '1.234,5': must be a finite number"),
        (b"view,x_m\na,nan\n", "line 2, x_m: 'nan': must be a finite number"),
        (b"view,y_m\na,1\n", "column x_m is missing; columns: view,x_m, optional: left"),
        (b"view,x_m,z_m\na,1,2\n", "unknown column 'z_m'"),
        (b"view,x_m,x_m\na,1,2\n", "column x_m is there twice"),
        (b"view,x_m\n", "contains no row"),
        (b"", "column view is missing"),
        (b"v\xffiew,x_m\n", "cannot be read: not a text file: byte 1 is not UTF-8"),
    ],
)
def test_table_that_cannot_be_used_is_one_line(tmp_path: Path, content: bytes, words: str) -> None:
    def checked() -> None:
        table = read(tmp_path / "a.csv", content)
        for line, row in table.rows:
            table.number(line, "x_m", row["x_m"])
        table.check()

    with pytest.raises(BadInput) as caught:
        checked()
    assert str(caught.value).startswith(f"{tmp_path / 'a.csv'}: {words}")
    assert "\n" not in str(caught.value)
