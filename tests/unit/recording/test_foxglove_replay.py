"""Playback of a recording in Foxglove: messages at their times, play, pause, seek."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_scenario
from hil.core.messages import CYCLE
from hil.errors import BadInput
from hil.recording.foxglove_replay import RecordedMessages, RecordingPlayer
from hil.recording.writer import RecordingHeader, RunFile
from tests.support.foxglove_client import FoxgloveClient

pytest.importorskip("foxglove")

START_NS = 1_700_000_000_000_000_000
RUN_S = 30.0
PAUSED, ENDED = 1, 3


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of 30 s at 50 Hz, noise but for its times, in many blocks."""
    path = tmp_path_factory.mktemp("play") / "run.mcap"
    scenario = load_scenario("scheme-1").value.model_dump_json()
    file = RunFile(path, RecordingHeader({"schema_version": "3"}, {"scenario.json": scenario}, START_NS))
    n = round(50 * RUN_S)
    noise = np.random.default_rng(2).standard_normal(n * CYCLE.itemsize // 8)
    rows = np.frombuffer(bytearray(noise.tobytes()), CYCLE)
    rows["t_s"] = 0.02 * np.arange(n)
    file.write_cycles(rows)
    file.finish({"stop": "completed"}, "{}")
    return path


@pytest.fixture
def client(recording: Path) -> Iterator[FoxgloveClient]:
    """Return a client of a player that is paused at the start."""
    player = RecordingPlayer(RecordedMessages(recording), 0)
    stopped = threading.Event()
    thread = threading.Thread(target=player.run, args=(stopped,))
    thread.start()
    with FoxgloveClient(player.address) as connected:
        connected.until(lambda: bool(connected.of("/cycle")), "the first message")
        assert connected.control(play=False)["status"] == PAUSED
        connected.during(0.1)
        yield connected
    stopped.set()
    thread.join()
    player.close()


def times_s(client: FoxgloveClient, topic: str = "/cycle") -> list[float]:
    return [(message.time_ns - START_NS) * 1e-9 for message in client.of(topic)]


def test_range_and_channels_are_those_of_the_file(client: FoxgloveClient, recording: Path) -> None:
    assert client.info["dataStartTime"] == {"sec": START_NS // 10**9, "nsec": 0}
    assert client.info["dataEndTime"] == {"sec": START_NS // 10**9 + 29, "nsec": 980_000_000}
    assert set(client.channels) == set(RecordedMessages(recording).channels)
    assert client.channels["/cycle"]["schemaEncoding"] == "hil.fields"
    assert len(client.of("/scene")) >= 1


def test_paused_playback_sends_nothing_and_continues_where_it_was(client: FoxgloveClient) -> None:
    seen = len(client.of("/cycle"))
    client.during(0.3)
    assert len(client.of("/cycle")) == seen
    client.control(play=True)
    client.during(0.3)
    client.control(play=False)
    assert np.allclose(np.diff(times_s(client)), 0.02)  # none is missing or twice


def test_seek_sends_what_was_valid_then_and_goes_on_from_there(client: FoxgloveClient) -> None:
    for to_s in (20.0, 3.0):
        client.control(play=False)
        client.during(0.1)  # what was under way
        client.messages.clear()
        state = client.control(play=True, speed=1.0, seek_ns=START_NS + round(to_s * 1e9))
        assert state["sought"]
        client.during(0.3)
        found = times_s(client)
        assert to_s - 0.021 < found[0] <= to_s
        assert to_s + 0.1 < found[-1] < to_s + 0.9
        assert len(client.of("/scene")) == 1
        assert to_s - 0.11 < times_s(client, "/state")[0] <= to_s


def test_speed_is_relative_to_real_time_and_the_end_is_reported(client: FoxgloveClient) -> None:
    begun_s = time.monotonic()
    client.control(play=True, speed=20.0, seek_ns=START_NS)
    client.until(lambda: client.playback[-1]["status"] == ENDED, "the end")
    assert 1.4 < time.monotonic() - begun_s < 5.0
    # the state of the playback has a queue of its own and may overtake the last messages
    client.until(lambda: times_s(client)[-1] == pytest.approx(RUN_S - 0.02), "the last cycle")
    client.messages.clear()
    client.control(play=True, speed=1.0)
    client.until(lambda: bool(client.of("/cycle")), "the first message")
    assert times_s(client)[0] == 0.0


def test_services_do_the_same_for_viewers_without_controls(client: FoxgloveClient) -> None:
    client.messages.clear()
    assert client.call("/hil/seek", t_s=10.0)["ok"]
    assert client.call("/hil/play", speed=2.0)["ok"]
    client.until(lambda: bool(times_s(client)) and times_s(client)[-1] > 10.2, "playback at 10 s")
    assert client.call("/hil/pause")["ok"]
    for payload, words in (
        (b'{"t_s": "x"}', "finite"),
        (b"{}", "t_s is missing"),
        (b"[", "column"),
        (b'{"t_s":1e999}', ""),
    ):
        answer = client.call_bytes("/hil/seek", payload)
        assert not answer["ok"]
        assert words in answer["text"]


def test_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    path.write_bytes(b"not MCAP at all")
    with pytest.raises(BadInput, match="not a recording"):
        RecordedMessages(path)


def test_intact_part_of_a_file_that_broke_off_is_played(recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(recording.read_bytes()[: recording.stat().st_size // 2])
    found = RecordedMessages(cut)
    assert 10.0 < (found.end_ns - found.start_ns) * 1e-9 < 20.0
