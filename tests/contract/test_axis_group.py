"""One contract for every backend of rails and turntable: mocks, and drivers against their emulators."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, AsciiTurntableLine, Cia402, Modbus, ModbusAxis, Rails, Turntable
from hil.core.clock import SimulatedClock, WallClock
from hil.drivers.base import AxisGroup, Jogs
from hil.drivers.mock_axes import MockAxes
from hil.drivers.rails.driver import ModbusRails
from hil.drivers.rails.emulator import RailsEmulator, RtuRailsEmulator
from hil.drivers.remote.devices import IoLink, RemoteAxes
from hil.drivers.remote.io_layout import IO, IoSharedMemory
from hil.drivers.remote.requests import IoRequests
from hil.drivers.shared_state import SharedAxisState
from hil.drivers.turntable.ascii.driver import AsciiTurntable
from hil.drivers.turntable.ascii.emulator import AsciiTurntableEmulator
from hil.drivers.turntable.cia402.driver import Cia402Turntable
from hil.drivers.turntable.cia402.emulator import Cia402Emulator
from hil.drivers.vmu.mock import MockVmu
from hil.errors import DeviceError, SafetyTrip
from hil.processes.io_server import IoServer

pytestmark = pytest.mark.wires

SPEED = 2.0
RIG = load_rig("emulated").value
RTU_RAILS = load_rig("emulated-rtu").value.rails
GATEWAY = RIG.rails.model_copy(
    update={"modbus": Modbus(**{name: ModbusAxis(port=502, device_id=7 + i) for i, name in enumerate(RAIL_NAMES)})}
)


@dataclass
class Backend:
    """A device on test and how its time passes."""

    device: AxisGroup
    now_s: Callable[[], float]
    pass_time: Callable[[float], None]
    low: np.ndarray
    high: np.ndarray

    def wait_until(self, reached: Callable[[], bool], limit_s: float = 5.0) -> bool:
        """Let bench time pass until ``reached`` or ``limit_s`` is over."""
        end_s = self.now_s() + limit_s
        while self.now_s() < end_s:
            if reached():
                return True
            self.pass_time(0.02)
        return reached()


def _travel(config: Rails | Turntable) -> tuple[np.ndarray, np.ndarray]:
    if isinstance(config, Rails):
        travel = np.array([getattr(config, name).travel_m for name in RAIL_NAMES])
    else:
        travel = np.radians([getattr(config, name).travel_deg for name in GIMBAL_NAMES])
    return travel[:, 0], travel[:, 1]


@contextmanager
def _mock(config: Rails | Turntable) -> Iterator[Backend]:
    clock = SimulatedClock()
    device = MockAxes(config.device, config)

    def pass_time(seconds: float) -> None:
        clock.t_s += seconds

    yield Backend(device, clock.now_s, pass_time, *_travel(config))


@contextmanager
def _on_wires(
    config: Rails | Turntable,
    make_emulator: Callable[..., Any],
    wire: Callable[[dict[str, str]], Rails | Turntable],
    make_driver: Callable[..., AxisGroup],
) -> Iterator[Backend]:
    clock, board, stop = WallClock(speed=SPEED), SharedAxisState.create(), threading.Event()
    emulator = make_emulator(config, clock, board)
    wired = wire(emulator.start())
    thread = threading.Thread(target=emulator.run, args=(stop,))
    thread.start()
    device = make_driver(wired, clock)
    try:
        yield Backend(device, clock.now_s, lambda s: clock.sleep_until(clock.now_s() + s), *_travel(config))
    finally:
        device.close()
        stop.set()
        thread.join(5.0)
        emulator.close()
        board.close()


@contextmanager
def _behind_the_io_process(config: Rails | Turntable) -> Iterator[Backend]:
    """The loop's side over shared memory; the host's work is done in a thread, the drives are mocks."""
    clock, stop = WallClock(speed=SPEED), threading.Event()
    here, there = socket.socketpair()
    memory = IoSharedMemory.create()
    axes: dict[str, AxisGroup] = {
        "rails": MockAxes("rails", RIG.rails),
        "turntable": MockAxes("turntable", RIG.turntable),
    }
    host = IoServer(axes, MockVmu(RIG.vmu, lambda t_s: None), memory, there, clock)
    host.start()
    thread = threading.Thread(target=host.run, args=(stop,))
    thread.start()
    requests = IoRequests(here, IO)
    link = IoLink(IO, memory, requests, clock, lambda: "")
    device = RemoteAxes(config.device, config, link)
    try:
        yield Backend(device, clock.now_s, lambda s: _pass(device, clock, s), *_travel(config))
    finally:
        device.close()
        stop.set()
        thread.join(5.0)
        host.close()
        requests.close()
        memory.close()


def _pass(device: RemoteAxes, clock: WallClock, seconds: float) -> None:
    """Let time pass as a loop does: with a look at the device in each cycle."""
    end_s = clock.now_s() + seconds
    while clock.now_s() < end_s:
        with suppress(DeviceError):
            device.read(clock.now_s())
        clock.sleep_until(min(end_s, clock.now_s() + 0.02))


def _wire_rails(addresses: dict[str, str], rails: Rails = RIG.rails) -> Rails:
    axes = {name: ModbusAxis(port=int(addresses[f"rails.{name}"].rpartition(":")[2])) for name in RAIL_NAMES}
    return rails.model_copy(update={"modbus": Modbus(**axes)})


def _wire_shared(addresses: dict[str, str]) -> Rails:
    """All three drives behind one gateway."""
    port = int(addresses["rails.x"].rpartition(":")[2])
    assert {address.rpartition(":")[2] for address in addresses.values()} == {str(port)}
    axes = {name: ModbusAxis(port=port, device_id=7 + i) for i, name in enumerate(RAIL_NAMES)}
    return RIG.rails.model_copy(update={"modbus": Modbus(**axes)})


def _wire_rtu(addresses: dict[str, str]) -> Rails:
    assert RTU_RAILS.rtu is not None
    wire = {"port": addresses["rails"], "parity": "none"}  # a pseudo terminal has no parity
    return RTU_RAILS.model_copy(update={"rtu": RTU_RAILS.rtu.model_copy(update=wire)})


def _wire_can(addresses: dict[str, str], turntable: Turntable = RIG.turntable) -> Turntable:
    return turntable.model_copy(update={"cia402": Cia402(channel=addresses["turntable"])})


def _ascii(protocol: str, turntable: Turntable = RIG.turntable) -> Any:
    def wired(port: str | None) -> Turntable:
        return turntable.model_copy(
            update={"driver": "ascii", "ascii": AsciiTurntableLine(port=port, protocol=protocol)}
        )

    return _on_wires(
        wired(None), AsciiTurntableEmulator, lambda addresses: wired(addresses["turntable"]), AsciiTurntable
    )


BACKENDS: dict[str, Callable[[], Any]] = {
    "rails-mock": lambda: _mock(RIG.rails),
    "rails-modbus": lambda: _on_wires(RIG.rails, RailsEmulator, _wire_rails, ModbusRails),
    "rails-modbus-gateway": lambda: _on_wires(GATEWAY, RailsEmulator, _wire_shared, ModbusRails),
    "rails-modbus-rtu": lambda: _on_wires(RTU_RAILS, RtuRailsEmulator, _wire_rtu, ModbusRails),
    "turntable-mock": lambda: _mock(RIG.turntable),
    "turntable-cia402": lambda: _on_wires(RIG.turntable, Cia402Emulator, _wire_can, Cia402Turntable),
    "rails-remote": lambda: _behind_the_io_process(RIG.rails),
    "turntable-remote": lambda: _behind_the_io_process(RIG.turntable),
    "turntable-hil-ascii": lambda: _ascii("hil-ascii"),
    "turntable-acu": lambda: _ascii("acu"),
}


def _incremental(config: Rails | Turntable, names: tuple[str, str, str]) -> Any:
    """Return ``config`` with axes that do not know their places when their drives are switched on."""
    return config.model_copy(
        update={name: getattr(config, name).model_copy(update={"encoder": "incremental"}) for name in names}
    )


LOST_RAILS: Rails = _incremental(RIG.rails, RAIL_NAMES)
LOST_TURNTABLE: Turntable = _incremental(RIG.turntable, GIMBAL_NAMES)
LOST_BACKENDS: dict[str, Callable[[], Any]] = {
    "rails-mock": lambda: _mock(LOST_RAILS),
    "rails-modbus": lambda: _on_wires(LOST_RAILS, RailsEmulator, lambda a: _wire_rails(a, LOST_RAILS), ModbusRails),
    "turntable-cia402": lambda: _on_wires(
        LOST_TURNTABLE, Cia402Emulator, lambda a: _wire_can(a, LOST_TURNTABLE), Cia402Turntable
    ),
    "turntable-hil-ascii": lambda: _ascii("hil-ascii", LOST_TURNTABLE),
    "turntable-acu": lambda: _ascii("acu", LOST_TURNTABLE),
}


@pytest.mark.parametrize("name", sorted(LOST_BACKENDS))
def test_axes_that_are_not_homed_move_only_while_they_are_jogged(name: str) -> None:
    with LOST_BACKENDS[name]() as backend:
        device, now_s = backend.device, backend.now_s
        assert isinstance(device, Jogs)
        device.open(now_s())
        start = device.read(now_s()).position

        def creep(backend: Backend) -> bool:
            with suppress(SafetyTrip):
                device.send(start + np.array([0.0, 0.02, 0.0]), np.zeros(3), backend.now_s())
            return abs(device.read(backend.now_s()).position[1] - start[1] - 0.02) < 2e-3

        assert not backend.wait_until(lambda: creep(backend), limit_s=1.0)
        assert np.abs(device.read(now_s()).position - start).max() < 1e-4
        device.set_jogging(True)
        assert backend.wait_until(lambda: creep(backend))
        beyond = device.send(backend.high + 1.0, np.zeros(3), now_s())
        assert np.array_equal(beyond, backend.high + 1.0)  # it does not know where its ends are
        device.stop(now_s())
        device.set_jogging(False)


@pytest.fixture(params=sorted(BACKENDS))
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    with BACKENDS[request.param]() as made:
        yield made


def test_device_is_an_axis_group_and_names_its_axes(backend: Backend) -> None:
    device = backend.device
    assert isinstance(device, AxisGroup)
    assert all(name.startswith(f"{device.name}.") for name in device.axis_names)


def test_nothing_moves_when_a_device_is_opened(backend: Backend) -> None:
    backend.device.open(backend.now_s())
    first = backend.device.read(backend.now_s()).position
    backend.pass_time(0.3)
    assert np.abs(backend.device.read(backend.now_s()).position - first).max() < 1e-5


def test_axes_go_where_they_are_sent_and_stand_there(backend: Backend) -> None:
    device = backend.device
    device.open(backend.now_s())
    target = device.read(backend.now_s()).position + np.array([0.02, -0.03, 0.01])
    rest = np.zeros(3)

    def there() -> bool:
        device.send(target, rest, backend.now_s())
        feedback = device.read(backend.now_s())
        return bool(np.abs(feedback.position - target).max() < 1e-4 and np.abs(feedback.rate).max() < 1e-3)

    assert backend.wait_until(there)


def test_send_returns_what_was_accepted_after_the_travel(backend: Backend) -> None:
    backend.device.open(backend.now_s())
    beyond = np.array([backend.high[0] + 1.0, backend.low[1] - 1.0, backend.high[2] + 1.0])
    accepted = backend.device.send(beyond, np.zeros(3), backend.now_s())
    assert accepted == pytest.approx([backend.high[0], backend.low[1], backend.high[2]])


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_setpoint_that_is_not_finite_is_refused_by_the_axis_name(backend: Backend, bad: float) -> None:
    device = backend.device
    device.open(backend.now_s())
    with pytest.raises(SafetyTrip, match=device.axis_names[1]):
        device.send(np.array([0.0, bad, 0.0]), np.zeros(3), backend.now_s())


def test_feedback_is_of_now(backend: Backend) -> None:
    backend.device.open(backend.now_s())
    backend.pass_time(0.1)
    assert backend.now_s() - backend.device.read(backend.now_s()).t_s < 0.2


def test_stop_brings_moving_axes_to_a_stand_that_later_setpoints_do_not_break(backend: Backend) -> None:
    device = backend.device
    device.open(backend.now_s())
    start = device.read(backend.now_s()).position
    far = start + np.array([0.3, 0.3, 0.3])

    def moving() -> bool:
        device.send(far, np.zeros(3), backend.now_s())
        return bool(np.abs(device.read(backend.now_s()).rate).min() > 0.05)

    assert backend.wait_until(moving)
    device.stop(backend.now_s())
    assert backend.wait_until(lambda: bool(np.abs(device.read(backend.now_s()).rate).max() < 1e-3), 2.0)
    stood = device.read(backend.now_s()).position
    device.send(far, np.zeros(3), backend.now_s())
    backend.pass_time(0.4)
    assert np.abs(device.read(backend.now_s()).position - stood).max() < 1e-3
    assert np.abs(far - stood).min() > 0.01


def test_stop_and_close_may_come_twice_and_in_any_state(backend: Backend) -> None:
    device = backend.device
    device.stop(backend.now_s())
    device.close()
    device.open(backend.now_s())
    device.stop(backend.now_s())
    device.stop(backend.now_s())
    device.close()
    device.close()
    device.stop(backend.now_s())


def test_closed_device_refuses_with_its_name(backend: Backend) -> None:
    device = backend.device
    device.open(backend.now_s())
    device.close()
    with pytest.raises(DeviceError, match=device.name):
        device.read(backend.now_s())
