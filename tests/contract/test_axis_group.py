"""One contract for every backend of axes, one to six: mocks, and drivers against their emulators."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import (
    LINEAR_NAMES,
    RAIL_NAMES,
    ROTARY_NAMES,
    AsciiTurntableLine,
    AxisGroupTable,
    Cia402,
    HeldAtPlace,
    HeldLinearAxes,
    HeldRotaryAxes,
    Modbus,
    ModbusAxis,
    Rails,
    Turntable,
)
from hil.config.tables.drive_habits import DriveHabits
from hil.config.tables.faults import ErrorTerm
from hil.core.clock import BenchClock, Order, SimulatedClock
from hil.core.messages import Homing
from hil.drivers.axes import ServoAxes
from hil.drivers.base import AxisGroup, Jogs
from hil.drivers.mock_axes import MockAxes
from hil.drivers.remote.devices import IoLink, RemoteAxes
from hil.drivers.remote.io_layout import IO, IoSharedMemory
from hil.drivers.remote.requests import IoRequests
from hil.drivers.split_axes import make_axes
from hil.drivers.vmu.mock import MockVmu
from hil.errors import DeviceError, SafetyTrip
from hil.parts.emulation.fault_injection import Faults
from hil.parts.emulation.shared_state import SharedAxisState
from hil.parts.wires.io_server import IoServer
from tests.support import example_driver
from tests.support.drive_makes import MAKES
from tests.support.lock_step import in_lock_step, serving

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
    faults: Faults | None = None
    """Of the emulator on the other end of a wire."""

    @property
    def rest(self) -> np.ndarray:
        """Rates of axes at rest, (n,)."""
        return np.zeros(len(self.low))

    def wait_until(self, reached: Callable[[], bool], limit_s: float = 5.0) -> bool:
        """Let bench time pass until ``reached`` or ``limit_s`` is over."""
        end_s = self.now_s() + limit_s
        while self.now_s() < end_s:
            if reached():
                return True
            self.pass_time(0.02)
        return reached()


def _name(config: AxisGroupTable) -> str:
    """Return the name of the device: rails, turntable, or that of further axes."""
    return "further" if isinstance(config, HeldAtPlace) else config.device


def _travel(config: AxisGroupTable) -> tuple[np.ndarray, np.ndarray]:
    axes = ServoAxes(config)
    return axes.low, axes.high


@contextmanager
def _mock(config: AxisGroupTable) -> Iterator[Backend]:
    clock = SimulatedClock()
    device = MockAxes(_name(config), config)

    def pass_time(seconds: float) -> None:
        clock.t_s += seconds

    yield Backend(device, clock.now_s, pass_time, *_travel(config))


@contextmanager
def _on_wires(config: AxisGroupTable) -> Iterator[Backend]:
    """The selected drivers against their emulators, all from the registry of drivers; faults of the first."""
    with in_lock_step() as clock, closing(SharedAxisState.create()) as board, ExitStack() as served:
        group = _name(config)
        parts = config.parts(group)
        emulators = [part.make_emulator(clock, board, name=name) for name, part in parts.items()]
        addresses = [address for emulator in emulators for address in emulator.start().items()]
        wired = config.connected(group, dict(addresses))
        for emulator in emulators:
            served.enter_context(serving(clock, emulator))
        with closing(make_axes(wired, clock, group)) as device:
            yield Backend(device, clock.now_s, clock.sleep, *_travel(config), emulators[0].faults)


@contextmanager
def _behind_the_io_process(config: AxisGroupTable) -> Iterator[Backend]:
    """The loop's side over shared memory; the host's work is done in a thread, the drives are mocks."""
    here, there = socket.socketpair()
    name = _name(config)
    memory = IoSharedMemory.create({name: len(config.axes)} if isinstance(config, HeldAtPlace) else {})
    axes: dict[str, AxisGroup] = {name: MockAxes(name, config)}
    with in_lock_step() as clock, closing(memory):
        host = IoServer(axes, MockVmu(RIG.vmu, lambda t_s: None), memory, there, clock)
        host.start()
        with serving(clock, host, Order.IO), closing(IoRequests(here, IO, clock)) as requests:
            link = IoLink(IO, memory, requests, clock, lambda: "")
            with closing(RemoteAxes(name, config, link)) as device:
                yield Backend(device, clock.now_s, partial(_pass, device, clock), *_travel(config))


def _pass(device: RemoteAxes, clock: BenchClock, seconds: float) -> None:
    """Let time pass as a loop does: with a look at the device in each cycle."""
    end_s = clock.now_s() + seconds
    while clock.now_s() < end_s:
        with suppress(DeviceError):
            device.read(clock.now_s())
        clock.sleep_until(min(end_s, clock.now_s() + 0.02))


def _ascii(protocol: str, turntable: Turntable = RIG.turntable, port: str | None = None) -> Turntable:
    return turntable.model_copy(update={"driver": "ascii", "ascii": AsciiTurntableLine(protocol=protocol, port=port)})


def _of_a_make(habits: dict[str, Any]) -> Turntable:
    return RIG.turntable.model_copy(update={"cia402": Cia402(emulated=DriveHabits(**habits))})


def _on_two_controllers(key: str, controller: dict[str, Any]) -> Any:
    """Return the table of the emulated rig with some axes on a further controller."""
    table = getattr(RIG, key)
    return type(table).model_validate(table.model_dump(mode="json") | {"controllers": [controller]}, strict=False)


def _further(key: str, n: int, driver: str, **keys: Any) -> AxisGroupTable:
    """Return the table of ``n`` further axes, those of the emulated rig's x or roll over and over."""
    names, axis, limit = (
        (LINEAR_NAMES, RIG.rails.x, {"travel_m": (-1.0, 9.0), "park_m": 0.0})
        if key == "linear_axes"
        else (ROTARY_NAMES, RIG.turntable.roll, {})
    )
    table = {"driver": driver, "servo": {"gain_per_s": 30.0, "lag_s": 0.006}, **keys}
    table |= dict.fromkeys(names[:n], axis.model_dump(mode="json") | limit)
    table["place_m" if key == "linear_axes" else "place_deg"] = (0.0,) * n
    model = HeldLinearAxes if key == "linear_axes" else HeldRotaryAxes
    found: AxisGroupTable = model.model_validate(table, strict=False)
    return found


