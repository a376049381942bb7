"""Replay of images: recorded ones through today's vision unit or docking monitor, compared with the recorded results.

With the same images, geometry and settings the results are identical.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np

from hil.config.scene import Scene
from hil.config.vmu_geometry import VmuGeometry
from hil.core.camera_images import MONITOR
from hil.core.messages import PoseFrame
from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.frame_codec import FrameDecoder
from hil.errors import BadInput
from hil.maths import quat
from hil.parts.monitor.monitor import DockingMonitor
from hil.parts.monitor.results import PORTION, QUANTITIES, Portion, portion_of, portion_row
from hil.parts.monitor.setup import settings_of
from hil.parts.monitor.sources import WHOLE, VideoFrame, exposure
from hil.recording import images
from hil.recording.read import Recorded
from hil.vmu.estimators import make_estimator

VMU, DOCKING_MONITOR = "the vision unit", "the docking monitor"
POSE: Final = ("x", "y", "z", "rx", "ry", "rz")
_PERIOD_FRACTION: Final = 0.25  # of a frame period: tolerance of a frame's time against that of its image


@dataclass(frozen=True)
class ImageComponent:
    """One number of the results. count: results in which it differs; first_s: time of the run of the first of them;
    largest: |difference| in unit and in the recorded sigmas; None if only one of both is finite."""

    name: str
    unit: str
    count: int
    first_s: float | None
    largest: float | None
    largest_sigmas: float | None
    largest_s: float | None

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


@dataclass
class ImagesReplayed:
    """Result of a replay. images: exposures processed; compared: results (poses or portions) both in the recording
    and in the replay; statuses: (recorded, replayed) -> count; missing, new: results only in the recording or only in
    the replay; remarks: reasons why differences are expected."""

    of: str
    images: int = 0
    compared: int = 0
    missing: int = 0
    new: int = 0
    statuses: Counter[tuple[str, str]] = field(default_factory=Counter)
    differences: list[ImageComponent] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """Whether every status and every number is the same, bit by bit."""
        same = all(original == now for original, now in self.statuses)
        return same and not (self.differences or self.missing or self.new)


class _Compared:
    """Collection of result pairs: recorded and replayed numbers with the recorded sigmas."""

    def __init__(self, names: Sequence[tuple[str, str]]) -> None:
        self._names = names
        self._rows: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, t_s: float, apart: np.ndarray, differs: np.ndarray, sigmas: np.ndarray) -> None:
        """Add one result: differences, whether the numbers differ in a bit, recorded sigmas."""
        self._rows.append((t_s, apart, differs, sigmas))

    def __len__(self) -> int:
        return len(self._rows)

    def components(self) -> Iterator[ImageComponent]:
        if not self._rows:
            return
        t_s = np.array([row[0] for row in self._rows])
        apart, differs, sigmas = (np.array([row[i] for row in self._rows]) for i in (1, 2, 3))
        for i, (name, unit) in enumerate(self._names):
            where = np.flatnonzero(differs[:, i])
            if not len(where):
                continue
            sizes = np.abs(apart[where, i])
            worst = int(np.argmax(np.where(np.isfinite(sizes), sizes, -1.0)))
            ratios = sizes / sigmas[where, i]
            yield ImageComponent(
                name,
                unit,
                len(where),
                _finite(t_s[where[0]]),
                _finite(sizes[worst]),
                _finite(np.max(ratios[np.isfinite(ratios)], initial=-math.inf)),
                _finite(t_s[where[worst]]),
            )


class _ImageCounter:
    """Count of images, and reasons why they are not all that the source exposed."""

    def __init__(self) -> None:
        self.count = 0
        self._encodings: set[str] = set()
        self._last = -1
        self._missing = 0

    def add(self, recorded_image: images.RecordedImage) -> None:
        self.count += 1
        self._encodings.add(recorded_image.encoding)
        self._missing += max(0, recorded_image.number - self._last - 1)
        self._last = recorded_image.number

    def remarks(self) -> list[str]:
        remarks = []
        if "jpeg" in self._encodings:
            remarks.append("the images are JPEG, not the original ones: differences are expected")
        if self._missing:
            of = self.count + self._missing
            remarks.append(f"{self._missing} of {of} exposures are not recorded: differences are expected")
        return remarks


def replay_vision_unit(recorded: Recorded, geometry: VmuGeometry, source: str | None = None) -> ImagesReplayed:
    """Return the comparison of the recorded frames with a vision unit's with ``geometry`` on the recorded pairs.

    Frames of a rig with wires are compared with the resolution of the wire. Of a lost frame only the status is
    compared. Raises BadInput. source: path of the geometry, unless it is the recording's.
    """
    vmu = recorded.rig.vmu
    estimator = make_estimator(vmu.estimator, geometry, vmu.estimator_settings, source or str(recorded.path))
    counter = _ImageCounter()
    frames = _Frames(recorded)
    replayed = ImagesReplayed(VMU)
    compared = _Compared([*((name, "m") for name in POSE[:3]), *((name, "rad") for name in POSE[3:]), *_REST])
    on_wires = recorded.run["rig_kind"] != "mock"
    only_noise = vmu.covariance == "noise"
    for left, right in images.pairs(recorded.path):
        counter.add(left)
        solution = estimator.solve(left.image(recorded.path), right.image(recorded.path), left.bench_s)
        replayed.statuses[left.status, solution.status] += 1
        original, now = frames.at(left.bench_s), solution.frame(0, left.bench_s, only_noise)
        if original is None or now is None:
            replayed.missing += original is not None
            replayed.new += now is not None and left.status != solution.status
            continue
        compared.add(left.t_s, *_compare_frames(original, _as_sent(now) if on_wires else now))
    if not counter.count:
        raise images.no_images(recorded.path, VMU)
    replayed.images, replayed.compared, replayed.remarks = counter.count, len(compared), counter.remarks()
    replayed.differences = list(compared.components())
    return replayed


_REST: Final = (("covariance", ""), ("LEDs used", ""))


class _Frames:
    """The recorded frames by their exposure."""

    def __init__(self, recorded: Recorded) -> None:
        order = np.argsort(recorded.arrivals["frame"]["t_s"], kind="stable")
        self._frames = recorded.arrivals["frame"][order]
        self._t_s = self._frames["t_s"]
        self._reach_s = _PERIOD_FRACTION / recorded.rig.vmu.rate_hz

    def at(self, bench_s: float) -> PoseFrame | None:
        if not len(self._t_s):
            return None
        i = int(np.argmin(np.abs(self._t_s - bench_s)))
        return PoseFrame.from_record(self._frames[i]) if abs(self._t_s[i] - bench_s) < self._reach_s else None


def _compare_frames(original: PoseFrame, now: PoseFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return differences, whether the bits differ, and sigmas, (8,): pose, covariance, LEDs."""
    rotation = -quat.to_rotation_vector(quat.multiply(now.q_vt, quat.conjugate(original.q_vt)))
    leds = float((now.leds_left, now.leds_right) != (original.leds_left, original.leds_right))
    covariance = float(np.abs(now.covariance - original.covariance).max())
    apart = np.concatenate((now.t_v - original.t_v, rotation, [covariance, leds]))
    turned = _bits(now.q_vt) != _bits(original.q_vt)
    differs = np.concatenate(
        (
            _bits(now.t_v) != _bits(original.t_v),
            np.full(3, turned.any()),
            [(_bits(now.covariance) != _bits(original.covariance)).any(), leds > 0.0],
        )
    )
    sigmas = np.concatenate((np.sqrt(np.diag(original.covariance)), np.full(2, math.nan)))
    return apart, differs, sigmas


