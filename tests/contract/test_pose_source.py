"""One contract for every backend of the vision unit: the mock, and the driver against its emulator."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.rig import VmuLine
from hil.core.clock import Order, SimulatedClock
from hil.core.messages import PoseFrame
from hil.drivers.base import PoseSource
from hil.drivers.vmu.driver import Rs422Vmu
from hil.drivers.vmu.mock import MockVmu
from hil.errors import DeviceError, LinkTimeout
from hil.parts.emulation.vision_unit import VmuEmulator
from tests.support.lock_step import in_lock_step, serving

CONFIG = load_rig("emulated").value.vmu
COVARIANCE = np.diag([1e-6, 2e-6, 3e-6, 4e-7, 5e-7, 6e-7])


def _pose_at(t_s: float) -> PoseFrame:
    """A pose that has its time of exposure."""
    return PoseFrame(
        0, t_s, t_s, np.array([0.1, -0.2, 1.0 + t_s]), np.array([0.0, 0.6, 0.0, 0.8]), COVARIANCE, 0x3F, 0x1F
    )


@dataclass
class Backend:
    source: PoseSource
    now_s: Callable[[], float]
    pass_time: Callable[[float], None]
    go_silent: Callable[[], None]

    def collect(self, seconds: float) -> list[PoseFrame]:
        """Poll every 20 ms for ``seconds`` of bench time."""
        frames = []
        end_s = self.now_s() + seconds
        while self.now_s() < end_s:
            self.pass_time(0.02)
            frames += self.source.poll(self.now_s())
        return frames


@contextmanager
def _mock() -> Iterator[Backend]:
    clock = SimulatedClock()
    source = MockVmu(CONFIG, _pose_at)

    def pass_time(seconds: float) -> None:
        clock.t_s += seconds

    def go_silent() -> None:
        source.fail(LinkTimeout(source.name, "silent"))

    yield Backend(source, clock.now_s, pass_time, go_silent)


@contextmanager
def _on_the_wire() -> Iterator[Backend]:
    stop = threading.Event()
    with in_lock_step() as clock:
        emulator = VmuEmulator(CONFIG, clock, _pose_at)
        wired = CONFIG.model_copy(update={"rs422": VmuLine(port=emulator.start()["vmu"])})
        with serving(clock, emulator, Order.CAMERAS, stop), closing(Rs422Vmu(wired, clock)) as source:
            yield Backend(source, clock.now_s, clock.sleep, stop.set)


BACKENDS = {"mock": _mock, "rs422": _on_the_wire}


@pytest.fixture(params=sorted(BACKENDS))
def backend(request: pytest.FixtureRequest) -> Iterator[Backend]:
    with BACKENDS[request.param]() as made:
        yield made


def test_source_keeps_the_protocol(backend: Backend) -> None:
    assert isinstance(backend.source, PoseSource)
    assert backend.source.name == "vmu"


def test_frames_come_at_the_units_rate_oldest_first_with_their_time_of_exposure(backend: Backend) -> None:
    backend.source.open(backend.now_s())
    frames = backend.collect(2.0)
    assert len(frames) >= 8
    times = np.array([frame.t_s for frame in frames])
    assert np.all(np.diff(times) > 0.0)
    assert np.median(np.diff(times)) == pytest.approx(1.0 / CONFIG.rate_hz, abs=1e-5)
    assert all(frame.received_s >= frame.t_s for frame in frames)


def test_pose_and_covariance_arrive_as_they_were_measured(backend: Backend) -> None:
    backend.source.open(backend.now_s())
    frame = backend.collect(0.6)[-1]
    assert frame.t_v == pytest.approx([0.1, -0.2, 1.0 + frame.t_s], abs=1e-5)
    assert frame.q_vt == pytest.approx([0.0, 0.6, 0.0, 0.8])
    assert frame.covariance == pytest.approx(COVARIANCE, rel=1e-6)
    assert (frame.leds_left, frame.leds_right) == (0x3F, 0x1F)


def test_frames_are_counted(backend: Backend) -> None:
    backend.source.open(backend.now_s())
    frames = backend.collect(1.0)
    assert backend.source.counters()["frames"] == len(frames)
    assert backend.source.counters()["lost"] == 0


def test_silence_is_an_error_that_names_the_unit(backend: Backend) -> None:
    backend.source.open(backend.now_s())
    backend.collect(0.5)
    backend.go_silent()
    with pytest.raises(LinkTimeout, match="vmu"):
        backend.collect(CONFIG.timeout_s + 1.0)


def test_close_may_come_twice_and_a_closed_unit_refuses(backend: Backend) -> None:
    backend.source.close()
    backend.source.open(backend.now_s())
    backend.source.close()
    backend.source.close()
    with pytest.raises(DeviceError, match="vmu"):
        backend.source.poll(backend.now_s())
