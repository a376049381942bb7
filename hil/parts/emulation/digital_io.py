"""Emulator of the coupler on Modbus TCP, with safety relay, emergency stop and interlocks."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

from hil.config.tables.io import Io
from hil.core.clock import BenchClock
from hil.drivers.io import NAME
from hil.drivers.io.codec import Image, LineMap, respond
from hil.drivers.io.relay import HoldingBrakes, SafetyRelay
from hil.maths.random_streams import stream
from hil.parts.emulation.fault_injection import Faults, FaultyWire
from hil.parts.emulation.modbus_tcp import ModbusTcpEmulator, ModbusTcpPort
from hil.parts.emulation.shared_state import ChainState

STEP_S: Final = 0.004  # between two updates of the relay, as BenchClock.paced_s
IDENTITY: Final = ("hil", "io-coupler", "1.0")
_HEADER: Final = struct.Struct(">HHHB")  # transaction, protocol 0, length with the device id, device id
_ID_BYTES: Final = 1
_BUSY: Final = 6  # exception code
_LONGEST: Final = 254  # bytes after the length field

PublishChain = Callable[[ChainState, float], None]
"""Receives the state of the chain, and the bench time, s."""


class EmulatedCoupler:
    """The coupler with the relay and contacts wired to it. Times are bench time, s.

    pump_timeout_s: longest time between two edges of the charge pump with which the relay stays closed.
    """

    def __init__(self, config: Io, pump_timeout_s: float) -> None:
        self.map = LineMap(config)
        self.faults = Faults(NAME, ("wire", "io"), tuple(self.map.interlocks))
        coils, inputs = dict.fromkeys(self.map.coils, False), dict.fromkeys(self.map.inputs, False)
        self.image = Image(coils, inputs, IDENTITY)
        self.relay = SafetyRelay(pump_timeout_s, config.torque_delay_s)
        self._brakes = HoldingBrakes(0.5 * config.torque_delay_s)
        self._other_pump = False
        self.advance(0.0)

    @property
    def thrusters(self) -> tuple[bool, ...]:
        """The thrusters' lines."""
        return tuple(self.image.coils[address] for address in self.map.thrusters)

    def advance(self, now_s: float) -> ChainState:
        """Update relay and inputs; return the state of the chain."""
        image, lines = self.image, self.map
        released = self.faults.value("estop") is None
        open_now = {name for name in lines.interlocks if self.faults.value("interlock", name) is not None}
        pump, enable = (image.coils[address] for address in lines.coils[:2])
        if self.faults.value("pump_ignored") is not None:
            pump = self._other_pump = not self._other_pump
        permitted = self.faults.value("local_enable_off") is None
        closed = self.relay.update(now_s, pump, enable, released and not open_now, permitted)
        released_brakes = closed and (lines.brakes is None or image.coils[lines.brakes])
        released_brakes = released_brakes or self.faults.value("brakes_open") is not None
        brakes_closed = self._brakes.update(now_s, released_brakes)
        if self.faults.value("freeze") is None:
            if lines.brakes_closed is not None:
                image.inputs[lines.brakes_closed] = brakes_closed
            if lines.local_enable is not None:
                image.inputs[lines.local_enable] = permitted
            image.inputs[lines.estop] = released
            image.inputs[lines.chain] = closed
            for name, address in lines.interlocks.items():
                image.inputs[address] = name not in open_now
        return ChainState(closed, self.relay.torque(now_s), released_brakes, bytes(self.thrusters) if closed else b"")

    def respond(self, request: bytes, now_s: float) -> bytes:
        """Return the response (PDU) to a request (PDU)."""
        self.advance(now_s)
        if self.faults.value("freeze") is not None:  # requests are accepted, the lines do not change
            frozen = Image(dict(self.image.coils), self.image.inputs, self.image.identity)
            return respond(frozen, request)
        response = respond(self.image, request)
        self.advance(now_s)
        return response


class IoEmulator(ModbusTcpEmulator):
    """A coupler on 127.0.0.1, port by the system; calls ``publish`` with the chain's state every 4 ms.

    If bench time runs faster than real time, these are wall time, and the relay waits for the charge pump as long, in
    wall time, as it does in real time: emulator and pump are programs of this computer.
    """

    def __init__(self, config: Io, clock: BenchClock, publish: PublishChain, seed: int = 0) -> None:
        super().__init__(clock, clock.paced_s(STEP_S))
        self._publish = publish
        self._device_id = config.device_id
        self._chance = stream(seed, "wire", "coupler")
        self.coupler = EmulatedCoupler(config, clock.paced_s(config.pump_timeout_s))
        self.faults = self.coupler.faults
        self.port = ModbusTcpPort(self._feed, FaultyWire(self.faults, stream(seed, "wire")), clock)
        self._ports.append(self.port)
        publish(ChainState(False, False, False), clock.now_s())

    def start(self) -> dict[str, str]:
        """Listen; return ``{"io": "host:port"}``."""
        self._listen()
        return {NAME: self.port.address}

    def _step(self) -> None:
        now_s = self._clock.now_s()
        self._publish(self.coupler.advance(now_s), now_s)

    def _feed(self, data: bytes) -> tuple[int, list[bytes]]:
        """Return the number of bytes consumed and the responses; ConnectionError for data that is not Modbus TCP."""
        used = 0
        responses: list[bytes] = []
        while len(data) - used >= _HEADER.size:
            transaction, protocol, length, device_id = _HEADER.unpack_from(data, used)
            if protocol != 0 or not _ID_BYTES < length <= _LONGEST:
                raise ConnectionAbortedError("not Modbus TCP")
            end = used + _HEADER.size - _ID_BYTES + length
            if len(data) < end:
                break
            request, used = data[used + _HEADER.size : end], end
            if device_id == self._device_id and self.faults.value("link_down") is None:
                now_s = self._clock.now_s()
                is_busy = self._chance.random() < (self.faults.value("busy") or 0.0)
                response = bytes((request[0] | 0x80, _BUSY)) if is_busy else self.coupler.respond(request, now_s)
                self._publish(self.coupler.advance(now_s), now_s)
                is_odd = self._chance.random() < (self.faults.value("odd_frames") or 0.0)
                unit = self.faults.value("other_unit")
                unit_id = device_id if unit is None else round(unit)
                responses.append(_HEADER.pack(transaction, is_odd, len(response) + _ID_BYTES, unit_id) + response)
        return used, responses
