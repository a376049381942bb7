"""Samples of sensors on serial wires, and of those that programs of the user's own send: one JSON object a datagram.

    {"t_s": 12.34, "value": [...], "covariance": [[...], ...], "status": 0}

``value`` has the components of the sensor in its order and units, ``covariance`` their covariance. ``t_s`` is the
moment of the measurement on the bench's monotonic clock (``time.monotonic``) if the sensor's ``stamp`` is "capture".
With "receipt" it is not read: the measurement is taken to be ``latency_s`` before its arrival. Poses may have the form
of a frame file instead (``frames``), as the frames of a vision unit.
"""

from __future__ import annotations

import json
import math
import time
from collections import Counter
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.sensors import SensorConfig, device_of
from hil.core.clock import BenchClock, WallClock
from hil.core.messages import PoseFrame
from hil.core.sensor_records import SENSOR_SAMPLE
from hil.drivers.datagrams import DatagramPort
from hil.drivers.line_sensor.driver import LineSensor, LineSettings
from hil.drivers.serial_port import is_counted
from hil.drivers.vmu.codecs import frame_codec
from hil.errors import BadInput, LinkLost, one_line
from hil.maths import linear, quat
from hil.params.sensors import sensors_of
from hil.session.sample_sources import wired_sensors

_BYTES_MAX: Final = 4096
_PER_POLL: Final = 16
_AHEAD_MAX_S: Final = 0.05  # by which a stamp may be in the future: clocks of two processes of a computer agree


