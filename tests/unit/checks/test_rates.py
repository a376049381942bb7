"""Rates of IMU and axes, and the filters' memory: what cannot work is rejected in one line before the run."""

from __future__ import annotations

import pytest

from hil.checks.compatibility import check_memory, check_rates
from hil.errors import BadInput
from tests.support.run_settings import make_job

RTU = "emulated-rtu"
MOCK = "mock"


@pytest.mark.parametrize(
    ("rig", "settings", "key", "words"),
    [
        (MOCK, ("imu.rate_hz=25.0",), "imu.rate_hz", "25: allowed are multiples of the cycle's rate, 50 Hz"),
        (MOCK, ("imu.rate_hz=120.0",), "imu.rate_hz", "120: allowed are multiples"),
        (MOCK, ("rig.bench.axes_rate_hz=90.0",), "rig.bench.axes_rate_hz", "90: allowed are multiples"),
        (MOCK, ("rig.bench.axes_rate_hz=20000.0",), "rig.bench.axes_rate_hz", "20000: at most 10000 are allowed"),
        (
            MOCK,
            ("rig.telemetry.rate_hz=30.0",),
            "rig.telemetry.rate_hz",
            "30: allowed is the cycle's rate, 50 Hz, divided",
        ),
        (MOCK, ("rig.telemetry.rate_hz=100.0",), "rig.telemetry.rate_hz", "100: allowed is the cycle's rate"),
        (RTU, ("rig.bench.axes_rate_hz=1000.0",), "rig.bench.axes_rate_hz", "rails (modbus_rtu) carries 60"),
        (RTU, ("step_s=0.001",), "step_s", "0.001: 1000 setpoints per second, the wire of rails (modbus_rtu) carries"),
        (
            "emulated",
            ("rig.turntable.driver=ascii", "rig.bench.axes_rate_hz=1000.0"),
            "rig.bench.axes_rate_hz",
            "turntable (ascii) carries 290",
        ),
        (
            "emulated",
            ("rig.turntable.cia402.bitrate=250000", "rig.bench.axes_rate_hz=1000.0"),
            "rig.bench.axes_rate_hz",
            "turntable (cia402) carries 351",
        ),
        (
            RTU,
            ("rig.rails.exchange_rate_max_hz=61.0",),
            "rig.rails.exchange_rate_max_hz",
            "61: the wire of rails (modbus_rtu) carries 60 exchanges per second",
        ),
        (
            "emulated",
            ("rig.turntable.exchange_rate_max_hz=2000.0",),
            "rig.turntable.exchange_rate_max_hz",
            "2000: the wire of turntable (cia402) carries",
        ),
        (
            "emulated",
            ("rig.vmu.rate_hz=1000.0",),
            "rig.vmu.rate_hz",
            "1000: the wire of vmu (rs422) carries",
        ),
    ],
)
def test_rate_that_cannot_be_kept_is_rejected(rig: str, settings: tuple[str, ...], key: str, words: str) -> None:
    job = make_job(1.0, settings, rig=rig)
    (problem,) = check_rates(job.scenario, job.rig)
    assert problem.key == key
    assert words in problem.message


def test_a_slow_wire_with_a_rate_of_its_own_is_accepted_at_any_rate_of_the_axes() -> None:
    job = make_job(1.0, ("rig.bench.axes_rate_hz=1000.0", "rig.rails.exchange_rate_max_hz=60.0"), rig=RTU)
    assert check_rates(job.scenario, job.rig) == []


@pytest.mark.parametrize("rate_hz", ["0.0", "-50.0", "9.0"])
def test_a_rate_of_exchanges_below_ten_hertz_is_rejected(rate_hz: str) -> None:
    with pytest.raises(BadInput, match=r"exchange_rate_max_hz: .* must be greater than or equal to 10"):
        make_job(1.0, (f"rig.rails.exchange_rate_max_hz={rate_hz}",), rig="emulated")


@pytest.mark.parametrize("rig", [MOCK, "emulated"])
def test_multiples_of_the_rate_of_the_cycle_are_accepted(rig: str) -> None:
    job = make_job(1.0, ("imu.rate_hz=200.0", "rig.bench.axes_rate_hz=1000.0", "rig.telemetry.rate_hz=10.0"), rig=rig)
    assert check_rates(job.scenario, job.rig) == []
    assert (job.ticks, job.scenario.value.imu_samples, job.rig.value.telemetry_cycles(job.scenario.value.step_s)) == (
        20,
        4,
        5,
    )


@pytest.mark.parametrize("step_s", [0.02, 0.004, 0.001])
def test_memory_holds_the_same_time_at_every_rate(step_s: float) -> None:
    job = make_job(1.0, (f"step_s={step_s}", "vmu.latency_s=0.3"))
    assert job.scenario.value.memory_steps * step_s == pytest.approx(1.28)
    assert check_memory(job.scenario, job.rig) == []


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (("vmu.latency_s=0.9", "vmu.latency_jitter_s=0.9"), "1.28: allowed from 1.84, the age of the latest poses"),
        (("gnc.navigation.memory_s=0.1", "vmu.latency_s=0.3"), "0.1: allowed from 0.34"),
        (("gnc.navigation.memory_s=5.0", "step_s=0.0001"), "50000 steps of 0.0001 s, allowed 20000"),
    ],
)
def test_memory_that_is_too_short_or_too_long_is_rejected(settings: tuple[str, ...], words: str) -> None:
    job = make_job(0.1, settings)
    (problem,) = check_memory(job.scenario, job.rig)
    assert problem.key == "gnc.navigation.memory_s"
    assert words in problem.message
