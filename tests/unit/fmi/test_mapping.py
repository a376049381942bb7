"""Elements of arrays by their names, and integers that their type holds."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from hil.core.fields import Field
from hil.gnc_backends.output_texts import whole_text
from hil.parts.fmi.archive import FmuError
from hil.parts.fmi.binary import Fmu
from hil.parts.fmi.description import FmiVariable, ModelDescription
from hil.parts.fmi.mapping import MappedElement, map_record, record_fields
from hil.parts.fmi.plant_model import _Call, _Group

FORCE = FmiVariable("force", 7, "input", "continuous", "Float64", "f8", "Float64", (2, 3), "1 2 3 4 5 6")
SMALL = FmiVariable("level", 8, "input", "discrete", "Int8", "i1", "Int8", (2,), "5 6")
FIELDS = (Field("a", "f8", (), "1", "", "first"), Field("b", "f8", (2,), "1", "", "second"))


def described(*variables: FmiVariable) -> ModelDescription:
    return ModelDescription(3, "m", "m", "t", True, None, False, {each.name: each for each in variables})


def test_element_of_an_array_is_mapped_by_its_name() -> None:
    mapped = {"a": "force[2,1]", "b": ("force[1,3]", "level[2]")}
    found = map_record(described(FORCE, SMALL), FIELDS, mapped, ("input",), "inputs")
    assert [(each.variable.name, each.index) for each in found] == [("force", 3), ("force", 2), ("level", 1)]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("force[3,1]", "force has 2 x 3 elements, counted from 1"),
        ("force[0,1]", "counted from 1"),
        ("force[1]", "force has 2 x 3 elements"),
        ("force[1,1,1]", "force has 2 x 3 elements"),
        ("force[x]", "force has 2 x 3 elements"),
        ("force", "has 6 elements, expected 1"),
        ("forces[1]", r"has no variable 'forces\[1\]'"),
        ("[1]", r"has no variable '\[1\]'"),
    ],
)
def test_element_that_an_array_does_not_have_is_refused(name: str, words: str) -> None:
    with pytest.raises(FmuError, match=words):
        map_record(described(FORCE), FIELDS, {"a": name}, ("input",), "inputs")


def small_call() -> _Call:
    field = record_fields(FIELDS)[0]
    call = object.__new__(_Call)
    call.group = _Group("Int8", [MappedElement(field, 0, SMALL, 1, 1.0, 0.0)])
    call.values = np.zeros(2, "i1")
    return call


def test_elements_that_no_field_has_keep_their_start_values() -> None:
    call = small_call()
    call.put(np.array([100.0, 0.0, 0.0]))
    assert call.values.tolist() == [5, 100]


@pytest.mark.parametrize("value", [300.0, -129.0, 1.5, np.nan])
def test_integer_that_its_type_cannot_hold_is_refused(value: float) -> None:
    """300 became 44."""
    with pytest.raises(FmuError, match=r"^level: .* is no Int8"):
        small_call().put(np.array([value, 0.0, 0.0]))


def test_parameter_that_its_type_cannot_hold_is_refused() -> None:
    fmu = object.__new__(Fmu)
    fmu.description = described(SMALL)
    with pytest.raises(FmuError, match=r"^level: 300, expected Int8"):
        fmu.set_values(0, "Int8", [SMALL], [300])
    assert ctypes.c_int8(300).value == 44


def test_message_of_an_fmu_is_not_cut_at_the_text_of_the_record() -> None:
    message = b"solver: step size below 1e-12 at t = 3.02 s in component chaser.thruster[4]"
    assert whole_text(message[:63] + b"\0", message) == message
    assert whole_text(b"level is not a value of on" + bytes(38), message).startswith(b"level")
    assert whole_text(bytes(64), message) == bytes(64)