def _as_sent(frame: PoseFrame) -> PoseFrame:
    """Return ``frame`` with the resolution of its bytes on the wire."""
    (decoded,) = FrameDecoder(frame_codec()).feed(frame_codec().encode(frame), 0.0)
    assert decoded.pose is not None
    return decoded.pose


def replay_monitor(recorded: Recorded, scene: Scene) -> ImagesReplayed:
    """Return the comparison of recorded portions with the docking monitor's for ``scene``. Raises BadInput."""
    monitor, counter = DockingMonitor(scene, settings_of(recorded.scenario)), _ImageCounter()
    portions: list[Portion] = []
    replayed = ImagesReplayed(DOCKING_MONITOR)
    for recorded_image in images.recorded_images(recorded.path, MONITOR):
        counter.add(recorded_image)
        portions += monitor.feed(_frame(recorded, scene, recorded_image))
        assert monitor.last is not None
        replayed.statuses[recorded_image.status, monitor.last.status] += 1
    if not counter.count:
        raise images.no_images(recorded.path, DOCKING_MONITOR)
    portions += monitor.finish()
    replayed.images, replayed.remarks = counter.count, counter.remarks()
    _compare_portions(replayed, recorded.of_parts["portions"], portions, recorded.intact)
    return replayed


def _frame(recorded: Recorded, scene: Scene, recorded_image: images.RecordedImage) -> VideoFrame:
    image = recorded_image.image(recorded.path)
    size = (scene.camera.width, scene.camera.height)
    if image.shape[::-1] != size:
        text = f"{image.shape[1]} x {image.shape[0]}: must be {size[0]} x {size[1]}, the camera of the scene"
        raise BadInput.single(str(recorded.path), f"{MONITOR} {recorded_image.number}", text)
    half = exposure(scene, recorded_image.number)[1]
    if half != WHOLE:
        image = np.ascontiguousarray(image[::2])  # each line stands in it twice
    return VideoFrame(recorded_image.number, recorded_image.t_s, image, half)


def _compare_portions(replayed: ImagesReplayed, original: np.ndarray, now: Sequence[Portion], whole: bool) -> None:
    """Compare portions that end with the same frame.

    whole: the recording has its end; if it broke off, portions after its last one do not count as new.
    """
    last_s = math.inf if whole else float(original["t_s"].max(initial=-math.inf))
    units = [name.rpartition("_")[2].replace("mps", "m/s") for name in QUANTITIES]
    compared = _Compared([*zip(QUANTITIES, units, strict=True), ("status, frames, sigmas", "")])
    rows = {float(row["t_s"]): row for row in original}
    for portion in now:
        row = rows.pop(portion.t_s, None)
        if row is None:
            replayed.new += portion.t_s <= last_s
            continue
        old, new = portion_of(row), np.frombuffer(portion_row(portion).tobytes(), PORTION)[0]
        both_nan = np.isnan(old.values) & np.isnan(portion.values)
        rest = any(row[name] != new[name] for name in ("status", "frames"))
        rest |= not np.array_equal(old.sigmas, portion.sigmas, equal_nan=True)
        compared.add(
            portion.t_s,
            np.append(portion.values - old.values, float(rest)),
            np.append((_bits(old.values) != _bits(portion.values)) & ~both_nan, rest),
            np.append(old.sigmas, math.nan),
        )
    replayed.missing, replayed.compared = len(rows), len(compared)
    replayed.differences = list(compared.components())


def _bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.int64)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
