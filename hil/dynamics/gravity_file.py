"""Reader of gravity fields: ICGEM's ``.gfc``, GMAT's ``.cof``, SHADR tables of the Planetary Data System (``.tab``,
``.sha``).

A file must hold every coefficient from degree 2 to the degree of its header: an incomplete field would go unnoticed
in a run.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from hil.core.files import MIB, read_text
from hil.core.messages import Array
from hil.errors import BadInput

_BYTES_MAX = 128 * MIB  # a field of degree 1200 has 80 MiB
_DEGREE_MAX = 2000
_GM_TOLERANCE = 0.01  # published lunar fields differ by 1e-6
_RADIUS_TOLERANCE = 0.02
_KINDS = "an ICGEM .gfc, a GMAT .cof, or a PDS SHADR .tab or .sha file"

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[EeDd][-+]?\d+)?"
_POTFIELD = re.compile(
    rf"POTFIELD\s*(\d{{1,3}})\s*(\d{{1,3}})\s+\d+\s+({_NUMBER})\s+({_NUMBER})(?:\s+({_NUMBER}))?\s*$"
)
_GFC_KEYS = (("earth_gravity_constant", "gravity_constant"), ("radius",), ("max_degree",))
_GFC_OF_TIME = ("gfct", "trnd", "dot", "acos", "asin")
_RECOEF = re.compile(rf"RECOEF\s*(\d{{1,3}})\s*(\d{{1,3}})\s+({_NUMBER})\s*({_NUMBER})?\s*$")


class GravityFileError(ValueError):
    """The file cannot be used; the text gives the reason and, if there is one, the line."""


@dataclass(frozen=True)
class GravityField:
    """gm: m^3/s^2. radius: m. c, s: (N + 1, N + 1), indexed [n, m], fully normalised, without dimension."""

    gm: float
    radius: float
    c: Array
    s: Array

    @property
    def degree(self) -> int:
        return len(self.c) - 1

    def of_body(self, gm: float, radius: float, name: str) -> GravityField:
        """Return the field; raise GravityFileError if it is not of the body of ``gm``, m^3/s^2, and ``radius``, m."""
        if abs(self.gm / gm - 1.0) > _GM_TOLERANCE or abs(self.radius / radius - 1.0) > _RADIUS_TOLERANCE:
            shown = f"GM {self.gm / 1e9:g} km^3/s^2, radius {self.radius / 1e3:g} km"
            raise GravityFileError(f"is not of {name} ({shown}): give {_KINDS} of {name}")
        return self

    def up_to(self, degree: int) -> GravityField:
        """Return the field cut off after ``degree``; raise GravityFileError if its degree is lower."""
        if degree > self.degree:
            raise GravityFileError(f"goes to degree {self.degree}, too low for degree {degree}")
        return GravityField(
            self.gm, self.radius, self.c[: degree + 1, : degree + 1], self.s[: degree + 1, : degree + 1]
        )


def of_zonal(gm: float, radius: float, zonal: Sequence[float]) -> GravityField:
    """Return the field of a point mass with the zonal harmonics J2, J3, ..., not normalised; gm: m^3/s^2, radius: m."""
    c = np.zeros((len(zonal) + 2, len(zonal) + 2))
    for n, j in enumerate(zonal, start=2):
        c[n, 0] = -j / math.sqrt(2 * n + 1)
    return GravityField(gm, radius, c, np.zeros_like(c))


def read(path: Path) -> GravityField:
    """Return the field in ``path``, in the format of its suffix; raise GravityFileError.

    An unchanged file is not read again.
    """
    if path.suffix.lower() not in _READERS:
        raise GravityFileError(f"unknown format {path.suffix or 'without a suffix'}: give {_KINDS}")
    try:
        stamp = path.stat()
    except OSError as error:
        raise GravityFileError(f"cannot be read: {error.strerror}") from error
    return _read(path, stamp.st_mtime_ns, stamp.st_size)


@lru_cache(maxsize=4)
def _read(path: Path, _changed_ns: int, _size: int) -> GravityField:
    try:
        text = read_text(path, _BYTES_MAX, "latin-1" if path.suffix.lower() == ".gfc" else "ascii")
    except BadInput as error:
        raise GravityFileError(f"{error.problems[0].message}: give {_KINDS}") from error
    field = _READERS[path.suffix.lower()](text)
    field.c.flags.writeable = field.s.flags.writeable = False  # shared by all callers
    return field


class _Coefficients:
    """Coefficients read so far; missing ones are nan."""

    def __init__(self, degree: int, order: int) -> None:
        self._order = order
        self.c = np.full((degree + 1, degree + 1), np.nan)
        self.s = np.zeros((degree + 1, degree + 1))

    def put(self, line: int, n: int, m: int, c: float, s: float) -> None:
        if not (0 <= m <= n < len(self.c)):
            raise GravityFileError(
                f"line {line}: degree {n}, order {m} does not fit degree {len(self.c) - 1} of the header"
            )
        if not (math.isfinite(c) and math.isfinite(s)):
            raise GravityFileError(f"line {line}: degree {n}, order {m} is not finite")
        if not math.isnan(self.c[n, m]) and (self.c[n, m], self.s[n, m]) != (c, s):
            raise GravityFileError(f"line {line}: degree {n}, order {m} is given twice, with other numbers")
        self.c[n, m], self.s[n, m] = c, s

    def field(self, gm: float, radius: float) -> GravityField:
        degree = len(self.c) - 1
        if np.nan_to_num(self.c[0, 0]) not in (0.0, 1.0):
            raise GravityFileError(f"degree 0: {self.c[0, 0]:.16g}, allowed 1 or 0: GM has the mass of the body")
        for n in range(2, degree + 1):
            for m in range(min(n, self._order) + 1):
                if math.isnan(self.c[n, m]):
                    raise GravityFileError(f"is cut: its header gives degree {degree}, degree {n} order {m} is missing")
        self.c[np.isnan(self.c)] = 0.0  # degrees 0 and 1, and orders above the header's
        return GravityField(gm, radius, self.c, self.s)


def _read_cof(text: str) -> GravityField:
    """GMAT: a POTFIELD line (degree, order, GM in m^3/s^2, radius in m), RECOEF lines, END. Negative S touch C."""
    coefficients: _Coefficients | None = None
    gm = radius = 0.0
    for number, line in enumerate(text.splitlines(), start=1):
        word = line.split(None, 1)[0] if line.strip() else ""
        if word.startswith("POTFIELD"):
            header = _POTFIELD.match(line)
            if header is None:
                raise GravityFileError(f"line {number}: not a POTFIELD line of degree, order, GM and radius")
            if header[5] is not None and _float(header[5]) != 1.0:
                raise GravityFileError(
                    f"line {number}: the coefficients are not fully normalised (flag {header[5]}, wanted 1)"
                )
            gm, radius = _float(header[3]), _float(header[4])
            coefficients = _Coefficients(int(header[1]), int(header[2]))
        elif word.startswith("RECOEF"):
            row = _RECOEF.match(line)
            if coefficients is None or row is None or (int(row[2]) > 0 and row[4] is None):
                raise GravityFileError(
                    f"line {number}: not a RECOEF line of degree, order, C and S under a POTFIELD line"
                )
            coefficients.put(number, int(row[1]), int(row[2]), _float(row[3]), _float(row[4] or "0"))
        elif word == "END":
            break
        elif word != "COMMENT" and word.strip("C"):  # GMAT's own files have a frame of C around their titles
            raise GravityFileError(f"line {number}: {word[:20]} is not a keyword of a GMAT .cof file")
    else:
        if coefficients is not None:
            raise GravityFileError("is cut: there is no END line")
    if coefficients is None:
        raise GravityFileError("has no POTFIELD line: not a GMAT .cof file")
    return coefficients.field(gm, radius)


def _read_shadr(text: str) -> GravityField:
    """PDS: radius in km, GM in km^3/s^2, its sigma, degree, order, normalisation; then rows n, m, C, S (and sigmas)."""
    lines = text.splitlines()
    header = _numbers(lines[0], 1) if lines else []
    if len(header) < 6:
        raise GravityFileError("line 1: not a SHADR header of radius, GM, its sigma, degree, order, normalisation, ...")
    degree, order = _whole(header[3], 1), _whole(header[4], 1)
    if header[5] != 1.0:
        raise GravityFileError(f"line 1: the coefficients are not fully normalised (state {header[5]:g}, wanted 1)")
    coefficients = _Coefficients(degree, order)
    width = 0
    for number, line in enumerate(lines[1:], start=2):
        if not line.strip():
            continue
        row = _numbers(line, number)
        width = width or len(row)
        if len(row) < max(4, width):
            raise GravityFileError(f"line {number}: is cut: {len(row)} numbers, the rows before have {max(4, width)}")
        coefficients.put(number, _whole(row[0], number), _whole(row[1], number), row[2], row[3])
    _check_last_line(text, lines)
    return coefficients.field(header[1] * 1e9, header[0] * 1e3)


def _read_gfc(text: str) -> GravityField:
    """ICGEM: a header of keys and values up to end_of_head; then rows gfc n, m, C, S (and sigmas)."""
    lines = text.splitlines()
    begin = next((number for number, line in enumerate(lines, start=1) if line.split()[:1] == ["end_of_head"]), 0)
    if not begin:
        raise GravityFileError("has no end_of_head line: not an ICGEM .gfc file, or cut")
    head = [line.split() for line in lines[: begin - 1] if line.strip()]
    first = next((k for key in ("begin_of_head", "product_type") for k, line in enumerate(head) if line[0] == key), 0)
    header = {line[0]: line[1] for line in reversed(head[first:]) if len(line) > 1}  # before it free text
    if header.get("norm", "fully_normalized") != "fully_normalized":
        raise GravityFileError(f"norm: the coefficients are {header['norm']}, allowed fully_normalized")
    gm, radius, degree = (_header_number(header, names) for names in _GFC_KEYS)
    coefficients = _Coefficients(_whole(degree, 1), _whole(degree, 1))
    for number, line in enumerate(lines[begin:], start=begin + 1):
        key, *words = line.split() or [""]
        if key == "gfc" and len(words) >= 4:
            n, m, c, s = _numbers(" ".join(words[:4]), number)
            coefficients.put(number, _whole(n, number), _whole(m, number), c, s)
        elif key in _GFC_OF_TIME:
            raise GravityFileError(f"line {number}: {key}: changes with time, allowed is a static field")
        elif key:
            raise GravityFileError(f"line {number}: not a gfc line of degree, order, C and S")
    _check_last_line(text, lines)
    return coefficients.field(gm, radius)


def _header_number(header: dict[str, str], names: tuple[str, ...]) -> float:
    value = next((header[name] for name in names if name in header), "")
    try:
        return _float(value)
    except ValueError as error:
        raise GravityFileError(f"{names[0]}: {value[:20] or 'is missing'}: must be a number") from error


def _check_last_line(text: str, lines: Sequence[str]) -> None:
    """Raise GravityFileError if the last line may have lost digits."""
    if not text.endswith("\n") and len(lines) > 2 and len(lines[-1].rstrip()) < len(lines[-2].rstrip()):
        raise GravityFileError(f"line {len(lines)}: is cut: shorter than the row before, and no end of line")


def _numbers(line: str, number: int) -> list[float]:
    try:
        return [_float(word) for word in line.replace(",", " ").split()]
    except ValueError as error:
        raise GravityFileError(f"line {number}: not a row of numbers") from error


def _whole(value: float, number: int) -> int:
    if not 0 <= value <= _DEGREE_MAX or value != int(value):
        raise GravityFileError(f"line {number}: {value:g} is not a degree or order, allowed 0 to {_DEGREE_MAX}")
    return int(value)


def _float(word: str) -> float:
    """Return the number; Fortran writes D for E."""
    return float(word.replace("D", "E").replace("d", "e"))


_READERS = {".gfc": _read_gfc, ".cof": _read_cof, ".tab": _read_shadr, ".sha": _read_shadr}
