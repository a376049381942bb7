"""Docking monitor of a run: rendered or live camera and monitor, in this process or in a child process.

Its only input is the measured axis positions in the rows of CYCLE, or the camera. The loop does not wait for it;
results that arrive while it runs are compared with the navigation (``loop/sensor_stage.py``).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple, Self

import numpy as np

from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.scene import Scene
from hil.core.camera_images import IMAGE, MONITOR, CameraImage, ImageEncoder, ImageSink
from hil.core.child_process import ChildProcess, Message, Parent
from hil.core.clock import WallClock
from hil.core.messages import CYCLE
from hil.drivers.cameras.processes import CameraProcesses, raise_failure
from hil.errors import DeviceError
from hil.frmn.image_memory import RunTime, image_policy
from hil.frmn.ring import NoTelemetry, Ring, Telemetry
from hil.frmn.search_region import Box, SearchRegion
from hil.parts.monitor.camera import RenderedCamera
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.results import PORTION, Portion, portion_of, portion_row
from hil.parts.monitor.screen.overlay import annotated_shapes
from hil.parts.monitor.settings import MonitorSettings, Region
from hil.parts.monitor.sources import WHOLE, VideoFrame

NAME: Final = "docking monitor"
MONITOR_ADDRESS: Final = "127.0.0.4"
"""Address of the emulated television camera unless the rig file sets another."""
_NO_ROWS: Final = np.zeros(0, CYCLE)
_NICE: Final = 10  # lower priority than the processes that move the bench
_POLL_S: Final = 0.02
_READY_WALL_S: Final = 300.0  # the first start compiles
_FINISH_WALL_S: Final = 120.0  # above real time, frames wait to be processed at the end of the run


@dataclass
class MonitorOutcome:
    """Results of the docking monitor over a run.

    lag_s: longest time by which the newest row was ahead of a frame when that was processed. missed_rows: cycles that
    were overwritten before they were read. failure: why the monitor ended early, "" if it did not. warning: what the
    images show to be wrong in the scene, "" for nothing.
    """

    scene: str
    frames: int = 0
    portions: list[Portion] = field(default_factory=list)
    frame_mean_s: float = 0.0
    frame_max_s: float = 0.0
    lag_s: float = 0.0
    missed_rows: int = 0
    failure: str = ""
    warning: str = ""


class MonitorSinks(NamedTuple):
    """Sinks of the camera's images with their overlay, and of the results as rows of PORTION."""

    images: ImageSink | None = None
    portions: Telemetry = NoTelemetry()


_NO_SINKS: Final = MonitorSinks()


class MonitorOfFrames:
    """Docking monitor with its results. search: region that an operator sets, None for none."""

    search: SearchRegion | None = None

    def __init__(self, scenario: Scenario, scene: Scene, sinks: MonitorSinks = _NO_SINKS) -> None:
        self.outcome = MonitorOutcome(scenario.monitor.scene)
        self._monitor = DockingMonitor(scene, settings_of(scenario))
        self._images, self._portions = sinks
        self._box: Box | None = None
        self._spent_s = 0.0

    def process(self, frame: VideoFrame, now_s: float) -> None:
        """Measure on a frame; now_s: time of the run."""
        self._poll_search()
        start = time.perf_counter()
        portions = self._monitor.feed(frame)
        spent_s = time.perf_counter() - start
        self._keep(portions)
        self._put_image(frame)
        self._spent_s += spent_s
        outcome = self.outcome
        outcome.frames += 1
        outcome.frame_max_s = max(outcome.frame_max_s, spent_s)
        outcome.frame_mean_s = self._spent_s / outcome.frames
        outcome.lag_s = max(outcome.lag_s, now_s - frame.t_s)

    def finish(self) -> MonitorOutcome:
        """Return the results, with the frames of an unfinished portion."""
        self._keep(self._monitor.finish())
        self.outcome.warning = self._monitor.warning
        return self.outcome

    def _poll_search(self) -> None:
        if self.search is None or not self.search.changed():
            return
        self._box = self.search.get()
        self._monitor.search_in(None if self._box is None else Region.of_box(*self._box))

    def _keep(self, portions: Sequence[Portion]) -> None:
        for portion in portions:
            self.outcome.portions.append(portion)
            self._portions.put(portion_row(portion))

    def _put_image(self, frame: VideoFrame) -> None:
        """Send the frame with its overlay if one is due; a half frame with each line twice."""
        look = self._monitor.last
        if self._images is None or look is None or not self._images.due(frame.t_s):
            return
        image = frame.image if frame.field == WHOLE else np.repeat(frame.image, 2, axis=0)
        newest = self.outcome.portions[-1] if self.outcome.portions else None
        shapes = annotated_shapes(look.detection, newest, self._box, self._monitor.warning)
        self._images.put(
            CameraImage(MONITOR, image, t_s=frame.t_s, number=frame.number, status=look.status, shapes=shapes)
        )


