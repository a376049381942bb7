"""Simulated vehicle on a level floor, in the process of the coupler whose lines fire its thrusters."""

from __future__ import annotations

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.parts.emulation.shared_state import ChainState, SharedAxisState
from hil.session.floating import SimulatedVehicle


class FloatingVehicle:
    """Moves the vehicle of ``rig`` by the coupler's lines and writes its pose to ``board``, as axes that would show it.

    Its kernels are compiled when this returns.
    """

    def __init__(self, scenario: Scenario, rig: Rig, seed: int, board: SharedAxisState) -> None:
        self._board, self._vehicle = board, SimulatedVehicle(scenario, rig, seed)
        warm_up = SimulatedVehicle(scenario, rig, seed)
        warm_up.fire(b"\1", 0.0)
        warm_up.axes_at(0.1)

    def publish(self, chain: ChainState, now_s: float) -> None:
        """Write the state of the chain, and the vehicle at bench time ``now_s``."""
        self._board.write_chain(chain, now_s)
        self._vehicle.fire(chain.thrusters, now_s)
        axes = self._vehicle.axes_at(now_s)
        self._board.write("rails", now_s, axes.rail_m, axes.rail_mps)
        self._board.write("turntable", now_s, axes.gimbal_rad, axes.gimbal_radps)
