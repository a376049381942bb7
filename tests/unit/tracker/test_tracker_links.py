"""Clients of trackers against the emulated servers, on sockets of this computer."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.core.clock import WallClock
from hil.errors import LinkLost
from hil.parts.emulation.trackers import NatNetServer, QtmServer, TextSender, TrackerEmulator, TrackerServer
from hil.parts.tracker import preflight
from hil.parts.tracker.link import open_link
from hil.parts.tracker.table import Tracker

pytestmark = pytest.mark.wires

R, Q = np.array([-3.0, 0.2, -0.1]), np.array([0.0, 0.0, 0.0, 1.0])
FRAME = {"position_m": [1.0, 0.5, 0.2]}
POINTS = """
name = "points"
rotation = "none"
sigma_position_m = 1e-4
fields = [{ name = "counter" }, { name = "time" }, { name = "position" }]
checksum = { kind = "none" }
text = { separator = " " }
"""


def _table(driver: str, **keys: Any) -> Tracker:
    names: list[Any] = [1, 2] if driver == "natnet" else ["chaser", "target"]
    bodies = {"chaser": {"body": names[0]}, "frame": FRAME}
    if driver != "text":
        bodies["target"] = {"body": names[1]}
    return Tracker.model_validate({"driver": driver, **bodies, **keys}, strict=False)


@contextmanager
def _served(config: Tracker, server: TrackerServer, clock: WallClock) -> Iterator[Tracker]:
    """Give the table with the address of ``server``, which runs meanwhile."""
    emulator, stop = TrackerEmulator(config, server, lambda _: (R, Q), clock, 0), threading.Event()
    thread = threading.Thread(target=emulator.run, args=(stop,))
    thread.start()
    try:
        yield config.connected(emulator.start()["tracker"])
    finally:
        stop.set()
        thread.join()
        emulator.close()


def _server(config: Tracker, clock: WallClock) -> TrackerServer:
    if config.driver == "natnet":
        return NatNetServer((4, 1), config.latency_s)
    return QtmServer(["chaser", "target"]) if config.driver == "qtm" else TextSender(config, clock)


@pytest.mark.parametrize("driver", ["natnet", "qtm", "text"])
def test_client_reads_what_the_emulated_server_measures(driver: str) -> None:
    config, clock = _table(driver), WallClock()
    with _served(config, _server(config, clock), clock) as served:
        link = open_link(served, clock)
        try:
            time.sleep(0.5)
            frames = link.poll(clock.now_s())
        finally:
            link.close()
    assert len(frames) > 20
    assert (link.failure, link.invalid) == ("", 0)
    assert {name for frame in frames for name in frame.bodies} == {body.body for body in config.bodies.values()}
    ages = [frame.received_s - frame.stamp_s for frame in frames]
    assert min(ages) + config.clock_offset_s == pytest.approx(config.latency_s, abs=3e-3)
    mean = np.mean([frame.bodies[config.chaser.body].position for frame in frames], axis=0)
    assert mean == pytest.approx(R + FRAME["position_m"], abs=3e-4)


def test_points_of_a_laser_tracker_have_no_attitude(tmp_path: Any) -> None:
    (tmp_path / "points.toml").write_text(POINTS)
    config, clock = _table("text", frames=str(tmp_path / "points.toml")), WallClock()
    with _served(config, _server(config, clock), clock) as served:
        link = open_link(served, clock)
        time.sleep(0.3)
        frames = link.poll(clock.now_s())
        link.close()
    assert len(frames) > 10
    assert all(frame.bodies["chaser"].q is None for frame in frames)


@pytest.mark.parametrize("driver", ["natnet", "qtm"])
def test_tracker_that_does_not_respond_is_one_line(driver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hil.parts.tracker.link._RESPONSE_WALL_S", 0.2)
    with pytest.raises(LinkLost, match=r"^tracker: 127\.0\.0\.1:9: .*: is it streaming\?$"):
        open_link(_table(driver, port=9), WallClock())


def test_preflight_names_what_is_not_tracked() -> None:
    clock = WallClock()
    config = _table("natnet", faults=[{"kind": "lost", "at_s": 0.0, "of": "target"}])
    with _served(config, _server(config, clock), clock) as served:
        rig = load_rig("mock").value.model_copy(update={"tracker": served})
        (check,) = preflight.checks(rig)
    assert check.passed is False
    assert "not tracked: target (2)" in check.value
