"""Range finder on its serial wire: emulated, in lock-step, with faults of the wire; and on hardware without a port."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hil
from hil.core.sensor_records import ACCEPTED
from hil.errors import BadInput
from hil.parts.emulation.fault_injection import FaultControl
from hil.recording import read
from hil.session.build import check, wired_bench
from tests.support.run_settings import HARDWARE_WIRES, make_job

RANGER = {"sensors.ranger.kind": "range_finder", "rig.host.time": "lock_step"}


def test_samples_come_over_the_wire_with_their_times_and_are_fused(tmp_path: Path) -> None:
    overrides = RANGER | {"sensors.ranger.latency_s": 0.03}
    assert hil.run("scheme-1", "emulated", 4, 2.0, overrides, record=tmp_path).stop == "completed"
    (path,) = tmp_path.glob("*.mcap")
    arrivals = read.load(path).sensor_arrivals
    assert (arrivals["result"] == ACCEPTED).sum() >= 15
    measured_s, received_s = arrivals["sample"]["t_s"], arrivals["sample"]["received_s"]
    assert np.allclose(np.diff(measured_s), 0.1, atol=2e-3)
    assert (received_s - measured_s >= 0.03).all()
    assert (received_s - measured_s < 0.08).all()
    range_m = arrivals["sample"]["value"][:, 0]
    np.testing.assert_allclose(range_m, np.round(range_m, 4), atol=1e-9)  # in 1/10 mm


def test_a_dead_wire_is_an_alarm_of_the_sensor_and_stops_nothing() -> None:
    settings = tuple(f"{key}={value}" for key, value in RANGER.items())
    with wired_bench(make_job(1.0, settings, rig="emulated")) as bench:
        control = FaultControl(bench.addresses["sensor.ranger.faults"])
        control.send("on link_down")
        control.close()
        made = bench.runner()
        outcome = made.run()
    assert outcome.stop == "completed"
    (alarm,) = outcome.alarms
    assert alarm.text.startswith("sensor.ranger: samples none for ")
    assert alarm.active


def test_lines_that_cannot_be_used_are_counted_by_their_reason() -> None:
    settings = tuple(f"{key}={value}" for key, value in RANGER.items())
    with wired_bench(make_job(1.0, settings, rig="emulated")) as bench:
        control = FaultControl(bench.addresses["sensor.ranger.faults"])
        control.send("on corrupt 0.5")
        control.close()
        outcome = bench.runner().run()
    refused = outcome.measured["sensors"]["ranger"]["refused"]
    assert refused
    assert all(reason and count > 0 for reason, count in refused.items())


def test_hardware_needs_the_port_and_the_meaning_of_a_line_s_time(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(f'extends = "emulated"\nname = "lab"\nkind = "hardware"\nsign_off.waived = true\n{HARDWARE_WIRES}')

    def problem(*settings: str) -> str:
        with pytest.raises(BadInput) as error:
            check(make_job(4.0, ("sensors.ranger.kind=range_finder", *settings), rig=str(path)))
        return str(error.value)

    assert "rig.sensors.ranger.port: is missing: the serial port of the sensor" in problem()
    text = problem("rig.sensors.ranger.port=/dev/ttyUSB7")
    assert 'sensors.ranger.stamp: must be "receipt"' in text
    text = problem("rig.sensors.ranger.port=/dev/ttyUSB7", "sensors.ranger.stamp=receipt")
    assert "sensors.ranger.port: /dev/ttyUSB7: no such port" in text
    assert "stamp" not in text
