"""Declarations of sensor modules, and the check of their kernels."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hil
from hil.config.tables.sensors import by_name
from hil.errors import BadInput
from hil.sensors import check
from hil.sensors.module import checked
from hil.sensors.trial import rehearsed


def module(**changes: Any) -> type[hil.SensorModule]:
    """Return a module of a height above z = 0 of H, with ``changes``."""

    def measure(settings, truth, out):  # type: ignore[no-untyped-def]
        out.sample.value[0] = truth.r_CT_H[2] + settings.sigma_m * truth.normal[0]
        out.sample.covariance[0, 0] = settings.sigma_m**2

    def innovate(settings, estimate, out):  # type: ignore[no-untyped-def]
        out.value[0] = out.sample.value[0] - estimate.r_CT_H[2]
        out.h[0, 2] = 1.0

    given: dict[str, Any] = {
        "kind": "height",
        "components": (hil.Component("height_m", "m"),),
        "settings": (hil.Setting("sigma_m", 0.01, "m", 1e-6, 1.0),),
        "faults": {"no_sample": "at once"},
        "measure": staticmethod(measure),
        "innovate": staticmethod(innovate),
    }
    return type("Height", (hil.SensorModule,), given | changes)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"faults": {}}, "a sensor without a fault hypothesis does not load"),
        ({"faults": {"explodes": "bang"}}, "explodes is no kind of fault"),
        ({"faults": {"offset": " "}}, "offset must state"),
        ({"kind": "two words"}, "must be an identifier"),
        ({"components": ()}, "must be 1 to 6"),
        ({"components": (hil.Component("height", "m"),)}, "must end in its unit, _m"),
        ({"components": (hil.Component("a_m", "m"), hil.Component("a_m", "m"))}, "a_m is declared twice"),
        ({"settings": (hil.Setting("rate_hz", 1.0),)}, "rate_hz is a key of every sensor"),
        ({"errors": (hil.SensorError("bias", 1, "sigma_m"),)}, "bias is of component 1, of 1"),
        ({"errors": (hil.SensorError("bias", 0, "none_m"),)}, "needs the setting none_m"),
        ({"innovate": hil.SensorModule.innovate}, "innovate is missing"),
        ({"sees": "stars"}, 'must be "bench" or "truth"'),
    ],
)
def test_declaration_that_lacks_or_contradicts_something_does_not_load(changes: dict[str, Any], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        checked(module(**changes))


def three_of_six(settings, truth, out):  # type: ignore[no-untyped-def]
    out.sample.value[:] = truth.r_CT_H


def beyond_the_last(settings, truth, out):  # type: ignore[no-untyped-def]
    out.sample.value[int(truth.q_CH[3]) + 8] = 1.0


def undeclared(settings, truth, out):  # type: ignore[no-untyped-def]
    out.sample.value[1] = truth.r_CT_H[0]


@pytest.mark.parametrize(
    ("kernel", "text"),
    [
        (
            three_of_six,
            r"Height\.measure raised ValueError: could not broadcast .* \(test_module_declarations.py, line \d+",
        ),
        (beyond_the_last, r"Height\.measure raised IndexError: index 9 is out of bounds for axis 0 with size 6"),
        (undeclared, r"measure: out\.sample\.value has more components than the module declares, 1"),
    ],
)
def test_kernel_of_another_shape_does_not_fly(kernel: Any, text: str) -> None:
    with pytest.raises(BadInput, match=text):
        rehearsed(checked(module(measure=staticmethod(kernel))))


def test_sound_module_passes_its_check() -> None:
    assert check.problems(checked(module())) == []


def test_wrong_jacobian_is_found_by_differences() -> None:
    def innovate(settings, estimate, out):  # type: ignore[no-untyped-def]
        out.value[0] = out.sample.value[0] - estimate.r_CT_H[2]
        out.h[0, 1] = 1.0

    (line,) = check.problems(checked(module(innovate=staticmethod(innovate))))
    assert line.startswith("innovate: h of height_m by r[1] is 1, by differences 0")


def test_noise_that_is_not_the_stated_one_is_found() -> None:
    def measure(settings, truth, out):  # type: ignore[no-untyped-def]
        out.sample.value[0] = truth.r_CT_H[2] + 3.0 * settings.sigma_m * truth.normal[0]
        out.sample.covariance[0, 0] = settings.sigma_m**2

    (line,) = check.problems(checked(module(measure=staticmethod(measure))))
    assert "noise is not what is stated" in line


def test_covariance_that_is_none_is_found() -> None:
    def innovate(settings, estimate, out):  # type: ignore[no-untyped-def]
        out.value[0] = out.sample.value[0] - estimate.r_CT_H[2]
        out.h[0, 2] = 1.0
        out.noise[0, 0] = -1.0

    (line,) = check.problems(checked(module(innovate=staticmethod(innovate))))
    assert "is no covariance" in line


def test_kernel_that_does_not_compile_names_the_reason() -> None:
    def measure(settings, truth, out):  # type: ignore[no-untyped-def]
        out.sample.value[0] = truth.normals[0]

    text = r"Height\.measure does not compile: a record has no field 'normals', did you mean normal\? \(line \d+\)"
    with pytest.raises(hil.errors.BadInput, match=text):
        check.problems(checked(module(measure=staticmethod(measure))))


def test_kernel_with_a_wrong_type_names_the_operation_and_its_line() -> None:
    def measure(settings, truth, out):  # type: ignore[no-untyped-def]
        out.sample.value[0] = truth.normal

    line = measure.__code__.co_firstlineno + 1
    text = rf"does not compile: numba has no setitem\(nestedarray.* \(line {line}\)$"
    with pytest.raises(hil.errors.BadInput, match=text):
        check.problems(checked(module(measure=staticmethod(measure))))


def test_random_numbers_of_its_own_are_found() -> None:
    def measure(settings, truth, out):  # type: ignore[no-untyped-def]
        out.sample.value[0] = truth.r_CT_H[2] + settings.sigma_m * np.random.randn()
        out.sample.covariance[0, 0] = settings.sigma_m**2

    (line,) = check.problems(checked(module(measure=staticmethod(measure))))
    assert line.startswith("measure: gives another value for the same truth")


def test_two_sensors_of_one_name_and_one_without_a_name_are_refused() -> None:
    with pytest.raises(hil.errors.BadInput, match='name = "a": two sensors have it'):
        by_name([{"kind": "lidar", "name": "a"}, {"kind": "pose", "name": "a"}], "file.toml")
    with pytest.raises(hil.errors.BadInput, match="2: needs a name"):
        by_name([{"kind": "lidar", "name": "a"}, {"kind": "pose"}], "file.toml")
