"""Checks of a rig in lock-step."""

from __future__ import annotations

from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.errors import Problem


def check_lock_step(scenario: Loaded[Scenario], rig: Loaded[Rig], speed: float) -> list[Problem]:
    """Return the problems of a rig whose ``host.time`` is "lock_step". speed: relative to real time, as asked for."""
    if rig.value.host.time != "lock_step":
        return []

    def problem(key: str, text: str) -> Problem:
        return Problem(rig.where(key), f"rig.{key}", text)

    if rig.value.kind == "hardware":
        return [problem("host.time", '"lock_step": hardware does not wait, only an emulated rig can be in lock-step')]
    if rig.value.kind == "mock":
        return [problem("host.time", '"lock_step": a mock rig runs in simulated time, only an emulated one has wires')]
    problems = [
        problem(f"{key}.driver", f'"{table.driver}": reads the wall clock, which lock-step does not have')
        for key, table in rig.value.device_tables().items()
        if table.has_wires and not table.entry.keeps_bench_time(table)
    ]
    if (wire := rig.value.flight_computer.command_words) != "none":
        problems.append(problem("flight_computer.command_words", f'"{wire}": a flight computer reads the wall clock'))
    if scenario.value.monitor.source == "camera":
        where = scenario.where("monitor.source")
        problems.append(Problem(where, "monitor.source", '"camera": a camera reads the wall clock (lock-step)'))
    if speed != 1.0:
        problems.append(Problem("--speed", f"{speed:g}", "in lock-step a rig is as fast as its wires: omit --speed"))
    return problems
