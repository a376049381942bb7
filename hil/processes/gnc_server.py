"""GNC server: the built-in GNC in a process, or on a computer, of its own (``hil gnc``).

It answers each input with the output that ``hil run`` would have computed in that cycle. Lost inputs are bridged by
the newest sample of the IMU; after a longer gap, and for another bench, the filters restart.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from hil.config.scenario import Scenario
from hil.core.gnc_records import GNC_INPUT, GncMode, GncOrder, GncState
from hil.core.messages import COMMAND, IMU, MAX_POSES, NAVIGATION, POSE, REFERENCE, Event, new
from hil.errors import LinkLost, LinkTimeout
from hil.frmn.link import PORT_CLOSED, Arrival, Link
from hil.frmn.mailboxes import GNC_FILTERS, GNC_FLIGHT, Role
from hil.frmn.udp import Address, shown
from hil.frmn.wire import Refusal
from hil.gnc_backends import udp_records
from hil.maths.arrays import copy_into
from hil.setup.assembly import make_gnc
from hil.setup.gnc_setup import gnc_setup

_OFFERS: Final = ("gnc.flight", "gnc.output", "gnc.filters")
_WANTS: Final = ("gnc.setup", "gnc.input")
_SILENT_S: Final = 0.35  # wall time after which another bench is accepted
_BRIDGED_S: Final = 1.2  # of consecutive lost inputs: less than the filters' memory of 64 steps at 50 Hz
_SILENCES_REPORTED: Final = 3  # further ones are only counted
_SLICE_S: Final = 0.05
_SILENT_CYCLES: Final = 3  # in real time without an input, after which the bench is reported as silent
_NEEDED: Final = ("step_s", "n_thrusters", "thruster_position_m", "thruster_force_N", "mass_kg", "inertia_kgm2")
"""Fields of GNC_SETUP that must agree between bench and GNC: the chaser."""


def gnc_side(name: str, bind: Address | None, peer: Address | None) -> Link:
    """Return the GNC's side of the link. bind: address where it waits for a bench. peer: the bench that it contacts."""
    return Link(Role.GNC, name, _OFFERS, _WANTS, bind, peer, _SILENT_S)


@dataclass
class GncServerStats:
    """Statistics of a GNC server: reason of its end, and counters."""

    end: str = ""
    setups: int = 0
    steps: int = 0
    bridged: int = 0
    """Steps for lost inputs."""
    restarts: int = 0
    """Restarts of the filters, after gaps too long to bridge."""
    silences: int = 0
    """Silences of the bench during a run, longer than three cycles."""
    filters: list[str] = field(default_factory=list)
    """Events of the filter monitor: NIS and, if enabled, the shadow filter."""
    compute_us: list[float] = field(default_factory=list)
    """Time of each step, from the input to the output."""

    def as_json(self, link: Link) -> dict[str, Any]:
        """Return the statistics with the link's counters."""
        us = np.array(self.compute_us)
        percentiles = {
            name: float(np.percentile(us, share)) if len(us) else None
            for name, share in (("p50", 50.0), ("p99", 99.0), ("max", 100.0))
        }
        return {
            "end": self.end,
            "setups": self.setups,
            "steps": self.steps,
            "bridged": self.bridged,
            "restarts": self.restarts,
            "silences": self.silences,
            "filters": self.filters,
            "compute_us": percentiles,
            **link.counters(),
            "refused": list(link.complaints),
        }


