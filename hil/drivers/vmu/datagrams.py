"""The vision unit on UDP: datagrams of a camera or tracker, described by a frame file."""

from __future__ import annotations

from hil.config.rig import Vmu
from hil.core.clock import BenchClock
from hil.drivers.datagrams import DatagramPort
from hil.drivers.vmu.driver import Rs422Vmu
from hil.drivers.wire_reader import READ_WALL_S


class UdpVmu(Rs422Vmu):
    """Pose source on ``config.udp``; each datagram has one frame or several."""

    _of_datagrams = True

    def __init__(self, config: Vmu, clock: BenchClock) -> None:
        super().__init__(config, clock)
        self._settings = config.settings
        self._address = f"{self._settings.host}:{self._settings.port}"
        self._fastest_s = config.processing_s
        self._reset(0.0)

    def _open_port(self) -> DatagramPort:
        return DatagramPort(self._clock, self._settings.host, self._settings.port, READ_WALL_S)
