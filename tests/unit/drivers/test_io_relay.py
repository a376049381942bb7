"""The safety relay: what opens it, how fast, and that only a new edge of enable closes it again."""

from __future__ import annotations

import pytest

from hil.drivers.io.relay import DROP_OUT_S, SafetyRelay

PUMP_S = 0.05
STEP_S = 0.001


class Desk:
    """A relay that is looked at every millisecond; the pump toggles every 10 ms while ``pumping``."""

    def __init__(self) -> None:
        self.relay = SafetyRelay(PUMP_S)
        self.t_s = 0.0
        self.pumping = True
        self.enable = False
        self.contacts = True
        self._pump = False
        self._k = 0

    def run(self, seconds: float) -> float:
        """Let time pass; return after how long, s, the relay was first open, or ``seconds``."""
        opened_s = seconds
        start_s = self.t_s
        for _ in range(round(seconds / STEP_S)):
            self._k += 1
            self.t_s = self._k * STEP_S
            if self.pumping and self._k % 10 == 0:
                self._pump = not self._pump
            if not self.relay.update(self.t_s, self._pump, self.enable, self.contacts):
                opened_s = min(opened_s, self.t_s - start_s)
        return opened_s


@pytest.fixture
def desk() -> Desk:
    """Return inputs and outputs whose relay is closed."""
    desk = Desk()
    desk.run(0.1)
    assert not desk.relay.closed
    desk.enable = True
    desk.run(0.1)
    assert desk.relay.closed
    return desk


def test_relay_stays_closed_while_all_is_well(desk: Desk) -> None:
    assert desk.run(5.0) == 5.0


@pytest.mark.parametrize(
    ("what", "longest_s"),
    [("contacts", 0.010), ("enable", 0.010), ("pumping", PUMP_S + 0.010)],
)
def test_relay_opens_in_time_and_only_a_new_edge_of_enable_closes_it(desk: Desk, what: str, longest_s: float) -> None:
    setattr(desk, what, False)
    assert DROP_OUT_S <= desk.run(0.2) <= longest_s
    setattr(desk, what, True)
    desk.run(0.5)
    assert desk.relay.closed == (what == "enable")  # that one is an edge by itself
    desk.enable = False
    desk.run(0.01)
    desk.enable = True
    desk.run(0.01)
    assert desk.relay.closed


@pytest.mark.parametrize("missing", ["contacts", "pumping"])
def test_an_edge_of_enable_closes_nothing_while_something_is_missing(desk: Desk, missing: str) -> None:
    setattr(desk, missing, False)
    desk.run(0.2)
    desk.enable = False
    desk.run(0.01)
    desk.enable = True
    desk.run(0.1)
    setattr(desk, missing, True)
    desk.run(0.2)
    assert not desk.relay.closed


def test_a_pump_that_stands_high_is_as_dead_as_one_that_stands_low(desk: Desk) -> None:
    while not desk._pump:
        desk.run(STEP_S)
    desk.pumping = False
    assert desk.run(0.2) <= PUMP_S + 0.010