def _without(table: AxisGroupTable, *names: str) -> AxisGroupTable:
    """Return what the driver of ``table`` gets if the axes ``names`` are fixed."""
    axis = type(table.axes[0])
    fixed = axis.model_validate(axis.fixed_at(0.0), strict=False)
    (part,) = table.model_copy(update=dict.fromkeys(names, fixed)).parts(table.device).values()
    return part


ONE_AXIS = str(Path(__file__).parent.parent / "support" / "one_axis.toml")
IDS = (11, 12, 13, 14, 15, 16)
WIRED: dict[str, Callable[[], AxisGroupTable]] = {
    "rails-modbus": lambda: RIG.rails,
    "rails-modbus-gateway": lambda: GATEWAY,
    "rails-modbus-rtu": lambda: RTU_RAILS,
    "rails-of-another-package": lambda: load_rig(example_driver.RIG).value.rails,
    "rails-split": lambda: _on_two_controllers("rails", {"axes": ["x"], "driver": "modbus_rtu"}),
    "turntable-split": lambda: _on_two_controllers(
        "turntable", {"axes": ["yaw"], "driver": "cia402", "cia402": {"node_ids": [7, 8, 9]}}
    ),
    "turntable-cia402": lambda: RIG.turntable,
    "turntable-hil-ascii": lambda: _ascii("hil-ascii"),
    "turntable-acu": lambda: _ascii("acu"),
    "two-rails-modbus": lambda: _without(RIG.rails, "z"),
    "one-rail-modbus-rtu": lambda: _without(RTU_RAILS, "x", "y"),
    "yaw-cia402": lambda: _without(RIG.turntable, "roll", "pitch"),
    "yaw-ascii": lambda: _without(_ascii(ONE_AXIS), "roll", "pitch"),
    "one-modbus": lambda: _further("linear_axes", 1, "modbus"),
    "six-modbus": lambda: _further("linear_axes", 6, "modbus"),
    "six-modbus-rtu": lambda: _further("linear_axes", 6, "modbus_rtu", rtu={"device_ids": IDS, "baud": 460_800}),
    "one-cia402": lambda: _further("rotary_axes", 1, "cia402", cia402={}),
    "six-cia402": lambda: _further("rotary_axes", 6, "cia402", cia402={"node_ids": IDS}),
}
OF_ONE_MAKE = {f"cia402, {make}": partial(_of_a_make, habits) for make, habits in MAKES.items()}
WIRED |= OF_ONE_MAKE | {"turntable-acu-tcp": lambda: _ascii("acu", port="tcp://127.0.0.1:0")}
QUICK_MAKES = ("cia402, interpolated position alone", "cia402, lingering bits")
BACKENDS: dict[str, Callable[[], Any]] = {
    "rails-mock": lambda: _mock(RIG.rails),
    "turntable-mock": lambda: _mock(RIG.turntable),
    "rails-remote": lambda: _behind_the_io_process(RIG.rails),
    "turntable-remote": lambda: _behind_the_io_process(RIG.turntable),
    "one-mock": lambda: _mock(_further("rotary_axes", 1, "mock")),
    "six-mock": lambda: _mock(_further("linear_axes", 6, "mock")),
    "six-remote": lambda: _behind_the_io_process(_further("rotary_axes", 6, "mock")),
} | {name: lambda table=table: _on_wires(table()) for name, table in WIRED.items()}


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """Run each test on all backends, or on all axes but the target's of the rig file given by --driver-rig."""
    rig_file = metafunc.config.getoption("--driver-rig", default=None)
    if "wired" in metafunc.fixturenames and rig_file is None:
        marks = {name: [pytest.mark.slow] for name in ("six-modbus-rtu", "six-cia402", *_slow_makes())}
        wired = [pytest.param(table, id=name, marks=marks.get(name, [])) for name, table in WIRED.items()]
        metafunc.parametrize("wired", wired)
        return
    if "wired" in metafunc.fixturenames:
        wired = [pytest.param(lambda each=each: each, id=name) for name, each in _wired_of(rig_file).items()]
        metafunc.parametrize("wired", wired)
        return
    if "backend" not in metafunc.fixturenames:
        return
    if rig_file is None:
        marks = {name: [pytest.mark.slow] for name in _slow_makes()}
        params = [pytest.param(make, id=name, marks=marks.get(name, [])) for name, make in BACKENDS.items()]
        metafunc.parametrize("backend", params, indirect=True)
        return
    made = [pytest.param(partial(_on_wires, table), id=name) for name, table in _wired_of(rig_file).items()]
    metafunc.parametrize("backend", made, indirect=True)


