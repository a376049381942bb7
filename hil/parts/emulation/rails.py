"""Emulator of the rails: up to six drives on Modbus TCP, or on one serial line, with servo dynamics."""

from __future__ import annotations

import threading
from typing import Any, Final

from hil.config.rig import LinearAxes
from hil.config.tables.wires import ModbusRtu
from hil.core.clock import BenchClock
from hil.drivers.rails.codec import DriveIdentity, RegisterMap
from hil.drivers.rails.drive import tcp_axes
from hil.errors import FaultKind
from hil.parts.emulation.emulated_axes import STEP_S, EmulatedAxes
from hil.parts.emulation.fault_injection import FaultyChannel, FaultyWire
from hil.parts.emulation.modbus_server import DriveAccess, EmulatedRailDrive, ModbusServer
from hil.parts.emulation.modbus_tcp import ModbusTcpEmulator, ModbusTcpPort
from hil.parts.emulation.pty_line import PtyLine
from hil.parts.emulation.shared_state import SharedAxisState

FIRMWARE: Final = (1, 0)
_SILENCE_S: Final = 0.02  # much longer than between the bytes of one request, also on a busy host
_PTY_BITS_PER_BYTE: Final = 10  # as PtyLine counts them


class EmulatedRails:
    """The drives, independent of the wire. axes: further arguments of ``EmulatedAxes``."""

    def __init__(
        self, config: LinearAxes, clock: BenchClock, shared: SharedAxisState, name: str = "rails", **axes: Any
    ) -> None:
        self._clock = clock
        self._map = RegisterMap(config.map)
        self._identity = DriveIdentity(config.map.vendor, max(FIRMWARE, config.map.firmware_min))
        self._axes = EmulatedAxes(name, config, clock, shared, **axes)
        self.faults = self._axes.faults
        self.wire_noise = self._axes.wire_noise
        codes = self._map.code_of(FaultKind.TORQUE_OFF), max(1, config.map.following_error)
        self.drives = [EmulatedRailDrive(self._axes, index, *codes) for index in range(len(config.axes))]

    def server(self, device_ids: dict[int, int], tcp: bool) -> ModbusServer:
        """Return the server of the drives behind one wire. device_ids: device id of each index."""
        drives = {
            device_id: DriveAccess(self.drives[index], self._map, self._clock)
            for index, device_id in device_ids.items()
        }
        return ModbusServer(drives, self._map.encode_identity(self._identity), tcp)

    def advance(self) -> None:
        """Advance axes and drives to the present."""
        now_s = self._clock.now_s()
        self._axes.advance(now_s)
        for name, drive in zip(self._axes.names, self.drives, strict=True):
            code = self.faults.pop("drive_fault", name)
            if code is not None:
                drive.trip(int(code) or self._map.code_of(FaultKind.OTHER))
            drive.supervise(now_s)


class RailsEmulator(ModbusTcpEmulator):
    """Up to six drives on 127.0.0.1, ports by the system; axes of one host and port in the rig file share a port.

    Positions are written to ``shared`` every 4 ms, of wall time above real time, and at each request. Further arguments
    are those of ``EmulatedRails``.
    """

    def __init__(self, config: LinearAxes, clock: BenchClock, shared: SharedAxisState, **kwargs: Any) -> None:
        super().__init__(clock, clock.paced_s(STEP_S))
        self._config = config
        self._rails = EmulatedRails(config, clock, shared, **kwargs)
        self.faults, self.drives = self._rails.faults, self._rails.drives

    def start(self) -> dict[str, str]:
        """Listen; return axis name -> "host:port"."""
        names = [f"{self.faults.device}.{name}" for name in self._config.axis_names]
        groups: dict[object, list[int]] = {}
        axes = tcp_axes(self._config)
        for index, axis in enumerate(axes):
            groups.setdefault(index if axis.port is None else (axis.host, axis.port), []).append(index)
        for group, noise in zip(groups.values(), self._rails.wire_noise.spawn(len(groups)), strict=True):
            server = self._rails.server({index: axes[index].device_id for index in group}, tcp=True)
            wire = FaultyWire(self.faults, noise)
            self._ports.append(ModbusTcpPort(server.feed, wire, self._clock))
        self._listen()
        ports = {index: port for port, group in zip(self._ports, groups.values(), strict=True) for index in group}
        return {name: ports[index].address for index, name in enumerate(names)}

    def _step(self) -> None:
        self._rails.advance()

    def _is_up(self) -> bool:
        return self.faults.value("link_down") is None


class RtuRailsEmulator:
    """Up to six drives on one serial line, a pseudo terminal with the timing of the real line."""

    def __init__(self, config: LinearAxes, clock: BenchClock, shared: SharedAxisState, **kwargs: Any) -> None:
        self._clock = clock
        rtu = config.rtu or ModbusRtu()
        self._rails = EmulatedRails(config, clock, shared, **kwargs)
        self.faults, self.drives = self._rails.faults, self._rails.drives
        self._server = self._rails.server(dict(enumerate(config.ids_of(rtu.device_ids))), tcp=False)
        self._channel = FaultyChannel(self.faults, self._rails.wire_noise)
        baud = round(rtu.baud * _PTY_BITS_PER_BYTE / rtu.bits_per_byte)
        self._line = PtyLine(baud, clock, rtu.adapter_latency_s)

    def start(self) -> dict[str, str]:
        """Return the path of the line."""
        return {self.faults.device: self._line.path}

    def run(self, stop: threading.Event) -> None:
        """Serve the line until ``stop`` is set."""
        data, received_s, step_s, line = b"", 0.0, self._clock.paced_s(STEP_S), self._line
        while not stop.is_set():
            received = line.read(step_s)
            self._rails.advance()
            if received:
                now_s = self._clock.now_s()
                # an incomplete request ends with a silence
                data = received if now_s - received_s > _SILENCE_S else data + received
                received_s = now_s
                used, responses = self._server.feed(data)
                data = data[used:]
                for response in responses:
                    self._channel.put(response, now_s)
            while packets := self._channel.due(self._clock.now_s()):
                for packet in packets:
                    line.write(packet)
                    self._rails.advance()

    def close(self) -> None:
        """Close the line. Idempotent."""
        self._line.close()
