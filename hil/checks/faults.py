"""Checks of a scenario's faults and further sensors against its vehicle, its GNC, and the rig."""

from __future__ import annotations

from collections import Counter

from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.faults import TERMS, TimedFault
from hil.core.messages import MAX_FAULTS
from hil.dynamics.thruster_faults import DELAY_STEPS_MAX
from hil.errors import Problem
from hil.params.sensors import MONITOR, sensors_of

KEY, DELAY_KEY = "faults", "chaser.thrusters.errors.delay_s"


def check_faults(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each fault of a device that vehicle or rig does not have, or that is out of its range."""
    faults = scenario.value.faults
    problems = []
    for index, fault in enumerate(faults):
        if text := _why_not(fault, scenario.value, rig.value):
            problems.append(Problem(scenario.where(KEY), f"{KEY}[{index}]", text))
    tables = Counter("sensor" if fault.family == "monitor" else fault.family for fault in faults)
    for family, count in tables.items():
        if count > MAX_FAULTS:
            text = f"{count} of {family}: at most {MAX_FAULTS} are allowed"
            problems.append(scenario.problem(KEY, text))
    longest_s, delay_s = DELAY_STEPS_MAX * scenario.value.sample_s, scenario.value.chaser.thrusters.errors.delay_s
    if delay_s > longest_s:
        text = f"{delay_s:g}: at most {DELAY_STEPS_MAX} steps of the truth are kept, {longest_s:g} s"
        problems.append(scenario.problem(DELAY_KEY, text))
    return problems


def _why_not(fault: TimedFault, scenario: Scenario, rig: Rig) -> str:
    if fault.at_s > scenario.duration_s:
        return f"at_s = {fault.at_s:g}: the run ends at {scenario.duration_s:g} s"
    thrusters = len(scenario.chaser.thrusters.position_m)
    if fault.family == "thruster" and fault.number >= thrusters:
        return f'device = "{fault.device}": the chaser has thruster.1 to thruster.{thrusters}'
    if fault.family == "thruster" and fault.kind == "delay":
        longest_s = DELAY_STEPS_MAX * scenario.sample_s
        if fault.values[0] > longest_s:
            return (
                f"value = {fault.values[0]:g}: at most {DELAY_STEPS_MAX} steps of the truth are kept, {longest_s:g} s"
            )
    if fault.family == "monitor" and scenario.monitor.source == "none":
        return 'device = "monitor": the scenario has no docking monitor, monitor.source is "none"'
    if fault.family == "axis" and rig.kind != "mock":
        names = ", ".join(family for family in TERMS if family != "axis")
        return f'device = "{fault.device}": axes have faults on the mock rig only; on {rig.name}: {names}'
    return ""


def unfused_sensors(scenario: Loaded[Scenario], gnc: str) -> list[Problem]:
    """Return a problem for each sensor to be fused by a GNC that receives none. gnc: its name."""
    text = f"not available: {gnc} receives no measurements of further sensors"
    return [
        scenario.problem(f"sensors.{name}", text)
        for name, config in scenario.value.sensors.items()
        if config.use == "fusion"
    ]


def check_sensors(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each sensor that GNC or rig cannot use: none is left out without notice."""
    value, problems = scenario.value, []

    def problem(key: str, text: str) -> None:
        problems.append(scenario.problem(f"sensors.{key}", text))

    modules = sensors_of(value)
    if (words := rig.value.flight_computer.command_words) != "none":
        problems += unfused_sensors(scenario, f"rig.flight_computer.command_words = {words}")
    if MONITOR in value.sensors:
        problem(MONITOR, "is the name of the docking monitor, table [monitor]")
    for name, config in value.sensors.items():
        sensor = modules[name].kind
        rate_hz = config.rate_hz or sensor.module.rate_hz
        if config.rate_hz is not None and rate_hz * value.step_s > 1.0 + 1e-9:
            problem(f"{name}.rate_hz", f"{rate_hz:g}: at most one measurement per cycle, {1.0 / value.step_s:g}")
        oldest_s = config.latency_s + 2.0 * value.step_s
        if oldest_s > value.gnc.navigation.memory_s:
            memory_s = value.gnc.navigation.memory_s
            problem(f"{name}.latency_s", f"{config.latency_s:g}: the filters remember {memory_s:g} s, two cycles more")
        if config.source == "udp" and rig.value.host.time == "lock_step" and sensor.module.sees != "bench":
            problem(f"{name}.source", '"udp": in lock-step only of what sees the bench, this sensor sees the truth')
        if config.source == "model" and rig.value.kind == "hardware" and sensor.module.sees == "bench":
            if sensor.module.wire is None:
                problem(f"{name}.source", '"model": would measure a bench that it does not see; on hardware "udp"')
            elif (line := rig.value.sensors.get(name)) is None or line.port is None:
                key = f"sensors.{name}.port"
                problems.append(Problem(rig.where(key), f"rig.{key}", "is missing: the serial port of the sensor"))
            elif config.stamp != "receipt":
                text = 'must be "receipt": a line was measured latency_s before it was sent'
                problem(f"{name}.stamp", text)
    for index, fault in enumerate(value.faults):
        if fault.family == "sensor" and fault.kind not in modules[fault.member].kind.module.faults:
            names = ", ".join(modules[fault.member].kind.module.faults)
            text = f'kind = "{fault.kind}": {modules[fault.member].config.kind} has {names}'
            problems.append(Problem(scenario.where("faults"), f"faults[{index}]", text))
    return problems