def _slow_makes() -> list[str]:
    return [name for name in OF_ONE_MAKE if name not in QUICK_MAKES]


def _wired_of(rig_file: str) -> dict[str, AxisGroupTable]:
    """Return the tables of all axes on wires, by names, but the target's."""
    groups = load_rig(rig_file).value.axis_groups
    wired = {name: table for name, table in groups.items() if table.has_wires and table.driven and name != "target"}
    return {name: table.parts(name)[name] if len(table.parts(name)) == 1 else table for name, table in wired.items()}


def _incremental(config: AxisGroupTable) -> Any:
    """Return ``config`` with axes without reference positions, near home, when their drives are switched on."""
    axes = {
        name: axis.model_copy(update={"encoder": "incremental", axis.key_of("park"): 0.1})
        for name, axis in zip(config.axis_names, config.axes, strict=True)
    }
    return config.model_copy(update=axes)


LOST_RAILS: Rails = _incremental(RIG.rails)
LOST_TURNTABLE: Turntable = _incremental(RIG.turntable)
LOST_BACKENDS: dict[str, Callable[[], Any]] = {
    "rails-mock": lambda: _mock(LOST_RAILS),
    "rails-modbus": lambda: _on_wires(LOST_RAILS),
    "turntable-cia402": lambda: _on_wires(LOST_TURNTABLE),
    "turntable-hil-ascii": lambda: _on_wires(_ascii("hil-ascii", LOST_TURNTABLE)),
    "turntable-acu": lambda: _on_wires(_ascii("acu", LOST_TURNTABLE)),
    "six-mock": lambda: _mock(_incremental(_further("linear_axes", 6, "mock"))),
    "six-modbus": lambda: _on_wires(_incremental(_further("linear_axes", 6, "modbus"))),
    "six-cia402": lambda: _on_wires(
        _incremental(_further("rotary_axes", 6, "cia402", cia402={"node_ids": IDS, "homing_method": 24}))
    ),
}


