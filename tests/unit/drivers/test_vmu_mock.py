"""The vision unit in memory: when frames come, and that it fails as the real one does."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.rig import Vmu
from hil.core.messages import PoseFrame
from hil.drivers.base import PoseSource
from hil.drivers.vmu import COUNTERS
from hil.drivers.vmu.mock import MockVmu
from hil.drivers.vmu.transport import Transport
from hil.errors import DriveFault, LinkLost, LinkTimeout


def pose_at(t_s: float) -> PoseFrame:
    return PoseFrame(99, 99.0, 99.0, np.array([t_s, 0.0, 3.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6))


def opened(transport: Transport | None = None, now_s: float = 0.0, **config: float) -> MockVmu:
    vmu = MockVmu(Vmu.model_validate({"driver": "mock"} | config), pose_at, transport)
    vmu.open(now_s)
    return vmu


def test_mock_is_a_pose_source() -> None:
    assert isinstance(opened(), PoseSource)
    assert set(opened().counters()) == set(COUNTERS)


def test_frame_comes_every_eighth_cycle_however_cycle_times_are_summed() -> None:
    by_product, by_sum = opened(), opened()
    t_s = 0.0
    for k in range(50_000):
        expected = [k // 8] if k % 8 == 0 else []
        assert [frame.counter for frame in by_product.poll(k * 0.02)] == expected
        assert [frame.counter for frame in by_sum.poll(t_s)] == expected
        t_s += 0.02


def test_frame_is_exposed_on_the_beat_and_handed_out_after_the_latency() -> None:
    vmu = opened(Transport(np.random.default_rng(0), latency_s=0.1))
    assert [len(vmu.poll(t_s)) for t_s in (0.0, 0.08)] == [0, 0]
    (frame,) = vmu.poll(0.1)
    assert (frame.counter, frame.t_s, frame.received_s) == (0, 0.0, 0.1)
    (frame,) = vmu.poll(0.26)
    assert (frame.counter, frame.t_s, frame.t_v[0]) == (1, 0.16, 0.16)
    assert frame.received_s == pytest.approx(0.26)


def test_frames_may_come_out_of_order_twice_or_never() -> None:
    vmu = opened(
        Transport(np.random.default_rng(3), 0.0, 0.5, duplicate_probability=0.3, loss_probability=0.2), timeout_s=10.0
    )
    frames = [frame for k in range(5001) for frame in vmu.poll(k * 0.02)]
    counters = [frame.counter for frame in frames]
    seen = set(counters)
    assert counters != sorted(counters)
    assert 0.2 < (len(counters) - len(seen)) / len(seen) < 0.4
    assert 0.1 < 1.0 - len(seen) / (max(seen) + 1) < 0.3
    assert all(0.0 <= frame.received_s - frame.t_s <= 0.5 for frame in frames)
    assert all(frame.t_v[0] == pytest.approx(frame.t_s) for frame in frames)


def test_exposures_before_the_opening_do_not_come() -> None:
    vmu = opened(now_s=10.0)
    frames = vmu.poll(10.3)
    assert [(frame.counter, frame.t_s) for frame in frames] == [(0, 10.08), (1, 10.24)]
    assert vmu.counters()["frames"] == 2


def test_slow_unit_times_out_and_comes_back() -> None:
    vmu = opened(now_s=0.5, rate_hz=1.0, timeout_s=0.4)
    assert vmu.poll(0.9) == []
    with pytest.raises(LinkTimeout, match=r"vmu: no answer for 0.410 s, allowed 0.4 s"):
        vmu.poll(0.91)
    assert len(vmu.poll(1.0)) == 1
    late = opened(Transport(np.random.default_rng(0), 0.2, 0.1), now_s=0.5, rate_hz=1.0, timeout_s=0.4)
    assert late.poll(1.19) == []  # the first frame may still be under way for 0.3 s


def test_ring_out_of_sight_is_counted_and_is_no_silence() -> None:
    vmu = MockVmu(Vmu(driver="mock"), lambda t_s: None)
    vmu.open(0.0)
    assert [frame for k in range(100) for frame in vmu.poll(k * 0.02)] == []
    assert vmu.counters()["no_pose"] == 13


def test_failure_stays_until_the_next_opening() -> None:
    vmu = opened()
    vmu.fail(DriveFault("vmu", "lens cap"))
    for _ in range(2):
        with pytest.raises(DriveFault, match="vmu: lens cap"):
            vmu.poll(0.02)
    vmu.close()
    vmu.close()
    vmu.open(0.16)
    assert len(vmu.poll(0.16)) == 1


def test_closed_mock_gives_nothing() -> None:
    vmu = opened()
    vmu.close()
    with pytest.raises(LinkLost, match="vmu: is closed"):
        vmu.poll(0.0)
