"""Whether a scenario and a rig suit each other: what shows only when the two meet, one problem a line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from serial.tools import list_ports

from hil import parameters
from hil.bench.kinematics import axes_of_pose
from hil.config.load import Loaded, load_protocol
from hil.config.rig import GIMBAL_NAMES, RAIL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.errors import BadInput, Problem
from hil.maths import euler
from hil.messages import AXES, new


def axes_at(scenario: Scenario, rig: Rig, position_m: Sequence[float], attitude_deg: Sequence[float]) -> np.record:
    """Return AXES, at rest, for the chaser at ``position_m`` in H with the 3-2-1 angles ``attitude_deg``."""
    axes = new(AXES)
    rest = np.zeros(3)
    q = euler.to_quaternion(np.radians(attitude_deg), parameters.YAW_PITCH_ROLL)
    axes_of_pose(parameters.bench(rig, scenario.step_s), np.array(position_m), rest, q, rest, axes)
    return axes


def layout_problems(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem where the thrusters cannot move an axis."""
    try:
        parameters.allocation(scenario.value.chaser)
    except ValueError as error:
        key = "chaser.thrusters.position_m"
        return [Problem(scenario.where(key), key, str(error))]
    return []


def pose_problems(scenario_file: Loaded[Scenario], rig_file: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each axis that cannot take the start pose or a point that the approach goes to."""
    scenario, rig = scenario_file.value, rig_file.value
    params = parameters.bench(rig, scenario.step_s)
    ready = scenario.gnc.guidance.ready_point_m
    problems = []
    level = (0.0, 0.0, 0.0)
    poses = [
        ("initial.position_m", scenario.initial.position_m, scenario.initial.attitude_deg),
        ("gnc.guidance.ready_point_m", ready, level),
    ]
    for name in scenario.gnc.guidance.sequence:
        point = scenario.gnc.guidance.phases[name].point_m
        if point is not None:
            poses.append((f"gnc.guidance.phases.{name}.point_m", point, level))
    for key, position, attitude in poses:
        axes = axes_at(scenario, rig, position, attitude)
        source = scenario_file.where(key)
        for i, (rail, gimbal) in enumerate(zip(RAIL_NAMES, GIMBAL_NAMES, strict=True)):
            value, low, high = axes.rail_m[i], params.low[i], params.high[i]
            if not low <= value <= high:
                text = f"{list(position)}: rails.{rail} would go to {value:.3f} m, allowed {low:g} to {high:g} m"
                problems.append(Problem(source, key, text))
            angle, least, most = np.degrees([axes.gimbal_rad[i], params.low[3 + i], params.high[3 + i]])
            if not least <= angle <= most:
                text = (
                    f"{list(attitude)}: turntable.{gimbal} would go to {angle:.2f} deg, "
                    f"allowed {least:g} to {most:g} deg"
                )
                problems.append(Problem(source, "initial.attitude_deg", text))
    return problems


def approach_problems(scenario: Loaded[Scenario]) -> list[Problem]:
    """Return a problem for each phase that closes in faster than its own supervision allows."""
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
            problems.append(Problem(scenario.where(key), key, text))
    return problems


def turntable_problems(rig: Loaded[Rig]) -> list[Problem]:
    """Return the problems of the protocol file or EDS that the turntable's driver goes by."""
    config = rig.value.turntable
    try:
        if config.driver == "ascii" and config.ascii is not None:
            load_protocol(config.ascii.protocol)
        elif config.driver == "cia402" and config.cia402 is not None:
            from hil.drivers.turntable.cia402_eds import Eds  # not without need: canopen takes its time

            Eds.of(config.cia402, homing=any(getattr(config, name).encoder == "incremental" for name in GIMBAL_NAMES))
    except BadInput as error:
        return list(error.problems)
    return []


def turntable_warnings(rig: Rig) -> list[str]:
    """Return a line for each protection that the turntable's command set goes without."""
    config = rig.turntable
    return load_protocol(config.ascii.protocol).value.warnings() if config.driver == "ascii" and config.ascii else []


def port_problems(rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each serial port of a hardware rig that this computer does not have."""
    value = rig.value
    if value.kind != "hardware":
        return []
    named: list[tuple[str, str | None]] = []
    if value.turntable.driver == "ascii" and value.turntable.ascii is not None:
        named.append(("turntable.ascii.port", value.turntable.ascii.port))
    can = value.turntable.cia402
    if value.turntable.driver == "cia402" and can is not None and can.interface in ("serial", "slcan"):
        named.append(("turntable.cia402.channel", can.channel))
    if value.vmu.rs422 is not None:
        named.append(("vmu.rs422.port", value.vmu.rs422.port))
    present = ", ".join(sorted(port.device for port in list_ports.comports())) or "none"
    return [
        Problem(rig.where(key), key, f"{port}: no such port, this computer has {present}")
        for key, port in named
        if port is not None and port.startswith("/") and not Path(port).exists()
    ]
