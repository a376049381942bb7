"""A scenario's seat for a GNC at the other end of a link."""

from __future__ import annotations

from hil.config.gnc_link import GncLink
from hil.config.scenario import Scenario
from hil.frmn.link import Link
from hil.frmn.mirror import Mirror
from hil.gnc.filter_monitor import FilterMonitor
from hil.gnc_backends.udp import UdpGnc
from hil.loop.runner import Runner
from hil.params import gnc as gnc_params
from hil.setup.gnc_setup import backend_setup


def remote_gnc(scenario: Scenario, link: Link, config: GncLink, lock_step: bool, period_s: float | None) -> UdpGnc:
    """Return the seat of whoever flies ``scenario`` over ``link``. period_s: wall time of a cycle, None without one."""
    return UdpGnc(
        link,
        config,
        lock_step,
        period_s,
        FilterMonitor(gnc_params.navigation(scenario), None),
        backend_setup(scenario),
    )


def mirror_of(runner: Runner, link: Link) -> Mirror:
    """Return what each cycle of ``runner`` is to be put into, so that the other side gets the cells that it wants."""
    modes, rate = runner.safety.modes, runner.rate
    return Mirror(runner.loop.telemetry, link, lambda: modes.mode.value, lambda: rate.overruns)
