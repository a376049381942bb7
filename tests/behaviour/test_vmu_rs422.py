"""The vision unit's driver on a pseudo terminal: against hand-made frames, its emulator, and its death."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from hil.config.rig import Vmu, VmuLine
from hil.core.child_process import ChildProcess
from hil.core.clock import WallClock
from hil.core.messages import PoseFrame
from hil.drivers.base import PoseSource
from hil.drivers.vmu import COUNTERS
from hil.drivers.vmu.codec import STATUS_NO_POSE
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.driver import Rs422Vmu
from hil.errors import DeviceError, DriveFault, LinkLost, LinkTimeout
from hil.parts.emulation.pty_line import PtyLine
from hil.parts.emulation.vision_unit import VmuEmulator

pytestmark = pytest.mark.wires

SPEED = 4.0
POSE = PoseFrame(0, 0.0, 0.0, np.array([0.1, -0.2, 3.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6) * 1e-4)

CHILD = """
import numpy as np
from hil.core.clock import WallClock
from hil.config.rig import Vmu
from hil.core.child_process import serve
from hil.parts.emulation.vision_unit import VmuEmulator
from hil.core.messages import PoseFrame
pose = PoseFrame(0, 0.0, 0.0, np.array([0.1, -0.2, 3.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6) * 1e-4)
def unit(c):
    vmu = Vmu.model_validate(c["vmu"], strict=False)
    return VmuEmulator(vmu, WallClock(c["epoch_ns"], c["speed"]), lambda t_s: pose)
serve(unit)
"""


def config(port: str | None = None, **changes: float) -> Vmu:
    return Vmu.model_validate({"driver": "rs422", "rs422": VmuLine(port=port)} | changes)


@dataclass
class Desk:
    """A driver and the other end of its line."""

    clock: WallClock
    line: PtyLine
    vmu: Rs422Vmu

    def send(self, *counters: int) -> None:
        for counter in counters:
            self.line.write(frame_codec().encode(replace(POSE, counter=counter, t_s=self.clock.now_s())))

    def poll(self) -> list[PoseFrame]:
        return self.vmu.poll(self.clock.now_s())

    def poll_until(self, done: Callable[[list[PoseFrame]], bool]) -> list[PoseFrame]:
        """Poll at about 1 kHz until ``done(all frames)``, 5 s at most."""
        frames: list[PoseFrame] = []
        give_up_s = time.monotonic() + 5.0
        while not done(frames):
            assert time.monotonic() < give_up_s, self.vmu.counters()
            time.sleep(0.001)
            frames += self.poll()
        return frames

    def error(self) -> tuple[DeviceError, float]:
        """Poll until an error comes; return it and how long that took, s of wall time."""
        start_s = time.monotonic()
        with pytest.raises(DeviceError) as caught:
            self.poll_until(lambda frames: False)
        return caught.value, time.monotonic() - start_s


@pytest.fixture
def desk() -> Iterator[Desk]:
    clock = WallClock(speed=SPEED)
    line = PtyLine(460_800, clock)
    vmu = Rs422Vmu(config(line.path, timeout_s=2.0), clock)
    vmu.open(clock.now_s())
    yield Desk(clock, line, vmu)
    vmu.close()
    line.close()


def test_driver_is_a_pose_source(desk: Desk) -> None:
    assert isinstance(desk.vmu, PoseSource)
    assert set(desk.vmu.counters()) == set(COUNTERS)


def test_frames_come_once_and_oldest_first(desk: Desk) -> None:
    before_s = desk.clock.now_s()
    desk.send(5, 6, 7)
    frames = desk.poll_until(lambda frames: len(frames) == 3)
    assert [frame.counter for frame in frames] == [5, 6, 7]
    assert before_s < frames[0].received_s <= frames[2].received_s <= desk.clock.now_s()
    assert desk.poll() == []


def test_gap_repetition_and_overtaken_frame_are_counted_across_the_wrap(desk: Desk) -> None:
    desk.send(0xFFFF_FFFE, 0xFFFF_FFFE, 2, 1, 1, 3)
    frames = desk.poll_until(lambda frames: len(frames) == 4)
    assert [frame.counter for frame in frames] == [0xFFFF_FFFE, 2, 1, 3]
    counters = desk.vmu.counters()
    assert {name: counters[name] for name in ("frames", "lost", "duplicates", "late")} == {
        "frames": 4,
        "lost": 2,
        "duplicates": 2,
        "late": 1,
    }


def test_frame_from_far_behind_is_dropped(desk: Desk) -> None:
    desk.send(1000, 1, 1001)
    assert [frame.counter for frame in desk.poll_until(lambda frames: len(frames) == 2)] == [1000, 1001]
    assert desk.vmu.counters()["late"] == 1


def test_clock_of_the_units_own_is_set_against_bench_time() -> None:
    clock = WallClock()
    line = PtyLine(460_800, clock)
    vmu = Rs422Vmu(config(line.path).model_copy(update={"clock": "own"}), clock)
    vmu.open(clock.now_s())
    try:
        stamps = [9000.0 + 0.01 * i for i in range(5)]
        started_s = clock.now_s()
        for counter, stamp_s in enumerate(stamps):
            clock.sleep_until(started_s + stamp_s - stamps[0])
            line.write(frame_codec().encode(replace(POSE, counter=counter, t_s=stamp_s)))
        desk = Desk(clock, line, vmu)
        frames = desk.poll_until(lambda frames: len(frames) == len(stamps))
        assert all(started_s - 0.1 < frame.t_s <= frame.received_s for frame in frames)
    finally:
        vmu.close()
        line.close()


def test_damaged_frame_is_counted_and_the_next_is_taken(desk: Desk) -> None:
    damaged = bytearray(frame_codec().encode(replace(POSE, counter=1, t_s=desk.clock.now_s())))
    damaged[50] ^= 0x10
    desk.send(0)
    desk.line.write(bytes(damaged))
    desk.send(2)
    assert [frame.counter for frame in desk.poll_until(lambda frames: len(frames) == 2)] == [0, 2]
    counters = desk.vmu.counters()
    assert (counters["crc_errors"], counters["skipped_bytes"], counters["lost"]) == (1, frame_codec().size, 1)


def test_frame_from_before_the_opening_is_not_handed_out(desk: Desk) -> None:
    desk.line.write(frame_codec().encode(replace(POSE, counter=3, t_s=0.0)))
    desk.send(9)
    assert [frame.counter for frame in desk.poll_until(lambda frames: len(frames) == 1)] == [9]
    assert (desk.vmu.counters()["late"], desk.vmu.counters()["lost"]) == (1, 0)


def test_unit_that_never_speaks_times_out(desk: Desk) -> None:
    error, took_s = desk.error()
    assert isinstance(error, LinkTimeout)
    assert str(error).startswith("vmu: no answer for 2.0")
    assert 0.4 < took_s < 0.8


def test_repeated_frame_is_no_sign_of_life(desk: Desk) -> None:
    def repeat(_: list[PoseFrame]) -> bool:
        desk.send(0)
        return False

    with pytest.raises(LinkTimeout, match=r"since open: frames 1, duplicates \d+"):
        desk.poll_until(repeat)


def test_frame_without_a_pose_is_a_sign_of_life(desk: Desk) -> None:
    counter = 0
    while desk.clock.now_s() < 3.0:
        desk.line.write(frame_codec().encode_status(counter, desk.clock.now_s(), STATUS_NO_POSE))
        assert desk.poll() == []
        counter += 1
        time.sleep(0.05)
    assert desk.vmu.counters()["no_pose"] > 5


def test_fault_of_the_unit_reaches_the_loop(desk: Desk) -> None:
    desk.line.write(frame_codec().encode_status(0, desk.clock.now_s(), 0x82))
    error, _ = desk.error()
    assert isinstance(error, DriveFault)
    assert str(error) == "vmu: reports fault 0x82"


def test_wrong_baud_rate_shows_in_the_error(desk: Desk) -> None:
    desk.line.write(b"\xfe\x00" * 100)
    error, _ = desk.error()
    assert "skipped_bytes 200" in str(error)


@pytest.mark.parametrize("port", ["/dev/no-such-port", None])
def test_missing_port_is_named(port: str | None) -> None:
    with pytest.raises(LinkLost, match=r"vmu: .*(cannot open /dev/no-such-port|rs422\.port is not set)"):
        Rs422Vmu(config(port), WallClock()).open(0.0)


def test_close_is_quick_and_may_be_repeated_and_undone(desk: Desk) -> None:
    start_s = time.monotonic()
    desk.vmu.close()
    assert time.monotonic() - start_s < 0.09
    desk.vmu.close()
    with pytest.raises(LinkLost, match="vmu: is closed"):
        desk.poll()
    desk.vmu.open(desk.clock.now_s())
    desk.send(0)
    assert len(desk.poll_until(lambda frames: len(frames) == 1)) == 1


def test_emulator_exposes_on_the_beat_and_sends_after_processing_and_line_time() -> None:
    clock = WallClock(speed=SPEED)
    rate_hz, processing_s = 6.25, 0.05
    settings = config(rate_hz=rate_hz, processing_s=processing_s)
    asked: list[float] = []

    def pose_at(t_s: float) -> PoseFrame | None:
        asked.append(t_s)
        return None if len(asked) == 3 else replace(POSE, t_v=np.array([t_s, 0.0, 3.0]))

    emulator = VmuEmulator(settings, clock, pose_at)
    addresses = emulator.start()
    stop = threading.Event()
    thread = threading.Thread(target=emulator.run, args=(stop,))
    vmu = Rs422Vmu(config(addresses["vmu"], timeout_s=2.0), clock)
    vmu.open(clock.now_s())
    thread.start()
    try:
        desk_frames: list[PoseFrame] = []
        while len(desk_frames) < 5 and clock.now_s() < 10.0:
            desk_frames += vmu.poll(clock.now_s())
            time.sleep(0.001)
    finally:
        stop.set()
        thread.join(1.0)
        vmu.close()
        emulator.close()
    assert [frame.counter for frame in desk_frames] == [0, 1, 3, 4, 5]
    assert vmu.counters()["no_pose"] == 1
    assert vmu.counters()["lost"] == 0
    line_s = frame_codec().size * 10 / 460_800
    for frame in desk_frames:
        assert frame.t_s == pytest.approx(frame.t_v[0], abs=1e-6)
        assert frame.t_s * rate_hz == pytest.approx(round(frame.t_s * rate_hz), abs=1e-4)
        assert frame.received_s - frame.t_s > processing_s + line_s


@pytest.mark.parametrize(
    ("number", "error_class", "bound_s"),
    [(signal.SIGKILL, LinkLost, 0.4), (signal.SIGSTOP, LinkTimeout, 0.4)],
)
def test_dead_and_frozen_unit_surface_within_the_time_out(
    number: signal.Signals,
    error_class: type[DeviceError],
    bound_s: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "unit_child.py").write_text(CHILD)
    monkeypatch.setenv("PYTHONPATH", f"{tmp_path}:{Path.cwd()}:{os.environ.get('PYTHONPATH', '')}")
    clock = WallClock()
    settings = config()
    child = ChildProcess(
        "vmu emulator",
        "unit_child",
        {"vmu": settings.model_dump(), "epoch_ns": clock.epoch_ns, "speed": clock.speed},
    )
    try:
        vmu = Rs422Vmu(config(child.wait_ready(20.0)["addresses"]["vmu"]), clock)
        vmu.open(clock.now_s())
        try:
            desk = Desk(clock, None, vmu)  # type: ignore[arg-type]
            desk.poll_until(lambda frames: len(frames) == 2)
            os.kill(child.pid, number)
            error, took_s = desk.error()
            start_s = time.monotonic()
        finally:
            vmu.close()
        assert time.monotonic() - start_s < 0.09
        assert isinstance(error, error_class)
        assert (error.__cause__ is None) == (error_class is LinkTimeout)
        assert took_s < bound_s + 0.1
    finally:
        start_s = time.monotonic()
        child.close()
        assert time.monotonic() - start_s < 0.45
