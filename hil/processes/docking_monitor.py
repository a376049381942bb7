"""The docking monitor beside a run: a process of its own on the wall clock, after the run in simulated time.

``python -m hil.processes.docking_monitor`` is the child. One JSON line of configuration goes down its stdin, one that
says that it is ready comes up; it reads each cycle's row from the telemetry. The end of its stdin ends the watch, and
what it saw comes up as one more line. It looks at the encoders alone; the loop neither waits for it nor hears from it.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final, Self

import numpy as np

from hil.cameras.docking import RenderedCamera
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.scene import Scene
from hil.core.camera_images import MONITOR, PICTURE, CameraImage, ImageEncoder, MakesPictures
from hil.core.messages import CYCLE
from hil.drivers.emulator_process import die_with_parent
from hil.errors import LinkLost, LinkTimeout
from hil.frmn.image_memory import wanted_pictures
from hil.frmn.ring import NoTelemetry, Ring, Telemetry
from hil.monitor.monitor import Monitor
from hil.monitor.results import PORTION, Portion, portion_row
from hil.monitor.screen.overlay import with_words
from hil.monitor.settings import MonitorSettings
from hil.monitor.sources import WHOLE, VideoFrame

NAME: Final = "docking monitor"
_NICE: Final = 10  # it may come late; whoever moves the bench may not
_POLL_S: Final = 0.02
_READY_WALL_S: Final = 300.0  # the first start compiles
_LAST_WORDS_WALL_S: Final = 120.0  # a bench at many times the speed of time leaves pictures to be looked at


@dataclass
class Watched:
    """What the monitor saw of a run. ``lag_s``: how far the newest row was ahead of a frame when it was looked at;
    ``missed_rows``: cycles that it read too late to have them; ``failure``: why it ended early, "" if it did not."""

    scene: str
    frames: int = 0
    portions: list[Portion] = field(default_factory=list)
    frame_mean_s: float = 0.0
    frame_max_s: float = 0.0
    lag_s: float = 0.0
    missed_rows: int = 0
    failure: str = ""


class Watch:
    """Camera and monitor together. shown: takes the pictures, told: the portions, each as a row of PORTION."""

    def __init__(
        self,
        scenario: Scenario,
        scene: Scene,
        rig: Rig,
        seed: int,
        shown: MakesPictures | None = None,
        told: Telemetry | None = None,
    ) -> None:
        config = scenario.monitor
        self.watched = Watched(config.scene)
        self._camera = RenderedCamera(scene, config, rig, scenario.step_s, seed)
        self._monitor = Monitor(scene, settings_of(scenario))
        self._shown = shown
        self._told = told or NoTelemetry()
        self._spent_s = 0.0
        self._newest_s = 0.0

    def take(self, read: Callable[[], np.ndarray]) -> None:
        """Look at every frame that the rows (n,) of CYCLE lead up to, which ``read`` gives: those that are new."""
        self._add(read())
        watched = self.watched
        for frame in self._camera.frames():
            start = time.perf_counter()
            done = self._monitor.feed(frame)
            spent_s = time.perf_counter() - start
            self._keep(done)
            self._show(frame)
            self._spent_s += spent_s
            watched.frames += 1
            watched.frame_max_s = max(watched.frame_max_s, spent_s)
            watched.frame_mean_s = self._spent_s / watched.frames
            watched.lag_s = max(watched.lag_s, self._newest_s - frame.t_s)
            self._add(read())  # the telemetry forgets, however long it takes to look

    def _add(self, rows: np.ndarray) -> None:
        if len(rows):
            self._camera.track.add(rows)
            self._newest_s = float(rows["t_s"][-1])

    def _keep(self, done: Sequence[Portion]) -> None:
        for portion in done:
            self.watched.portions.append(portion)
            self._told.put(portion_row(portion))

    def _show(self, frame: VideoFrame) -> None:
        """Hand over the frame with what was found in it, where it is wanted; a half frame with each line twice."""
        look = self._monitor.last
        if self._shown is None or look is None or not self._shown.due(frame.t_s):
            return
        image = frame.image if frame.field == WHOLE else np.repeat(frame.image, 2, axis=0)
        newest = self.watched.portions[-1] if self.watched.portions else None
        shapes = with_words(look.seen, newest)
        self._shown.put(
            CameraImage(MONITOR, image, t_s=frame.t_s, number=frame.number, status=look.status, shapes=shapes)
        )

    def finish(self) -> Watched:
        """Return what was seen, the frames of an unfinished portion included."""
        self._keep(self._monitor.finish())
        return self.watched


def settings_of(scenario: Scenario) -> MonitorSettings:
    """Return the settings of the monitor beside a run of ``scenario``."""
    guidance = scenario.gnc.guidance  # how fast a rate may change is known here
    acceleration = max(guidance.acceleration_mps2, guidance.deceleration_mps2)
    return MonitorSettings(target=scenario.monitor.target, acceleration_mps2=acceleration)


def watch_recorded(
    scenario: Scenario,
    scene: Scene,
    rig: Rig,
    seed: int,
    history: np.ndarray,
    shown: MakesPictures | None = None,
    told: Telemetry | None = None,
) -> Watched:
    """Return what the monitor sees of a run whose rows ``history`` (n,) of CYCLE are there.

    shown: takes the pictures, told: the portions, each as a row of PORTION.
    """
    watch = Watch(scenario, scene, rig, seed, shown, told)
    unread = [history]
    watch.take(lambda: unread.pop() if unread else history[:0])
    watched = watch.finish()
    watched.lag_s = 0.0
    return watched


class MonitorProcess:
    """The child and the way to it; start it from a thread that lives as long as the bench.

    pictures, portions: rings of PICTURE and PORTION that it fills, for other processes to read; None: nobody does.
    """

    def __init__(
        self,
        scenario: Scenario,
        scene: Scene,
        rig: Rig,
        seed: int,
        telemetry: Ring,
        pictures: Ring | None = None,
        portions: Ring | None = None,
    ) -> None:
        self._scene = scenario.monitor.scene
        configuration = {
            "scenario": scenario.model_dump(mode="json"),
            "scene": scene.model_dump(mode="json"),
            "rig": rig.model_dump(mode="json"),
            "seed": seed,
            "telemetry": telemetry.descriptor,
            "slots": telemetry.slots,
            "pictures": _place(pictures),
            "portions": _place(portions),
        }
        rings = [ring for ring in (telemetry, pictures, portions) if ring is not None]
        self._process = subprocess.Popen(
            [sys.executable, "-m", "hil.processes.docking_monitor"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[ring.descriptor for ring in rings],
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
        with contextlib.suppress(BrokenPipeError):  # it died at once: wait_ready tells
            self._stdin.write(json.dumps(configuration).encode() + b"\n")
            self._stdin.flush()

    @property
    def pid(self) -> int:
        return self._process.pid

    def wait_ready(self) -> None:
        """Return once every kernel is compiled. Raises LinkLost or LinkTimeout, both name the monitor."""
        self._line(_READY_WALL_S)

    def finish(self) -> Watched:
        """End the watch; return what was seen. Raises LinkLost or LinkTimeout."""
        self._stdin.close()
        told = json.loads(self._line(_LAST_WORDS_WALL_S))
        told["portions"] = [_portion(row) for row in told["portions"]]
        return Watched(**told)

    def close(self) -> None:
        """End the child, whatever it does. Idempotent."""
        self._process.kill()
        self._process.wait()
        with contextlib.suppress(BrokenPipeError):
            self._stdin.close()
        self._stdout.close()

    def _line(self, timeout_s: float) -> bytes:
        ready, _, _ = select.select([self._stdout], [], [], timeout_s)
        if not ready:
            raise LinkTimeout(NAME, f"says nothing for {timeout_s:g} s")
        line = self._stdout.readline()
        if not line.endswith(b"\n"):
            raise LinkLost(NAME, f"its process ended with exit code {self._process.wait()}")
        return line

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _place(ring: Ring | None) -> tuple[int, int] | None:
    return None if ring is None else (ring.descriptor, ring.slots)


def _outlets(told: dict[str, Any], rig: Rig) -> tuple[MakesPictures | None, Telemetry | None]:
    """Return, in the child, who takes pictures and portions."""
    wanted = wanted_pictures(rig)
    shown, portions = None, None
    if told["pictures"] is not None and wanted.encoding != "none":
        shown = ImageEncoder(Ring(told["pictures"][0], PICTURE, told["pictures"][1], "pictures"), wanted)
    if told["portions"] is not None:
        portions = Ring(told["portions"][0], PORTION, told["portions"][1], "portions")
    return shown, portions


def _portion(row: dict[str, Any]) -> Portion:
    numbers = {name: np.array([math.nan if x is None else x for x in row[name]]) for name in ("values", "sigmas")}
    return Portion(row["t_s"], row["frames"], row["status"], **numbers)


def _told(watched: Watched) -> str:
    rows = [
        {
            "t_s": portion.t_s,
            "frames": portion.frames,
            "status": portion.status,
            **{
                name: [x if math.isfinite(x) else None for x in getattr(portion, name).tolist()]
                for name in ("values", "sigmas")
            },
        }
        for portion in watched.portions
    ]
    return json.dumps(asdict(Watched(**{**vars(watched), "portions": []})) | {"portions": rows})


def _warm_up(scenario: Scenario, scene: Scene, rig: Rig) -> None:
    """Look at a still bench for a second, so that everything is compiled."""
    rows = np.zeros(3, CYCLE)
    rows["t_s"] = rows["sampled_s"][:, 0] = rows["sampled_s"][:, 1] = (0.0, 0.6, 1.2)
    rows["feedback"]["rail_m"][:, 0] = 5.0
    watch_recorded(scenario, scene, rig, 0, rows)


def _main() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent stops the bench, and then this
    die_with_parent()
    up = os.fdopen(os.dup(sys.stdout.fileno()), "w", buffering=1)
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    line = sys.stdin.buffer.readline()
    if not line:
        return
    told = json.loads(line)
    scenario = Scenario.model_validate(told["scenario"], strict=False)
    scene = Scene.model_validate(told["scene"], strict=False)
    rig = Rig.model_validate(told["rig"], strict=False)
    ring = Ring(told["telemetry"], CYCLE, told["slots"])
    _warm_up(scenario, scene, rig)
    os.nice(_NICE)  # nothing moves before this
    reader = ring.reader()
    watch = Watch(scenario, scene, rig, told["seed"], *_outlets(told, rig))
    up.write("ready\n")
    ended = False
    while not ended:
        ready, _, _ = select.select([sys.stdin], [], [], _POLL_S)
        ended = bool(ready)  # nothing is ever sent: only its end makes stdin ready
        watch.take(reader.read)
    watched = watch.finish()
    watched.missed_rows = reader.lost
    up.write(_told(watched) + "\n")


if __name__ == "__main__":
    _main()
