"""Couplers that are busy, that answer for another unit, and gateways that take their time, in lock-step."""

from __future__ import annotations

import math

import pytest

from hil.config.tables.io import Io
from hil.core.clock import Order
from hil.core.messages import IoOutputs
from hil.drivers.io.driver import ModbusIo
from hil.errors import DeviceError, LinkTimeout, ProtocolError
from hil.parts.emulation.digital_io import IoEmulator
from tests.support.lock_step import in_lock_step, serving

HABITS = {
    "busy and odd": {"busy": 0.05, "odd_frames": 0.02},
    "unit 255": {"other_unit": 255.0},
    "unit 0": {"other_unit": 0.0},
    "gateway": {"delay": 0.02, "busy": 0.05, "odd_frames": 0.02},
}


def keep_closed(habits: dict[str, float], seconds: float) -> dict[str, int]:
    """Keep the safety chain closed on a coupler with ``habits``; return what the driver has counted."""
    keys = {"driver": "modbus", "timeout_s": 0.4, "pump_timeout_s": 0.5, "device_id": 7}
    with in_lock_step() as clock:
        emulator = IoEmulator(Io.model_validate(keys), clock, lambda chain, t_s: None, seed=4)
        host, _, port = emulator.start()["io"].rpartition(":")
        io = ModbusIo(Io.model_validate(keys | {"host": host, "port": int(port)}), clock)
        with serving(clock, emulator, Order.COUPLER):
            try:
                for name, value in habits.items():
                    emulator.faults.on(name, value=value)
                io.open(clock.now_s())
                closed_s, end_s, k = math.inf, clock.now_s() + seconds, 0
                while clock.now_s() < end_s:
                    io.pulse(clock.now_s())
                    io.write(IoOutputs(closed_s < math.inf or k % 20 > 4, b"\1"), clock.now_s())
                    inputs = io.read(clock.now_s())
                    if inputs.chain_closed:
                        closed_s = min(closed_s, clock.now_s())
                    assert inputs.chain_closed or closed_s == math.inf
                    clock.sleep(0.01)
                    k += 1
                assert closed_s < math.inf
                return io.counters()
            finally:
                io.close()


@pytest.mark.parametrize("seconds", [3.0, pytest.param(60.0, marks=[pytest.mark.slow, pytest.mark.timeout(900)])])
@pytest.mark.parametrize("habit", HABITS)
def test_coupler_with_a_habit_keeps_the_chain_closed_and_is_counted(habit: str, seconds: float) -> None:
    counted = keep_closed(HABITS[habit], seconds)
    kinds = {"busy": "busy", "odd_frames": "odd", "other_unit": "other_unit"}
    for name in HABITS[habit].keys() & kinds.keys():
        assert counted[kinds[name]] > 0, counted


def test_answer_of_another_unit_is_named() -> None:
    with pytest.raises(LinkTimeout, match=r"io: no answer within .* s; unit 9 has answered: correct io\.device_id"):
        keep_closed({"other_unit": 9.0}, 1.0)


def test_coupler_that_is_always_busy_or_odd_ends_the_run() -> None:
    with pytest.raises(ProtocolError, match="Modbus exception 6"):
        keep_closed({"busy": 1.0}, 1.0)
    with pytest.raises(DeviceError, match="no response of a coupler"):
        keep_closed({"odd_frames": 1.0}, 1.0)
