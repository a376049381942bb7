"""Rails under every fault of their wire and their axes, over TCP and over a serial line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import Modbus, ModbusAxis, Rails
from hil.core.clock import WallClock
from hil.core.messages import Homing
from hil.drivers.rails.codec import Command, ControlFlags, RegisterMap, Status
from hil.drivers.rails.driver import ModbusRails
from hil.errors import DeviceError, DriveFault, FaultKind, LinkLost, LinkTimeout, ProtocolError, SafetyTrip
from hil.parts.emulation.emulated_axes import WATCHDOG_S
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.emulation.rails import RailsEmulator, RtuRailsEmulator
from hil.parts.emulation.shared_state import ChainState, SharedAxisState
from tests.support.lock_step import GRID_S, in_lock_step, serving

RIGS = ("emulated", "emulated-rtu")
TIMEOUT_S = 1.2
INCREMENTAL = {"encoder": "incremental", "homing_rate_mps": 0.2}
Answers = list[tuple[float, bytes]]


@dataclass
class Bench:
    rails: ModbusRails
    emulator: RailsEmulator | RtuRailsEmulator
    clock: LockStepConductor
    map: RegisterMap
    tcp: bool
    chain: list[bool]

    def open(self) -> None:
        self.rails.open(self.clock.now_s())

    def read(self) -> Any:
        return self.rails.read(self.clock.now_s())

    def wait(self, condition: Callable[[], bool], limit_s: float = 10.0) -> bool:
        end_s = self.clock.now_s() + limit_s
        while self.clock.now_s() < end_s:
            if condition():
                return True
            self.clock.sleep(GRID_S)
        return condition()

    def failure(self) -> DeviceError:
        """Return what the driver raises, sooner or later."""
        found: list[DeviceError] = []

        def failed() -> bool:
            try:
                self.read()
            except DeviceError as error:
                found.append(error)
            return bool(found)

        assert self.wait(failed)
        return found[0]

    def exchanges(self, more: int) -> None:
        """Let so many exchanges take place, none of which may fail."""
        enough = self.rails.counters()["exchanges"] + more

        def done() -> bool:
            self.read()
            return self.rails.counters()["exchanges"] >= enough

        assert self.wait(done)

    def treat(self, deed: Callable[[bytes], Answers]) -> None:
        """Let ``deed`` have the next answer with a state in it, and then no more."""
        wire = self.emulator._ports[0]._wire if self.tcp else self.emulator._channel._wire
        passed = wire.passed
        size = (9 if self.tcp else 5) + 2 * self.map.state.count

        def once(packet: bytes) -> Answers:
            if len(packet) != size:
                return passed(packet)
            wire.passed = passed  # type: ignore[method-assign]
            return deed(packet)

        wire.passed = once  # type: ignore[method-assign]

    def registers_at(self) -> int:
        """Return where in an answer the registers begin."""
        return 9 if self.tcp else 3


@contextmanager
def bench_of(rig: str, **changes: object) -> Iterator[Bench]:
    chain = [True]
    config = Rails.model_validate(load_rig(rig).value.rails.model_dump() | {"timeout_s": TIMEOUT_S} | changes)
    make = RtuRailsEmulator if rig == "emulated-rtu" else RailsEmulator
    with in_lock_step() as clock, closing(SharedAxisState.create()) as board:
        emulator = make(config, clock, board, chain=lambda: ChainState(*chain * 3), seed=3)
        device = wired(config, emulator.start())
        with serving(clock, emulator), closing(ModbusRails(device, clock)) as rails:
            yield Bench(rails, emulator, clock, RegisterMap(config.map), rig == "emulated", chain)


def wired(config: Rails, addresses: dict[str, str]) -> Rails:
    if config.rtu is not None:
        line = config.rtu.model_copy(update={"port": addresses["rails"], "parity": "none"})
        return config.model_copy(update={"rtu": line})
    ports = {name[-1]: ModbusAxis(port=int(address.rpartition(":")[2])) for name, address in addresses.items()}
    return config.model_copy(update={"modbus": Modbus(**ports)})


@pytest.fixture(params=RIGS)
def bench(request: pytest.FixtureRequest) -> Iterator[Bench]:
    with bench_of(request.param) as made:
        made.open()
        yield made


def test_a_single_lost_answer_is_asked_for_again(bench: Bench) -> None:
    bench.treat(lambda packet: [])
    assert bench.wait(lambda: bench.rails.counters()["retries"] == 1)
    bench.exchanges(20)
    assert bench.rails.counters() | {"exchanges": 0} == {
        "exchanges": 0,
        "retries": 1,
        "protocol_errors": 0,
        "late": 0,
        "duplicates": 0,
    }


def test_a_damaged_answer_is_asked_for_again_at_once(bench: Bench) -> None:
    damaged_at = 5 if bench.tcp else 12  # the header's length; the serial frame is covered by its check sum
    bench.treat(lambda packet: [(0.0, _flipped(packet, damaged_at))])
    assert bench.wait(lambda: bench.rails.counters()["retries"] == 1)
    bench.exchanges(20)
    counted = bench.rails.counters()
    assert (counted["protocol_errors"], counted["retries"]) == (1, 1)


@pytest.mark.parametrize("what", ["position", "status"])
def test_wrong_numbers_in_a_sound_tcp_answer_do_not_pass(what: str) -> None:
    with bench_of("emulated") as bench:
        bench.open()
        before = bench.read().position
        register = bench.map.config.state.position if what == "position" else bench.map.config.state.status
        place = bench.registers_at() + 2 * (register.address - bench.map.state.address)
        bench.treat(lambda packet: [(0.0, _flipped(packet, place + (what == "status"), 0x08))])
        assert bench.wait(lambda: bench.rails.counters()["retries"] == 1)
        for _ in range(20):
            bench.exchanges(1)
            assert bench.read().position == pytest.approx(before, abs=1e-3)


def test_a_late_answer_is_counted_and_not_taken_for_the_next_one(bench: Bench) -> None:
    bench.treat(lambda packet: [(0.3, packet)])
    assert bench.wait(lambda: bench.rails.counters()["late"] == 1)
    bench.exchanges(20)
    assert bench.rails.counters()["retries"] == 1


def test_answers_that_come_twice_are_counted_and_harm_nothing(bench: Bench) -> None:
    bench.emulator.faults.on("duplicate", value=1.0)
    assert bench.wait(lambda: bench.rails.counters()["duplicates"] > 20)
    bench.exchanges(20)
    assert bench.rails.counters()["retries"] == 0


@pytest.mark.parametrize(
    ("fault", "value", "what"),
    [("drop", 1.0, "no answer within .* s, asked twice"), ("delay", 5.0, "no answer within .* s, asked twice")],
)
def test_silent_wire_is_reported_with_the_name_of_an_axis(bench: Bench, fault: str, value: float, what: str) -> None:
    bench.emulator.faults.on(fault, value=value)
    error = bench.failure()
    assert isinstance(error, LinkTimeout)
    assert error.device in bench.rails.axis_names
    with pytest.raises(LinkTimeout, match=what):
        bench.read()


def test_wire_that_damages_everything_is_reported_with_the_name_of_an_axis(bench: Bench) -> None:
    bench.emulator.faults.on("corrupt", value=1.0)
    error = bench.failure()
    assert error.device in bench.rails.axis_names
    assert bench.rails.counters()["retries"] > 0


def test_dead_link_is_reported_and_can_be_opened_again_once_it_is_back(bench: Bench) -> None:
    bench.emulator.faults.on("link_down")
    error = bench.failure()
    assert isinstance(error, LinkLost if bench.tcp else LinkTimeout)
    assert error.device in bench.rails.axis_names
    with pytest.raises(DeviceError, match=r"rails\.\w: no "):
        bench.open()
    bench.emulator.faults.clear()
    bench.clock.sleep(0.1)
    bench.open()
    bench.exchanges(10)


def test_frozen_values_reach_the_reader_as_they_are(bench: Bench) -> None:
    start = bench.read().position
    bench.emulator.faults.on("freeze")
    for _ in range(20):
        bench.rails.send(start + 0.05, np.zeros(3), bench.clock.now_s())
        bench.exchanges(3)
    assert bench.read().position == pytest.approx(start, abs=1e-6)


def test_a_jump_of_an_encoder_is_confirmed_and_then_shown(bench: Bench) -> None:
    before = bench.read().position[1]
    bench.emulator.faults.on("jump", "y", 0.3)
    assert bench.wait(lambda: bench.read().position[1] > before + 0.25)
    assert bench.rails.counters()["retries"] == 1


@pytest.mark.parametrize("chosen", [False, True])
def test_fault_of_a_drive_is_reported_by_its_name(bench: Bench, chosen: bool) -> None:
    text = "motor too hot" if chosen else "following error too large" if bench.tcp else "over-current"
    code = (3.0 if bench.tcp else 0x4310) if chosen else None
    bench.emulator.faults.on("drive_fault", "z", code)
    error = bench.failure()
    assert isinstance(error, DriveFault)
    assert error.kind is FaultKind.OTHER
    assert str(error).startswith("rails.z: fault ")
    assert str(error).endswith(text)


def test_a_reversed_encoder_is_a_following_error_of_the_drive_which_has_no_torque_then(bench: Bench) -> None:
    bench.open()
    begun_s, start = bench.clock.now_s(), bench.read().position
    bench.emulator.faults.on("reversed", "y")
    found: list[DeviceError] = []

    def failed() -> bool:
        now_s = bench.clock.now_s()
        way = np.array([0.0, 0.2 * (now_s - begun_s), 0.0])
        try:
            bench.rails.send(start + way, np.array([0.0, 0.2, 0.0]), now_s)
            bench.read()
        except DeviceError as error:
            found.append(error)
        return bool(found)

    assert bench.wait(failed)
    assert isinstance(found[0], DriveFault)
    assert str(found[0]).startswith("rails.y: fault ")
    assert str(found[0]).endswith("following error too large")
    axes = bench.emulator.drives[1]._axes
    assert axes.astray == [False, True, False]
    assert [axes.limit(i) for i in range(3)] == [0, 0, 0]
    bench.emulator.faults.clear()
    assert bench.wait(lambda: not axes.moving(1))
    stood = float(axes.position[1])
    bench.rails.close()
    bench.open()  # resets the fault; the axis holds where it has come to a stand
    assert axes.astray == [False, False, False]
    assert bench.read().position[1] == pytest.approx(stood, abs=1e-3)


def test_an_open_safety_chain_is_a_fault_by_name_until_it_is_closed(bench: Bench) -> None:
    bench.chain[0] = False
    error = bench.failure()
    assert isinstance(error, DriveFault)
    assert error.kind is FaultKind.TORQUE_OFF
    assert str(error).endswith("safe torque off")
    with pytest.raises(DriveFault, match="safe torque off"):
        bench.open()
    bench.chain[0] = True
    bench.clock.sleep(0.1)
    bench.open()


@pytest.mark.parametrize("rig", RIGS)
def test_torque_off_is_known_by_its_code_when_the_map_calls_it_otherwise(rig: str) -> None:
    register_map = load_rig(rig).value.rails.map
    faults = {"2": "over-current", str(register_map.torque_off): "STO active"}
    renamed = {"faults": faults, "following_error": -1}
    with bench_of(rig, map=register_map.model_dump() | renamed) as bench:
        bench.open()
        bench.chain[0] = False
        error = bench.failure()
        assert isinstance(error, DriveFault)
        assert str(error).endswith("STO active")
        assert error.kind is FaultKind.TORQUE_OFF
        with pytest.raises(DriveFault) as caught:
            bench.open()
        assert caught.value.kind is FaultKind.TORQUE_OFF


@pytest.mark.parametrize("rig", RIGS)
def test_axes_without_a_reference_position_are_homed(rig: str) -> None:
    axes = load_rig(rig).value.rails
    changes = {name: getattr(axes, name).model_dump() | INCREMENTAL | {"park_m": 0.2} for name in ("x", "z")}
    with bench_of(rig, **changes) as bench:
        bench.open()
        assert bench.read().homing == (Homing.NEEDED, Homing.DONE, Homing.NEEDED)
        with pytest.raises(SafetyTrip, match=r"rails\.x: setpoint before homing, allowed once the axis is homed"):
            bench.rails.send(np.zeros(3), np.zeros(3), bench.clock.now_s())
        bench.rails.home(bench.clock.now_s())
        assert bench.wait(lambda: bench.read().homing == (Homing.UNDER_WAY, Homing.DONE, Homing.UNDER_WAY))
        assert bench.wait(lambda: bench.read().homing == (Homing.DONE, Homing.DONE, Homing.DONE))
        assert bench.wait(lambda: abs(bench.read().position[0]) < 0.02)
        bench.rails.send(np.array([0.1, 0.0, 0.1]), np.zeros(3), bench.clock.now_s())
        assert bench.wait(lambda: abs(bench.read().position[2] - 0.1) < 0.002)


def test_a_search_that_is_stopped_has_failed_and_the_axis_stands() -> None:
    axes = load_rig("emulated").value.rails
    with bench_of("emulated", x=axes.x.model_dump() | INCREMENTAL) as bench:
        bench.open()
        bench.rails.home(bench.clock.now_s())
        assert bench.wait(lambda: bench.read().rate[0] < -0.1)
        bench.rails.stop(bench.clock.now_s())
        assert bench.wait(lambda: bench.read().homing[0] is Homing.FAILED)
        assert bench.wait(lambda: abs(bench.read().rate[0]) < 1e-3)


def test_a_search_whose_controller_falls_silent_is_ended_by_the_drive() -> None:
    axes = load_rig("emulated").value.rails
    config = axes.model_copy(update={"x": axes.x.model_copy(update=INCREMENTAL)})
    board = SharedAxisState.create()
    emulator = RailsEmulator(config, WallClock(), board)
    drive = emulator.drives[0]
    start_s = 100.0  # in a future that the clock will not reach
    drive.command(Command(ControlFlags.ENABLE | ControlFlags.HOME, 1, 0.0, 0.0), start_s)
    searching = drive.state(start_s + 0.9 * WATCHDOG_S).status
    assert Status.MOVING in searching
    assert Status.HOMING_FAILED not in searching
    ended = drive.state(start_s + WATCHDOG_S + 0.1).status
    assert Status.QUICK_STOP | Status.HOMING_FAILED in ended
    assert Status.MOVING not in drive.state(start_s + WATCHDOG_S + 2.0).status
    emulator.close()
    board.close()


@pytest.mark.parametrize("rig", RIGS)
def test_axis_on_a_limit_switch_reports_which_one(rig: str) -> None:
    axes = load_rig(rig).value.rails
    ends = {"y": {"park_m": axes.y.travel_m[1]}, "z": {"park_m": axes.z.travel_m[0]}}
    changes = {name: getattr(axes, name).model_dump() | park for name, park in ends.items()}
    with bench_of(rig, **changes) as bench:
        bench.open()
        assert bench.read().limit == (0, 1, -1)


def test_port_that_cannot_be_opened_is_reported_with_its_name() -> None:
    rails = load_rig("emulated-rtu").value.rails
    assert rails.rtu is not None
    gone = rails.model_copy(update={"rtu": rails.rtu.model_copy(update={"port": "/dev/no-such-port"})})
    clock = WallClock()
    device = ModbusRails(gone, clock)
    with pytest.raises(LinkLost, match=r"rails\.\w: no connection to /dev/no-such-port"):
        device.open(clock.now_s())


def test_a_drive_of_another_maker_on_the_line_is_refused() -> None:
    with bench_of("emulated-rtu") as bench:
        bench.rails._map.config = bench.map.config.model_copy(update={"vendor": 0x0ABD})
        with pytest.raises(ProtocolError, match=r"rails\.\w: wrong drive at /dev/pts/\d+: vendor 0x00000ABC"):
            bench.open()


def _flipped(packet: bytes, place: int, bit: int = 0x20) -> bytes:
    damaged = bytearray(packet)
    damaged[place] ^= bit
    return bytes(damaged)
