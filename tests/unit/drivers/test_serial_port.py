"""Serial ports of all devices pass on each byte at once, or the collection time of their adapter is shown."""

from __future__ import annotations

import errno
import termios

import pytest
import serial

from hil.core.clock import WallClock
from hil.drivers.serial_port import latency_timer_ms, open_serial, set_low_latency
from hil.errors import LinkLost
from hil.parts.emulation.counted_serial import CountedSerial
from tests.support.turntable_bench import error_of, served


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


def test_line_that_goes_while_it_is_opened_is_an_os_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def gone(self: Port) -> None:
        raise termios.error(errno.EIO, "Input/output error")  # of tcflush, no OSError

    monkeypatch.setattr(Port, "reset_input_buffer", gone)
    monkeypatch.setattr(serial, "Serial", lambda path, baud, **settings: Port())
    with pytest.raises(OSError, match="Input/output error") as raised:
        open_serial(WallClock(), "/dev/ttyUSB0", 115_200)
    assert raised.value.errno == errno.EIO


@pytest.mark.parametrize("driver", ["ascii", "acu", "cia402"])
@pytest.mark.parametrize("first", range(6))
def test_line_that_goes_is_a_lost_link_at_every_call_of_the_port(driver, first, monkeypatch) -> None:
    """A cable that is pulled, or the other end's death, is met by whichever call of the port is the next."""
    with served(driver) as (_, device, clock), monkeypatch.context() as patch:
        calls = 0

        def failing(call):
            def made(*arguments):
                nonlocal calls
                calls += 1
                if calls > first:
                    raise OSError(errno.EIO, "Input/output error")
                return call(*arguments)

            return made

        for name in ("read", "write", "wait_readable"):
            patch.setattr(CountedSerial, name, failing(getattr(CountedSerial, name)))
        patch.setattr(CountedSerial, "in_waiting", property(failing(CountedSerial.in_waiting.fget)))
        error = error_of(device, clock)
    assert isinstance(error, LinkLost)
    assert str(error).startswith("turntable")
