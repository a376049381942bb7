"""Driver: owns the serial line, checks each response, raises errors that name the device."""

from __future__ import annotations

import numpy as np
import serial

from acme_rails import codec
from acme_rails.codec import Response, Status
from hil.config.rig import Rails
from hil.core.clock import BenchClock
from hil.core.messages import HOMED, Array, AxisFeedback
from hil.drivers.cyclic_exchange import CyclicAxisGroup
from hil.drivers.serial_port import open_serial
from hil.errors import DriveFault, FaultKind, LinkLost, LinkTimeout, ProtocolError

RESPONSE_S = 0.05  # bench time for one response
ATTEMPTS = 4  # of requests during set-up


class AcmeLink:
    """The controller as an ``ExchangeLink``: one request, one response."""

    has_profiles = False
    jogging = False

    def __init__(self, config: Rails, clock: BenchClock, name: str) -> None:
        self._name = name
        self._settings = config.settings
        self._timeout_s = config.timeout_s
        self._clock = clock
        self._port: serial.Serial | None = None
        self._number = 0
        self._stopped = False
        self._received_s = 0.0
        self._counts = dict.fromkeys(("exchanges", "lost", "protocol_errors", "late"), 0)

    def open(self) -> AxisFeedback:
        """Open the port, check the model, enable the drives."""
        try:
            self._port = open_serial(
                self._clock, self._settings.port, self._settings.baud, timeout=0.0, write_timeout=0.3
            )
        except (OSError, ValueError) as error:
            raise LinkLost(self._name, f"cannot open {self._settings.port}: {error}") from error
        self._stopped = False
        self._received_s = self._clock.now_s()
        self._counts = dict.fromkeys(self._counts, 0)
        model = " ".join(self._insist(codec.IDENT))
        if self._settings.model not in (None, model):
            raise ProtocolError(self._name, f"model is {model!r}, expected {self._settings.model!r}")
        self._insist(codec.ENABLE)
        return self._feedback(codec.decode_response(self._insist(codec.READ)))

    def exchange(self, position: Array, rate: Array) -> AxisFeedback | None:
        """Send the setpoint, or only read after a quick stop; return feedback, None without a valid response."""
        self._counts["exchanges"] += 1
        request = codec.READ if self._stopped else f"{codec.SET} {codec.encode_numbers(position, rate)}"
        words = self._request(request)
        if words is None:
            silent_s = self._clock.now_s() - self._received_s
            if silent_s > self._timeout_s:
                raise LinkTimeout(self._name, f"no response for {silent_s:.3f} s, allowed {self._timeout_s:g} s")
            return None
        return self._feedback(codec.decode_response(words))

    def home(self) -> None:
        """Nothing to do: the encoders are absolute."""

    def move_to(self, position: Array, rate: Array) -> None:
        """Never called: the controller has no profiles."""

    def quick_stop(self) -> None:
        """Send the quick stop until it is acknowledged."""
        self._stopped = True
        if self._port is not None:
            self._insist(codec.STOP)

    def disable(self) -> None:
        """Stop: the controller has no command that switches the torque off."""
        self.quick_stop()

    def close(self) -> None:
        """Close the port. Idempotent."""
        port, self._port = self._port, None
        if port is not None:
            port.close()

    def counters(self) -> dict[str, int]:
        """Return exchanges, lost responses, damaged responses, and those that are late or come twice."""
        return dict(self._counts)

    def _feedback(self, response: Response) -> AxisFeedback:
        if response.status & Status.FAULT:
            off = bool(response.status & Status.TORQUE_OFF)
            text, kind = ("torque off", FaultKind.TORQUE_OFF) if off else ("fault of the controller", FaultKind.OTHER)
            raise DriveFault(self._name, text, kind)
        return AxisFeedback(self._received_s, np.array(response.position_m), np.array(response.rate_mps), HOMED)

    def _insist(self, request: str) -> list[str]:
        for _ in range(ATTEMPTS):
            if (words := self._request(request)) is not None:
                return words
        raise LinkTimeout(self._name, f"no response to {request}, sent {ATTEMPTS} times")

    def _request(self, request: str) -> list[str] | None:
        """Send a request; return the words of its response after the number, None without a valid one."""
        port = self._port
        if port is None:
            raise LinkLost(self._name, "is not open")
        self._number = (self._number + 1) % 1000
        sent_s = self._clock.now_s()
        data = b""
        try:
            port.write(codec.encode(f"{self._number} {request}"))
            while self._clock.now_s() < sent_s + RESPONSE_S:
                data += port.read(256)
                *lines, data = data.split(b"\n")
                responses = [words for line in lines if (words := self._decoded(line))]
                due = [words for words in responses if words[0] == str(self._number)]
                self._counts["late"] += len(responses) - bool(due)
                if due:
                    self._received_s = 0.5 * (sent_s + self._clock.now_s())
                    return due[0][1:]
                self._clock.sleep_until(self._clock.now_s() + 0.001)
        except OSError as error:
            raise LinkLost(self._name, f"serial port failed: {error}") from error
        self._counts["lost"] += 1
        return None

    def _decoded(self, line: bytes) -> list[str]:
        try:
            return codec.decode(line)
        except ValueError:
            self._counts["protocol_errors"] += 1
            return []


class AcmeRails(CyclicAxisGroup):
    """AxisGroup of the rails on the port of ``[rails.acme]``."""

    def __init__(self, config: Rails, clock: BenchClock, name: str = "rails") -> None:
        super().__init__(config, clock, AcmeLink(config, clock, name), name)
