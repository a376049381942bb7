"""The driver against the emulated controller: codec, contract of axes, faults, and a run in closed loop."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from acme_rails import codec
from acme_rails.codec import Status
from acme_rails.driver import AcmeRails
from acme_rails.emulator import AcmeEmulator

import hil
from hil.config.load import load_rig
from hil.core.clock import Order
from hil.errors import DeviceError, SafetyTrip
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.emulation.shared_state import SharedAxisState

RIG = str(Path(__file__).parents[1] / "rig.toml")
RESTS = np.zeros(3)


class Bench:
    """Driver and emulator on one wire, in bench time."""

    def __init__(self, clock: LockStepConductor, rails: AcmeRails, emulator: AcmeEmulator) -> None:
        self.clock, self.rails, self.faults = clock, rails, emulator.faults

    @property
    def position(self) -> np.ndarray:
        return self.rails.read(self.clock.now_s()).position

    def follow(self, step_m: float, duration_s: float = 1.0) -> None:
        """Move all axes by ``step_m`` in equal steps, a setpoint every 20 ms."""
        start, begin_s = self.position, self.clock.now_s()
        while (t_s := self.clock.now_s() - begin_s) < duration_s:
            rate = np.full(3, step_m / duration_s)
            self.rails.send(start + rate * t_s, rate, self.clock.now_s())
            self.clock.sleep(0.02)

    def wait(self, duration_s: float) -> None:
        self.clock.sleep(duration_s)


@contextmanager
def benches() -> Iterator[Bench]:
    clock, stop, board = LockStepConductor(0.02, 30.0), threading.Event(), SharedAxisState.create()
    table = load_rig(RIG).value.rails
    emulator = AcmeEmulator(table, clock, board)
    table = table.connected("rails", emulator.start())
    served = clock.start_thread(lambda: emulator.run(stop), "controller", Order.AXES)
    rails = AcmeRails(table, clock)
    try:
        rails.open(clock.now_s())
        yield Bench(clock, rails, emulator)
    finally:
        rails.close()
        stop.set()
        clock.join(served, 5.0)
        emulator.close()
        board.close()
        clock.close()


def test_line_and_its_numbers() -> None:
    line = codec.encode(f"7 {int(Status.ENABLED)} {codec.encode_numbers((0.5, 0.0, -0.25), (0.0, 0.1, 0.0))}")
    assert line == b"7 1 500000 0 -250000 0 100000 0*38\n"
    assert codec.decode_response(codec.decode(line.rstrip(b"\n"))[1:]).position_m == (0.5, 0.0, -0.25)
    with pytest.raises(ValueError, match="checksum"):
        codec.decode(line.replace(b"500000", b"500001").rstrip(b"\n"))


def test_axes_follow_setpoints_and_hold_after_a_stop() -> None:
    with benches() as bench:
        start = bench.position
        bench.follow(0.05)
        bench.wait(0.5)
        assert bench.position == pytest.approx(start + 0.05, abs=2e-3)
        bench.rails.stop(bench.clock.now_s())
        bench.wait(0.5)
        held = bench.position
        bench.follow(0.05)
        assert bench.position == pytest.approx(held, abs=1e-5)


def test_setpoint_beyond_the_travel_is_limited_and_one_that_is_no_number_is_refused() -> None:
    with benches() as bench:
        now_s = bench.clock.now_s()
        assert bench.rails.send(np.full(3, 100.0), RESTS, now_s).tolist() == [12.0, 1.5, 1.5]
        with pytest.raises(SafetyTrip, match=r"^rails.x: setpoint nan"):
            bench.rails.send(np.full(3, np.nan), RESTS, now_s)


@pytest.mark.parametrize(
    ("fault", "text"), [("link_down", "no response"), ("drive_fault x", "fault of the controller")]
)
def test_fault_names_the_device(fault: str, text: str) -> None:
    with benches() as bench:
        bench.faults.execute(f"on {fault}")
        with pytest.raises(DeviceError, match=f"^rails: {text}"):
            bench.follow(0.01)


def test_loop_is_closed_on_the_emulated_controller() -> None:
    run = hil.run("scheme-1", rig=RIG, duration_s=2.0, overrides={"rig.host.time": "lock_step"})
    assert run.summary["stop"] == "completed"
    assert max(run.summary["bench"]["rail_error_max_m"]) < 0.005
