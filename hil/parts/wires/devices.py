"""Checks of a rig's clock, links and devices: each device is opened, identified, sampled and closed."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
from serial.tools import list_ports

from hil.config.load import Loaded
from hil.config.rig import AxisGroupTable, Rig
from hil.config.scenario import Scenario
from hil.config.tables.host import ClockConfig
from hil.core.clock import WallClock
from hil.core.part import hooks
from hil.core.plug_ins import call
from hil.drivers.base import AxisGroup, CountsPackets, Describes, PoseSource
from hil.drivers.ptp import read_status
from hil.drivers.returned import checked_feedback, checked_frames
from hil.drivers.serial_port import latency_timer_ms
from hil.drivers.split_axes import RigDrivers, make_drivers
from hil.drivers.wire_lock import locked_wires
from hil.errors import BenchError, DeviceError, LinkTimeout, Problem
from hil.loop.rate_keeper import WallClockRate
from hil.loop.safety_io_stage import SafetyIoStage, chain_kept_closed
from hil.preflight.check import PreflightCheck

_FIRST_SAMPLE_S = 5.0
_POLL_S = 0.01
_MEASURED_S = 0.5
_SETPOINT_S = 0.002
_FEW = 0.8


def hardware_checks(scenario: Scenario, rig: Rig, enable_drives: bool) -> list[PreflightCheck]:
    """Return the checks of clock, links and devices of a hardware rig. enable_drives: its axes are opened."""
    with locked_wires(rig):
        return wired_checks(scenario, rig, WallClock(), enable_drives)


def wired_checks(scenario: Scenario, rig: Rig, clock: WallClock, enable_drives: bool) -> list[PreflightCheck]:
    """Return the checks of clock, links and devices of a rig whose wires have addresses."""
    of_parts = [each for check in hooks("preflight", scenario, rig) for each in check(rig)]
    return [ptp_check(rig.clock), *port_checks(rig), *_devices(rig, scenario, clock, enable_drives), *of_parts]


def _devices(rig: Rig, scenario: Scenario, clock: WallClock, enable_drives: bool) -> list[PreflightCheck]:
    """Return the checks of the devices, with the safety chain closed for enabled ones."""
    drivers = make_drivers(rig, clock, scenario.step_s / rig.ticks(scenario.step_s))
    if rig.io is None or not rig.has_io:
        return device_checks(drivers, rig, clock, enable_drives)
    if not enable_drives:
        advice = "opened with --devices, which closes the safety chain"
        skipped = PreflightCheck("device io", None, "skipped", advice)
        return [skipped, *device_checks(drivers, rig, clock, enable_drives)]
    rate = WallClockRate(clock, scenario.step_s)
    lines = SafetyIoStage(rig.io.make_driver(clock), np.zeros(rig.io.thruster_lines, dtype=np.int64))
    try:
        lines.open(rate)
        with chain_kept_closed(lines, rate):
            enabled = "" if rig.io.inputs.local_enable is None else "local enabling input on, "
            fine = PreflightCheck(
                "device io", True, f"identified, emergency stop released, {enabled}safety chain closes"
            )
            return [fine, *device_checks(drivers, rig, clock, enable_drives)]
    except BenchError as error:
        advice = (
            "release the emergency stop, close the interlocks, switch the local enabling input on, "
            "check the coupler's link (docs/explanation/safety.md)"
        )
        return [PreflightCheck("device io", False, str(error), advice)]
    finally:
        lines.stop(clock.now_s())
        lines.close()


def device_checks(drivers: RigDrivers, rig: Rig, clock: WallClock, enable_drives: bool) -> list[PreflightCheck]:
    """Return a check for each axis group and the vision unit."""
    checks = []
    for name, group in drivers.axes.items():
        unit = "m" if rig.axis_groups[name].si_per_unit == 1.0 else "deg"
        if enable_drives:
            checks += _axes(group, unit, clock, _promised_hz(rig.axis_groups[name], name))
        else:
            advice = "opened with --devices, which enables its drives: they hold their positions"
            checks.append(PreflightCheck(f"device {group.name}", None, "skipped", advice))
    return [*checks, *([_source(drivers.poses, clock)] if rig.has_vmu else [])]


def _promised_hz(table: AxisGroupTable, name: str) -> float:
    """Return the setpoints per second that the wires of a group carry by their rates and frames."""
    wires = [part.entry.setpoints_hz(part) for part in table.parts(name).values() if part.has_wires]
    return min([table.exchanges_max_hz, *wires])


def _axes(group: AxisGroup, unit: str, clock: WallClock, promised_hz: float) -> list[PreflightCheck]:
    """Return the check of a group, and what its driver uses of the drives. promised_hz: by the wires of the rig."""
    facts: list[str] = []

    def sample() -> str:
        feedback = checked_feedback(group.name, group.read, group.read(clock.now_s()), len(group.axis_names))
        values = np.degrees(feedback.position) if unit == "deg" else feedback.position
        names = [name.rpartition(".")[2] for name in group.axis_names]
        positions = ", ".join(f"{name} {value:.3f}" for name, value in zip(names, values, strict=True))
        facts.extend(group.facts() if isinstance(group, Describes) else ())
        return f"identified, at {positions} {unit}{_exchange_rate(group, clock, promised_hz)}"

    def release() -> None:
        group.stop(clock.now_s())
        group.close()

    checked = _check_device(group.name, lambda: group.open(clock.now_s()), sample, release)
    return [checked, *(PreflightCheck(f"drives of {group.name}", True, fact) for fact in facts)]


def _exchange_rate(group: AxisGroup, clock: WallClock, promised_hz: float) -> str:
    """Return the exchanges per second that this line reaches, measured with setpoints at the present position."""
    if not isinstance(group, CountsPackets):
        return ""
    feedback, start_s = group.read(clock.now_s()), clock.now_s()
    sampled_s = {feedback.t_s}  # of all axes: some drivers count an exchange per drive
    while clock.now_s() < start_s + _MEASURED_S:
        group.send(feedback.position, np.zeros_like(feedback.position), clock.now_s())
        time.sleep(_SETPOINT_S)
        sampled_s.add(group.read(clock.now_s()).t_s)
    measured_hz = (len(sampled_s) - 1) / (clock.now_s() - start_s)
    text = f", {measured_hz:.0f} exchanges per second measured"
    if measured_hz > _FEW * promised_hz:
        return text
    causes = "an adapter that collects bytes, a gateway, or a busy host"
    return f"{text}, {promised_hz:.0f} by the rates of its wires: {causes}"


def _source(source: PoseSource, clock: WallClock) -> PreflightCheck:
    def sample() -> str:
        frames = [*checked_frames(source.name, source.poll, source.poll(clock.now_s()))]
        if not frames:
            raise LinkTimeout(source.name, "no pose")
        return f"pose at {np.linalg.norm(frames[-1].t_v):.3f} m from the camera"

    return _check_device(source.name, lambda: source.open(clock.now_s()), sample, source.close)


def _check_device(
    name: str, start: Callable[[], None], sample: Callable[[], str], release: Callable[[], None]
) -> PreflightCheck:
    """Open a device, wait for its first sample, and release it in any case."""
    try:
        call(name, start)
        return PreflightCheck(f"device {name}", True, _first_sample(lambda: call(name, sample)))
    except BenchError as error:
        advice = "check its power and its link (docs/how-to/set-up-a-rig.md); hil emulate starts a device that responds"
        return PreflightCheck(f"device {name}", False, str(error), advice)
    finally:
        with suppress(BenchError):
            call(name, release)


def _first_sample(sample: Callable[[], str]) -> str:
    """Wait for the first sample and return it."""
    deadline = time.monotonic() + _FIRST_SAMPLE_S
    while True:
        try:
            return sample()
        except LinkTimeout:
            if time.monotonic() > deadline:
                raise
            time.sleep(_POLL_S)


_NETWORK = Path("/sys/class/net")


def port_checks(rig: Rig) -> list[PreflightCheck]:
    """Return a check per link of ``rig``; a kind without a check is reported as not checked."""
    checks = {"serial": _serial, "tcp": _tcp, "udp": _udp, "can": _can}
    return [
        checks[wire.kind](wire.key, wire.address)
        if wire.kind in checks
        else PreflightCheck(f"wire {wire.key}", None, f"{wire.address}: not checked, no port of this computer")
        for wire in rig.wires()
        if wire.address is not None
    ]


def _serial(key: str, address: str) -> PreflightCheck:
    name = f"port {key}"
    if not Path(address).exists():
        present = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
        return PreflightCheck(
            name, False, f"{address}: no such port", f"connect it or correct the key; present: {present}"
        )
    if not os.access(address, os.R_OK | os.W_OK):
        group = _group_of(address)
        advice = f"sudo usermod -aG {group} $USER, then log in again"
        return PreflightCheck(name, False, f"{address}: no read and write permission for this user", advice)
    timer_ms = latency_timer_ms(address)
    timer = "" if timer_ms is None else f", its adapter collects bytes for {timer_ms} ms until a driver opens it"
    return PreflightCheck(name, True, f"{address}: readable and writable{timer}")


def _group_of(path: str) -> str:
    try:
        return Path(path).group()
    except (OSError, KeyError):
        return "dialout"


def _tcp(key: str, address: str) -> PreflightCheck:
    name = f"host {key}"
    host, _, port = address.rpartition(":")
    try:
        resolved = socket.getaddrinfo(host, int(port), type=socket.SOCK_STREAM)[0][4][0]
    except OSError as error:
        advice = "correct the key, or add the host to /etc/hosts"
        return PreflightCheck(name, False, f"{address}: {error.strerror or error}", advice)
    return PreflightCheck(name, True, address if resolved == host else f"{address} is {resolved}")


def _udp(key: str, address: str) -> PreflightCheck:
    name = f"UDP port {key}"
    host, _, port = address.rpartition(":")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.bind((host, int(port)))
        except OSError as error:
            advice = "give an address of this computer and a port that no other program uses"
            return PreflightCheck(name, False, f"{address}: {error.strerror or error}", advice)
    return PreflightCheck(name, True, f"{address}: free")


def _can(key: str, address: str) -> PreflightCheck:
    name = f"CAN {key}"
    state = _NETWORK / address / "operstate"
    if not state.exists():
        advice = f"connect {address} or create it with ip link add; see ip -details link"
        return PreflightCheck(name, False, f"{address}: no such interface", advice)
    operstate = state.read_text(encoding="ascii").strip()
    if operstate == "down":
        return PreflightCheck(name, False, f"{address}: down", f"sudo ip link set {address} up type can bitrate ...")
    return PreflightCheck(name, True, f"{address}: {operstate}")


def ptp_check(clock: ClockConfig) -> PreflightCheck:
    """Return state and offset of PTP; a note unless ``clock.ptp_max_offset_us`` requires it."""
    advice = "start ptp4l, and phc2sys for a clock of the network card (docs/how-to/prepare-the-computer.md)"
    try:
        status = read_status(clock.ptp_socket, clock.ptp_domain)
    except DeviceError as error:
        required = clock.ptp_max_offset_us is not None
        return PreflightCheck("PTP", False if required else None, str(error), advice if required else "")
    value = str(status)
    if clock.ptp_max_offset_us is None:
        return PreflightCheck("PTP", None, value)
    problem = ptp_problem(clock)
    return PreflightCheck(
        "PTP", not problem, problem or f"{value}, allowed {clock.ptp_max_offset_us:g} us", advice if problem else ""
    )


def check_clock(_: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem if the clock is farther from its PTP master than ``clock.ptp_max_offset_us``.

    A mock rig has no clock that could be synchronised.
    """
    fault = "" if rig.value.kind == "mock" else ptp_problem(rig.value.clock)
    key = "clock.ptp_max_offset_us"
    return [Problem(rig.where(key), f"rig.{key}", f"{rig.value.clock.ptp_max_offset_us:g}: {fault}")] if fault else []


def ptp_problem(clock: ClockConfig) -> str:
    """Return why the clock does not keep the limit of ``clock``, "" if it does, or if there is none."""
    if clock.ptp_max_offset_us is None:
        return ""
    try:
        return read_status(clock.ptp_socket, clock.ptp_domain).problem(1e-6 * clock.ptp_max_offset_us)
    except DeviceError as error:
        return str(error)
