"""GNC server: the built-in GNC in a process, or on a computer, of its own (``hil gnc``).

The reply to each input is what ``hil run`` would have computed in that cycle. Lost inputs are bridged with the newest
sample of the IMU; after a longer gap, and for another bench, the filters restart.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.core.gnc_records import GncMode, GncOrder, GncState
from hil.core.messages import COMMAND, IMU, MAX_POSES, NAVIGATION, POSE, REFERENCE, Event, new
from hil.core.sensor_records import SENSOR_ARRIVAL
from hil.errors import BadInput, LinkLost, LinkTimeout
from hil.frmn.gnc_input import MEASURED, InputReceiver
from hil.frmn.mailboxes import GNC_FILTERS, GNC_FLIGHT, IMU_SAMPLES_MAX, Role
from hil.frmn.wire import Refusal
from hil.maths.arrays import copy_into
from hil.parts.links import udp_records
from hil.parts.links.link import PORT_CLOSED, Arrival, Link
from hil.parts.links.udp import Address, shown
from hil.session.assembly import make_gnc
from hil.session.gnc_setup import gnc_setup

_OFFERS: Final = ("gnc.flight", "gnc.output", "gnc.filters")
WANTS: Final = ("gnc.setup", "gnc.input")
"""Mailboxes that every GNC receives; those of MEASURED are for GNCs that want them."""
_NO_ARRIVALS: Final = np.zeros(0, SENSOR_ARRIVAL)
_SILENT_S: Final = 0.35  # wall time after which another bench may replace a silent one
_BRIDGED_FRACTION: Final = 0.9375  # of the filters' memory: the longest time of consecutive lost inputs
_SILENCES_LOGGED: Final = 3  # further ones are only counted
_SLICE_S: Final = 0.05
_SILENT_CYCLES: Final = 3  # of wall time without an input, after which the bench counts as silent ...
_SILENT_LEAST_S: Final = 0.06  # ... at least this
_NEEDED: Final = ("step_s", "n_thrusters", "thruster_position_m", "thruster_force_N", "mass_kg", "inertia_kgm2")
"""Fields of GNC_SETUP in which bench and GNC must agree: they describe the chaser."""


def wants_of(scenario: Loaded[Scenario]) -> tuple[str, ...]:
    """Return the mailboxes that the built-in GNC of ``scenario`` receives: with the samples of a faster IMU.

    Raises BadInput if the IMU has more samples per cycle than the link carries.
    """
    n = scenario.value.imu_samples
    if n > IMU_SAMPLES_MAX:
        key, most_hz = "imu.rate_hz", IMU_SAMPLES_MAX / scenario.value.step_s
        text = f"{scenario.value.imu.rate_hz:g}: a GNC on another computer gets at most {most_hz:g} samples per second"
        raise BadInput.single(scenario.where(key), key, text)
    return (*WANTS, *(name for name in MEASURED if n > 1 or name != "imu.samples"))


def gnc_side(
    name: str,
    bind: Address | None,
    peer: Address | None,
    key: bytes | None = None,
    offers: tuple[str, ...] = _OFFERS,
    wants: tuple[str, ...] = WANTS,
) -> Link:
    """Return the GNC's side of the link. bind: address to listen on. peer: the bench. key: None for the user's.

    offers, wants: mailboxes that it sends and receives; ``wants_of`` those of the built-in GNC.
    """
    link = Link(Role.GNC, name, offers, wants, bind, peer, key)
    link.silent_max_s = _SILENT_S
    return link


@dataclass
class GncServerStats:
    """Statistics of a GNC server, and why it ended."""

    end: str = ""
    setups: int = 0
    steps: int = 0
    bridged: int = 0
    """Steps for lost inputs."""
    restarts: int = 0
    """Of the filters, after gaps too long to bridge."""
    silences: int = 0
    """Of the bench during a run, longer than three cycles."""
    filters: list[str] = field(default_factory=list)
    """Events of the filter monitor: NIS and, if it is enabled, the shadow filter."""
    compute_us: list[float] = field(default_factory=list)
    """Of each step: from the input to the reply."""

    def as_json(self, link: Link) -> dict[str, Any]:
        """Return the statistics, including the link's."""
        us = np.array(self.compute_us)
        percentiles = {
            name: float(np.percentile(us, percent)) if len(us) else None
            for name, percent in (("p50", 50.0), ("p99", 99.0), ("max", 100.0))
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
        self._samples: np.ndarray = np.zeros(scenario.imu_samples, IMU)
        self._imu, self._reference = new(IMU), new(REFERENCE)
        self.poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
        self.arrived = 0
        self._receiver = InputReceiver()
        self._input, self._replies = self._receiver.input, np.zeros(1, GNC_FLIGHT)
        self._filters = np.zeros(1, GNC_FILTERS)
        self._out = self._replies.view(np.recarray)[0]
        self._sent_filters = self._filters.view(np.recarray)[0]
        start = GNC_FLIGHT.fields["command"][1] if GNC_FLIGHT.fields else 0
        self._command_bytes = self._replies.view(np.uint8).data[start : start + COMMAND.itemsize]
        self._command_before = b""  # COMMAND before the last decision of control
        self._aborting = False
        self._restart()
        self._warm_up()

    def serve(self, patience_s: float) -> GncServerStats:
        """Reply to inputs until the bench disconnects; return the statistics.

        patience_s: wall time without a bench after which LinkTimeout is raised, or LinkLost if there was one.
        """
        last_rx_s = time.monotonic()
        silent_after_s = max(_SILENT_LEAST_S, _SILENT_CYCLES * self._scenario.step_s)
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
                if silent and self.stats.silences <= _SILENCES_LOGGED:
                    self._announce("the bench sends again")
                last_rx_s, silent = now_s, False
            elif self._is_running and not silent and now_s - last_rx_s >= silent_after_s:
                silent = True
                self.stats.silences += 1
                if self.stats.silences <= _SILENCES_LOGGED:
                    self._announce(f"the bench has been silent for {1e3 * (now_s - last_rx_s):.0f} ms")
            self._check_silence(now_s - last_rx_s, patience_s)

    @property
    def _is_running(self) -> bool:
        """Whether the last input of the bench was one of a run under way."""
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
        if arrival.name in MEASURED:
            self._receiver.add(arrival.name, arrival.record)
            return
        if self._joined != self.link.joined:
            return  # from a bench that has not sent its setup
        self._receiver.take(arrival.record)
        if self._input.mode == GncMode.RUNNING and not self._fault:
            self._run(int(self._input.cycle))
        else:
            self._send_idle(int(self._input.cycle))

    def _receive_setup(self, record: np.ndarray) -> None:
        """Restart for another bench or another setup; reply in any case with the state of this GNC."""
        setup = record.tobytes()
        if self._joined != self.link.joined or setup != self._setup:
            self._setup, self._joined = setup, self.link.joined
            self.stats.setups += 1
            self._fault = self._difference(record.view(np.recarray)[0])
            self._restart()
            assert self.link.peer is not None
            where = f"the bench at {shown(self.link.peer.address)}"
            self._announce(f"{where}: {self._fault}" if self._fault else f"set up by {where}")
        self._send_idle(-1)

    def _difference(self, setup: np.record) -> str:
        """Return the field in which the bench's chaser differs from the scenario's, "" if there is none."""
        for name in _NEEDED:
            ours, theirs = np.asarray(self._expected[name]), np.asarray(setup[name])
            if not np.array_equal(ours, theirs):
                shown_values = f" ({theirs} there, {ours} here)" if ours.ndim == 0 else ""
                return f"setup differs in {name}{shown_values}"
        return ""

    def _restart(self) -> None:
        """Restart filters and control."""
        self._gnc = make_gnc(self._scenario)
        self._gnc.filter_monitor.events.subscribe(self._log_filters)
        self._last = -1
        self._not_before_s = -math.inf
        self._out.navigation, self._out.command = new(NAVIGATION), new(COMMAND)

    def _log_filters(self, event: Event) -> None:
        text = f"{event.t_s:.2f} s {event.source}: {event.text}"
        self.stats.filters.append(text)
        self._announce(text)

    def _send_idle(self, cycle: int) -> None:
        """Reply while the loop is open: the state of this GNC, without demands."""
        output = self._out.output
        output.cycle, output.direct, output.estimate = cycle, 1, 0
        output.state = GncState.FAULT if self._fault else GncState.WORKING
        output.text = self._fault.encode()[:64]
        output.force = output.torque = 0
        output.on = 0
        self.link.send("gnc.output", output)

    def _run(self, cycle: int) -> None:
        """Compute the reply to an input, or repeat the last one."""
        begun_s = time.perf_counter()
        if cycle <= self._last:
            if cycle == self._last:
                if self._input.orders & GncOrder.ABORT and not self._aborting:
                    self._control_again()
                self._send()
            return
        gap = cycle - self._last - 1
        if self._last >= 0 and gap * self._scenario.step_s > _BRIDGED_FRACTION * self._scenario.gnc.navigation.memory_s:
            self.stats.restarts += 1
            self._announce(f"{gap} inputs were lost: the filters restart")
            self._restart()
        if self._last < 0 < cycle:
            self._join_at(cycle)
        arrived = self._read_input()
        if self._last >= 0:
            self._bridge(gap)
        self.arrived = arrived
        self._gnc.set_sensor_arrivals(self._arrivals())
        out = self._out
        self._navigate(None if self._last < 0 or gap else out.command, cycle)
        self._command_before = bytes(self._command_bytes)
        self._actuate(cycle)
        out.output.text = b""
        self._last = cycle
        self._aborting = bool(self._input.orders & GncOrder.ABORT)
        self._send()
        self.stats.steps += 1
        self.stats.compute_us.append(1e6 * (time.perf_counter() - begun_s))

    def _control_again(self) -> None:
        """Repeat the decision of control in the same cycle: an abort on the estimate has changed the reference."""
        self._aborting = True
        self._read_input()
        self._command_bytes[:] = self._command_before
        self._actuate(self._last)

    def _read_input(self) -> int:
        """Write IMU, reference and poses from the input; return the number of poses."""
        return int(udp_records.read_input(self._input, self._not_before_s, self._imu, self._reference, self.poses))

    def _arrivals(self) -> np.ndarray:
        """Return the measurements of further sensors in the input, (n,) of SENSOR_ARRIVAL."""
        n = int(self._input.measured.n_measurements)
        arrivals = np.zeros(n, SENSOR_ARRIVAL)
        arrivals["sample"] = self._input.measured.measurements[:n]
        return arrivals

    def _actuate(self, cycle: int) -> None:
        """Run control on the present estimate and write the reply to the input ``cycle``."""
        out = self._out
        self._gnc.actuate(out.navigation, self._reference, out.command)
        udp_records.write_output(cycle, out.navigation, out.command, self._n, out.output)

    def _navigate(self, command: np.record | None, cycle: int = -1) -> None:
        """Run the filters over the cycle before ``cycle``, or over a lost one: by the newest mean of the IMU.

        The mean stands for each sample that is missing. command: of that cycle, None if the samples are not its own.
        """
        samples, measured, n = self._samples, self._input.measured, len(self._samples)
        samples["rate_C"], samples["force_C"] = self._imu.rate_C, self._imu.force_C
        if n > 1 and cycle >= 0 and measured.n_samples == n:
            samples["rate_C"] = measured.samples["rate_radps"][:n]
            samples["force_C"] = measured.samples["force_mps2"][:n]
        self._gnc.navigate(self._samples, self, self._out.navigation, command)

    def _join_at(self, cycle: int) -> None:
        """Start the filters in the middle of a run: their steps take its cycle numbers, older poses are discarded."""
        self._gnc.state.navigation.fusion.cycle = cycle * len(self._samples)
        self._gnc.state.navigation.t_s = cycle * self._scenario.step_s
        self._gnc.cycle = cycle - 1
        self._not_before_s = (cycle - 0.5) * self._scenario.step_s

    def _bridge(self, gap: int) -> None:
        """Carry the filters over lost inputs: their thrusters never opened, so control is not run."""
        self.arrived = 0
        self._gnc.set_sensor_arrivals(_NO_ARRIVALS)
        for _ in range(gap):
            self._navigate(None)
        self.stats.bridged += gap

    def _send(self) -> None:
        if self._gnc.fused_now:
            udp_records.write_filters(self._last, self._gnc.state.navigation.fusion, self._sent_filters)
            self.link.send("gnc.filters", self._filters)
        self.link.send("gnc.flight", self._replies)

    def _warm_up(self) -> None:
        """Call each kernel once: nothing compiles while a bench waits for an answer."""
        self._read_input()
        self._navigate(self._out.command)
        self._navigate(None)
        self._actuate(0)
        udp_records.write_filters(0, self._gnc.state.navigation.fusion, self._sent_filters)
        copy_into(self._imu.rate_C, np.zeros(3))
        self._restart()
