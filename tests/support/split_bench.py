"""A bench and its GNC as in hil dss and hil gnc, in two threads of one process, for tests."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.core.operator_commands import AutoResumeOperator
from hil.errors import DeviceError
from hil.frmn.ring import Telemetry
from hil.loop.cycle import Loop
from hil.loop.outcome import Outcome
from hil.loop.session_parts import SessionParts
from hil.parts.links.gnc_server import GncServer, gnc_side, wants_of
from hil.parts.links.link import Link
from hil.parts.links.mirror import mirror_to
from hil.parts.links.udp import LOOPBACK, Address
from hil.parts.links.udp_gnc import UdpGnc, gnc_link, make_udp_gnc
from hil.session import build
from hil.session.warm_up import warm_up

LOCAL: Address = (LOOPBACK, 0)


@contextmanager
def gnc_thread(
    scenario_name: str, bench: Address, settings: Sequence[str] = (), patience_s: float = 20.0
) -> Iterator[GncServer]:
    """Give our GNC, which serves the bench at ``bench`` in a thread until the bench disconnects or falls silent."""
    scenario = load_scenario(scenario_name, settings)
    link = gnc_side("test gnc", None, bench, wants=wants_of(scenario))
    computer = GncServer(scenario.value, link)

    def serve() -> None:
        with suppress(DeviceError):  # reported by the bench's side as well
            computer.serve(patience_s)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield computer
    finally:
        thread.join(30.0)
        link.close()
        assert not thread.is_alive()


class _Each:
    """Calls when a row is there, after handing it on."""

    def __init__(self, inner: Telemetry, call: Callable[[], None]) -> None:
        self._inner = inner
        self._call = call

    def put(self, row: np.ndarray) -> None:
        self._inner.put(row)
        self._call()


@dataclass
class Split:
    """A bench whose GNC is elsewhere."""

    job: build.Job
    gnc: UdpGnc
    link: Link
    operator: AutoResumeOperator | None = None
    loop: Loop | None = None
    """Of the run under way."""
    setpoints: list[np.ndarray] = field(default_factory=list)
    """Each that the axes were sent, (6,), rails in m, gimbals in rad."""
    each_cycle: Callable[[int], None] = lambda _: None
    """Called with the number of each cycle that has been run."""

    def fly(self) -> Outcome:
        """Wait for the GNC, then run."""
        self.gnc.connect(60.0)
        parts = SessionParts(self.operator)
        mirror_to(self.link, parts)
        parts.layers.append(lambda rows: _Each(rows, lambda: self.each_cycle(self.gnc.cycle)))
        with build.opened(self.job, parts) as runner:
            if self.operator is not None:
                self.operator.mode = lambda: runner.safety.modes.mode
            self.loop = loop = runner.loop
            send = loop.bench._send

            def spy(now_s: float) -> None:
                send(now_s)
                setpoint = loop.now.setpoint
                self.setpoints.append(np.concatenate([setpoint.rail_m, setpoint.gimbal_rad]))

            loop.bench._send = spy  # type: ignore[method-assign]
            return runner.run()

    def largest_jerks(self) -> tuple[float, float]:
        """Return the largest change of rate between setpoints of rails, m/s^2, and gimbals, rad/s^2."""
        step_s = self.job.scenario.value.step_s
        change = np.abs(np.diff(np.array(self.setpoints), 2, axis=0)) / step_s**2
        return float(change[:, :3].max()), float(change[:, 3:].max())

    def account(self) -> dict[str, Any]:
        return self.gnc.stats.as_json()


@contextmanager
def split_bench(
    scenario_name: str,
    duration_s: float,
    settings: Sequence[str] = (),
    lock_step: bool = True,
    speed: float = 1.0,
    seed: int = 0,
    operator: AutoResumeOperator | None = None,
    peer: Address | None = None,
) -> Iterator[Split]:
    """Give the bench's side of a split run on a mock rig; in lock-step as fast as it goes, free on the wall clock."""
    scenario, rig = load_scenario(scenario_name, settings), load_rig("mock", settings)
    job = build.Job(scenario, rig, seed, duration_s, speed, paced=not lock_step)
    warm_up(job)  # nothing compiles while the other side waits
    link = gnc_link("test dss", None if peer else LOCAL, peer)
    period_s = None if lock_step else scenario.value.step_s / speed
    try:
        gnc = make_udp_gnc(scenario.value, link, rig.value.gnc_link, lock_step, period_s)
        yield Split(replace(job, make_backend=lambda _: gnc), gnc, link, operator)
    finally:
        link.close()