class UdpSamples:
    """Datagrams of one sensor. number: of the sensor. n: components. now_s: the clock of the stamps.

    clock: of the bench, whose time is that of the stamps in lock-step. Datagrams that cannot be used are counted in
    ``refused``, by reason, and never reach the navigation. Raises BadInput if the port cannot be opened.
    """

    def __init__(
        self,
        name: str,
        number: int,
        n: int,
        config: SensorConfig,
        now_s: Callable[[], float] = time.monotonic,
        clock: BenchClock | None = None,
    ) -> None:
        self.refused: Counter[str] = Counter()
        self.name, self.failure = device_of(name), ""
        self.last_s = -math.inf
        """Bench time of the last usable datagram; -inf before the first ``poll``."""
        self._number, self._n, self._config, self._now_s = number, n, config, now_s
        self._count, self._last_s = 0, -math.inf
        self._decoder = None if config.frames is None else frame_codec(config.frames).decoder(True, by_camera=False)
        try:
            self._port = DatagramPort(clock or WallClock(), config.host, config.port or 0, 0.0)
        except OSError as error:
            text = f"{config.host}:{config.port}: cannot be opened: {error.strerror or error}"
            raise BadInput.single("scenario", f"sensors.{name}.port", text) from error

    @property
    def port(self) -> int:
        """Port on which datagrams are received."""
        return self._port.number

    def poll(self, now_s: float, run_zero_s: float) -> np.ndarray:
        """Return what has arrived since the last call, (n,) of SENSOR_SAMPLE, in the run's time."""
        rows = []
        self.last_s = now_s if self.last_s == -math.inf else self.last_s
        for _ in range(_PER_POLL):
            try:
                data = self._port.read()
            except ConnectionError:
                break
            if not data:
                break
            if (row := self._sample(data, now_s, run_zero_s)) is not None:
                rows.append(row)
                self.last_s = now_s
        return np.concatenate([np.zeros(0, SENSOR_SAMPLE), *rows])

    def close(self) -> None:
        """Close the port."""
        self._port.close()

    def _sample(self, data: bytes, now_s: float, run_zero_s: float) -> np.ndarray | None:
        try:
            value, covariance, age_s, status = self._content(data)
        except ValueError as error:
            self.refused[one_line(str(error), 100)] += 1
            return None
        row = np.zeros(1, SENSOR_SAMPLE)
        received_s = now_s - run_zero_s
        if received_s < age_s:
            self.refused["measured before the run"] += 1
            return None
        row["sensor"], row["number"], row["status"] = self._number, self._count, status
        row["t_s"], row["received_s"] = received_s - age_s, received_s
        row["value"][0, : self._n] = value
        row["covariance"][0, : self._n, : self._n] = covariance
        self._count += 1
        return row

    def _content(self, data: bytes) -> tuple[np.ndarray, np.ndarray, float, int]:
        """Return value, covariance, age in s and status of a datagram. Raises ValueError with what is wrong."""
        if len(data) > _BYTES_MAX:
            raise ValueError(f"longer than {_BYTES_MAX} bytes")
        if self._decoder is not None:
            pose = self._pose(data)
            turn = np.empty(3)
            quat.to_rotation_vector_into(pose.q_vt, turn)
            return np.concatenate([pose.t_v, turn]), pose.covariance, self._age_s({"t_s": pose.t_s}), 0
        try:
            table: Any = json.loads(data)
            value = np.array(table["value"], float)
            covariance = np.array(table["covariance"], float)
            status = int(table.get("status", 0))
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise ValueError(f"no object with value and covariance: {type(error).__name__}") from error
        if value.shape != (self._n,) or covariance.shape != (self._n, self._n):
            raise ValueError(f"value {value.shape}, covariance {covariance.shape}: must have {self._n} components")
        if not (np.isfinite(value).all() and np.isfinite(covariance).all()):
            raise ValueError("a number is not finite")
        if np.abs(covariance - covariance.T).max() > 1e-9 * np.abs(covariance).max() or (
            linear.eigenvalues(covariance)[0] <= 0.0
        ):
            raise ValueError("covariance is not symmetric and positive definite")
        if status != 0:
            raise ValueError(f"status {status}: not good")
        return value, covariance, self._age_s(table), status

    def _pose(self, data: bytes) -> PoseFrame:
        """Return the last pose in a datagram of frames. Raises ValueError if it has none."""
        assert self._decoder is not None
        decoded = self._decoder.feed(data, self._now_s())
        poses = [frame.pose for frame in decoded if frame.pose is not None and frame.status == 0]
        if not poses:
            raise ValueError("status: no pose" if decoded else f"no frame of {self._config.frames}")
        return poses[-1]

    def _age_s(self, table: dict[str, Any]) -> float:
        if self._config.stamp == "receipt":
            return self._config.latency_s
        stamp = table.get("t_s")
        if isinstance(stamp, bool) or not isinstance(stamp, int | float) or not math.isfinite(stamp):
            raise ValueError("t_s is missing or no number")
        age_s = self._now_s() - float(stamp)
        if age_s < -_AHEAD_MAX_S:
            raise ValueError("t_s is in the future")
        if float(stamp) == self._last_s:
            raise ValueError("t_s repeats")
        self._last_s = float(stamp)
        return max(0.0, age_s)


def open_datagrams(scenario: Scenario, clock: BenchClock) -> list[UdpSamples]:
    """Return the open ports of the scenario's sensors. Raises BadInput for one that cannot be opened.

    clock: bench time; in lock-step datagrams are stamped with it.
    """
    now_s = clock.now_s if is_counted(clock) else time.monotonic
    sources: list[UdpSamples] = []
    try:
        for number, (name, (kind, config, _)) in enumerate(sensors_of(scenario).items()):
            if config.source == "udp":
                sources.append(UdpSamples(name, number, len(kind.components), config, now_s, clock))
    except BadInput:
        for source in sources:
            source.close()
        raise
    return sources


def line_sensors(scenario: Scenario, rig: Rig, clock: BenchClock) -> list[LineSensor]:
    """Return the open ports of the scenario's sensors on ``rig``. clock: bench time. Raises LinkLost."""
    sensors: list[LineSensor] = []
    wired = wired_sensors(scenario, rig)
    try:
        for number, (name, (kind, config, _)) in enumerate(sensors_of(scenario).items()):
            if name in wired and config.source != "udp" and kind.module.wire is not None:
                line = rig.sensors[name]
                settings = LineSettings(line.port or "", line.baud, config.latency_s)
                device = device_of(name)
                sensors.append(LineSensor(device, number, len(kind.components), kind.module.wire, settings, clock))
    except LinkLost:
        for source in sensors:
            source.close()
        raise
    return sensors
