"""Turntable of up to six CiA 402 drives on one CAN bus, cyclic synchronous position mode."""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from hil.config.rig import Cia402, GimbalAxis, RotaryAxes
from hil.core.clock import BenchClock
from hil.core.messages import Array, AxisFeedback, Homing
from hil.drivers.base import full_names
from hil.drivers.cyclic_exchange import CyclicAxisGroup
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.can_port import CanPort
from hil.drivers.turntable.cia402.eds import Eds
from hil.drivers.turntable.cia402.node import Node
from hil.drivers.turntable.cia402.setup import DriveSetup, PortNetwork
from hil.errors import BadInput, DeviceError, LinkTimeout

_RESPONSE_S: Final = 0.04  # bench time within which the responses to one SYNC are valid
_WATCHDOG_S: Final = 0.5  # drives make a quick stop without setpoints for longer
_OLD_FRAMES_WALL_S: Final = 0.005
_CONTROL_EVERY: Final = 5  # exchanges: the controlword is repeated, in case a frame was lost


class Cia402Link:
    """The bus and its nodes. A cycle is a setpoint PDO each and a SYNC; a feedback PDO of each responds.

    Feedback is stamped with the bench time of the SYNC, when the drives sample. Raises BadInput if
    the drives' EDS lacks objects that the driver needs.
    """

    def __init__(self, device: str, config: RotaryAxes, wire: Cia402, clock: BenchClock) -> None:
        self.device = device
        self.axis_names = full_names(device, config.axis_names)
        self._wire = wire
        self._timeout_s = config.timeout_s
        self._clock = clock
        self._scale = wire.counts_per_turn
        axes: list[GimbalAxis] = [getattr(config, name) for name in config.axis_names]
        ids = [wire.node_ids[axis] for axis in config.axis_numbers]
        self._eds = Eds.of(wire, homing=any(axis.encoder == "incremental" for axis in axes))
        self.has_profiles = self._eds.has_profiles
        self.jogging = False
        self._nodes = [
            Node(name, node_id, config, axis, wire, clock)
            for name, node_id, axis in zip(self.axis_names, ids, axes, strict=True)
        ]
        self._handlers = {
            base + node.node_id: handler
            for node in self._nodes
            for base, handler in (
                (codec.TPDO1_ID, node.on_feedback),
                (codec.TPDO2_ID, node.on_status),
                (codec.EMCY_ID, node.on_emergency),
                (codec.HEARTBEAT_ID, node.on_heartbeat),
            )
        }
        self._port: CanPort | None = None
        self._receiving = False
        self._passive = False  # profiled move: setpoints are not passed on
        self._stopped = False
        self._slow_steps: deque[Callable[[], None]] = deque()
        self._exchanges = 0
        self._lost = 0

    def open(self) -> AxisFeedback:
        """Set all drives up and enable them; return their positions."""
        self._port = CanPort(self.device, self._wire, self._clock)
        self._exchanges = self._lost = 0
        self._passive = self._stopped = self._receiving = False
        self._slow_steps.clear()
        try:
            return self._set_up(self._port)
        except DeviceError:
            with contextlib.suppress(DeviceError):  # the first error is raised
                self.quick_stop()
            self.close()
            raise

    def _set_up(self, port: CanPort) -> AxisFeedback:
        network = PortNetwork(port)
        port.send((codec.NMT_ID, bytes((codec.NMT_PRE_OPERATIONAL, 0))))
        for node in self._nodes:
            setup = DriveSetup(port, network, node.node_id, node.name, self._eds, self._on_other, self._clock)
            node.set_up(setup, self._timeout_s, _WATCHDOG_S)
            node.protocol_errors = node.surplus = 0
        port.send((codec.NMT_ID, bytes((codec.NMT_START, 0))))
        counts = [node.enable() for node in self._nodes]
        end_s = self._clock.host_s() + _OLD_FRAMES_WALL_S
        while (left_s := end_s - self._clock.host_s()) > 0.0:  # statuswords from before all were enabled
            port.receive(left_s)
        for node, position in zip(self._nodes, counts, strict=True):
            node.reset(position)
        self._receiving = True
        return self._feedback(self._clock.now_s())

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Send setpoints and SYNC of one cycle, receive the responses."""
        port = self._open_port()
        self._take_pending(port)
        self._run_slow_step(port)
        controls = [node.control() for node in self._nodes] if self._exchanges % _CONTROL_EVERY == 0 else []
        self._exchanges += 1
        if self._passes_setpoints():
            for node, angle, speed in zip(self._nodes, position, rate, strict=True):
                node.target = codec.counts_from_rad(angle, self._scale)
                node.offset = codec.counts_from_rad(speed, self._scale)
        setpoints = [node.setpoint() for node in self._nodes]
        for node in self._nodes:
            node.answered = False
        port.send(*controls, *setpoints, (codec.SYNC_ID, b""))
        return self._collect(port, self._clock.now_s())

    def home(self) -> None:
        """Start homing of the drives that are not homed."""
        for node in self._nodes:
            if node.homing is not Homing.DONE:
                node.homing = Homing.UNDER_WAY
                self._slow_steps.append(node.begin_homing)

    def move_to(self, position: Array, rate: Array) -> None:
        """Start profiled moves to position (n,), rad, at most at rate (n,), rad/s."""
        self._passive = True
        for node, angle, speed in zip(self._nodes, position, rate, strict=True):
            goal = codec.counts_from_rad(angle, self._scale), codec.counts_from_rad(speed, self._scale)
            self._slow_steps.append(partial(node.begin_profile, *goal))

    def _run_slow_step(self, port: CanPort) -> None:
        """Run one slow step, of one drive: the setpoints of the others must not be delayed for long."""
        for node in self._nodes:
            if node.homing_is_over:
                self._slow_steps.append(node.end_homing)
        if self._slow_steps and not self._stopped:
            self._slow_steps.popleft()()
            self._send_controlwords(port)

    def quick_stop(self) -> None:
        """Send the quick-stop controlword to all nodes and repeat it from now on."""
        self._stopped = True
        for node in self._nodes:
            node.controlword = codec.QUICK_STOP
            node.offset = 0
        if self._port is not None:
            self._send_controlwords(self._port)

    def disable(self) -> None:
        """Send the controlword that switches the voltage off to all nodes, and repeat it from now on."""
        self._stopped = True
        for node in self._nodes:
            node.controlword = codec.DISABLE_VOLTAGE
        if self._port is not None:
            self._send_controlwords(self._port)

    def close(self) -> None:
        """Let the nodes leave operation, which stops drives that still move, and let go of the bus."""
        port, self._port = self._port, None
        if port is None:
            return
        with contextlib.suppress(DeviceError):  # the bus may be gone
            port.send((codec.NMT_ID, bytes((codec.NMT_STOP, 0))))
        port.close()

    def counters(self) -> dict[str, int]:
        """Return exchanges, lost (not answered by all drives in time), protocol_errors, late, skipped_bytes.

        late: responses received when none was due, including repeated ones; a PDO has no number.
        """
        return {
            "exchanges": self._exchanges,
            "lost": self._lost,
            "protocol_errors": sum(node.protocol_errors for node in self._nodes),
            "late": sum(node.surplus for node in self._nodes),
            "skipped_bytes": self._port.skipped_bytes if self._port else 0,
        }

    def _open_port(self) -> CanPort:
        if self._port is None:
            raise LinkTimeout(self.device, "is not open")
        return self._port

    def _passes_setpoints(self) -> bool:
        if self._stopped or self._passive:
            return False
        return self.jogging or all(node.homing is Homing.DONE for node in self._nodes)

    def _send_controlwords(self, port: CanPort) -> None:
        port.send(*(node.control() for node in self._nodes))

    def _take_pending(self, port: CanPort) -> None:
        while (frame := port.receive(0.0)) is not None:
            self._handle(*frame)

    def _collect(self, port: CanPort, sync_s: float) -> AxisFeedback | None:
        end_s = sync_s + _RESPONSE_S
        while not self._all_answered() and (left_s := end_s - self._clock.now_s()) > 0.0:
            frame = port.receive(left_s / self._clock.speed)
            if frame is not None:
                self._handle(*frame)
        if not self._all_answered():
            self._take_pending(port)  # the responses may have arrived while this thread was suspended
        complete = self._all_answered()
        now_s = self._clock.now_s()
        for node in self._nodes:
            node.check_silence(now_s)
            node.answered = True  # later responses are late
        if not complete:
            self._lost += 1
            return None
        return self._feedback(sync_s)

    def _all_answered(self) -> bool:
        return all(node.answered for node in self._nodes)

    def _feedback(self, sampled_s: float) -> AxisFeedback:
        turn = codec.rad_from_counts(1, self._scale)
        return AxisFeedback(
            sampled_s,
            np.array([node.position for node in self._nodes]) * turn,
            np.array([node.velocity for node in self._nodes]) * turn,
            tuple(node.homing for node in self._nodes),
            tuple(node.limit for node in self._nodes),
        )

    def _handle(self, identifier: int, data: bytes) -> None:
        handler = self._handlers.get(identifier)
        if handler is not None:
            handler(data)

    def _on_other(self, identifier: int, data: bytes) -> None:
        """Receive a frame while waiting for an SDO response."""
        if self._receiving:
            self._receiving = False  # no second transfer inside the first one
            try:
                if identifier & 0x780 != codec.EMCY_ID and identifier & 0x780 != codec.TPDO2_ID:
                    self._handle(identifier, data)
            finally:
                self._receiving = True


class Cia402Turntable(CyclicAxisGroup):
    """Turntable on CAN; ``config.cia402`` names interface, channel, nodes, counts per turn and EDS. Raises BadInput."""

    def __init__(self, config: RotaryAxes, clock: BenchClock, name: str = "turntable") -> None:
        if config.cia402 is None or config.cia402.channel is None:
            raise BadInput.single("rig", "turntable.cia402.channel", "is missing: the wire to the device")
        super().__init__(config, clock, Cia402Link(name, config, config.cia402, clock), name)
