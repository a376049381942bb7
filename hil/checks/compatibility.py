"""Compatibility checks of scenario, rig and host; each returns a list of problems."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hil.bench.kinematics import SETPOINTS_KEPT
from hil.checks.abort import check_transfers
from hil.checks.modes import check_modes
from hil.checks.reachability import check_reachability
from hil.checks.target_motion import check_target_motion
from hil.checks.vehicle import check_vehicle
from hil.config.load import Loaded, load_scene
from hil.config.motion_digest import motion_digest
from hil.config.rig import BENCH_AXES, AxisGroupTable, Rig
from hil.config.scenario import Scenario
from hil.config.tables.limits import excess, scenario_limits
from hil.core.messages import MAX_THRUSTERS
from hil.errors import BadInput, Problem
from hil.gnc.approach_monitor import ACROSS, ALONG, ATTITUDE, alert_limits
from hil.maths import linear
from hil.params import bench as bench_params
from hil.params import gnc as gnc_params

if TYPE_CHECKING:
    from hil.config.scene import Scene

_NOISE_SIGMAS = 3.0  # standard deviations of a pose that an alert limit must exceed
_RATE_MAX_HZ = 10_000.0
_RATIO_TOLERANCE = 1e-9
_ROUNDING_HZ = 0.5  # rounding of a wire's capacity in messages
_MEMORY_STEPS_MAX = (
    20_000  # each of them 3 kB, 20 kB with an error budget, and a few microseconds when a pose is that late
)


def check_plan(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems of the plan: of the target's motion, of the rig's reach, and of the thruster layout."""
    try:
        gnc_params.allocation(scenario.value.chaser)
    except ValueError as error:
        return [scenario.problem("chaser.thrusters.position_m", str(error))]
    problems = (
        _check_sharing(scenario, rig)
        or check_modes(scenario)
        or check_transfers(scenario)
        or [
            *check_vehicle(scenario),
            *check_target_motion(scenario, rig),
            *(check_reachability(scenario, rig) if rig.value.floating is None else []),
        ]
    )
    if problems or rig.value.arm is None:
        return problems
    from hil.checks.arm import check_arm  # of few rigs

    return check_arm(scenario, rig)


