"""Checks of a scenario's faults against its vehicle and the rig."""

from __future__ import annotations

from collections import Counter

from hil.config.faults import TERMS, TimedFault
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.messages import MAX_FAULTS
from hil.dynamics.thruster_faults import DELAY_STEPS_MAX
from hil.errors import Problem

KEY, DELAY_KEY = "faults", "chaser.thrusters.errors.delay_s"


def check_faults(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each fault of a device that vehicle or rig does not have, or that is out of its range."""
    faults = scenario.value.faults
    found = []
    for index, fault in enumerate(faults):
        if text := _why_not(fault, scenario.value, rig.value):
            found.append(Problem(scenario.where(KEY), f"{KEY}[{index}]", text))
    tables = Counter("sensor" if fault.family == "monitor" else fault.family for fault in faults)
    for family, count in tables.items():
        if count > MAX_FAULTS:
            text = f"{count} of {family}: at most {MAX_FAULTS} are allowed"
            found.append(Problem(scenario.where(KEY), KEY, text))
    longest_s, delay_s = DELAY_STEPS_MAX * scenario.value.sample_s, scenario.value.chaser.thrusters.errors.delay_s
    if delay_s > longest_s:
        text = f"{delay_s:g}: at most {DELAY_STEPS_MAX} steps of the truth are kept, {longest_s:g} s"
        found.append(Problem(scenario.where(DELAY_KEY), DELAY_KEY, text))
    return found


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
