"""Units of FMI variables: by the FMU's own definitions, else by their names."""

from __future__ import annotations

import math

import pytest

from hil.parts.fmi.archive import FmuError
from hil.parts.fmi.units import FmiUnit, parse_unit, to_si, unit_of_bases


@pytest.mark.parametrize(
    ("name", "wanted", "factor"),
    [
        ("deg", "rad", math.pi / 180.0),
        ("deg/s", "rad/s", math.pi / 180.0),
        ("mm", "m", 1e-3),
        ("km/h", "m/s", 1000.0 / 3600.0),
        ("mm/s2", "m/s^2", 1e-3),
        ("m.s-2", "m/s^2", 1.0),
        ("m*s^-2", "m/s^2", 1.0),
        ("kg.m2", "kg m^2", 1.0),
        ("g", "kg", 1e-3),
        ("deg^2", "rad^2", (math.pi / 180.0) ** 2),
        ("1", "1", 1.0),
    ],
)
def test_unit_is_read_from_its_name(name: str, wanted: str, factor: float) -> None:
    assert to_si(FmiUnit(None), name, wanted) == pytest.approx((factor, 0.0), rel=1e-15)


def test_definition_of_the_fmu_decides() -> None:
    odd = unit_of_bases({"m": 1}, 1852.0, 5.0)
    assert to_si(odd, "m", "m") == (1852.0, 5.0)  # whatever it is called


def test_radian_counts_as_one_because_tools_disagree() -> None:
    assert to_si(unit_of_bases({"s": -1, "rad": 1}, 2.0, 0.0), "x", "rad/s") == (2.0, 0.0)
    assert to_si(unit_of_bases({"s": -1}, 2.0, 0.0), "x", "rad/s") == (2.0, 0.0)


@pytest.mark.parametrize(("name", "wanted"), [("m", "m/s"), ("s", "m"), ("N", "m/s^2"), ("furlong", "m")])
def test_other_dimension_or_unknown_unit_is_refused(name: str, wanted: str) -> None:
    with pytest.raises(FmuError, match=name):
        to_si(FmiUnit(None), name, wanted)


def test_unit_with_factor_zero_is_refused() -> None:
    with pytest.raises(FmuError, match="factor 0"):
        unit_of_bases({"m": 1}, 0.0, 0.0)


def test_unknown_unit_has_no_exponents() -> None:
    assert parse_unit("N.m.parsec").exponents is None
