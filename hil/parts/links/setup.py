"""GNC on another computer in a loop: its backend over a link, and the records that the link mirrors to it."""

from __future__ import annotations

from hil.config.scenario import Scenario
from hil.config.tables.host import GncLink
from hil.gnc.estimation.filter_monitor import FilterMonitor
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.params import gnc as gnc_params
from hil.parts.links.link import Link
from hil.parts.links.mirror import Mirror
from hil.parts.links.udp_gnc import UdpGnc
from hil.session.gnc_setup import backend_setup


def make_udp_gnc(scenario: Scenario, link: Link, config: GncLink, lock_step: bool, period_s: float | None) -> UdpGnc:
    """Return the backend of ``scenario`` over ``link``. period_s: wall time of a cycle, None in simulated time."""
    monitor = FilterMonitor(gnc_params.navigation(scenario), None)
    return UdpGnc(link, config, lock_step, period_s, monitor, backend_setup(scenario))


def mirror_to(link: Link, parts: SessionParts, cycles: int = 1) -> None:
    """Let the session of ``parts`` send the other side of ``link`` the mailboxes that it requests.

    cycles: per row that is sent.
    """
    mirror = Mirror(link, cycles)
    parts.layers.append(mirror.over)

    def begin(runner: Runner) -> None:
        modes, rate = runner.safety.modes, runner.rate
        mirror.begin(lambda: modes.mode.value, lambda: rate.overruns)

    parts.on_built.append(begin)
