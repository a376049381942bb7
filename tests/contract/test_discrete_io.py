"""One contract for every backend of the digital lines: the mock, and the driver against its emulator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

import pytest

from hil.config.tables.io import Io
from hil.core.clock import Order, SimulatedClock
from hil.core.messages import IoInputs, IoOutputs
from hil.drivers.base import DiscreteIo
from hil.drivers.io.driver import ModbusIo
from hil.drivers.io.mock import MockIo
from hil.errors import DeviceError, LinkTimeout
from hil.parts.emulation.digital_io import IoEmulator
from tests.support.lock_step import in_lock_step, serving

PUMP_TIMEOUT_S = 0.4  # generous: the machine that tests run on does other things too
THRUSTERS = bytes((1, 0, 0, 1))


def config(driver: str, **changes: object) -> Io:
    table = {"driver": driver, "pump_timeout_s": PUMP_TIMEOUT_S, "interlocks": {"door": 5}, "thruster_lines": 6}
    table["inputs"] = {"local_enable": 3}
    return Io.model_validate(table | changes)


@dataclass
class Backend:
    """A device, its time, and what people do to the bench."""

    io: DiscreteIo
    now_s: Callable[[], float]
    pass_time: Callable[[float], None]
    press: Callable[[bool], None]
    open_door: Callable[[bool], None]
    switch_off: Callable[[bool], None]
    thrusters: Callable[[], tuple[bool, ...]]
    go_silent: Callable[[], None]

    def wait_for(self, done: Callable[[IoInputs], bool], pulsing: bool = True) -> IoInputs:
        """Pulse every 20 ms until the inputs are as wanted, 10 s at most."""
        give_up_s = self.now_s() + 10.0
        while True:
            if pulsing:
                self.io.pulse(self.now_s())
            inputs = self.io.read(self.now_s())
            if done(inputs):
                return inputs
            assert self.now_s() < give_up_s, inputs
            self.pass_time(0.02)

    def close_the_chain(self) -> None:
        """Give an edge of enable with the pump running."""
        self.io.write(IoOutputs(False, THRUSTERS), self.now_s())
        for _ in range(10):
            self.io.pulse(self.now_s())
            self.pass_time(0.02)
        self.io.write(IoOutputs(True, THRUSTERS), self.now_s())
        self.wait_for(lambda inputs: inputs.chain_closed)


@contextmanager
def _mock() -> Iterator[Backend]:
    clock = SimulatedClock()
    io = MockIo(config("mock"))

    def pass_time(seconds: float) -> None:
        clock.t_s += seconds

    yield Backend(
        io,
        clock.now_s,
        pass_time,
        lambda pressed: setattr(io, "pressed", pressed),
        lambda is_open: setattr(io, "open_interlocks", ("door",) if is_open else ()),
        lambda off: setattr(io, "local_enable", not off),
        lambda: tuple(bool(on) for on in io.outputs.thrusters.ljust(6, b"\0")),
        lambda: io.fail(LinkTimeout("io", "silent")),
    )


@contextmanager
def _on_the_wire() -> Iterator[Backend]:
    with in_lock_step() as clock:
        emulator = IoEmulator(config("modbus"), clock, lambda closed, t_s: None)
        port = int(emulator.start()["io"].rpartition(":")[2])
        faults = emulator.faults
        with serving(clock, emulator, Order.COUPLER), closing(ModbusIo(config("modbus", port=port), clock)) as io:
            yield Backend(
                io,
                clock.now_s,
                clock.sleep,
                lambda pressed: faults.on("estop") if pressed else faults.off("estop"),
                lambda is_open: faults.on("interlock", "door") if is_open else faults.off("interlock", "door"),
                lambda off: faults.on("local_enable_off") if off else faults.off("local_enable_off"),
                lambda: emulator.coupler.thrusters,
                lambda: faults.on("link_down"),
            )


BACKENDS = {"mock": _mock, "modbus": _on_the_wire}


@pytest.fixture(params=sorted(BACKENDS))
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    with BACKENDS[request.param]() as made:
        made.io.open(made.now_s())
        yield made


def test_device_keeps_the_protocol(backend: Backend) -> None:
    assert isinstance(backend.io, DiscreteIo)
    assert backend.io.name == "io"


def test_an_opened_device_has_a_sample_and_leaves_the_chain_open(backend: Backend) -> None:
    inputs = backend.io.read(backend.now_s())
    assert inputs[1:4] == (True, False, ())
    assert backend.now_s() - inputs.t_s < 2.0


def test_the_chain_closes_with_a_running_pump_and_an_edge_of_enable(backend: Backend) -> None:
    backend.close_the_chain()
    backend.pass_time(0.1)
    assert backend.thrusters() == (True, False, False, True, False, False)


def test_inputs_have_the_time_when_the_thruster_lines_last_changed(backend: Backend) -> None:
    backend.close_the_chain()
    first_s = backend.wait_for(lambda inputs: not math.isnan(inputs.thrusters_s)).thrusters_s
    backend.pass_time(0.1)
    assert backend.wait_for(lambda inputs: inputs.t_s > first_s).thrusters_s == first_s
    changed_s = backend.now_s()
    backend.io.write(IoOutputs(True, bytes(6)), changed_s)
    inputs = backend.wait_for(lambda inputs: inputs.thrusters_s > first_s)
    assert changed_s <= inputs.thrusters_s <= inputs.t_s


def test_chain_opens_without_pulses(backend: Backend) -> None:
    backend.close_the_chain()
    backend.wait_for(lambda inputs: not inputs.chain_closed, pulsing=False)


def test_the_emergency_stop_opens_the_chain_and_its_release_does_not_close_it(backend: Backend) -> None:
    backend.close_the_chain()
    backend.press(True)
    backend.wait_for(lambda inputs: not inputs.estop_closed and not inputs.chain_closed)
    backend.press(False)
    backend.wait_for(lambda inputs: inputs.estop_closed)
    for _ in range(20):
        backend.io.pulse(backend.now_s())
        backend.pass_time(0.02)
    assert not backend.io.read(backend.now_s()).chain_closed
    backend.close_the_chain()


def test_an_open_interlock_is_named_and_opens_the_chain(backend: Backend) -> None:
    backend.close_the_chain()
    backend.open_door(True)
    backend.wait_for(lambda inputs: inputs.open_interlocks == ("door",) and not inputs.chain_closed)


def test_the_chain_stays_without_the_switch_at_the_bench_and_does_not_close_without_it(backend: Backend) -> None:
    backend.close_the_chain()
    assert backend.wait_for(lambda inputs: True).local_enable is True
    backend.switch_off(True)
    assert backend.wait_for(lambda inputs: inputs.local_enable is False).chain_closed
    for enable in (False, True):
        backend.io.write(IoOutputs(enable, THRUSTERS), backend.now_s())
        for _ in range(10):
            backend.io.pulse(backend.now_s())
            backend.pass_time(0.02)
    assert not backend.io.read(backend.now_s()).chain_closed
    backend.switch_off(False)
    backend.close_the_chain()


def test_stop_sets_all_lines_off_and_keeps_them_off(backend: Backend) -> None:
    backend.close_the_chain()
    backend.io.stop(backend.now_s())
    backend.io.stop(backend.now_s())
    backend.wait_for(lambda inputs: not inputs.chain_closed)
    assert not any(backend.thrusters())


def test_silence_is_an_error_that_names_the_device(backend: Backend) -> None:
    backend.go_silent()
    with pytest.raises(LinkTimeout, match=r"^io: "):
        backend.wait_for(lambda inputs: False)


def test_close_may_come_twice_and_a_closed_device_refuses_until_it_is_opened_again(backend: Backend) -> None:
    backend.close_the_chain()
    backend.io.close()
    backend.io.close()
    backend.io.stop(backend.now_s())
    with pytest.raises(DeviceError, match=r"^io: is closed"):
        backend.io.read(backend.now_s())
    with pytest.raises(DeviceError, match="io"):
        backend.io.write(IoOutputs(True, b""), backend.now_s())
    backend.io.open(backend.now_s())
    assert not backend.io.read(backend.now_s()).chain_closed