class CameraMonitor(MonitorOfFrames):
    """Rendered camera and docking monitor."""

    def __init__(self, scenario: Scenario, scene: Scene, rig: Rig, seed: int, sinks: MonitorSinks = _NO_SINKS) -> None:
        super().__init__(scenario, scene, sinks)
        self._camera = RenderedCamera(scene, scenario.monitor, rig, scenario.step_s, seed)
        self._newest_s = 0.0

    def update(self, read: Callable[[], np.ndarray]) -> None:
        """Process every frame up to the newest row; ``read`` returns the new rows, (n,) of CYCLE."""
        self._add(read())
        for frame in self._camera.frames():
            self.process(frame, self._newest_s)
            self._add(read())  # before the ring overwrites them, however long a frame takes

    def _add(self, rows: np.ndarray) -> None:
        if len(rows):
            self._camera.track.add(rows)
            self._newest_s = float(rows["t_s"][-1])


class LiveClock(NamedTuple):
    """Bench time and time of the run in another process. run_time: descriptor of ``RunTime``."""

    epoch_ns: int
    speed: float
    run_time: int


class LiveMonitor:
    """Live camera and docking monitor; frames without a time of the run are not used. Raises DeviceError."""

    def __init__(self, monitor: MonitorOfFrames, scene: Scene, rig: Rig, times: LiveClock) -> None:
        self._monitor = monitor
        self._fps = scene.fps
        self._clock = WallClock(times.epoch_ns, times.speed)
        self._run_time = RunTime(times.run_time)
        self._last = -1
        table, size = rig.monitor_camera, (scene.camera.width, scene.camera.height)
        identifier = table.camera or (MONITOR_ADDRESS if rig.kind == "emulated" else None)
        self._cameras = CameraProcesses({MONITOR: identifier}, table, scene.fps, table.timeout_s, [size], self._clock)
        try:
            self.identity_doubt = self._cameras.check_identities({MONITOR: scene.camera.identity})
        except DeviceError:
            self._cameras.close()
            raise

    def update(self, timeout_s: float) -> None:
        """Process the new frames; waits up to ``timeout_s`` for one. Raises DeviceError for a camera that fails."""
        before_s = self._clock.now_s()
        for _, frame in self._cameras.frames(timeout_s):
            t_s = self._run_time.at(frame.exposed_s)
            if frame.image is None or not t_s >= 0.0:
                continue
            number = round(t_s * self._fps)  # a lost frame leaves a gap
            if number > self._last:
                self._last = number
                self._monitor.process(VideoFrame(number, t_s, frame.image), self._run_time.at(self._clock.now_s()))
        self._cameras.check(before_s)

    def close(self) -> None:
        """End the camera process. Idempotent."""
        self._cameras.close()