@pytest.mark.parametrize("name", sorted(LOST_BACKENDS))
def test_all_axes_are_homed_together_and_then_follow_their_setpoints(name: str) -> None:
    with LOST_BACKENDS[name]() as backend:
        device, now_s = backend.device, backend.now_s
        device.open(now_s())
        assert set(device.read(now_s()).homing) == {Homing.NEEDED}
        device.home(now_s())
        assert backend.wait_until(lambda: set(device.read(now_s()).homing) == {Homing.DONE}, limit_s=60.0)
        goal = device.read(now_s()).position + 0.02

        def there() -> bool:
            device.send(goal, backend.rest, now_s())
            return bool(np.abs(device.read(now_s()).position - goal).max() < 1e-3)

        assert backend.wait_until(there)


@pytest.mark.parametrize("name", sorted(LOST_BACKENDS))
def test_axes_that_are_not_homed_move_only_while_they_are_jogged(name: str) -> None:
    with LOST_BACKENDS[name]() as backend:
        device, now_s = backend.device, backend.now_s
        assert isinstance(device, Jogs)
        device.open(now_s())
        start = device.read(now_s()).position
        ahead = backend.rest
        ahead[-2] = 0.02

        def creep(backend: Backend) -> bool:
            with suppress(SafetyTrip):
                device.send(start + ahead, backend.rest, backend.now_s())
            return bool(np.abs(device.read(backend.now_s()).position - start - ahead).max() < 2e-3)

        assert not backend.wait_until(lambda: creep(backend), limit_s=1.0)
        assert np.abs(device.read(now_s()).position - start).max() < 1e-4
        device.set_jogging(True)
        assert backend.wait_until(lambda: creep(backend))
        beyond = device.send(backend.high + 1.0, backend.rest, now_s())
        assert np.array_equal(beyond, backend.high + 1.0)  # the positions of its ends are unknown
        device.stop(now_s())
        device.set_jogging(False)


@pytest.fixture
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    with request.param() as made:
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
    start = device.read(backend.now_s()).position
    target = start + np.resize([0.02, -0.03, 0.01], len(start))

    def there() -> bool:
        device.send(target, backend.rest, backend.now_s())
        feedback = device.read(backend.now_s())
        return bool(np.abs(feedback.position - target).max() < 1e-4 and np.abs(feedback.rate).max() < 1e-3)

    assert backend.wait_until(there)


def test_send_returns_what_was_accepted_after_the_travel(backend: Backend) -> None:
    backend.device.open(backend.now_s())
    up = np.arange(len(backend.low)) % 2 == 0
    beyond = np.where(up, backend.high + 1.0, backend.low - 1.0)
    accepted = backend.device.send(beyond, backend.rest, backend.now_s())
    assert accepted == pytest.approx(np.where(up, backend.high, backend.low))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_setpoint_that_is_not_finite_is_refused_by_the_axis_name(backend: Backend, bad: float) -> None:
    device = backend.device
    device.open(backend.now_s())
    setpoint, last = backend.rest, len(backend.rest) - 1
    setpoint[last] = bad
    with pytest.raises(SafetyTrip, match=device.axis_names[last]):
        device.send(setpoint, backend.rest, backend.now_s())


def test_feedback_is_of_now(backend: Backend) -> None:
    backend.device.open(backend.now_s())
    backend.pass_time(0.1)
    assert backend.now_s() - backend.device.read(backend.now_s()).t_s < 0.2


def test_stop_brings_moving_axes_to_a_stand_that_later_setpoints_do_not_break(backend: Backend) -> None:
    device = backend.device
    device.open(backend.now_s())
    start = device.read(backend.now_s()).position
    far = start + 0.3

    def moving() -> bool:
        device.send(far, backend.rest, backend.now_s())
        return bool(np.abs(device.read(backend.now_s()).rate).min() > 0.05)

    assert backend.wait_until(moving)
    device.stop(backend.now_s())
    assert backend.wait_until(lambda: bool(np.abs(device.read(backend.now_s()).rate).max() < 1e-3), 2.0)
    stood = device.read(backend.now_s()).position
    device.send(far, backend.rest, backend.now_s())
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


