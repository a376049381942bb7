"""Bench in memory as kernels: axes, exposures of the vision unit, measurements of the docking monitor, thruster lines.

A mock in Python (``hil.drivers``) and the compiled shell (``hil.loop.compiled.run_cycles``) move the same state.
"""

from __future__ import annotations

import numpy as np

from hil.bench import kinematics
from hil.bench.kinematics import BENCH_PARAMS
from hil.core.jit import entry, kernel
from hil.core.messages import MAX_THRUSTERS
from hil.dynamics.truth import rate_against_hill
from hil.maths import stack
from hil.models.axis_faults import NOMINAL_AXES
from hil.models.camera_timing import TRAVEL, delays, exposure_time
from hil.models.faults import FAULTS
from hil.models.servo import SERVO, move_servo, send_to_servo, servo_step_of_two
from hil.sensors.measurement import deliver, is_any_due, measure
from hil.sensors.mounting import MOUNTING
from hil.sensors.vision_unit.camera import CAMERA
from hil.sensors.vision_unit.errors import VISION_MEMORY
from hil.sensors.vision_unit.model import VISION_PARAMS, measure_frame
from hil.sensors.vision_unit.transit import FRAME_TRANSIT, put_exposure
from hil.sensors.vision_unit.transit import receive_frames as receive_from

MOCK_PARAMS = np.dtype(
    [
        ("vmu_rate_hz", "f8"),
        ("vmu_timeout_s", "f8"),
        ("thruster_lines", "i8"),  # thrusters mirrored to digital lines
        ("vision", VISION_PARAMS),
        ("travel", TRAVEL),
        ("camera", CAMERA),
        ("axis_faults", FAULTS),
        ("nominal_axes", NOMINAL_AXES),
        ("bench", BENCH_PARAMS),  # as the machine is built
        ("mounting", MOUNTING),
    ],
    align=True,
)

MOCK_STATE = np.dtype(
    [
        ("rails", SERVO),
        ("turntable", SERVO),
        ("transit", FRAME_TRANSIT),
        ("vision_memory", VISION_MEMORY),
        ("lines", "i8", MAX_THRUSTERS),  # as mirrored
        ("lines_changed_s", "f8"),  # bench time, nan without lines
    ],
    align=True,
)


@kernel
def _move_axes(mock, now_s):
    """Move rails and turntable to ``now_s``."""
    rails, turntable = mock.rails, mock.turntable
    left_s = now_s - rails.t_s
    if rails.t_s != turntable.t_s:
        move_servo(rails, now_s)
        move_servo(turntable, now_s)
    elif left_s > 0.0:
        rails.t_s = turntable.t_s = now_s
        servo_step_of_two(rails, turntable, left_s)


@entry
def read_axes(state, now_s):
    """Write the encoders' values at ``now_s`` of bench time, and their time, into the present row."""
    mock, now = state.mock, state.now
    _move_axes(mock, now_s)
    rails, turntable, feedback = mock.rails, mock.turntable, state.now.feedback
    kinematics.write_axes(rails.position, rails.rate, turntable.position, turntable.rate, feedback)
    for i in range(3):
        feedback.rail_m[i] += rails.encoder_offset[i]
        feedback.gimbal_rad[i] += turntable.encoder_offset[i]
    now.sampled_s[0] = now.sampled_s[1] = now_s - state.zero_s


@entry
def expose(params, state, until_s, first, vision_noise, travel_draws, leds, frames, stats):
    """Write the frames that the vision unit exposes up to ``until_s`` into ``frames``, in transit.

    first: number of the exposure of the first row of noise and draws.
    """
    mock, late = state.mock, stack.vector(2)
    r, q = stack.vector(3), stack.vector(4)
    while True:
        t_s = exposure_time(mock.transit.next_exposure, params.mock.vmu_rate_hz)
        if t_s > until_s:
            return
        row = mock.transit.next_exposure - first
        _move_axes(mock, t_s)
        kinematics.pose_on_bench(params.mock.bench, mock.rails.position, mock.turntable.position, r, q)
        measure_frame(
            params.mock.vision, params.mock.camera, leds, params.mock.mounting, r, q, vision_noise[row], t_s,
            mock.vision_memory, frames[mock.transit.in_transit],
        )  # fmt: skip
        if params.counts != 0:
            margin = mock.vision_memory.view_margin
            if margin < 0.0 and not stats.view_margin < 0.0:
                stats.view_lost_s = t_s - state.zero_s
            if margin < stats.view_margin:
                stats.view_margin, stats.view_margin_s = margin, t_s - state.zero_s
        copies = delays(params.mock.travel, travel_draws[row], late)
        put_exposure(mock.transit, frames, t_s, late, copies)


@entry
def receive_frames(params, state, now_s, frames):
    """Put the frames that arrive by ``now_s`` first in ``frames``; return their number, -1 after a silence too long."""
    transit = state.mock.transit
    n = receive_from(transit, now_s, frames)
    return -1 if now_s - transit.last_rx_s > params.mock.vmu_timeout_s else n


@kernel
def measure_sensors(params, state, t_s):
    """Let the modelled sensors measure that are due, and pass what has arrived on to the navigation."""
    if is_any_due(params.sensors, state.sensors, t_s):
        r, q, rate = stack.vector(3), stack.vector(4), stack.vector(3)
        kinematics.pose_of_axes(params.mock.bench, state.mock.rails.position, state.mock.turntable.position, r, q)
        rate_against_hill(state.now.truth, rate)
        measure(params.sensors, state.sensors, t_s, state.now.truth, rate, r, q)
    deliver(state.sensors, t_s, state.gnc.navigation.fusion.sensors)


@kernel
def mirror_thrusters(params, state, now_s):
    """Write the digital lines if a thruster has changed; the relay stays closed, as its pump is pulsed each cycle."""
    mock, changed = state.mock, False
    state.now.on_wire_s = mock.lines_changed_s - state.zero_s  # as the coupler was read, at the start of the cycle
    for i in range(params.mock.thruster_lines):
        if state.now.command.on[i] != mock.lines[i]:
            mock.lines[i] = state.now.command.on[i]
            changed = True
    if changed:
        mock.lines_changed_s = now_s


@kernel
def send_setpoint(mock, setpoint, now_s, rails, gimbals):
    """Send ``setpoint`` (AXES); write the accepted positions, (3,) each. Return False if a number is not finite."""
    return send_to_servo(mock.rails, setpoint.rail_m, setpoint.rail_mps, now_s, rails) and send_to_servo(
        mock.turntable, setpoint.gimbal_rad, setpoint.gimbal_radps, now_s, gimbals
    )
