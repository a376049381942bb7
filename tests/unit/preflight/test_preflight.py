"""Preflight: checks of host, links, devices and lateness on given facts."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.config.rig import RAIL_NAMES, AxisGroupTable, Rig
from hil.core.clock import WallClock
from hil.core.messages import PoseFrame
from hil.drivers.mock_axes import MockAxes
from hil.drivers.split_axes import RigDrivers
from hil.drivers.vmu.mock import MockVmu
from hil.errors import ProtocolError
from hil.parts.wires import devices
from hil.parts.wires.devices import device_checks
from hil.preflight.check import PreflightCheck, all_passed
from hil.preflight.host import HostFacts, Privileges, host_checks, probe_host
from hil.preflight.lateness import Lateness, histogram_lines, lateness_check, pause_check, summarise
from hil.preflight.run import overtravel_check, preflight, reachability_check

GOOD = HostFacts(
    clock_resolution_s=1e-9,
    clock_source="tsc",
    privileges=Privileges("", ""),
    governors=("performance", "performance"),
    processors=4,
    free_bytes=100e9,
    kernel="6.12.0-rt",
    kernel_is_realtime=True,
    kernels_cached=True,
)
CYCLES = 20001
QUIET = summarise(0.02, np.full(250, 5e-6), 0, "SCHED_FIFO 80")


def _check(facts: HostFacts, name: str, on_hardware: bool = True) -> PreflightCheck:
    return next(check for check in host_checks(facts, CYCLES, on_hardware) if check.name == name)


def test_good_host_passes_in_every_point_and_gets_no_advice() -> None:
    checks = host_checks(GOOD, CYCLES, on_hardware=True)
    assert [check.passed for check in checks] == [True] * 9
    assert {check.advice for check in checks} == {""}


@pytest.mark.parametrize(
    ("name", "change", "passed", "advice"),
    [
        ("clock resolution", {"clock_resolution_s": 4e-3}, False, "CONFIG_HIGH_RES_TIMERS"),
        ("clock source", {"clock_source": "hpet"}, False, "clocksource=tsc"),
        ("clock source", {"clock_source": ""}, None, ""),
        ("scheduling", {"privileges": Privileges("Operation not permitted", "")}, False, "rtprio 80"),
        ("memory lock", {"privileges": Privileges("", "Cannot allocate memory")}, False, "memlock unlimited"),
        ("CPU governor", {"governors": ("performance", "powersave")}, False, "cpupower frequency-set"),
        ("CPU governor", {"governors": ()}, None, ""),
        ("processors", {"processors": 1}, False, "second one"),
        ("disk", {"free_bytes": 0.9e9}, False, "free disk space"),
        ("kernel", {"kernel_is_realtime": False}, None, "PREEMPT_RT"),
        ("compiled kernels", {"kernels_cached": False}, None, "first run compiles"),
    ],
)
def test_each_shortcoming_of_a_host_with_hardware_is_named_with_what_to_do(
    name: str, change: dict[str, object], passed: bool | None, advice: str
) -> None:
    check = _check(replace(GOOD, **change), name)  # type: ignore[arg-type]
    assert check.passed is passed
    assert advice in check.advice
    others = [c for c in host_checks(replace(GOOD, **change), CYCLES, True) if c.name != name]  # type: ignore[arg-type]
    assert all(c.passed for c in others)


@pytest.mark.parametrize("name", ["scheduling", "memory lock", "CPU governor"])
def test_refused_privileges_are_a_note_if_no_hardware_moves(name: str) -> None:
    poor = replace(GOOD, privileges=Privileges("not permitted", "not permitted"), governors=("powersave",))
    check = _check(poor, name, on_hardware=False)
    assert check.passed is None
    assert check.advice
    assert all_passed(host_checks(poor, CYCLES, on_hardware=False))


def test_a_long_run_asks_for_room_for_twenty_of_its_kind() -> None:
    check = next(c for c in host_checks(replace(GOOD, free_bytes=50e9), 10_000_000, True) if c.name == "disk")
    assert check.passed is False


def test_probe_of_this_host_gives_facts_and_leaves_this_process_as_it_was(tmp_path: Path) -> None:
    before = os.sched_getscheduler(0)
    facts = probe_host(tmp_path)
    assert os.sched_getscheduler(0) == before
    assert facts.clock_resolution_s > 0.0
    assert facts.processors >= 1
    assert facts.free_bytes > 0.0
    assert facts.kernel


def test_lateness_fails_from_a_tenth_of_the_period_on() -> None:
    assert lateness_check(QUIET).passed is True
    late = np.full(1000, 5e-6)
    late[-3:] = 0.0021
    check = lateness_check(summarise(0.02, late, 0, "SCHED_OTHER"))
    assert check.passed is False
    assert "p99.9 2100" in check.value
    assert "allowed below 2000 us (10% of the period)" in check.value
    assert "SCHED_OTHER" in check.value
    assert check.advice
    assert lateness_check(summarise(0.05, late, 0, "SCHED_OTHER")).passed is True


def test_histogram_counts_every_cycle_once_in_bins_that_double() -> None:
    late_us = np.array([-0.1, 0.3, 1.0, 1.5, 2.1, 3.9, 70.0, 5000.0])
    found = summarise(0.02, late_us * 1e-6, 0, "SCHED_OTHER")
    counts = {entry["below_us"]: entry["cycles"] for entry in found.histogram}
    assert sum(counts.values()) == len(late_us)
    assert (counts[1], counts[2], counts[4], counts[128], counts[8192]) == (2, 2, 2, 1, 1)
    lines = histogram_lines(found)
    assert len(lines) == len(found.histogram) == 14
    assert lines[0].endswith("2 " + 40 * "#")
    assert lines[3].endswith(" 0")


def _rig(tmp_path: Path, **given: str) -> Rig:
    chosen = {
        "channel": "can_none_7",
        "interface": "socketcan",
        "port": str(tmp_path / "ttyNone"),
        "host": "192.0.2.1",
        **given,
    }
    path = tmp_path / "lab.toml"
    path.write_text(
        'extends = "emulated"\nname = "lab"\nkind = "hardware"\n[rails.modbus]\n'
        + "".join(
            f'{name} = {{ host = "{chosen["host"]}", port = {port} }}\n' for port, name in enumerate(RAIL_NAMES, 502)
        )
        + f'[turntable.cia402]\ninterface = "{chosen["interface"]}"\nchannel = "{chosen["channel"]}"\n'
        + f'[io]\nhost = "{chosen["host"]}"\nport = 505\n'
        + f'[vmu.rs422]\nport = "{chosen["port"]}"\n'
    )
    return load_rig(str(path)).value


def test_wires_of_a_rig_are_those_that_its_drivers_open(tmp_path: Path) -> None:
    found = _rig(tmp_path).wires()
    assert [(wire.key, wire.kind) for wire in found] == [
        ("rails.modbus.x", "tcp"),
        ("rails.modbus.y", "tcp"),
        ("rails.modbus.z", "tcp"),
        ("turntable.cia402.channel", "can"),
        ("io", "tcp"),
        ("vmu.rs422.port", "serial"),
    ]
    assert found[0].address == "192.0.2.1:502"


def test_missing_port_and_interface_are_named_and_an_address_needs_no_name_server(tmp_path: Path) -> None:
    checks = {check.name: check for check in devices.port_checks(_rig(tmp_path))}
    assert checks["host rails.modbus.x"].passed is True
    assert checks["CAN turntable.cia402.channel"].value == "can_none_7: no such interface"
    port = checks["port vmu.rs422.port"]
    assert port.passed is False
    assert port.value == f"{tmp_path / 'ttyNone'}: no such port"


def test_link_of_a_kind_without_a_check_is_reported_as_not_checked(tmp_path: Path) -> None:
    checks = {
        check.name: check for check in devices.port_checks(_rig(tmp_path, interface="pcan", channel="PCAN_USBBUS1"))
    }
    check = checks["wire turntable.cia402.channel"]
    assert check.passed is None
    assert check.value == "PCAN_USBBUS1: not checked, no port of this computer"


def test_port_without_the_right_to_it_advises_its_group(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    port = tmp_path / "ttyUSB0"
    port.touch()
    monkeypatch.setattr(os, "access", lambda *_: False)
    monkeypatch.setattr(Path, "group", lambda _: "dialout")
    check = devices.port_checks(_rig(tmp_path, port=str(port)))[-1]
    assert check.passed is False
    assert check.advice.startswith("sudo usermod -aG dialout $USER")


def test_host_that_cannot_be_resolved_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def unknown(*_: object, **__: object) -> None:
        raise OSError(-2, "Name or service not known")

    monkeypatch.setattr("socket.getaddrinfo", unknown)
    check = devices.port_checks(_rig(tmp_path, host="rail-x.lab"))[0]
    assert check.passed is False
    assert check.value == "rail-x.lab:502: Name or service not known"


class Telltale(MockAxes):
    """Axes that record their calls."""

    def __init__(self, name: str, config: AxisGroupTable) -> None:
        super().__init__(name, config)
        self.done: list[str] = []

    def open(self, now_s: float) -> None:
        self.done.append("open")
        super().open(now_s)

    def stop(self, now_s: float) -> None:
        self.done.append("stop")
        super().stop(now_s)

    def close(self) -> None:
        self.done.append("close")
        super().close()


@pytest.fixture
def bench(mock_rig: Rig) -> tuple[Telltale, Telltale, MockVmu]:
    pose = PoseFrame(1, 0.0, 0.0, np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6))
    rails = Telltale("rails", mock_rig.rails)
    turntable = Telltale("turntable", mock_rig.turntable)
    return rails, turntable, MockVmu(mock_rig.vmu, lambda t_s: replace(pose, t_s=t_s))


def of(bench: tuple[Telltale, Telltale, MockVmu]) -> tuple[RigDrivers, Rig]:
    rails, turntable, poses = bench
    return RigDrivers({"rails": rails, "turntable": turntable}, poses), load_rig("mock").value


def _passed(checks: Sequence[PreflightCheck]) -> list[bool | None]:
    return [check.passed for check in checks]


def test_devices_are_opened_read_stopped_and_closed(bench: tuple[Telltale, Telltale, MockVmu]) -> None:
    checks = device_checks(*of(bench), WallClock(), enable_drives=True)
    assert _passed(checks) == [True, True, True]
    assert checks[0].value == "identified, at x 3.000, y 0.000, z 0.000 m"
    assert checks[2].value == "pose at 2.000 m from the camera"
    assert bench[0].done == bench[1].done == ["open", "stop", "close"]


def test_drives_of_hardware_are_not_enabled_unasked(bench: tuple[Telltale, Telltale, MockVmu]) -> None:
    checks = device_checks(*of(bench), WallClock(), enable_drives=False)
    assert _passed(checks) == [None, None, True]
    assert "--devices" in checks[0].advice
    assert bench[0].done == bench[1].done == []


def test_device_that_fails_is_named_and_the_others_are_still_checked(
    bench: tuple[Telltale, Telltale, MockVmu], monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: float) -> None:
        raise ProtocolError("rails", "identity 7, expected 402")

    monkeypatch.setattr(bench[0], "open", refuse)
    checks = device_checks(*of(bench), WallClock(), enable_drives=True)
    assert _passed(checks) == [False, True, True]
    assert checks[0].value == "rails: identity 7, expected 402"
    assert bench[0].done[-1] == "close"


def test_silent_device_is_given_up(bench: tuple[Telltale, Telltale, MockVmu], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices, "_FIRST_SAMPLE_S", 0.05)
    monkeypatch.setattr(bench[2], "poll", lambda _: [])
    checks = device_checks(*of(bench), WallClock(), enable_drives=True)
    assert checks[2].passed is False
    assert checks[2].value == "vmu: no pose"


def test_plan_that_the_rig_cannot_realise_fails_with_its_problems() -> None:
    settings = ("rig.rails.x.rate_max_mps=0.035",)
    check = reachability_check(load_scenario("scheme-1", settings), load_rig("mock", settings))
    assert check.passed is False
    assert "rails.x would go at up to 0.04 m/s" in check.value
    assert reachability_check(load_scenario("scheme-1"), load_rig("mock")).passed is True


@pytest.mark.parametrize(
    ("longest_s", "on_hardware", "passed"), [(0.02, True, True), (0.06, True, False), (0.06, False, None)]
)
def test_pause_that_would_open_the_chain_fails_on_hardware(
    longest_s: float, on_hardware: bool, passed: bool | None
) -> None:
    late = summarise(0.02, np.array([1e-5] * 1000 + [longest_s]), 0, "SCHED_OTHER")
    check = pause_check(late, 0.05, on_hardware)
    assert check.passed is passed
    assert check.value == f"longest {1e3 * longest_s:.1f} ms in 20 s, allowed below io.pump_timeout_s, 50 ms"
    assert bool(check.advice) == (passed is not True)
    assert pause_check(late, None, on_hardware).passed is None


def test_lateness_that_cannot_be_measured_fails(tmp_path: Path) -> None:
    def broken(*_: float) -> Lateness:
        raise RuntimeError("the lateness could not be measured: killed")

    found = preflight(load_scenario("scheme-1"), load_rig("mock"), tmp_path, False, probe=lambda _: GOOD, meter=broken)
    assert not found.passed
    assert found.numbers()["lateness_us"] is None


def test_numbers_have_the_promised_keys(tmp_path: Path) -> None:
    told: list[str] = []
    found = preflight(
        load_scenario("scheme-1"), load_rig("mock"), tmp_path, False, told.append, lambda _: GOOD, lambda *_: QUIET
    )
    numbers = found.numbers()
    assert numbers["passed"] is True
    assert numbers["rate_hz"] == 50.0
    assert set(numbers["lateness_us"]) == {"p50", "p99", "p999", "max"}
    assert all(set(check) == {"name", "passed", "value", "advice"} for check in numbers["checks"])
    assert len(told) == 4


def test_overtravel_is_the_braking_distance_beyond_the_travel() -> None:
    check = overtravel_check(load_rig("mock").value)
    assert check.passed is None
    assert "rails.x 0.21 m" in check.value
    assert "turntable.yaw 10.00 deg" in check.value
