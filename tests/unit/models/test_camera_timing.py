"""When the vision unit exposes, and how its frames travel."""

from __future__ import annotations

import numpy as np
import pytest

from hil.core.messages import new
from hil.models.camera_timing import TRAVEL, delays, exposure_time, first_exposure


@pytest.mark.parametrize(("now_s", "number"), [(0.0, 0), (0.16, 1), (0.16 + 1e-12, 1), (0.161, 2), (7.99, 50)])
def test_first_exposure_is_the_next_multiple(now_s: float, number: int) -> None:
    assert first_exposure(now_s, 6.25) == number
    assert exposure_time(number, 6.25) == pytest.approx(0.16 * number)


def test_frames_are_late_lost_and_doubled_as_often_as_asked(rng: np.random.Generator) -> None:
    travel = new(TRAVEL)
    travel.latency_s, travel.jitter_s, travel.duplicate_probability, travel.loss_probability = 0.1, 0.2, 0.3, 0.25
    out, counts, late = np.empty(2), [], []
    for draws in rng.random((4000, 4)):
        counts.append(delays(travel, draws, out))
        late += out[: counts[-1]].tolist()
    assert counts.count(0) / 4000 == pytest.approx(0.25, abs=0.02)
    assert counts.count(2) / (4000 - counts.count(0)) == pytest.approx(0.3, abs=0.03)
    assert 0.1 <= min(late) < 0.105
    assert 0.295 < max(late) < 0.3