class InLoopMonitor:
    """Monitor in the process of a loop in simulated time: sink of its rows, source of the results for its interlock."""

    def __init__(self, monitor: CameraMonitor) -> None:
        self._monitor = monitor
        self._telemetry: Telemetry = NoTelemetry()
        self._rows: list[np.ndarray] = []
        self._polled = 0

    def over(self, rows: Telemetry) -> Telemetry:
        """Return this sink, which passes each row on to ``rows``."""
        self._telemetry = rows
        return self

    def put(self, row: np.ndarray) -> None:
        """Take a row of CYCLE, shape (1,)."""
        self._telemetry.put(row)
        self._rows.append(row.copy())

    def poll(self) -> list[Portion]:
        """Return the portions that the rows so far have completed."""
        self._monitor.update(self._read)
        portions = self._monitor.outcome.portions[self._polled :]
        self._polled += len(portions)
        return portions

    def finish(self) -> MonitorOutcome:
        """Return the results of the run."""
        self.poll()
        outcome = self._monitor.finish()
        outcome.lag_s = 0.0
        return outcome

    def _read(self) -> np.ndarray:
        rows, self._rows = self._rows, []
        return np.concatenate(rows) if rows else _NO_ROWS


class RingPortions:
    """Results of a monitor in another process, from the ring that it fills."""

    def __init__(self, portions: Ring) -> None:
        self._reader = portions.reader(from_now=True)

    def poll(self) -> list[Portion]:
        """Return the portions since the last call; never waits."""
        return [portion_of(row) for row in self._reader.read()]


def settings_of(scenario: Scenario) -> MonitorSettings:
    """Return the settings of the docking monitor of a run of ``scenario``; guidance limits how fast a rate changes."""
    guidance = scenario.gnc.guidance
    acceleration = max(guidance.acceleration_mps2, guidance.deceleration_mps2)
    return MonitorSettings(target=scenario.monitor.target, acceleration_mps2=acceleration)


def monitor_recorded(
    scenario: Scenario, scene: Scene, rig: Rig, seed: int, history: np.ndarray, sinks: MonitorSinks = _NO_SINKS
) -> MonitorOutcome:
    """Return the monitor's results for the rows ``history`` (n,) of CYCLE of a run that has ended."""
    monitor = CameraMonitor(scenario, scene, rig, seed, sinks)
    unread = [history]
    monitor.update(lambda: unread.pop() if unread else history[:0])
    outcome = monitor.finish()
    outcome.lag_s = 0.0
    return outcome


class MonitorRings(NamedTuple):
    """Rings of the monitor's process: of CYCLE that it reads, of ``IMAGE`` and ``PORTION`` that it fills."""

    telemetry: Ring
    images: Ring | None = None
    portions: Ring | None = None


