"""Serial ports of all devices pass on each byte at once, or the collection time of their adapter is shown."""

from __future__ import annotations

import pytest
import serial

from hil.core.clock import WallClock
from hil.drivers.serial_port import latency_timer_ms, open_serial, set_low_latency


class Port:
    """A port of pyserial whose driver may not support low latency."""

    def __init__(self, error: Exception | None = None, **_: object) -> None:
        self.error, self.is_low = error, False

    def set_low_latency_mode(self, on: bool) -> None:
        if self.error is not None:
            raise self.error
        self.is_low = on

    def reset_input_buffer(self) -> None:
        """Discard nothing."""


def test_port_that_is_opened_has_low_latency(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(serial, "Serial", lambda path, baud, **settings: Port())
    assert open_serial(WallClock(), "/dev/ttyUSB0", 115_200).is_low


@pytest.mark.parametrize("error", [ValueError("not supported"), OSError(25, "no tty"), AttributeError()])
def test_port_without_low_latency_is_opened_all_the_same(error: Exception) -> None:
    assert not set_low_latency(Port(error))
    assert not set_low_latency(None)


def test_latency_timer_of_an_adapter_is_read(tmp_path) -> None:
    device = tmp_path / "ttyUSB0" / "device"
    device.mkdir(parents=True)
    (device / "latency_timer").write_text("16\n")
    assert latency_timer_ms("/dev/ttyUSB0", tmp_path) == 16
    assert latency_timer_ms("/dev/ttyS0", tmp_path) is None
