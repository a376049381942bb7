"""Check of the computer's synchronisation by PTP."""

from __future__ import annotations

from hil.checks.clock import ptp_problem
from hil.config.clock import ClockConfig
from hil.drivers.ptp import read_status
from hil.errors import DeviceError
from hil.preflight.check import PreflightCheck


def ptp_check(clock: ClockConfig) -> PreflightCheck:
    """Return state and offset of PTP; a note unless ``clock.ptp_max_offset_us`` requires it."""
    advice = "start ptp4l, and phc2sys for a clock of the network card (docs/how-to/prepare-the-computer.md)"
    try:
        status = read_status(clock.ptp_socket, clock.ptp_domain)
    except DeviceError as error:
        required = clock.ptp_max_offset_us is not None
        return PreflightCheck("PTP", False if required else None, str(error), advice if required else "")
    value = str(status)
    if clock.ptp_max_offset_us is None:
        return PreflightCheck("PTP", None, value)
    problem = ptp_problem(clock)
    return PreflightCheck(
        "PTP", not problem, problem or f"{value}, allowed {clock.ptp_max_offset_us:g} us", advice if problem else ""
    )
