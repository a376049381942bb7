"""Vision unit and further sensors of an emulated rig: what they measure of the emulated axes, and when it arrives.

A module of its own because its imports (cameras, scipy) take longer than all of another device's emulator.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.bench.manipulator import relative_axes
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.sensors import SensorConfig, device_of
from hil.core.camera_images import ThreadedImageSink
from hil.core.clock import BenchClock
from hil.core.kernel_record import kernel_record
from hil.core.line_protocol import LineProtocol
from hil.core.messages import Array, PoseFrame
from hil.core.sensor_records import NORMALS
from hil.drivers.datagrams import DatagramSender
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.transport import Transport
from hil.frmn.image_memory import ImageMemory
from hil.maths import quat
from hil.models.faults import SEED_BITS
from hil.params import bench as bench_params
from hil.params.sensors import sensors_of, settings_row
from hil.parts.emulation.line_sensor import LineSensorEmulator, SensorFrames
from hil.parts.emulation.shared_state import SharedAxisState
from hil.sensors.measurement import noise_of
from hil.sensors.module import SensorKind
from hil.sensors.trial import Trial
from hil.session.assembly import start_axes
from hil.session.pose_model import make_pose_sensor, transport

SeenAxes = Callable[[float], tuple[Array, Array]]
"""Rails, m, and turntable, rad, (3,) each, that show at a bench time what the cameras see."""


class EmulatedVision(NamedTuple):
    """What the emulator of a vision unit is made of: pose at a bench time, transport of frames, end of the images."""

    pose_at: Callable[[float], PoseFrame | None]
    transport: Transport
    at_end: Callable[[], None]


def seen_axes(scenario: Scenario, rig: Rig, board: SharedAxisState) -> SeenAxes:
    """Return what the cameras of a bench see of the axes of ``board``, relative to the target where it is rotated."""
    bench, manipulator = (
        bench_params.bench_as_built(rig, scenario.step_s, scenario.bench),
        bench_params.manipulator(rig),
    )

    def seen(t_s: float) -> tuple[Array, Array]:
        rails, gimbals = board.read("rails", t_s)[0], board.read("turntable", t_s)[0]
        if manipulator is None:
            return rails, gimbals
        return relative_axes(bench, manipulator, rails, gimbals, board.read("target", t_s)[0])

    if manipulator is not None:
        relative_axes(bench, manipulator, np.zeros(3), np.zeros(3), np.zeros(3))  # compiles
    return seen


def emulated_vision(
    scenario: Scenario, rig: Rig, seed: int, board: SharedAxisState, image_memory: Sequence[int] | None
) -> EmulatedVision:
    """Return a vision unit that observes the axes of ``board``; its kernels are compiled when this returns."""
    encoder = ImageMemory(*image_memory).encoder(rig) if image_memory else None
    images = ThreadedImageSink(encoder) if encoder else None  # a thread: the unit keeps time
    sensor = make_pose_sensor(scenario, rig, seed, images)
    warm_up = make_pose_sensor(scenario, rig, seed)  # compiles; the noise of ``sensor`` stays untouched
    start = start_axes(scenario, rig)
    for k in range(3):  # the search in whole images, then windows
        warm_up.measure(start.rail_m, start.gimbal_rad, k / rig.vmu.rate_hz)

    seen = seen_axes(scenario, rig, board)

    def pose_at(t_s: float) -> PoseFrame | None:
        return sensor.measure(*seen(t_s), t_s)

    return EmulatedVision(pose_at, transport(scenario.vmu, seed), images.close if images else lambda: None)


def emulated_sensor(
    scenario: Scenario, rig: Rig, seed: int, board: SharedAxisState, name: str, clock: BenchClock
) -> LineSensorEmulator:
    """Return the emulator of sensor ``name`` of ``scenario``; its kernels are compiled when this returns.

    It measures the pose of the axes, at rest in H and without the state of its module's own, with the noise that the
    modelled sensor has.
    """
    sensors = sensors_of(scenario)
    (kind, config, _), number = sensors[name], list(sensors).index(name)
    by_datagrams = config.source == "udp"
    protocol = LineProtocol() if by_datagrams else kind.module.wire
    assert protocol is not None
    bench = kernel_record(bench_params.bench_as_built(rig, scenario.step_s, scenario.bench))
    seen, trial = seen_axes(scenario, rig, board), Trial(kind, settings_row(kind, config))
    r, q = np.empty(3), np.empty(4)

    def measure_at(t_s: float, count: int) -> Sequence[float] | None:
        pose_of_axes(bench, *seen(t_s), r, q)
        truth = trial.truth
        truth.t_s, truth.r_CT_H, truth.q_CH = t_s, r, q
        for i in range(NORMALS):
            truth.normal[i] = noise_of(seed & SEED_BITS, number, count, i)
        if not trial.measure():
            return None
        values: list[float] = trial.output.sample.value[: len(kind.components)].tolist()
        return values

    measure_at(0.0, 0)
    rate_hz = config.rate_hz or kind.module.rate_hz
    frames = None
    if by_datagrams:
        sender = DatagramSender(clock, config.host, config.port)
        frames = SensorFrames(sender, _datagrams(kind, config, trial))
    times = rate_hz, config.latency_s
    return LineSensorEmulator(device_of(name), protocol, measure_at, times, clock, seed, frames)


def _datagrams(kind: SensorKind, config: SensorConfig, trial: Trial) -> Callable[[float, Sequence[float]], bytes]:
    """Return what makes the datagram of a measurement at a bench time, which ``trial`` has measured last."""
    n, counter = len(kind.components), itertools.count()

    def as_json(t_s: float, values: Sequence[float]) -> bytes:
        covariance = trial.output.sample.covariance[:n, :n].tolist()
        return json.dumps({"t_s": t_s, "value": list(values), "covariance": covariance}).encode()

    def as_frame(t_s: float, values: Sequence[float]) -> bytes:
        q = quat.from_rotation_vector(np.array(values[3:]))
        covariance = trial.output.sample.covariance[:6, :6].copy()
        return codec.encode(PoseFrame(next(counter), t_s, t_s, np.array(values[:3]), q, covariance))

    if config.frames is None:
        return as_json
    codec = frame_codec(config.frames)
    return as_frame
