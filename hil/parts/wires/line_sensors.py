"""Samples of sensors on serial wires of a rig."""

from __future__ import annotations

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.sensors import device_of
from hil.core.clock import BenchClock
from hil.drivers.line_sensor.driver import LineSensor, LineSettings
from hil.errors import LinkLost
from hil.params.sensors import sensors_of
from hil.session.sample_sources import wired_sensors


def line_sensors(scenario: Scenario, rig: Rig, clock: BenchClock) -> list[LineSensor]:
    """Return the open ports of the scenario's sensors on ``rig``. clock: bench time. Raises LinkLost."""
    sensors: list[LineSensor] = []
    wired = wired_sensors(scenario, rig)
    try:
        for number, (name, (kind, config, _)) in enumerate(sensors_of(scenario).items()):
            if name in wired and config.source != "udp" and kind.module.wire is not None:
                line = rig.sensors[name]
                settings = LineSettings(line.port or "", line.baud, config.latency_s)
                device = device_of(name)
                sensors.append(LineSensor(device, number, len(kind.components), kind.module.wire, settings, clock))
    except LinkLost:
        for source in sensors:
            source.close()
        raise
    return sensors
