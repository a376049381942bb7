"""GNC backend over UDP: the GNC server of ``hil gnc``, or an external program, on another computer or in a process.

Inputs and replies are mailboxes of the link (``hil/parts/links/link.py``). In lock-step each cycle waits for its reply;
running free it uses the newest one, which belongs to the cycle before. Without a reply the last command is kept for a
cycle or so, then all thrusters are closed; after a few cycles the GNC counts as lost, and the bench is held or stopped
(docs/how-to/two-computers.md). Setpoints follow the truth: late replies cause no jumps.
"""

from __future__ import annotations

import math
import time
from typing import Final

import numpy as np

from hil.config.scenario import Scenario
from hil.config.tables.host import GncLink
from hil.core.gnc_records import GncMode, GncOrder, GncState
from hil.core.messages import IMU, POSE, REFERENCE, TRUTH, Array, Event, new
from hil.core.observable import ObservableList
from hil.errors import LinkLost, LinkTimeout, ProtocolError
from hil.frmn.mailboxes import Role
from hil.gnc import whole_step
from hil.gnc.estimation import navigation
from hil.gnc.estimation.filter_monitor import FilterMonitor
from hil.gnc_backends.base import Poses, Records
from hil.gnc_backends.external import NO_POSES, BackendSetup, ExternalGnc
from hil.params import gnc as gnc_params
from hil.parts.links import udp_records
from hil.parts.links.link import Link
from hil.parts.links.mirror import MIRRORED
from hil.parts.links.udp import Address, shown
from hil.parts.links.udp_receiver import KEPT_CYCLES, CycleBuffer, LinkStats, ReceiveBuffers, ReplyReceiver
from hil.session.gnc_setup import backend_setup

NAME: Final = "gnc"
_OFFERS: Final = ("gnc.setup", "gnc.input", "imu.samples", *MIRRORED)
_WANTS: Final = ("gnc.output", "gnc.flight", "gnc.filters")
_BUSY_S: Final = 0.1  # wall time between two idle cycles after which the bench itself may have been silent
_SILENT_S: Final = 0.35  # wall time after which another GNC may replace a silent one: three heartbeats
_IDLE_S: Final = 0.01  # wall time of a cycle of a hold in simulated time
_A_POSE: Final = np.zeros(1, POSE).view(np.recarray)
_IDLE_IMU: Final = new(IMU)


def gnc_link(name: str, bind: Address | None, peer: Address | None, key: bytes | None = None) -> Link:
    """Return the bench's side of the link. bind: address to listen on. peer: the only GNC that is accepted. key: of
    the link, None for that of the user.

    Raises BadInput if the address cannot be bound.
    """
    link = Link(Role.DSS, name, _OFFERS, _WANTS, bind, peer, key)
    link.silent_max_s = _SILENT_S
    return link


