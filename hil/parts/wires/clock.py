"""Check of a rig's clock: the computer's clock against its PTP master."""

from __future__ import annotations

from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.host import ClockConfig
from hil.drivers.ptp import read_status
from hil.errors import DeviceError, Problem


def check_clock(_: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem if the clock is farther from its PTP master than ``clock.ptp_max_offset_us``.

    A mock rig has no clock that could be synchronised.
    """
    fault = "" if rig.value.kind == "mock" else ptp_problem(rig.value.clock)
    key = "clock.ptp_max_offset_us"
    return [Problem(rig.where(key), f"rig.{key}", f"{rig.value.clock.ptp_max_offset_us:g}: {fault}")] if fault else []


def ptp_problem(clock: ClockConfig) -> str:
    """Return why the clock does not keep the limit of ``clock``, "" if it does, or if there is none."""
    if clock.ptp_max_offset_us is None:
        return ""
    try:
        return read_status(clock.ptp_socket, clock.ptp_domain).problem(1e-6 * clock.ptp_max_offset_us)
    except DeviceError as error:
        return str(error)
