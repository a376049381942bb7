"""Gravity files as GMAT and ICGEM publish them, of Moon, Mars and Earth: accelerations against Basilisk's.

A folder of published files is compared as well: ``HIL_GRAVITY_FILES=FOLDER make oracle``.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("Basilisk", reason="Basilisk (bsk) is not installed: it belongs to the extra 'oracle'")

from hil.core.messages import new
from hil.dynamics import central_gravity
from hil.dynamics.central_gravity import GRAVITY_PARAMS
from hil.dynamics.gravity_file import GravityField, read
from tests.support.basilisk_pair import field_text, gravity_model

BODIES = {"moon": (4.90280105600000e12, 1.738e6), "mars": (4.28283703710000e13, 3.3942e6),
          "earth": (3.98600441500000e14, 6.3781363e6)}  # fmt: skip
PUBLISHED = sorted(Path(os.environ["HIL_GRAVITY_FILES"]).iterdir()) if "HIL_GRAVITY_FILES" in os.environ else []
DEGREES = (2, 8, 20, 50)
"""Harmonics up to these are compared; radii: 1.005 to 10 of the body's."""


def drawn(degree: int, rng: np.random.Generator) -> list[tuple[int, int, float, float]]:
    """Return coefficients of the size of Kaula's rule, with the digits that files have."""
    sizes = [(n, m, 1e-5 / max(n, 2) ** 2) for n in range(2, degree + 1) for m in range(n + 1)]
    numbers = [(n, m, *(size * rng.standard_normal(2))) for n, m, size in sizes]
    return [(n, m, float(f"{c:.14e}"), float(f"{s:.14e}") if m else 0.0) for n, m, c, s in numbers]


def as_gmat(path: Path, gm: float, radius: float, rows: list[tuple[int, int, float, float]]) -> Path:
    degree = rows[-1][0]
    rule = f"CCCCC  {'-' * 66}  CCCCC"
    head = ["COMMENT   5", "C" * 80, rule, f"CCCCC  {f'field : [{degree}x{degree}]':66}  CCCCC", rule, "C" * 80]
    head.append(f"POTFIELD{degree:3d}{degree:3d}  0 {gm:.14e} {radius:.14e} 1.00000000000000e+00")
    body = [f"RECOEF  {n:3d}{m:3d}   {c:21.14e}{f'{s:21.14e}' if m else ''}" for n, m, c, s in rows]
    path.write_text("\n".join([*head, *body, "END ", ""]), encoding="ascii")
    return path


def as_icgem(path: Path, gm: float, radius: float, rows: list[tuple[int, int, float, float]]) -> Path:
    head = ["*** model converted into ICGEM-format", "begin_of_head ====", "product_type                gravity_field"]
    head += ["modelname                   field", f"gravity_constant            {gm:.16E}".replace("E", "D")]
    head += [f"radius                      {radius:.7E}", "tide_system                 tide_free"]
    head += [f"max_degree                  {rows[-1][0]}", "errors                      no"]
    head += ["norm                        fully_normalized", "key    L    M    C    S", f"end_of_head {'=' * 60}"]
    body = ["gfc    0     0  1.0d0  0.0d0", "gfc    1     0  0.0d0  0.0d0", "gfc    1     1  0.0d0  0.0d0"]
    body += [f"gfc  {n:4d}  {m:4d}  {c:.14e} {s:.14e}" for n, m, c, s in rows]
    path.write_text("\n".join([*head, *body, ""]), encoding="ascii")
    return path


def largest_difference(field: GravityField, folder: Path, rng: np.random.Generator) -> float:
    """Return the largest relative difference of the accelerations at drawn places and degrees."""
    worst = 0.0
    for degree in [each for each in DEGREES if each <= field.degree]:
        cut = field.up_to(degree)
        file = folder / "basilisk.txt"
        file.write_text(field_text(cut), encoding="ascii")
        body = gravity_model(file)
        params, ours = new(GRAVITY_PARAMS), np.empty(3)
        params.gm, params.radius, params.degree = cut.gm, cut.radius, degree
        params.rotation = params.rate = 0.0
        table = central_gravity.field_table(cut.c, cut.s)
        for factor in (1.005, 1.05, 1.5, 3.0, 10.0):
            for _ in range(20):
                r = rng.standard_normal(3)
                r *= factor * cut.radius / np.linalg.norm(r)
                central_gravity.acceleration(params, table, 0.0, r, ours)
                theirs = np.array(body.gravityModel.computeField([[x] for x in r.tolist()], degree, True)).ravel()
                worst = max(worst, float(np.linalg.norm(ours - theirs) / np.linalg.norm(theirs)))
    return worst


@pytest.mark.parametrize("body", BODIES)
@pytest.mark.parametrize("write", [as_gmat, as_icgem])
def test_file_of_each_kind_has_the_acceleration_of_basilisk(
    tmp_path: Path, body: str, write: object, rng: np.random.Generator
) -> None:
    assert callable(write)
    gm, radius = BODIES[body]
    path = tmp_path / f"{body}{'.cof' if write is as_gmat else '.gfc'}"
    rows = drawn(50, rng)
    field = read(write(path, gm, radius, rows))
    assert (field.gm, field.radius, field.degree) == (gm, radius, 50)
    assert all((field.c[n, m], field.s[n, m]) == (c, s) for n, m, c, s in rows)
    assert largest_difference(field, tmp_path, rng) <= 1e-12


@pytest.mark.parametrize("path", PUBLISHED, ids=lambda path: path.name)
def test_published_file_has_the_acceleration_of_basilisk(path: Path, tmp_path: Path, rng: np.random.Generator) -> None:
    field = read(path)
    worst = largest_difference(field, tmp_path, rng)
    print(f"{path.name}: degree {field.degree}, largest relative difference {worst:.1e}")  # noqa: T201
    assert worst <= 1e-12
