"""Turntable of up to six CiA 402 drives on one CAN bus, in cyclic synchronous or interpolated position mode."""

from __future__ import annotations

import contextlib
import math
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Final

import numpy as np

from hil.config.rig import Cia402, GimbalAxis, RotaryAxes
from hil.core.clock import BenchClock
from hil.core.messages import Array, AxisFeedback, Homing
from hil.drivers.base import full_names
from hil.drivers.can_port import CanPort, Frame
from hil.drivers.cyclic_exchange import PERIOD_S, CyclicAxisGroup
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.eds import Eds
from hil.drivers.turntable.cia402.node import Node
from hil.drivers.turntable.cia402.sdo import PortNetwork
from hil.drivers.turntable.cia402.setup import LAG_WALL_S, DriveSetup
from hil.errors import BadInput, DeviceError, LinkTimeout, ProtocolError

_RESPONSE_S: Final = 0.04  # bench time within which the responses to one SYNC are valid
_WATCHDOG_S: Final = 0.5  # drives make a quick stop without setpoints for longer
_ROUNDING: Final = 1e-6
_HELD_EVERY_WALL_S: Final = 0.1
_POLL_WALL_S: Final = 0.005
_DEFERRED_MAX: Final = 100
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
        axes: list[GimbalAxis] = [getattr(config, name) for name in config.axis_names]
        self._eds = Eds.of(wire, homing=any(axis.encoder == "incremental" for axis in axes))
        self.has_profiles = False
        self.jogging = False
        self.period_s = PERIOD_S
        """Time between two exchanges while setpoints arrive."""
        self._nodes = [
            Node(name, node_id, config, axis, wire, clock)
            for name, node_id, axis in zip(self.axis_names, config.ids_of(wire.node_ids), axes, strict=True)
        ]
        self._handlers = {
            base + node.node_id: handler
            for node in self._nodes
            for base, handler in (
                *zip((pdo.identifier for pdo in self._eds.reports), node.report_handlers(self._eds), strict=True),
                (codec.EMCY_ID, node.on_emergency),
                (codec.HEARTBEAT_ID, node.on_heartbeat),
            )
        }
        self._port: CanPort | None = None
        self._receiving = False
        self._passive = False  # profiled move: setpoints are not passed on
        self._stopped = False
        self._slow_steps: deque[Callable[[], bool]] = deque()
        self._deferred: deque[Frame] = deque(maxlen=_DEFERRED_MAX)  # received during a transfer
        self._sync_id = codec.SYNC_ID
        self._exchanges = 0
        self._guarded_s = -math.inf
        self._lost = 0

    def open(self) -> AxisFeedback:
        """Set all drives up and enable them; return their positions."""
        self._port = CanPort(self.device, self._wire, self._clock)
        self._exchanges = self._lost = 0
        self._passive = self._stopped = self._receiving = False
        self._slow_steps.clear()
        self._deferred.clear()
        try:
            return self._set_up(self._port)
        except DeviceError:
            with contextlib.suppress(DeviceError):  # the first error is raised
                self.quick_stop()
            self.close()
            raise

    def _set_up(self, port: CanPort) -> AxisFeedback:
        network = PortNetwork(port)
        self._command_nodes(port, codec.NMT_PRE_OPERATIONAL)
        for node in self._nodes:
            setup = DriveSetup(port, network, node.node_id, node.name, self._eds, self._on_other, self._clock)
            node.set_up(setup, _WATCHDOG_S, self.period_s)
            node.protocol_errors = node.surplus = node.warnings = 0
        setups = [node.setup for node in self._nodes if node.setup is not None]
        # other nodes of the bus do not take an identifier of the bench's own node for SYNC
        own_id = codec.TPDO1_ID + self._wire.master_id
        self._sync_id = own_id if all(setup.set_sync(own_id) for setup in setups) else codec.SYNC_ID
        if self._sync_id != own_id and not all(setup.set_sync(codec.SYNC_ID) for setup in setups):
            raise ProtocolError(self.device, f"object 0x1005: the drives do not take 0x{codec.SYNC_ID:X} as SYNC")
        self.has_profiles = self._eds.has_profiles and all(node.units.has_rates for node in self._nodes)
        if any(node.needs_homing for node in self._nodes):
            self._clock.sleep(LAG_WALL_S)
        for node in self._nodes:
            if node.needs_homing and node.setup is not None:
                node.homing = Homing.DONE if node.setup.is_homed() else Homing.NEEDED
        self._command_nodes(port, codec.NMT_START)
        self._enable(port)
        end_s = self._clock.host_s() + _OLD_FRAMES_WALL_S
        while (left_s := end_s - self._clock.host_s()) > 0.0:  # statuswords from before all were enabled
            port.receive(left_s)
        for node in self._nodes:
            node.reset(node.target)
        self._receiving = True
        return self._feedback(self._clock.now_s())

    def _enable(self, port: CanPort) -> None:
        """Enable all drives together; those that show that they are enabled are held, as their watchdogs require."""
        setups = [node.setup for node in self._nodes if node.setup is not None]
        for setup in setups:
            setup.begin_enabling()
        waiting, held_s = list(self._nodes), -math.inf
        end_s = self._clock.host_s() + self._wire.enable_timeout_s
        while waiting := [node for node in waiting if not node.continue_enabling()]:
            self._guard(port)
            now_s = self._clock.host_s()
            if now_s > end_s and waiting[0].setup is not None:
                raise waiting[0].setup.not_enabled(self._wire.enable_timeout_s)
            if now_s > held_s + _HELD_EVERY_WALL_S:
                held_s = now_s
                enabled = [node for node in self._nodes if node.setup is not None and node.setup.shows_enabled]
                port.send(*(node.setpoint() for node in enabled), (self._sync_id, b""))
            self._clock.sleep(_POLL_WALL_S)

    def facts(self) -> list[str]:
        """Return what the driver uses of the opened drives, a line each."""
        return [node.facts() for node in self._nodes] + [
            f"SYNC 0x{self._sync_id:03X}"
            + (": other nodes of the bus take it too" if self._sync_id == codec.SYNC_ID else " of the bench alone")
        ]

    def _command_nodes(self, port: CanPort, command: int) -> None:
        """Send an NMT command to the nodes of this group, and to no other."""
        port.send(*((codec.NMT_ID, bytes((command, node.node_id))) for node in self._nodes))

    def _guard(self, port: CanPort) -> None:
        """Send the heartbeat of the bench, or guard the nodes, a few times per watchdog time."""
        now_s = self._clock.now_s()
        if now_s - self._guarded_s < _WATCHDOG_S / codec.GUARDS_PER_LIFE:
            return
        self._guarded_s = now_s
        means = {each for node in self._nodes if node.setup is not None for each in node.setup.watchdogs}
        if codec.HEARTBEAT_GUARD in means:
            port.send((codec.HEARTBEAT_ID + self._wire.master_id, bytes((codec.OPERATIONAL,))))
        if codec.LIFE_GUARD in means:
            port.send(*((codec.REMOTE | codec.HEARTBEAT_ID + node.node_id, b"") for node in self._nodes))

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Send setpoints and SYNC of one cycle, receive the responses."""
        port = self._open_port()
        self._take_pending(port)
        self._run_slow_step(port)
        self._guard(port)
        # in turn: few frames at once, as the queue of an interface is short
        controls = [node.control() for k, node in enumerate(self._nodes) if (self._exchanges + k) % _CONTROL_EVERY == 0]
        self._exchanges += 1
        if self._passes_setpoints():
            for node, angle, speed in zip(self._nodes, position, rate, strict=True):
                node.command(angle, speed)
        setpoints = [node.setpoint() for node in self._nodes]
        for node in self._nodes:
            node.answered = False
        port.send(*dict.fromkeys((*controls, *setpoints)), (self._sync_id, b""))
        return self._collect(port, self._clock.now_s())

    def home(self) -> None:
        """Start homing of the drives that are not homed."""
        for node in self._nodes:
            if node.homing is not Homing.DONE:
                node.homing = Homing.UNDER_WAY
                self._slow_steps.append(node.begin_homing)

    def limit_torque(self, axis: int, reduced: bool) -> None:
        """Start to reduce the torque limit of the drive of ``axis``, or to restore it."""
        node = self._nodes[axis]
        node.torque = ""
        self._slow_steps.append(partial(node.limit_torque, reduced))

    def torque_limit(self, axis: int) -> str:
        """Return the result, "" before there is one."""
        return self._nodes[axis].torque

    def move_to(self, position: Array, rate: Array) -> None:
        """Start profiled moves to position (n,), rad, at most at rate (n,), rad/s."""
        self._passive = True
        for node, angle, speed in zip(self._nodes, position, rate, strict=True):
            self._slow_steps.append(partial(node.begin_profile, float(angle), float(speed)))

    def _run_slow_step(self, port: CanPort) -> None:
        """Run one slow step, of one drive: the setpoints of the others must not be delayed for long.

        One that waits for its drive runs again after the others.
        """
        for node in self._nodes:
            if node.take_homing_result():
                self._slow_steps.append(node.end_homing)
        if self._slow_steps and not self._stopped:
            if self._slow_steps[0]():
                self._slow_steps.popleft()
            else:
                self._slow_steps.rotate(-1)
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
        for node in self._nodes:
            node.restore_torque()
        with contextlib.suppress(DeviceError):  # the bus may be gone
            self._command_nodes(port, codec.NMT_STOP)
        port.close()

    def counters(self) -> dict[str, int]:
        """Return exchanges, lost (not answered by all drives in time), protocol_errors, warnings, late, skipped_bytes.

        late: responses received when none was due, including repeated ones; a PDO has no number.
        """
        return {
            "exchanges": self._exchanges,
            "lost": self._lost,
            "protocol_errors": sum(node.protocol_errors for node in self._nodes),
            "warnings": sum(node.warnings for node in self._nodes),
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
        while self._deferred:
            self._handle(*self._deferred.popleft())
        while (frame := port.receive(0.0)) is not None:
            self._handle(*frame)

    def _collect(self, port: CanPort, sync_s: float) -> AxisFeedback | None:
        end_s = sync_s + _RESPONSE_S
        while not self._all_answered() and (left_s := end_s - self._clock.now_s()) > 0.0:
            frame = port.receive(left_s / self._clock.speed)
            if frame is not None:
                self._handle(*frame)
            while self._deferred:
                self._handle(*self._deferred.popleft())
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
        return AxisFeedback(
            sampled_s,
            np.array([node.position / node.units.position for node in self._nodes]),
            np.array([node.rate for node in self._nodes]),
            tuple(node.homing for node in self._nodes),
            tuple(node.limit for node in self._nodes),
        )

    def _handle(self, identifier: int, data: bytes) -> None:
        handler = self._handlers.get(identifier)
        if handler is not None:
            handler(data)

    def _on_other(self, identifier: int, data: bytes) -> None:
        """Receive a frame while waiting for an SDO response; one that may require a transfer waits for its end."""
        if self._receiving:
            self._deferred.append((identifier, data))


class Cia402Turntable(CyclicAxisGroup):
    """Turntable on CAN; ``config.cia402`` names interface, channel, nodes, counts per turn and EDS. Raises BadInput."""

    def __init__(self, config: RotaryAxes, clock: BenchClock, name: str = "turntable") -> None:
        if config.cia402 is None or config.cia402.channel is None:
            raise BadInput.single("rig", "turntable.cia402.channel", "is missing: the wire to the device")
        link = Cia402Link(name, config, config.cia402, clock)
        super().__init__(config, clock, link, name)
        self._drives = link

    def set_period(self, period_s: float) -> None:
        """Expect a setpoint every ``period_s``, from the next ``open`` on; the drives interpolate over that time."""
        least_s = 1.0 / self._config.exchanges_max_hz
        self._drives.period_s = period_s * math.ceil(least_s / period_s - _ROUNDING)

    def facts(self) -> list[str]:
        """Return mode, units and watchdog of each opened drive, a line each."""
        return self._drives.facts()

    def limit_torque(self, axis: int, reduced: bool) -> None:
        """Start to reduce the torque limit of the drive of ``axis``, or to restore it."""
        self._drives.limit_torque(axis, reduced)

    def torque_limit(self, axis: int) -> str:
        """Return what became of that, "" before it is done."""
        return self._drives.torque_limit(axis)
