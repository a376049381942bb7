"""Status of a recording in the console: growth, losses, failure and recovery."""

from __future__ import annotations

import numpy as np

from hil.parts.console.session_state import SILENT_S, RecordingStatus
from hil.recording.recorder import STATE


def state(size_bytes: int = 0, dropped: int = 0, trouble: str = "") -> np.ndarray:
    return np.array([(1, dropped, size_bytes, trouble.encode())], STATE)


def test_growing_recording_is_silent_and_its_first_loss_is_reported_once() -> None:
    watch = RecordingStatus("/runs/a.mcap")
    assert watch.update(state(1000), 0.1) == []
    (line,) = watch.update(state(2000, dropped=7), 0.1)
    assert line == "recording: /runs/a.mcap: 7 messages lost by overload, further losses are counted"
    assert watch.update(state(3000, dropped=9), 0.1) == []
    assert watch.as_json() == {"file": "a.mcap", "size_bytes": 3000, "lost": 9, "trouble": ""}


def test_full_disk_is_reported_once_and_losses_are_counted() -> None:
    watch = RecordingStatus("/runs/a.mcap")
    (line,) = watch.update(state(1000, 40, "No space left on device"), 0.1)
    assert line.startswith("recording: /runs/a.mcap: No space left on device: recording stopped")
    assert watch.update(state(1000, 80, "No space left on device"), 0.1) == []
    found = watch.as_json()
    assert found is not None
    assert (found["lost"], found["trouble"]) == (80, "No space left on device")


def test_silent_recorder_counts_as_dead_until_it_speaks_again() -> None:
    watch = RecordingStatus("/runs/a.mcap")
    assert watch.update(state(1000), SILENT_S) == []
    (line,) = watch.update(state(1000), SILENT_S + 0.1)
    assert "no report of its process for 2 s: recording stopped, the bench continues" in line
    assert watch.update(state(1000), SILENT_S + 5.0) == []
    assert watch.update(state(2000), 0.1) == ["recording: continues"]


def test_session_that_is_not_recorded_shows_nothing() -> None:
    assert RecordingStatus().as_json() is None
