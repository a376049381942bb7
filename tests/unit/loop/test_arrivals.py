"""Each frame of the vision unit is reported with the cycle that used it, or with -1."""

from __future__ import annotations

import numpy as np

from hil.config.rig import Rig
from hil.core.messages import ARRIVAL, MAX_POSES, PoseFrame
from hil.core.observable import ObservableList
from hil.loop.stages import VisionStage
from hil.session.assembly import core_memory
from tests.support.run_settings import make_job


class Source:
    """Hands out the frames that it was given."""

    name = "vmu"

    def __init__(self) -> None:
        self.frames: list[PoseFrame] = []

    def open(self, now_s: float) -> None: ...

    def poll(self, now_s: float) -> list[PoseFrame]:
        frames, self.frames = self.frames, []
        return frames

    def counters(self) -> dict[str, int]:
        return {}

    def close(self) -> None: ...


class Rows:
    """Keeps what it is given."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []

    def put(self, row: np.ndarray) -> None:
        assert row.dtype == ARRIVAL
        self.rows.append(row[0].copy())


def frame(counter: int, t_s: float) -> PoseFrame:
    q = np.array([0.0, 0.0, 0.0, 1.0])
    return PoseFrame(counter, t_s, t_s + 0.01, np.array([0.1, 0.2, 3.0 + counter]), q, np.eye(6), 3, 5)


def test_frames_are_reported_with_the_cycle_that_used_them(mock_rig: Rig) -> None:
    source, told, memory = Source(), Rows(), core_memory(make_job(1.0), mock_rig)
    vision = VisionStage(source, memory)
    vision.frame_sink = told
    memory.state.zero_s, memory.state.cycle = 10.0, -1

    def cycle(*frames: PoseFrame) -> list[tuple[int, int]]:
        source.frames, told.rows = list(frames), []
        memory.state.cycle += 1
        vision.receive(20.0)
        return [(int(r["frame"]["counter"]), int(r["cycle"])) for r in told.rows]

    source.frames = [frame(1, 9.0)]
    assert vision.discard_pending(9.5) == 1  # the bench is armed, the loop is open
    assert [int(r["cycle"]) for r in told.rows] == [-1]
    assert cycle() == []
    assert cycle(frame(2, 11.0), frame(3, 11.1)) == [(2, 1), (3, 1)]
    assert told.rows[1]["pose"]["t_s"] == 11.1 - 10.0
    assert told.rows[1]["pose"].tobytes() == vision.poses[1].tobytes()
    assert told.rows[1]["frame"]["received_s"] == 11.1 + 0.01
    vision.not_before_s = 12.0
    assert cycle(frame(4, 11.9), frame(5, 12.5)) == [(4, -1), (5, 2)]
    many = [frame(10 + i, 13.0 + i) for i in range(MAX_POSES + 2)]
    assert cycle(*many) == [(10, -1), (11, -1), *((12 + i, 3) for i in range(MAX_POSES))]


def test_subscriber_receives_past_and_coming_items() -> None:
    events: ObservableList[int] = ObservableList([1])
    heard: list[int] = []
    events.append(2)
    events.subscribe(heard.append)
    events.append(3)
    assert heard == events == [1, 2, 3]
