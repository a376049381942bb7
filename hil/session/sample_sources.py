"""Sensors of a scenario whose samples come over wires of a rig."""

from __future__ import annotations

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.params.sensors import sensors_of


def wired_sensors(scenario: Scenario, rig: Rig) -> list[str]:
    """Return the names of the sensors that are on serial wires of ``rig``: all that have a wire, unless it is a mock.

    On hardware those alone that the rig has a port for.
    """
    if rig.kind == "mock":
        return []
    return [
        name
        for name, (kind, _, models) in sensors_of(scenario).items()
        if models and kind.module.wire is not None and (rig.kind == "emulated" or name in rig.sensors)
    ]


def datagram_sensors(scenario: Scenario) -> list[str]:
    """Return the names of the sensors whose samples are datagrams."""
    return [name for name, (_, config, _) in sensors_of(scenario).items() if config.source == "udp"]
