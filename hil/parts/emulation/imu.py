"""Emulated IMU on the innermost gimbal of an emulated rig."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.wires import UDP
from hil.core.clock import BenchClock
from hil.core.kernel_record import kernel_record
from hil.core.line_protocol import LineProtocol
from hil.core.messages import Array
from hil.drivers.datagrams import DatagramSender
from hil.drivers.imu.can_frames import as_messages
from hil.drivers.vmu.codecs import frame_codec
from hil.maths import quat
from hil.maths.random_streams import stream
from hil.params import bench as bench_params
from hil.parts.emulation.line_sensor import LineSensorEmulator, SensorFrames
from hil.parts.emulation.pty_line import PtyLine
from hil.parts.emulation.shared_state import SharedAxisState


def emulated_imu(
    scenario: Scenario, rig: Rig, seed: int, board: SharedAxisState, clock: BenchClock
) -> LineSensorEmulator:
    """Return the IMU of ``rig.imu`` on the axes of ``board``, with drift and noise of the scenario's.

    Its gyros integrate: a rate is the mean since the frame before.
    """
    config = rig.imu
    assert config is not None
    bench = kernel_record(bench_params.bench(rig, scenario.step_s, scenario.bench))
    to_imu = quat.from_rotation_vector(np.radians(config.rotation_deg))
    earth_H = bench_params.earth_rate(rig)
    dice, sigma = stream(seed, "imu", "wire"), math.radians(scenario.imu.gyro_noise_degps)
    first = math.radians(scenario.imu.gyro_drift_initial_sigma_degps) * dice.standard_normal(3)
    drift = np.radians(scenario.imu.gyro_drift_degps) + first

    def attitude(t_s: float) -> Array:
        r, q = np.empty(3), np.empty(4)
        pose_of_axes(bench, board.read("rails", t_s)[0], board.read("turntable", t_s)[0], r, q)
        return q

    last_s, before = -math.inf, attitude(0.0)

    def measure_at(t_s: float, _: int) -> Sequence[float]:
        nonlocal last_s, before
        after = attitude(t_s)
        of_table = quat.to_rotation_vector(quat.multiply(after, quat.conjugate(before))) / (t_s - last_s)
        last_s, before = t_s, after
        rate = quat.transform(to_imu, of_table + quat.transform(after, earth_H) + drift)
        measured: list[float] = (rate + sigma * dice.standard_normal(3)).tolist()
        return measured

    codec, numbers = frame_codec(config.frames), itertools.count()
    by_datagrams = config.port is not None and config.port.startswith(UDP)
    baud = config.baud if config.can is None else config.can.baud
    wire: DatagramSender | PtyLine = DatagramSender(clock) if by_datagrams else PtyLine(baud, clock)

    def encoded(t_s: float, values: Sequence[float]) -> bytes:
        frame = codec.encode_rate(next(numbers), t_s, np.array(values))
        return frame if config.can is None else as_messages(config.can, frame)

    line = SensorFrames(wire, encoded)
    return LineSensorEmulator("imu", LineProtocol(), measure_at, (config.rate_hz, 0.0), clock, seed, line)
