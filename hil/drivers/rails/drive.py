"""Rail drives and their wires: requests are bounded in time, one lost response is retried, errors name the axis."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from typing import Final, TypeVar

from hil.config.rig import LinearAxes, ModbusAxis
from hil.config.tables.wires import ModbusRtu
from hil.core.clock import BenchClock
from hil.core.messages import Homing
from hil.drivers.rails.codec import Command, ControlFlags, RegisterBlock, RegisterMap, State, Status
from hil.drivers.rails.frames import READ_WRITE, Counters
from hil.drivers.rails.modbus_bus import ModbusBus
from hil.errors import DriveFault, LinkTimeout, ProtocolError

CONNECT_TIMEOUT_S: Final = 1.0
ENABLE_TIMEOUT_S: Final = 2.0  # a holding brake takes some 0.1 s to open
STOP: Final = ControlFlags.ENABLE | ControlFlags.QUICK_STOP
OFF: Final = ControlFlags(0)
ATTEMPTS: Final = 2
_ENABLE_POLL_S: Final = 0.005
_RATE_MARGIN: Final = 1.5  # allowed overshoot of the highest rate
_POSITION_MARGIN_M: Final = 0.01  # encoder noise, servo ripple, jitter of the time stamps

_Result = TypeVar("_Result")


@dataclass(frozen=True)
class ModbusDevice:
    """Address of a drive: its bus and device id. attempt_s: bench time for one response."""

    bus: ModbusBus
    device_id: int
    attempt_s: float


class Drive:
    """One drive; requires a running event loop. rate_max_mps: highest rate of its axis."""

    def __init__(
        self, name: str, wire: ModbusDevice, register_map: RegisterMap, rate_max_mps: float, clock: BenchClock
    ) -> None:
        self.name = name
        self.failed = False
        self.sampled_s = 0.0  # bench time of the newest state
        self.measured = 0.0, 0.0, 0.0
        """Bench time, s, position, m, and rate, m/s, of the newest state."""
        self._bus = wire.bus
        self._device_id = wire.device_id
        self._attempt_s = wire.attempt_s
        self._map = register_map
        self._rate_max = rate_max_mps
        self._clock = clock
        self._number = 0
        self._identified = False
        self._last: tuple[float, float] | None = None  # bench time, position

    async def identify(self) -> None:
        """Connect and check the identity of the drive."""
        await self._bus.connect(self.name, CONNECT_TIMEOUT_S)
        registers = await self._twice(lambda: self._read(self._map.identity))
        identity = self._decoded(lambda: self._map.decode_identity(registers))
        if problem := self._map.identity_problem(identity):
            raise ProtocolError(self.name, f"wrong drive at {self._bus.label}: {problem}")
        self._identified = True

    async def enable(self) -> float:
        """Reset faults of an earlier run, enable the drive; return the position that it holds, m."""
        first = await self._twice(self._read_state)
        self._last = self._clock.now_s(), first.position_m
        state = await self.exchange(ControlFlags.FAULT_RESET, first.position_m)
        deadline_s = self._clock.now_s() + ENABLE_TIMEOUT_S
        while True:
            held_m = state.position_m
            state = await self.exchange(ControlFlags.ENABLE, held_m)
            if state.status & Status.FAULT:
                raise self._fault(state.fault)
            if state.status & Status.ENABLED:
                return held_m
            if self._clock.now_s() > deadline_s:
                raise DriveFault(self.name, f"not enabled {ENABLE_TIMEOUT_S:g} s after the command")
            await asyncio.sleep(self._clock.wall_s(_ENABLE_POLL_S))

    async def exchange(
        self,
        control: ControlFlags,
        position_m: float,
        rate_mps: float = 0.0,
        problem: Callable[[State], DriveFault | None] = lambda _: None,
    ) -> State:
        """Write one command and read the following state, in one transaction where the drive has function 23.

        A state with a ``problem``, or with a position that the axis cannot have reached, is read once more, like a lost
        response: TCP carries no checksum of the drive. A state received twice is accepted.
        """
        seen: list[State] = []
        attempts = 0

        async def attempt() -> State:
            nonlocal attempts
            attempts += 1
            state = await self._transact(self._next(control, position_m, rate_mps))
            seen.append(state)
            if attempts < ATTEMPTS and (problem(state) or self._jumped(state, self._last)):
                raise ProtocolError(self.name, "implausible response")
            return state

        state = await self._twice(attempt)
        if self._jumped(state, self._last) and (
            len(seen) < 2 or self._jumped(state, (self.sampled_s, seen[0].position_m))
        ):
            raise ProtocolError(self.name, f"position {state.position_m:.6g} m is implausible: too far from the last")
        self._last = self.sampled_s, state.position_m
        self.measured = self.sampled_s, state.position_m, state.rate_mps
        return state

    def forget_position(self) -> None:
        """Accept any next position: homing moves the zero."""
        self._last = None

    def problem(self, state: State, stopping: bool) -> DriveFault | None:
        """Return why the drive is not in the commanded state, None if it is."""
        if state.status & Status.FAULT:
            return self._fault(state.fault)
        if stopping:
            return None
        if state.status & Status.QUICK_STOP:
            return DriveFault(self.name, "made a quick stop of its own (its watchdog or its stop input)")
        if not state.status & Status.ENABLED:
            return DriveFault(self.name, "switched itself off")
        return None

    async def send(self, control: ControlFlags) -> None:
        """Send STOP or OFF without waiting for a response: the drive may be unable to send one."""
        if self._identified:
            written = self._map.writes(self._next(control, 0.0, 0.0))[-1]  # with the control word
            await self._bus.send(self._device_id, self._map.functions[0], written, self._state_block)

    def _fault(self, code: int) -> DriveFault:
        return DriveFault(self.name, self._map.fault_text(code), self._map.fault_kind(code))

    def _next(self, control: ControlFlags, position_m: float, rate_mps: float) -> Command:
        self._number = (self._number + 1) % self._map.numbers
        return Command(control, self._number, position_m, rate_mps)

    @property
    def _state_block(self) -> tuple[int, int]:
        return self._map.state.address, self._map.state.count

    async def _transact(self, command: Command) -> State:
        echo = None if self._map.echo_at is None else (self._map.echo_at, command.number)
        function, writes = self._map.functions[0], self._map.writes(command)
        if function == READ_WRITE:
            registers = await self._bus.write_and_read(
                self.name, self._device_id, writes[0], self._state_block, echo, self._attempt_s
            )
        else:
            for written in writes:
                await self._bus.write(self.name, self._device_id, function, written, self._attempt_s)
            registers = await self._bus.read(self.name, self._device_id, self._state_block, self._attempt_s, echo)
        self.sampled_s = self._bus.sampled_s
        return self._decoded(lambda: self._map.decode_state(registers))

    async def _read_state(self) -> State:
        registers = await self._read(self._map.state)
        return self._decoded(lambda: self._map.decode_state(registers))

    async def _read(self, block: RegisterBlock) -> list[int]:
        return await self._bus.read(self.name, self._device_id, (block.address, block.count), self._attempt_s)

    async def _twice(self, attempt: Callable[[], Awaitable[_Result]]) -> _Result:
        """Return the result of one of two attempts; raise the error of the second one."""
        try:
            return await attempt()
        except LinkTimeout:
            if not self._bus.tcp and self._map.echo_at is None:
                raise  # a late response would pass for that to the second request
        except ProtocolError:
            pass
        self._bus.counters["retries"] += 1
        try:
            return await attempt()
        except LinkTimeout as error:
            raise LinkTimeout(self.name, f"no answer within {ATTEMPTS * self._attempt_s:.3g} s, asked twice") from error

    def _decoded(self, decode: Callable[[], _Result]) -> _Result:
        try:
            return decode()
        except ValueError as error:
            self._bus.counters["protocol_errors"] += 1
            raise ProtocolError(self.name, str(error)) from error

    def _jumped(self, state: State, previous: tuple[float, float] | None) -> bool:
        """Whether the axis cannot have moved there from its ``previous`` position (bench time, m)."""
        if previous is None:
            return False
        path_m = _RATE_MARGIN * self._rate_max * (self._clock.now_s() - previous[0]) + _POSITION_MARGIN_M
        return abs(state.position_m - previous[1]) > path_m or abs(state.rate_mps) > 2.0 * _RATE_MARGIN * self._rate_max


# Waiting for one drive delays the commands of the others: it must stay below their watchdog time.
ATTEMPT_MAX_S: Final = 0.2


def make_wires(config: LinearAxes, timeout_s: float, counters: Counters, clock: BenchClock) -> list[ModbusDevice]:
    """Return the wires of the axes, not connected yet. Requires a running event loop.

    timeout_s: within which a dead wire is reported.
    """
    if config.driver == "modbus_rtu":
        rtu = config.rtu or ModbusRtu()
        line = ModbusBus.on_port(rtu.port or "", rtu, rtu.exchange_s(config.map), counters, clock)
        attempt_s = _attempt_s(timeout_s, len(config.axes))
        return [ModbusDevice(line, device_id, attempt_s) for device_id in config.ids_of(rtu.device_ids)]
    axes = tcp_axes(config)
    hosts = [(axis.host, axis.port or 0) for axis in axes]
    lines = {host: ModbusBus.to_host(*host, counters, clock) for host in dict.fromkeys(hosts)}
    return [
        ModbusDevice(lines[host], axis.device_id, _attempt_s(timeout_s, hosts.count(host)))
        for host, axis in zip(hosts, axes, strict=True)
    ]


def _attempt_s(timeout_s: float, drives: int) -> float:
    """Return the time for one response if ``drives`` share a wire, s.

    On a dead wire each of them waits once before the first one retries and reports the failure.
    """
    return min(timeout_s / (drives + ATTEMPTS - 1), ATTEMPT_MAX_S)


def tcp_axes(config: LinearAxes) -> list[ModbusAxis]:
    """Return the TCP settings of the drives."""
    return [getattr(config.modbus, name, ModbusAxis()) for name in config.axis_names]


class HomingMonitor:
    """Homing state of each axis. Axes with absolute encoders are DONE from the start.

    From ``begin`` an axis is UNDER_WAY until its drive reports homed or failed; "failed" of an earlier homing is
    ignored.
    """

    def __init__(self, config: LinearAxes) -> None:
        self._absolute = [axis.encoder == "absolute" for axis in config.axes]
        self.state = [Homing.DONE if absolute else Homing.NEEDED for absolute in self._absolute]
        self._exchanges = [0] * len(self.state)  # since homing was commanded

    def begin(self) -> None:
        """Start homing of each axis that is not homed."""
        for axis, homing in enumerate(self.state):
            if homing in (Homing.NEEDED, Homing.FAILED):
                self.state[axis] = Homing.UNDER_WAY
                self._exchanges[axis] = 0

    def abort(self) -> None:
        """Abort homing that is under way."""
        for axis, homing in enumerate(self.state):
            if homing is Homing.UNDER_WAY:
                self.state[axis] = Homing.FAILED

    def is_homing(self, axis: int) -> bool:
        """Whether the homing bit must be set in the command."""
        return self.state[axis] is Homing.UNDER_WAY

    def update(self, axis: int, state: State, commanded: bool) -> bool:
        """Update from a state of the drive; return whether its zero has just moved. commanded: homing bit was set."""
        if self._absolute[axis]:
            return False
        previous = self.state[axis]
        if previous is Homing.UNDER_WAY:
            self._exchanges[axis] += commanded
            if not commanded:
                return False
            if state.status & Status.HOMING_FAILED and self._exchanges[axis] > 1:
                self.state[axis] = Homing.FAILED
            elif state.status & Status.HOMED:
                self.state[axis] = Homing.DONE
        elif state.status & Status.HOMED and previous is Homing.NEEDED:
            self.state[axis] = Homing.DONE  # homed in an earlier run, not switched off since
        elif not state.status & Status.HOMED and previous is Homing.DONE:
            self.state[axis] = Homing.NEEDED  # the drive was switched off
        return self.state[axis] is not previous


def limit_switch(status: Status, position_m: float, middle_m: float) -> int:
    """Return the limit switch that is active: -1 low, 1 high, 0 none.

    If the drive reports one without its side, the one nearer to the position is meant.
    """
    if status & Status.LIMIT_LOW:
        return -1
    if status & Status.LIMIT_HIGH:
        return 1
    if status & Status.LIMIT:
        return -1 if position_m < middle_m else 1
    return 0