def _check_sharing(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems of a target on rails that move: scaled distances, a keep-out that grows too far."""
    rails, value = rig.value.shared_rails, scenario.value
    if rails is None:
        where, key = rig.where("bench.bodies"), "rig.bench.bodies"
        text = 'on = "target" requires target_manipulator.sharing, allowed "lab"'
        return [Problem(where, key, text) for body in rig.value.bench.bodies if body.on == "target"][:1]
    if value.bench.scaled_beyond_m is not None:
        key, text = "bench.scaled_beyond_m", "does not go with target_manipulator.sharing, allowed none"
        return [scenario.problem(key, f"{value.bench.scaled_beyond_m:g}: {text}")]
    radius_m = float(bench_params.bench_guard(rig.value, value).zone.radius)
    grown = value.model_copy(update={"keep_out": value.keep_out.model_copy(update={"radius_m": radius_m})})
    if radius_m == value.keep_out.radius_m or not check_keep_out(replace(scenario, value=grown)):
        return []
    key = "target_manipulator.path_s"
    text = f"at {rails.path_speed_mps:.2g} m/s keep_out.radius_m grows to {radius_m:.3g} m, beyond a point of the plan"
    return [Problem(rig.where(key), f"rig.{key}", text)]


def check_approach(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for each speed of a phase above the closing-rate limit and each alert limit below the noise."""
    gnc = scenario.value.gnc
    problems = []
    limit = gnc.corridor.closing_rate_max_mps
    for name in gnc.guidance.sequence:
        phase = gnc.guidance.phases[name]
        own = phase.speed_mps is not None
        speed = phase.speed_mps if phase.speed_mps is not None else gnc.guidance.approach_speed_mps
        if phase.kind in ("approach", "final") and speed >= limit:
            key = f"gnc.guidance.phases.{name}.speed_mps" if own else "gnc.guidance.approach_speed_mps"
            text = f"{speed:g}: must be below gnc.corridor.closing_rate_max_mps, {limit:g}"
            problems.append(scenario.problem(key, text))
    return [*problems, *_check_alert_limits(scenario)]


def _check_alert_limits(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for each alert limit at the ready point that the noise of a single pose exceeds."""
    value = scenario.value
    if not value.gnc.fuses_imu:
        return []
    settings, vmu = value.integrity, value.vmu
    distance = linear.length(value.gnc.guidance.ready_point_m)
    scale = max(1.0, distance / vmu.reference_range_m) * _NOISE_SIGMAS
    limits = np.empty(3)
    params = gnc_params.approach_monitor(value)
    alert_limits(
        params, np.array(value.gnc.guidance.ready_point_m), np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]), limits
    )
    problems = []
    for name, limit, noise, unit in (
        ("alert_axial_m", limits[ALONG], scale * vmu.sigma_position_m, "m"),
        ("alert_corridor_fraction", limits[ACROSS], scale * vmu.sigma_position_m, "m"),
        ("alert_attitude_deg", math.degrees(limits[ATTITUDE]), scale * vmu.sigma_angle_deg, "deg"),
    ):
        if limit < noise:
            key, given = f"integrity.{name}", getattr(settings, name)
            text = (
                f"{given:g}: the alert limit at the ready point is {limit:.4g} {unit} and must be at least "
                f"{noise:.4g} {unit}, {_NOISE_SIGMAS:g} sigma of a pose"
            )
            problems.append(scenario.problem(key, text))
    return problems


def check_keep_out(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem if the plan has a point in the sphere or the half-space of the keep-out."""
    value, key = scenario.value, "keep_out.radius_m"
    radius_m, guidance = value.keep_out.radius_m, value.gnc.guidance
    points = {"initial.position_m": value.initial.position_m, "gnc.guidance.ready_point_m": guidance.ready_point_m}
    for name in guidance.sequence:
        if (point := guidance.phases[name].point_m) is not None:
            points[f"gnc.guidance.phases.{name}.point_m"] = point
    distances = {name: linear.length(point) for name, point in points.items()}
    distances["requirements.axial_distance_m"] = value.requirements.axial_distance_m
    name = min(distances, key=distances.__getitem__)
    if value.keep_out.has_corridor:
        return []
    if distances[name] > radius_m:
        return _beyond_half_space(scenario, points)
    text = f"{radius_m:g}: must be below {distances[name]:g}, the distance of {name}, or 0 for a scenario that docks"
    return [scenario.problem(key, text)]


def _beyond_half_space(scenario: Loaded[Scenario], points: Mapping[str, Sequence[float]]) -> list[Problem]:
    """Return a problem for the first of ``points`` of the plan, m, in H, that is in the half-space."""
    value = scenario.value
    if value.keep_out.inspects:
        return []
    along = {name: float(linear.product(value.gnc.corridor.axis, point)) for name, point in points.items()}
    name = min(along, key=along.__getitem__)
    if along[name] > value.keep_out.radius_m:
        return []
    text = (
        f"{list(points[name])}: {along[name]:g} m from the target along the docking axis, allowed more than "
        f"{value.keep_out.radius_m:g} by keep_out.radius_m, or keep_out.inspects = true"
    )
    return [scenario.problem(name, text)]


def check_scenario_limits(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each protective limit of the scenario that is weaker than the kind of rig accepts."""
    exceeded = excess(scenario_limits(rig.value.has_vmu), scenario.value, rig.value.kind)
    return [scenario.problem(key, text) for key, text in exceeded]


def check_host(rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem if this process cannot use the CPU of the loop."""
    cpu, present = rig.value.host.cpu, sorted(os.sched_getaffinity(0))
    if cpu is None or cpu in present:
        return []
    text = f"{cpu}: this computer has {', '.join(map(str, present))}"
    return [Problem(rig.where("host.cpu"), "rig.host.cpu", text)]


def check_rates(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems of the rates of IMU, axes and telemetry: of their ratio to the cycle's, and of the wires."""
    step_s = scenario.value.step_s
    imu_hz, axes_hz = scenario.value.imu.rate_hz, rig.value.bench.axes_rate_hz
    problems = []
    for source, key, rate_hz in (
        (scenario.where("imu.rate_hz"), "imu.rate_hz", imu_hz),
        (rig.where("bench.axes_rate_hz"), "rig.bench.axes_rate_hz", axes_hz),
    ):
        ratio = 1.0 if rate_hz is None else rate_hz * step_s
        if abs(ratio - round(ratio)) > _RATIO_TOLERANCE * ratio or round(ratio) < 1:
            text = f"{rate_hz:g}: allowed are multiples of the cycle's rate, {1.0 / step_s:g} Hz (step_s {step_s:g})"
            problems.append(Problem(source, key, text))
        elif rate_hz is not None and rate_hz > _RATE_MAX_HZ:
            problems.append(Problem(source, key, f"{rate_hz:g}: at most {_RATE_MAX_HZ:g} are allowed"))
    key, rate_hz = "telemetry.rate_hz", rig.value.telemetry.rate_hz
    if rate_hz is not None and abs(rate_hz * step_s * rig.value.telemetry_cycles(step_s) - 1.0) > _RATIO_TOLERANCE:
        text = f"{rate_hz:g}: allowed is the cycle's rate, {1.0 / step_s:g} Hz, divided by a whole number"
        problems.append(Problem(rig.where(key), f"rig.{key}", text))
    if (target := rig.value.moving_target) is not None and rig.value.ticks(scenario.value.step_s) > 1:
        name = "rotary_manipulator" if target is rig.value.rotated_target else "target_manipulator.sharing"
        text = f"{axes_hz:g}: does not go with {name}, allowed {1.0 / step_s:g}, the cycle's rate"
        problems.append(Problem(rig.where("bench.axes_rate_hz"), "rig.bench.axes_rate_hz", text))
    return problems or [*_wire_problems(scenario, rig), *_jerk_problems(scenario, rig)]


def _jerk_problems(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each axis whose limit of the jerk averages more setpoints than are kept."""
    value = rig.value
    period_s = scenario.value.step_s / value.ticks(scenario.value.step_s)
    problems = []
    for device, table in (("rails", value.rails), ("turntable", value.turntable)):
        for name, axis in zip(table.axis_names, table.axes, strict=True):
            key, jerk = f"{device}.{name}.{axis.key_of('jerk_max')}", axis.in_file("jerk_max")
            if jerk is not None and axis.averaging_s > SETPOINTS_KEPT * period_s:
                least = jerk * axis.averaging_s / (SETPOINTS_KEPT * period_s)
                text = f"{jerk:g}: allowed from {least:.3g} at {1.0 / period_s:g} setpoints per second"
                problems.append(Problem(rig.where(key), f"rig.{key}", text))
    return problems


def _wire_problems(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each wire that cannot carry its messages.

    These are the frames of the vision unit, and the exchanges of each axis group: the file's, else one per setpoint.
    """
    axes_hz, step_s = rig.value.bench.axes_rate_hz, scenario.value.step_s
    if axes_hz is not None:
        source, key, value, setpoints_hz = rig.where("bench.axes_rate_hz"), "rig.bench.axes_rate_hz", axes_hz, axes_hz
    else:
        source, key, value, setpoints_hz = scenario.where("step_s"), "step_s", step_s, 1.0 / step_s
    problems, held = [], "target_manipulator" if rig.value.shared_rails is None else ""
    for name, table in rig.value.device_tables().items():
        if not (isinstance(table, AxisGroupTable) and table.has_wires):
            continue
        most_hz, own_hz = table.entry.setpoints_hz(table), table.exchange_rate_max_hz
        own = f"{name}.exchange_rate_max_hz"
        carries = f"the wire of {name} ({table.driver}) carries {most_hz:.0f}"
        if own_hz is not None and own_hz > most_hz + _ROUNDING_HZ:
            problems.append(Problem(rig.where(own), f"rig.{own}", f"{own_hz:g}: {carries} exchanges per second"))
        elif own_hz is None and setpoints_hz > most_hz and name != held:
            text = f"{value:g}: {setpoints_hz:g} setpoints per second, {carries}; rig.{own} limits the exchanges"
            problems.append(Problem(source, key, text))
    vmu = rig.value.vmu
    most_hz = vmu.entry.setpoints_hz(vmu) if vmu.has_wires else math.inf
    if vmu.rate_hz > most_hz:
        text = f"{vmu.rate_hz:g}: the wire of vmu ({vmu.driver}) carries {most_hz:.0f} frames per second"
        problems.append(Problem(rig.where("vmu.rate_hz"), "rig.vmu.rate_hz", text))
    return problems


def check_memory(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem if poses arrive later than the filters remember, or if they remember too many steps."""
    value = scenario.value
    navigation, vmu = value.gnc.navigation, value.vmu
    if not value.gnc.fuses_imu:
        return []
    key = "gnc.navigation.memory_s"
    if value.memory_steps > _MEMORY_STEPS_MAX:
        text = (
            f"{navigation.memory_s:g}: {value.memory_steps} steps of {value.sample_s:g} s, allowed {_MEMORY_STEPS_MAX}"
        )
        return [scenario.problem(key, text)]
    parts = [f"vmu.latency_s {vmu.latency_s:g}", f"vmu.latency_jitter_s {vmu.latency_jitter_s:g}"]
    oldest_s = vmu.latency_s + vmu.latency_jitter_s + 2.0 * value.step_s
    if rig.value.vmu.has_wires:
        parts.append(f"rig.vmu.processing_s {rig.value.vmu.processing_s:g}")
        oldest_s += rig.value.vmu.processing_s
    if oldest_s > navigation.memory_s:
        text = f"{navigation.memory_s:g}: allowed from {oldest_s:g}, the age of the latest poses ({', '.join(parts)})"
        return [scenario.problem(key, text)]
    return []


def check_budget(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each place on which the error budget of the GNC and the rig disagree."""
    budget, bench = scenario.value.gnc.navigation.budget, rig.value.bench
    if budget.is_empty:
        return []
    problems = []
    for name in ("camera_position_m", "led_ring_position_m"):
        assumed, mounted = getattr(budget, name), getattr(bench, name)
        if assumed != mounted:
            text = f"{list(assumed)}: must be bench.{name} of the rig, {list(mounted)}"
            problems.append(scenario.problem(f"gnc.navigation.budget.{name}", text))
    return problems


def check_drivers(rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems of the files that drivers use, such as a protocol file or an EDS."""
    try:
        driver_warnings(rig.value)
    except BadInput as error:
        return list(error.problems)
    return []


def driver_warnings(rig: Rig) -> list[str]:
    """Return a line per protection that the devices' command sets leave out. Raises BadInput for an unusable file."""
    tables = [table for table in rig.device_tables().values() if table.has_wires]
    return [line for table in tables for line in table.entry.check_files(table)]


def check_ports(rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each serial port of a hardware rig that does not exist on this computer."""
    if rig.value.kind != "hardware":
        return []
    from serial.tools import list_ports

    present = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
    return [
        rig.problem(wire.key, f"{wire.address}: no such port, this computer has {present}")
        for wire in rig.value.wires()
        if wire.kind == "serial" and (wire.address or "").startswith("/") and not Path(str(wire.address)).exists()
    ]


def check_flight_computer(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems that prevent the reception of a flight computer's command words."""
    computer = rig.value.flight_computer
    if computer.command_words == "none":
        return []
    text = f'another GNC is given: rig.flight_computer.command_words = "{computer.command_words}"'
    keys = {f"gnc.{part}.backend": name for part, name in scenario.value.gnc.foreign.items()}
    if keys:
        return [scenario.problem(key, f'"{name}": {text}') for key, name in keys.items()]
    if rig.value.kind == "mock":
        key = "flight_computer.command_words"
        text = f'"{computer.command_words}": a mock rig does not run in real time, as a flight computer requires'
        return [Problem(rig.where(key), f"rig.{key}", text)]
    missing = [wire.key for wire in computer.wires() if wire.address is None]
    return [Problem(rig.where(key), f"rig.{key}", "is missing: the link of the command words") for key in missing]


def check_monitor(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems of the docking monitor and its scene, if the run has a monitor."""
    monitor = scenario.value.monitor
    if monitor.source == "none":
        return []
    if monitor.source == "model" and rig.value.kind == "hardware":
        text = '"model": would vouch for a bench that it does not see; on hardware "none" or "rendered"'
        return [scenario.problem("monitor.source", text)]
    try:
        scene = load_scene(monitor.scene).value
    except BadInput as error:
        return list(error.problems)
    if monitor.source == "camera" and (problems := _monitor_camera_problems(scenario, rig, scene)):
        return problems
    if monitor.target == "backup" and scene.backup is None:
        text = f'"backup": scene {monitor.scene} has the basic target alone'
        return [scenario.problem("monitor.target", text)]
    return []


def _monitor_camera_problems(scenario: Loaded[Scenario], rig: Loaded[Rig], scene: Scene) -> list[Problem]:
    key, where = "monitor.source", scenario.where("monitor.source")
    if rig.value.kind == "mock":
        return [Problem(where, key, f'"camera": rig "{rig.value.name}" is in memory, use one on wires, as emulated')]
    if rig.value.kind == "hardware" and rig.value.monitor_camera.camera is None:
        return [Problem(rig.where("monitor_camera.camera"), "rig.monitor_camera.camera", "is missing")]
    if scene.fields != "whole":
        return [Problem(where, key, f'"camera": scene {scenario.value.monitor.scene} has half frames, use whole ones')]
    return []


def check_io(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem if there are too few digital lines for the thrusters, or the cycle is too slow for the relay."""
    io = rig.value.io
    if io is None or not rig.value.has_io:
        return []
    problems = []
    count = len(scenario.value.chaser.thrusters.position_m)
    if 0 < io.thruster_lines < count:
        key = "io.thruster_lines"
        text = f"{io.thruster_lines}: allowed {count} to {MAX_THRUSTERS} for the scenario's thrusters, or 0 for none"
        problems.append(Problem(rig.where(key), f"rig.{key}", text))
    if io.has_wires and scenario.value.step_s > 0.5 * io.pump_timeout_s:
        key = "io.pump_timeout_s"
        text = f"{io.pump_timeout_s:g}: must be twice the scenario's step_s, {scenario.value.step_s:g}, or more"
        problems.append(Problem(rig.where(key), f"rig.{key}", text))
    return problems


def requires_sign_off(rig: Rig) -> bool:
    """Return whether hardware moves, and its sign-off is not waived."""
    return rig.kind == "hardware" and not (rig.sign_off is not None and rig.sign_off.waived)


def check_sign_off(rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem if hardware is not commissioned with its present rig file, unless that is waived."""
    if not requires_sign_off(rig.value):
        return []
    reason = sign_off_gap(rig.value)
    advice = f"commission it with hil commission {rig.source}, or set rig.sign_off.waived=true"
    return [Problem(rig.source, "rig.sign_off", f"{reason}: {advice}")] if reason else []


def sign_off_gap(rig: Rig) -> str:
    """Return why the rig is not signed off, "" if it is. Raises BadInput for an unreadable file."""
    sign_off = rig.sign_off
    if sign_off is None:
        return "is missing"
    if sign_off.digest is None:
        digest = motion_digest(rig)
        signed = {name for name, axis in sign_off.axes.items() if axis.digest == digest}
        missing = ", ".join(name for name in BENCH_AXES if name not in {*signed, *rig.undriven})
        return f"is not complete, missing: {missing or 'the dry run'}"
    if sign_off.digest != motion_digest(rig):
        return f"is invalid: the rig was changed after its sign-off on {sign_off.date}"
    return ""