@dataclass
class Motion:
    """What a loop sees of axes that are moved for a second: rows of positions, ages of the feedback, s; error."""

    position: np.ndarray
    age_s: np.ndarray
    error: DeviceError | None = None
    counted: float = 0.0
    """Packets that the driver has counted as damaged, late, lost or received twice; nan if it counts none."""


def counted(device: AxisGroup) -> float:
    """Return ``Motion.counted`` since ``open``."""
    count = getattr(device, "counters", None)
    return np.nan if count is None else sum(n for name, n in count().items() if name != "exchanges")


PERIOD_S, BEFORE, CYCLES, SPEED = 0.02, 10, 60, 0.03


def moved(backend: Backend, on: Callable[[], None] = lambda: None) -> Motion:
    """Move all axes of an open device evenly; call ``on`` after BEFORE cycles; end with the first error."""
    device, now_s = backend.device, backend.now_s
    start, rows, ages = device.read(now_s()).position.copy(), [], []
    for k in range(CYCLES):
        if k == BEFORE:
            on()
        try:
            feedback = device.read(now_s())
            device.send(start + SPEED * k * PERIOD_S, np.full(len(start), SPEED), now_s())
        except DeviceError as error:
            return Motion(np.array(rows), np.array(ages), error)
        rows.append(feedback.position - start)
        ages.append(now_s() - feedback.t_s)
        backend.pass_time(PERIOD_S)
    return Motion(np.array(rows), np.array(ages), counted=counted(device))


def _has_effect(fault: str, healthy: Motion, found: Motion) -> bool:
    """Whether a fault shows: as an error that names the device, in the positions, or as feedback that is late."""
    if found.error is not None:
        return True
    if fault in ("duplicate", "corrupt"):  # what comes twice is used once, what is damaged not: both are counted
        return not found.counted <= healthy.counted
    apart = np.abs(found.position - healthy.position).max(axis=1)
    return bool(apart[BEFORE:].max() > 1e-4 or (found.age_s - healthy.age_s)[BEFORE:].max() > 0.05)


def test_each_declared_fault_has_its_effect_alone_and_is_over_once_cleared(
    wired: Callable[[], AxisGroupTable],
) -> None:
    """Late, damaged and lost answers, and the faults of the axes: none is without effect, and none is taken as true."""
    config = wired()
    with _on_wires(config) as backend:
        backend.device.open(backend.now_s())
        healthy = moved(backend)
        assert backend.faults is not None
        kinds = dict(backend.faults.kinds)
    assert healthy.error is None
    assert {"drop", "corrupt", "delay", "link_down", "stuck"} <= set(kinds)
    without = [kind for kind, fault in kinds.items() if not _acts(config, kind, fault, healthy)]
    assert without == []


def _acts(config: AxisGroupTable, kind: str, fault: ErrorTerm, healthy: Motion) -> bool:
    """Return whether the fault has its effect before it is cleared, and the device works again afterwards."""
    with _on_wires(config) as backend:
        device, faults = backend.device, backend.faults
        assert faults is not None
        device.open(backend.now_s())
        axis = faults.axes[-1] if fault.of_axis else ""
        value = {"drop": 1.0, "corrupt": 1.0, "delay": 0.2, "scaled": 0.5}.get(kind)
        found = moved(backend, lambda: faults.on(kind, axis, value))
        if found.error is not None:
            assert device.name in str(found.error)
        np.testing.assert_allclose(found.position[:BEFORE], healthy.position[:BEFORE], atol=1e-9)
        if kind in ("drop", "link_down", "delay", "duplicate", "corrupt"):  # nothing that was read is wrong
            n = len(found.position)
            assert np.abs(found.position - healthy.position[:n]).max() < 1.1 * SPEED * config.timeout_s + 1e-3, kind
        faults.clear()
        device.close()
        backend.pass_time(0.1)
        assert backend.wait_until(lambda: _is_sound(backend))
        return _has_effect(kind, healthy, found)


def _is_sound(backend: Backend) -> bool:
    """Whether the device can be opened and gives feedback of now."""
    try:
        backend.device.open(backend.now_s())
        backend.pass_time(0.1)
        return backend.now_s() - backend.device.read(backend.now_s()).t_s < 0.2
    except DeviceError:
        backend.device.close()
        return False
