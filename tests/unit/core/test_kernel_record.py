"""A record for kernels that are called often: the same memory, the same fields, the same compiled kernel."""

from __future__ import annotations

import numpy as np

from hil.core.kernel_record import kernel_record
from hil.core.messages import AXES, CYCLE, new
from hil.loop.core_memory import CycleData


def test_it_is_a_view_of_the_record_and_of_each_of_its_fields() -> None:
    whole = new(CYCLE)
    view = kernel_record(whole)
    view.setpoint.rail_m[1] = 3.0
    view["t_s"] = 0.5
    inner = kernel_record(view.setpoint)
    inner.rail_mps = 1.0, 2.0, 4.0
    assert whole.setpoint.rail_m.tolist() == [0.0, 3.0, 0.0]
    assert whole.t_s == 0.5
    assert whole.setpoint.rail_mps.tolist() == [1.0, 2.0, 4.0]
    assert bytes(view.data) == bytes(whole.data)
    assert bytes(inner.data) == bytes(view.setpoint.data) == bytes(whole.setpoint.data)


def test_its_memory_is_handed_over_without_a_description_of_the_fields() -> None:
    assert kernel_record(new(AXES)).data.format == "B"
    assert CycleData().navigation.data.format == "B"


def test_a_copy_has_memory_of_its_own() -> None:
    view = kernel_record(new(AXES))
    other = view.copy()
    other.rail_m = 1.0, 2.0, 3.0
    assert view.rail_m.tolist() == [0.0, 0.0, 0.0]
    assert bytes(other.data) == np.asarray(other).tobytes()
    assert kernel_record(view).dtype is view.dtype