class UdpGnc(ExternalGnc):
    """Exchanges input and output with the GNC at the other end of ``link``.

    period_s: wall time of a cycle; None in simulated time, where lock-step waits without that limit. filter_monitor:
    checks the innovations that a GNC server reports.
    """

    def __init__(
        self,
        link: Link,
        config: GncLink,
        lock_step: bool,
        period_s: float | None,
        filter_monitor: FilterMonitor,
        setup: BackendSetup,
    ) -> None:
        self._buffers = ReceiveBuffers()
        super().__init__(NAME, setup)
        self.output = self._buffers.output
        self.link = link
        self.stats = LinkStats(link, "lock-step" if lock_step else "free-running")
        self.filter_monitor: FilterMonitor = filter_monitor
        self._config = config
        self._lock_step = lock_step
        self._period_s = period_s
        timeout_s = None if period_s is None else config.reply_timeout_fraction * period_s
        self._replies = ReplyReceiver(NAME, link, self._buffers, self.stats, setup.setup, lock_step, timeout_s)
        self._missed = 0  # consecutive cycles
        self._held_since_s: float | None = None
        self._idle_s = self._checked_from_s = -math.inf
        self._sent_orders: tuple[GncOrder, int] = (GncOrder.NONE, -1)  # not replied to yet, and the cycle of sending
        self._reference = new(REFERENCE)
        self._orbit = self.params.navigation.fusion.orbit
        self._past_truth, self._past_imu = CycleBuffer(TRUTH), CycleBuffer(IMU)
        link.complaints.subscribe(self._log_complaint)

    @property
    def event_logs(self) -> tuple[ObservableList[Event], ...]:
        """Lists of events: of the approach, of the GNC and of the filters that it reports."""
        return (*super().event_logs, self.filter_monitor.events)

    @property
    def blocking_reason(self) -> str:
        """Reason why a run on hold cannot be resumed: no GNC, not set up, not working."""
        if not self.link.alive(time.monotonic()):
            return f"{self.name} is silent"
        if not self._replies.is_set_up:
            return f"{self.name} has not answered its setup"
        state = self._replies.state
        if state is not GncState.WORKING:
            return f"{self.name} reports {state.name.lower().replace('_', ' ')}"
        return ""

    def connect(self, patience_s: float) -> str:
        """Wait until a GNC has answered its setup, before anything moves; return its name and address.

        Raises LinkTimeout with the address of this side, ProtocolError for one that lacks a mailbox that it needs.
        """
        give_up_s = time.monotonic() + patience_s
        while not self._replies.is_set_up:
            if time.monotonic() > give_up_s:
                refusal = f"; refused: {self.link.refusal[1]}" if self.link.refusal else ""
                refusal += f"; {self.link.complaints[-1]}" if self.link.complaints else ""
                where = shown(self.link.address)
                raise LinkTimeout(self.name, f"none has answered {where} within {patience_s:g} s{refusal}")
            self._replies.poll(self.cycle)
            self.link.wait(_IDLE_S)
        slots = self.params.navigation.fusion.sensors.slot
        if (slots["enabled"] & (1 - slots["witness"])).any() and "gnc.measurements" not in self.link.peer_wants:
            text = f"{self._peer_name()} does not receive gnc.measurements, and the scenario has sensors to be fused"
            raise ProtocolError(self.name, text)
        return self._peer_name()

    def on_idle_cycle(self, mode: GncMode, bench_s: float) -> None:
        """Send the mode while the loop is open, set up a GNC that has returned, and check for silence."""
        self._replies.poll(self.cycle)
        if self._replies.is_set_up:
            self._send_mode(mode)
        now_s = time.monotonic()
        if now_s - self._idle_s > _BUSY_S:  # the bench was busy and sent nothing itself
            self._checked_from_s = now_s
        self._idle_s = now_s
        if now_s - self._checked_from_s > _SILENT_S and self._config.on_loss == "stop" and not self.link.alive(now_s):
            raise self._lost(f"has been silent for more than {_SILENT_S:g} s")
        if mode is not GncMode.HOLD:
            self._held_since_s = None
            return
        self._held_since_s = self._held_since_s or now_s
        if self.blocking_reason and now_s - self._held_since_s > self._config.reconnect_timeout_s:
            raise self._lost(f"has not returned within {self._config.reconnect_timeout_s:g} s")
        if self._period_s is None:
            self.link.wait(_IDLE_S)

    def step(self, t_s: float, now: Records, inbox: Poses) -> None:
        """Write the reference, exchange input and output, and check the estimate."""
        self._reference, self._held_since_s = now.reference, None
        super().step(t_s, now, inbox)
        if self.approach_state["abort_began"] and self._lock_step and self._missed == 0 and self._buffers.has_flight:
            self._control_again(t_s, now)

    def _control_again(self, t_s: float, now: Records) -> None:
        """Let a GNC server repeat its control with the reference of an abort that has just begun."""
        self.approach_state["abort_began"] = 0
        self._write_input(t_s, GncMode.RUNNING, GncOrder.ABORT, now, None)
        self._replies.used -= 1
        if self.exchange(now.reference):
            self._read_reply(now, t_s)
        else:
            self.on_missing_output(now)

    def exchange(self, reference: np.record | None = None) -> bool:
        """Send the input; bring a reply into ``output``; return False if there is no new one.

        reference: if this cycle's input is sent a second time, the new REFERENCE in it.
        """
        self.link.service()
        if self._lock_step:
            self._send()
            self._replies.wait(self.cycle, self._send_input, reference)
        else:
            self._replies.receive(self.cycle)
            self._send()
        if not self._replies.take():
            return False
        self.stats.used(self.cycle - self._replies.used)
        if self._replies.used >= self._sent_orders[1]:
            self._sent_orders = (GncOrder.NONE, -1)
        return True

    def read_output(self, now: Records, cycle: int, t_s: float) -> None:
        """Write NAVIGATION and COMMAND from the reply that is used in ``cycle``. Raises BenchError."""
        self._missed = 0
        if self._read_reply(now, t_s) and (
            math.isfinite(now.navigation.nis_position) or math.isfinite(now.navigation.nis_attitude)
        ):
            self.filter_monitor.update(self._replies.used, now.samples, _A_POSE, now.navigation, NO_POSES)

    def _read_reply(self, now: Records, t_s: float) -> bool:
        """Write NAVIGATION and COMMAND; return whether they come from a GNC server."""
        super().read_output(now, self._replies.used, t_s)
        if not self._buffers.has_flight or self.output.state != GncState.WORKING:
            return False
        if not udp_records.read_flight(self._buffers.navigation, self._buffers.command, now.navigation, now.command):
            raise ProtocolError(self.name, "its estimate is not finite")
        return True

    def on_missing_output(self, now: Records) -> None:
        """Keep the last command for a while, then close all thrusters; after longer the GNC counts as lost."""
        self._missed += 1
        gone = self.link.peer.gone if self.link.peer is not None else None
        why = gone or ("" if self._replies.is_set_up else "was restarted")
        if not why and (self._missed >= self._config.timeout_cycles or self._period_s is None):
            why = "does not answer" if self._period_s is None else f"has not answered for {self._missed} cycles"
        if self._missed <= self._config.coast_cycles and self._replies.used >= 0 and not why:
            self.stats.coasted += 1
            now.navigation.nis_position = now.navigation.nis_attitude = math.nan
            return
        self.stats.closed += 1
        super().on_missing_output(now)
        if why:
            self._lose(why)

    def watch_approach(self, t_s: float, estimate: np.record, reference: np.record, supervision: np.record) -> None:
        """Check a GNC server as ``hil run`` does, before its first pose as well; others may send no estimate."""
        external = self._missed != 0 or not self._buffers.has_flight
        self._watch_approach(t_s, estimate, reference, supervision, external)

    def consistency(self, truth: np.record, imu: np.record) -> Array:
        """Return NEES of position and attitude filter, (2,), if their states came in this cycle, nan otherwise."""
        self._past_truth.put(self.cycle, truth)
        self._past_imu.put(self.cycle, imu)
        self._nees[:] = np.nan
        of, self._buffers.filters_of = self._buffers.filters_of, -1
        if of >= 0 and 0 <= self.cycle - of < KEPT_CYCLES:
            then = self._past_truth.at(of), self._past_imu.at(of)
            navigation.normalised_errors(self._buffers.filters, self._orbit, *then, self._nees)
        return self._nees

    def close(self) -> None:
        """Send the end of the run."""
        if self._replies.is_set_up:
            self._send_mode(GncMode.STOPPED)
        self.link.close("the run is over")

    def _send_mode(self, mode: GncMode) -> None:
        """Send an input without measurements: the loop is open."""
        t_s = max(0.0, self.cycle * float(self.setup.step_s))
        whole_step.write_input(
            self.cycle, t_s, int(mode), int(GncOrder.NONE), _IDLE_IMU, self._reference, NO_POSES, 0, self.input
        )
        self._send()

    def _write_input(self, t_s: float, mode: GncMode, orders: GncOrder, now: Records, inbox: Poses | None) -> None:
        pending, sent_in = self._sent_orders
        if pending and self.cycle - sent_in >= 2:
            orders |= pending  # the input with it, or the reply to it, was lost
        if orders:
            self._sent_orders = (orders, self.cycle)
        super()._write_input(t_s, mode, orders, now, inbox)

    def _send(self) -> None:
        self.stats.sent(self.cycle)
        self._send_input()

    def _send_input(self) -> None:
        self.link.send_input(self.input)

    def _lose(self, why: str) -> None:
        self.stats.losses += 1
        if self.link.peer is None or self.link.peer.gone:
            self._replies.forget_setup()
        self._replies.state = GncState.STARTING
        if self._config.on_loss == "stop":
            raise self._lost(why)
        self.request_hold(f"{self._peer_name()} {why}")

    def _lost(self, why: str) -> LinkLost:
        return LinkLost(self.name, f"{self._peer_name()} {why}")

    def _peer_name(self) -> str:
        peer = self.link.peer
        if peer is None:
            return "no GNC"
        return f"{peer.hello.name} at {shown(peer.address)}" if peer.hello is not None else shown(peer.address)

    def _log_complaint(self, complaint: str) -> None:
        self.messages.append(Event(max(0.0, self.cycle * float(self.setup.step_s)), "gnc link", complaint))


def make_udp_gnc(scenario: Scenario, link: Link, config: GncLink, lock_step: bool, period_s: float | None) -> UdpGnc:
    """Return the backend of ``scenario`` over ``link``. period_s: wall time of a cycle, None in simulated time."""
    monitor = FilterMonitor(gnc_params.navigation(scenario), None)
    return UdpGnc(link, config, lock_step, period_s, monitor, backend_setup(scenario))
