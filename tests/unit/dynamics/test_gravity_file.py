"""Gravity files: all kinds give the same field, and a damaged one is never flown."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.dynamics import gravity_file
from hil.dynamics.gravity_file import GravityFileError, read
from tests.support import moon_reference as reference


def cof_lines(gm: float = reference.GM, radius: float = reference.RADIUS_M) -> list[str]:
    """Return the shipped field as GMAT writes it: fixed columns, a negative S touches C."""
    c, s = reference.coefficients()
    lines = ["COMMENT   a lunar field", f"POTFIELD{8:3d}{8:3d}  1 {gm:.14e} {radius:.14E} 1.00000000000000E+00"]
    for n in range(2, 9):
        for m in range(n + 1):
            sine = f"{s[n, m]:21.14E}" if m else ""
            lines.append(f"RECOEF{n:5d}{m:3d}   {c[n, m]:21.14E}{sine}")
    return [*lines, "END"]


def gfc_lines(gm: float = reference.GM, radius: float = reference.RADIUS_M) -> list[str]:
    """Return the shipped field as ICGEM publishes fields, with a free text before its header."""
    c, s = reference.coefficients()
    lines = [
        "a field of the Moon", "", "product_type                gravity_field", "modelname                   LP165P",
        f"gravity_constant            {gm:.12e}".replace("e", "D"), f"radius                      {radius:.6E}",
        "max_degree                  8", "norm                        fully_normalized",
        "errors                      no", "tide_system                 unknown", "",
        "key    L    M         C                  S", "end_of_head ==========================================",
        "gfc    0    0    1.0   0.0",
    ]  # fmt: skip
    return lines + [f"gfc {n:4d} {m:4d} {c[n, m]:.14e} {s[n, m]:.14e}" for n in range(2, 9) for m in range(n + 1)]


def write(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def test_shipped_field_has_the_published_numbers() -> None:
    field = read(reference.SHIPPED)
    assert (field.gm, field.radius, field.degree) == (4902.801056e9, 1738.0e3, 8)
    assert field.c[2, 0] == -9.08901807506e-05
    assert field.c[2, 2] == 3.46354993722e-05
    assert field.s[4, 3] == -1.34434722871e-05
    assert (field.c[8, 8], field.s[8, 8]) == (-2.53069725912e-06, 2.14062002356e-06)
    assert np.count_nonzero(field.c) == 42
    assert np.count_nonzero(field.s) == 35


# the head of GMAT's own files: LP165P.cof, JGM3.cof, Mars50c.cof
GMAT_HEAD = [
    "COMMENT   5", "C" * 80, f"CCCCC  {'-' * 66}  CCCCC", f"CCCCC  {'lp165p.grv : [165x165] LP165P':66}  CCCCC",
    f"CCCCC  {'-' * 66}  CCCCC", "C" * 80,
]  # fmt: skip


def test_all_kinds_give_the_same_field(tmp_path: Path) -> None:
    shipped = read(reference.SHIPPED)
    for name, lines in (("a.cof", cof_lines()), ("b.cof", GMAT_HEAD + cof_lines()[1:]), ("c.gfc", gfc_lines())):
        field = read(write(tmp_path / name, lines))
        np.testing.assert_array_equal(field.c[2:], shipped.c[2:])
        np.testing.assert_array_equal(field.s, shipped.s)
        assert (field.gm, field.radius) == (shipped.gm, shipped.radius)


def test_free_text_before_the_header_is_no_key(tmp_path: Path) -> None:
    lines = ["radius 1.0 of what was measured", "max_degree of this product: see below", *gfc_lines()]
    assert read(write(tmp_path / "a.gfc", lines)).radius == reference.RADIUS_M
    lines = [*lines[:2], "product_type of others", "begin_of_head ====", *gfc_lines()[2:]]
    assert read(write(tmp_path / "b.gfc", lines)).degree == 8


def test_columns_of_a_high_degree_may_touch(tmp_path: Path) -> None:
    lines = ["POTFIELD120120  1 4.90280105600000e+12 1.73800000000000e+06 1.00000000000000E+00"]
    lines += [f"RECOEF{n:5d}{m:3d}   {1e-9:21.14E}{-n * 1e-9:21.14E}" for n in range(2, 121) for m in range(n + 1)]
    field = read(write(tmp_path / "high.cof", [*lines, "END"]))
    assert field.degree == 120
    assert (field.c[120, 115], field.s[120, 115]) == (1e-9, -120e-9)


def test_zonal_harmonics_are_those_of_the_field() -> None:
    shipped = read(reference.SHIPPED).up_to(3)
    zonal = [-shipped.c[n, 0] * np.sqrt(2 * n + 1) for n in (2, 3)]
    field = gravity_file.of_zonal(reference.GM, reference.RADIUS_M, zonal)
    np.testing.assert_allclose(field.c[:, 0], shipped.c[:, 0], rtol=1e-15)
    assert np.count_nonzero(field.s) == 0
    assert gravity_file.of_zonal(1.0, 1.0, ()).degree == 1


def test_field_is_cut_off_at_the_degree_asked_for() -> None:
    field = read(reference.SHIPPED).up_to(4)
    assert field.c.shape == (5, 5)
    with pytest.raises(GravityFileError, match="goes to degree 8, too low for degree 9"):
        read(reference.SHIPPED).up_to(9)


@pytest.mark.parametrize(("name", "lines", "end"), [("cut.cof", cof_lines(), 5), ("cut.gfc", gfc_lines(), 2)])
def test_file_of_lines_cut_anywhere_is_refused(name: str, lines: list[str], end: int, tmp_path: Path) -> None:
    text = "\n".join(lines) + "\n"
    path = tmp_path / name
    for length in range(0, len(text) - end, 7):
        path.write_text(text[:length], encoding="ascii")
        with pytest.raises(GravityFileError):
            read(path)


def test_shadr_file_cut_anywhere_is_refused(tmp_path: Path) -> None:
    text = reference.SHIPPED.read_text(encoding="ascii")
    path = tmp_path / "cut.tab"
    for length in range(0, len(text) - 2, 7):
        path.write_text(text[:length], encoding="ascii")
        with pytest.raises(GravityFileError):
            read(path)


@pytest.mark.parametrize(
    ("name", "lines", "words"),
    [
        ("moon.grv", ["product_type gravity_field"], "unknown format .grv"),
        ("moon.gfc", ["product_type gravity_field"], "no end_of_head line"),
        ("moon.gfc", [*gfc_lines()[:7], "norm unnormalized", *gfc_lines()[8:]], "the coefficients are unnormalized"),
        ("moon.gfc", [*gfc_lines(), "gfc 0 0 0.999 0.0"], "degree 0, order 0 is given twice"),
        ("moon.gfc", [line.replace("0    0    1.0", "0    0    0.999") for line in gfc_lines()], "degree 0: 0.999"),
        ("moon.gfc", [*gfc_lines(), "gfct 2 0 1e-4 0.0 0 0 19500101"], "gfct: changes with time"),
        ("moon.gfc", [*gfc_lines()[:6], *gfc_lines()[7:]], "max_degree: is missing"),
        ("moon.gfc", [*gfc_lines(), "gfc 2 0 1e-4 0.0"], "degree 2, order 0 is given twice, with other numbers"),
        ("moon.cof", [*cof_lines()[:3], "RECOEF    2  0   1.0E-4", *cof_lines()[3:]], "order 0 is given twice"),
        ("earth.gfc", gfc_lines(gm=3.986e14, radius=6378137.0), "is not of the Moon"),
        ("moon.cof", ["  1738.0, 4902.8, 0, 8, 8, 1, 0, 0", "2, 0, -9e-5, 0, 0, 0"], "not a keyword of a GMAT"),
        ("moon.cof", ["COMMENT nothing else"], "no POTFIELD line"),
        ("moon.tab", cof_lines(), "line 1: not a row of numbers"),
        ("moon.tab", ["1, 2, 3"], "line 1: not a SHADR header"),
        ("moon.tab", [], "line 1: not a SHADR header"),
        ("moon.tab", ["1738.0, 4902.8, 0, 8, 8, 0, 0, 0", "2, 0, -9e-5, 0"], "not fully normalised"),
        ("moon.tab", ["1738.0, 4902.8, 0, 2, 2, 1, 0, 0", "3, 0, -9e-5, 0"], "does not fit degree 2"),
        ("moon.tab", ["1738.0, 4902.8, 0, 2, 2, 1, 0, 0", "2, 0, nan, 0"], "not finite"),
        ("earth.tab", ["6378.1, 398600.4, 0, 0, 0, 1, 0, 0"], "is not of the Moon"),
        ("earth.cof", cof_lines(gm=3.986e14, radius=6378137.0), "is not of the Moon"),
    ],
)
def test_wrong_file_is_refused_with_its_reason(tmp_path: Path, name: str, lines: list[str], words: str) -> None:
    with pytest.raises(GravityFileError, match=words):
        read(write(tmp_path / name, lines)).of_body(reference.GM, reference.RADIUS_M, "the Moon")


def test_file_that_is_no_text_or_not_there_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "moon.tab"
    with pytest.raises(GravityFileError, match="cannot be read"):
        read(path)
    path.write_bytes(bytes(range(256)))
    with pytest.raises(GravityFileError, match="not a text file"):
        read(path)