class GncServer:
    """Serves the bench at the other end of ``link`` with the GNC of ``scenario``. announce: receives lines of text."""

    def __init__(self, scenario: Scenario, link: Link, announce: Callable[[str], None] = lambda _: None) -> None:
        self.link = link
        self.stats = GncServerStats()
        self._scenario = scenario
        self._announce = announce
        self._expected = gnc_setup(scenario)
        self._n = int(self._expected.n_thrusters)
        self._setup = b""
        self._joined = 0  # link.joined of the bench whose setup is in use
        self._fault = ""
        self._last = -1  # last cycle stepped
        self._imu, self._reference = new(IMU), new(REFERENCE)
        self.poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
        self.arrived = 0
        self._inputs, self._flights = np.zeros(1, GNC_INPUT), np.zeros(1, GNC_FLIGHT)
        self._filters = np.zeros(1, GNC_FILTERS)
        self._input = self._inputs.view(np.recarray)[0]
        self._input_bytes = self._inputs.view(np.uint8).data
        self._out = self._flights.view(np.recarray)[0]
        self._filter_record = self._filters.view(np.recarray)[0]
        start = GNC_FLIGHT.fields["command"][1] if GNC_FLIGHT.fields else 0
        self._command_bytes = self._flights.view(np.uint8).data[start : start + COMMAND.itemsize]
        self._command_before = b""  # command of the previous cycle
        self._aborting = False
        self._restart()
        self._warm_up()

    def serve(self, patience_s: float) -> GncServerStats:
        """Answer until the bench disconnects; return the statistics.

        patience_s: wall time without a bench after which LinkTimeout is raised, or LinkLost if there was one.
        """
        last_rx_s = time.monotonic()
        silent_after_s = _SILENT_CYCLES * self._scenario.step_s
        silent = False
        while True:
            left_s = last_rx_s + silent_after_s - time.monotonic()
            self.link.wait(min(_SLICE_S, left_s) if left_s > 0.0 else _SLICE_S)
            self.link.service()
            arrivals = self.link.poll()
            for arrival in arrivals:
                self._receive(arrival)
            now_s = time.monotonic()
            peer = self.link.peer
            if peer is not None and peer.gone not in (None, PORT_CLOSED) and self.stats.setups:
                self.stats.end = peer.gone or ""
                return self.stats
            if arrivals:
                if silent and self.stats.silences <= _SILENCES_REPORTED:
                    self._announce("the bench sends again")
                last_rx_s, silent = now_s, False
            elif self._is_running and not silent and now_s - last_rx_s >= silent_after_s:
                silent = True
                self.stats.silences += 1
                if self.stats.silences <= _SILENCES_REPORTED:
                    self._announce(f"the bench has been silent for {1e3 * (now_s - last_rx_s):.0f} ms")
            self._check_silence(now_s - last_rx_s, patience_s)

    @property
    def _is_running(self) -> bool:
        """Whether the bench's last message was an input of a running loop."""
        return self._joined > 0 and self._input.mode == GncMode.RUNNING

    def _check_silence(self, silent_s: float, patience_s: float) -> None:
        refusal = self.link.refusal
        if refusal is not None and refusal[0] in (Refusal.VERSION, Refusal.MAILBOXES):
            raise LinkLost("dss", f"refuses: {refusal[1]}")
        if silent_s <= patience_s:
            return
        peer = self.link.peer
        if peer is not None:
            raise LinkLost("dss", f"{shown(peer.address)} has been silent for {silent_s:.1f} s")
        text = f"; refused: {refusal[1]}" if refusal is not None else ""
        raise LinkTimeout("dss", f"no bench has answered within {patience_s:g} s{text}")

    def _receive(self, arrival: Arrival) -> None:
        if arrival.name == "gnc.setup":
            self._receive_setup(arrival.record)
            return
        if self._joined != self.link.joined:
            return  # from a bench that has not sent its setup
        self._input_bytes[:] = arrival.record.view(np.uint8).data
        if self._input.mode == GncMode.RUNNING and not self._fault:
            self._run(int(self._input.cycle))
        else:
            self._send_state(int(self._input.cycle))

    def _receive_setup(self, record: np.ndarray) -> None:
        """Restart for another bench or another setup; report the state of this GNC in any case."""
        setup = record.tobytes()
        if self._joined != self.link.joined or setup != self._setup:
            self._setup, self._joined = setup, self.link.joined
            self.stats.setups += 1
            self._fault = self._difference(record.view(np.recarray)[0])
            self._restart()
            assert self.link.peer is not None
            where = f"the bench at {shown(self.link.peer.address)}"
            self._announce(f"{where}: {self._fault}" if self._fault else f"set up by {where}")
        self._send_state(-1)

    def _difference(self, setup: np.record) -> str:
        """Return how the bench's chaser differs from this GNC's, "" if it does not."""
        for name in _NEEDED:
            ours, theirs = np.asarray(self._expected[name]), np.asarray(setup[name])
            if not np.array_equal(ours, theirs):
                shown_values = f" ({theirs} there, {ours} here)" if ours.ndim == 0 else ""
                return f"setup differs in {name}{shown_values}"
        return ""

    def _restart(self) -> None:
        """Restart filters and control."""
        self._gnc = make_gnc(self._scenario)
        self._gnc.watch.events.subscribe(self._on_filter_event)
        self._last = -1
        self._not_before_s = -math.inf
        self._out.navigation, self._out.command = new(NAVIGATION), new(COMMAND)

    def _on_filter_event(self, event: Event) -> None:
        text = f"{event.t_s:.2f} s {event.source}: {event.text}"
        self.stats.filters.append(text)
        self._announce(text)

    def _send_state(self, cycle: int) -> None:
        """Answer while the loop is open: with the state of this GNC only."""
        output = self._out.output
        output.cycle, output.direct, output.estimate = cycle, 1, 0
        output.state = GncState.FAULT if self._fault else GncState.WORKING
        output.text = self._fault.encode()[:64]
        output.force = output.torque = 0
        output.on = 0
        self.link.send("gnc.output", output)

    def _run(self, cycle: int) -> None:
        """Do the step of the input, or repeat the last output."""
        begun_s = time.perf_counter()
        if cycle <= self._last:
            if cycle == self._last:
                if self._input.orders & GncOrder.ABORT and not self._aborting:
                    self._control_again()
                self._send()
            return
        gap = cycle - self._last - 1
        if self._last >= 0 and gap * self._scenario.step_s > _BRIDGED_S:
            self.stats.restarts += 1
            self._announce(f"{gap} inputs were lost: the filters restart")
            self._restart()
        if self._last < 0 < cycle:
            self._join_at(cycle)
        arrived = udp_records.hear_input(self._input, self._not_before_s, self._imu, self._reference, self.poses)
        if self._last >= 0:
            self._bridge(gap)
        self.arrived = arrived
        out = self._out
        self._gnc.navigate(self._imu, self, out.navigation)
        self._command_before = bytes(self._command_bytes)
        self._gnc.control(out.navigation, self._reference, out.command)
        udp_records.tell_output(cycle, out.navigation, out.command, self._n, out.output)
        out.output.text = b""
        self._last = cycle
        self._aborting = bool(self._input.orders & GncOrder.ABORT)
        self._send()
        self.stats.steps += 1
        self.stats.compute_us.append(1e6 * (time.perf_counter() - begun_s))

    def _control_again(self) -> None:
        """Repeat control in the same cycle with a new reference, after the approach monitor has started an abort."""
        self._aborting = True
        udp_records.hear_input(self._input, self._not_before_s, self._imu, self._reference, self.poses)
        self._command_bytes[:] = self._command_before
        self._gnc.control(self._out.navigation, self._reference, self._out.command)
        udp_records.tell_output(self._last, self._out.navigation, self._out.command, self._n, self._out.output)

    def _join_at(self, cycle: int) -> None:
        """Start the filters in the middle of a run: with its step numbers, without older poses."""
        self._gnc.state.fusion.cycle = cycle
        self._gnc.cycle = cycle - 1
        self._not_before_s = (cycle - 0.5) * self._scenario.step_s

    def _bridge(self, gap: int) -> None:
        """Step the filters over lost inputs; control is not stepped, because no thruster opened."""
        self.arrived = 0
        for _ in range(gap):
            self._gnc.navigate(self._imu, self, self._out.navigation)
        self.stats.bridged += gap

    def _send(self) -> None:
        if self._gnc.fused_now:
            udp_records.tell_filters(self._last, self._gnc.state.fusion.filters, self._filter_record)
            self.link.send("gnc.filters", self._filters)
        self.link.send("gnc.flight", self._flights)

    def _warm_up(self) -> None:
        """Call each kernel once, so that nothing compiles while a bench waits for an output."""
        udp_records.hear_input(self._input, self._not_before_s, self._imu, self._reference, self.poses)
        self._gnc.navigate(self._imu, self, self._out.navigation)
        self._gnc.control(self._out.navigation, self._reference, self._out.command)
        udp_records.tell_output(0, self._out.navigation, self._out.command, self._n, self._out.output)
        udp_records.tell_filters(0, self._gnc.state.fusion.filters, self._filter_record)
        copy_into(self._imu.rate_C, np.zeros(3))
        self._restart()
