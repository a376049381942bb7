"""The rate of the exchanges is that of the run, not of what was before it."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.core.messages import CYCLE
from hil.drivers.mock_axes import MockAxes
from hil.parts.wires.meters import ExchangeRates


class CountedAxes(MockAxes):
    """Axes whose drives were exchanged with ``count`` times."""

    count, newest_s = 1000, 40.0

    def exchanges(self) -> tuple[int, float]:
        return self.count, self.newest_s


def test_exchanges_are_counted_from_the_first_cycle_of_the_run() -> None:
    rig = load_rig("mock").value
    rails = CountedAxes("rails", rig.rails)
    rates = ExchangeRates({"rails": rails, "turntable": MockAxes("turntable", rig.turntable)})
    row = np.zeros(1, CYCLE)
    assert rates.numbers() == {}
    for _ in range(101):
        rates.put(row)
        rails.count, rails.newest_s = rails.count + 5, rails.newest_s + 0.02
    found = rates.numbers()
    assert found == {"rails": pytest.approx(250.0)}
