"""GNC backend for a flight computer that opens thrusters by digital command words and receives poses only."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hil.config.tables.flight_computer import FlightComputer
from hil.core.messages import MAX_THRUSTERS, PoseFrame
from hil.errors import LinkTimeout
from hil.gnc import whole_step
from hil.gnc_backends.base import Records
from hil.gnc_backends.external import BackendSetup, ExternalGnc
from hil.parts.links.command_word_receiver import NAME, CommandWordReceiver, PoseForwarder

_BITS = 1 << np.arange(MAX_THRUSTERS)


def command_word_gnc(
    config: FlightComputer, bench_now_s: Callable[[], float], setup: BackendSetup
) -> tuple[CommandWordGnc, Callable[[PoseFrame, float], None] | None]:
    """Return the backend of the flight computer ``config``, and what forwards it each used frame, None for nothing."""
    forwarder = PoseForwarder(config.poses) if config.poses.port is not None else None
    gnc = CommandWordGnc(config, CommandWordReceiver(config, bench_now_s), forwarder, bench_now_s, setup)
    return gnc, forwarder.put if forwarder is not None else None


class CommandWordGnc(ExternalGnc):
    """Opens the thrusters of the newest command word; an expired one opens none, a longer silence holds or stops.

    bench_now_s: bench time, for the age of the words.
    """

    def __init__(
        self,
        config: FlightComputer,
        receiver: CommandWordReceiver,
        forwarder: PoseForwarder | None,
        bench_now_s: Callable[[], float],
        setup: BackendSetup,
    ) -> None:
        super().__init__(NAME, setup)
        self._config = config
        self._receiver = receiver
        self.forwarder = forwarder
        self._now_s = bench_now_s
        self._silent_since_s: float | None = None

    @property
    def blocking_reason(self) -> str:
        """Reason why a run on hold cannot be resumed: no recent command word."""
        return "" if self._age_s() <= self._config.timeout_s else f"{NAME} is silent"

    def open(self, bench_s: float) -> None:
        """Open both wires. Raises LinkLost."""
        self._receiver.open()
        if self.forwarder is not None:
            self.forwarder.open()

    def close(self) -> None:
        """Close both wires."""
        self._receiver.close()
        if self.forwarder is not None:
            self.forwarder.close()

    def exchange(self) -> bool:
        """Bring the newest command word into ``output``; return False if it has expired."""
        newest = self._receiver.newest()
        now_s = self._now_s()
        if newest is None or now_s - newest[1] > self._config.timeout_s:
            if self._silent_since_s is None:
                self._silent_since_s = newest[1] if newest is not None else now_s
            return False
        self._silent_since_s = None
        out = self.output
        whole_step.clear_output(out, self.cycle)
        out.direct = 1
        out.on[:] = (newest[0].thrusters & _BITS) != 0
        return True

    def on_missing_output(self, now: Records) -> None:
        """Close all thrusters; after a longer silence hold or stop. Raises LinkTimeout."""
        super().on_missing_output(now)
        assert self._silent_since_s is not None
        silent_s = self._now_s() - self._silent_since_s
        if silent_s <= self._config.lost_s:
            return
        text = f"no command word for {silent_s:.2f} s, allowed {self._config.lost_s:g} s"
        if self._config.on_loss == "stop":
            raise LinkTimeout(NAME, text)
        self.request_hold(f"{NAME}: {text}")

    def _age_s(self) -> float:
        newest = self._receiver.newest()
        return self._now_s() - newest[1] if newest is not None else np.inf
