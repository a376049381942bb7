"""Counters of a vision unit with cameras of this host are those that are declared, and so documented."""

from types import SimpleNamespace
from typing import cast
from unittest.mock import create_autospec

import numpy as np

from hil.config.load import load_rig, load_scenario
from hil.core.clock import Clock
from hil.drivers.cameras.pairing import TimedFrame
from hil.drivers.vmu import CAMERA_COUNTERS
from hil.parts.cameras.live import LiveVision
from hil.session.assembly import with_cameras
from hil.vmu.estimators import PoseEstimate, PoseEstimator


def test_every_counter_is_declared() -> None:
    estimator = create_autospec(PoseEstimator, instance=True)
    estimator.solve.return_value = PoseEstimate(0.0, "too_few")
    live = LiveVision(
        estimator, with_cameras(load_scenario("scheme-1", ["vmu.source=cameras"]), load_rig("emulated")).value.vmu
    )
    for side in (0, 1):
        live.put(side, TimedFrame(1.0, 1.01, 1, np.zeros((1, 1), np.uint8)))
    assert list(live.poses(cast(Clock, SimpleNamespace(now_s=lambda: 1.02)))) == []
    live.sent(1.03)
    assert {*live.counters(), "skipped", "identity_proven"} == set(CAMERA_COUNTERS)
