"""Checks of a rig before a run: clock of the computer, lock-step, and calibration file of the drift check."""

from __future__ import annotations

from hil.config.load import Loaded, load_geometry
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.host import ClockConfig
from hil.drivers.ptp import read_status
from hil.errors import BadInput, DeviceError, Problem
from hil.vmu.calibration.files import read_back


def check_clock(rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem if the clock is farther from its PTP master than ``clock.ptp_max_offset_us``.

    A mock rig has no clock that could be synchronised.
    """
    found = "" if rig.value.kind == "mock" else ptp_problem(rig.value.clock)
    key = "clock.ptp_max_offset_us"
    return [Problem(rig.where(key), f"rig.{key}", f"{rig.value.clock.ptp_max_offset_us:g}: {found}")] if found else []


def ptp_problem(clock: ClockConfig) -> str:
    """Return why the clock does not keep the limit of ``clock``, "" if it does, or if there is none."""
    if clock.ptp_max_offset_us is None:
        return ""
    try:
        return read_status(clock.ptp_socket, clock.ptp_domain).problem(1e-6 * clock.ptp_max_offset_us)
    except DeviceError as error:
        return str(error)


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


def check_drift_views(rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems of the drift check that ``rig`` requests, if it does."""
    vmu = rig.value.vmu
    if not vmu.drift_check.views:
        return []
    key = "vmu.drift_check.views"
    if vmu.driver != "cameras":
        text = f'{vmu.drift_check.views}: needs the images of vmu.source = "cameras", allowed 0 without'
        return [Problem(rig.where(key), f"rig.{key}", text)]
    key = "vmu.geometry_file"
    if vmu.geometry_file is None:
        return [Problem(rig.where(key), f"rig.{key}", "is missing: a file of hil calibrate, for vmu.drift_check")]
    try:
        read_back(load_geometry(vmu.geometry_file).value, vmu.geometry_file)
    except BadInput as error:
        return list(error.problems)
    return []