class MonitorProcess:
    """The docking monitor in a child process; start it from a thread that lives as long as the bench.

    times: of a live camera, which it starts. search: region that an operator sets.
    """

    def __init__(
        self,
        scenario: Scenario,
        scene: Scene,
        rig: Rig,
        seed: int,
        rings: MonitorRings,
        times: LiveClock | None = None,
        search: SearchRegion | None = None,
    ) -> None:
        slots = {name: (ring.descriptor, ring.slots) for name, ring in rings._asdict().items() if ring is not None}
        configuration = {
            "scenario": scenario.model_dump(mode="json"),
            "scene": scene.model_dump(mode="json"),
            "rig": rig.model_dump(mode="json"),
            "seed": seed,
            "rings": slots,
            "times": times,
            "search": None if search is None else search.descriptor,
        }
        descriptors = [descriptor for descriptor, _ in slots.values()] + ([times.run_time] if times else [])
        descriptors += [search.descriptor] if search is not None else []
        self._child = ChildProcess(NAME, "hil.parts.monitor.process", configuration, descriptors)

    @property
    def pid(self) -> int:
        return self._child.pid

    def wait_ready(self) -> None:
        """Return once every kernel is compiled. Raises DeviceError."""
        raise_failure(self._child.wait_ready(_READY_WALL_S))

    def finish(self) -> MonitorOutcome:
        """End the monitor; return its results. Raises DeviceError."""
        self._child.ask_to_end()
        result = self._child.receive(_FINISH_WALL_S)
        portions = [
            Portion(**row | {name: np.array(row[name]) for name in ("values", "sigmas")}) for row in result["portions"]
        ]
        return MonitorOutcome(**result | {"portions": portions})

    def close(self) -> None:
        """End the child at once. Idempotent."""
        self._child.kill()
        self._child.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def run_child(parent: Parent) -> None:
    """Monitor the run of the process that started this one, until it closes stdin; send the results."""
    configuration = parent.configuration
    scenario = Scenario.model_validate(configuration["scenario"], strict=False)
    scene = Scene.model_validate(configuration["scene"], strict=False)
    rig = Rig.model_validate(configuration["rig"], strict=False)
    rings: dict[str, tuple[int, int]] = configuration["rings"]
    warm_up(scenario, scene, rig)
    os.nice(_NICE)  # nothing moves before this
    reader = Ring(rings["telemetry"][0], CYCLE, rings["telemetry"][1]).reader()
    policy = image_policy(rig)
    sinks = _NO_SINKS
    if "images" in rings and policy.encoding != "none":
        ring = Ring(rings["images"][0], IMAGE, rings["images"][1], "pictures")
        sinks = sinks._replace(images=ImageEncoder(ring, policy))
    if "portions" in rings:
        sinks = sinks._replace(portions=Ring(rings["portions"][0], PORTION, rings["portions"][1], "portions"))
    search = None if configuration["search"] is None else SearchRegion(configuration["search"])
    if configuration["times"] is not None:
        live = MonitorOfFrames(scenario, scene, sinks)
        live.search = search
        _run_live(parent, live, scene, rig)
        return
    monitor = CameraMonitor(scenario, scene, rig, configuration["seed"], sinks)
    monitor.search = search
    parent.send()
    while not parent.wait_end(_POLL_S):
        monitor.update(reader.read)
    monitor.update(reader.read)
    outcome = monitor.finish()
    outcome.missed_rows = reader.lost
    parent.send(**_as_json(outcome))


def _run_live(parent: Parent, monitor: MonitorOfFrames, scene: Scene, rig: Rig) -> None:
    """Monitor the images of a live camera until the parent ends or the camera fails; send the results."""
    try:
        live = LiveMonitor(monitor, scene, rig, LiveClock(*parent.configuration["times"]))
    except DeviceError as error:
        parent.send(failure=[type(error).__name__, error.device, error.what])
        return
    parent.send()
    try:
        while not parent.wait_end(0.0):
            live.update(_POLL_S)
    except DeviceError as error:
        monitor.outcome.failure = str(error)
        while not parent.wait_end(_READY_WALL_S):
            pass
    finally:
        live.close()
    outcome = monitor.finish()
    outcome.warning = "; ".join(filter(None, (outcome.warning, live.identity_doubt)))
    parent.send(**_as_json(outcome))


def _as_json(outcome: MonitorOutcome) -> Message:
    """Return ``outcome`` for a line of JSON; NaN stays NaN."""
    rows: list[dict[str, Any]] = [
        {
            "t_s": portion.t_s,
            "frames": portion.frames,
            "status": portion.status,
            "values": portion.values.tolist(),
            "sigmas": portion.sigmas.tolist(),
        }
        for portion in outcome.portions
    ]
    return {**vars(outcome), "portions": rows}


def warm_up(scenario: Scenario, scene: Scene, rig: Rig) -> None:
    """Monitor a bench at rest for a second, so that every kernel is compiled."""
    rows = np.zeros(3, CYCLE)
    rows["t_s"] = rows["sampled_s"][:, 0] = rows["sampled_s"][:, 1] = (0.0, 0.6, 1.2)
    rows["feedback"]["rail_m"][:, 0] = 5.0
    monitor_recorded(scenario, scene, rig, 0, rows)
