"""Rails in memory."""

from __future__ import annotations

from hil.config.rig import Rails
from hil.drivers.base import RAIL_NAMES
from hil.drivers.mock_axes import MockAxes


class MockRails(MockAxes):
    """Three rails (m, m/s) in simulated time."""

    def __init__(self, config: Rails) -> None:
        super().__init__("rails", RAIL_NAMES, config)
