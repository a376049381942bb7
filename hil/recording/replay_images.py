"""Replay of pictures: the recorded ones once more through today's vision unit or docking monitor, beside the recording.

What they found then stands in the recording; with the same pictures, geometry and settings they find the very same.
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
from hil.drivers.vmu.codec import PoseDecoder, encode
from hil.errors import BadInput
from hil.maths import quat
from hil.monitor.monitor import Monitor
from hil.monitor.results import PORTION, QUANTITIES, Portion, portion_of, portion_row
from hil.monitor.sources import WHOLE, VideoFrame, exposure
from hil.recording import images
from hil.recording.read import Recorded
from hil.setup.docking_monitor import settings_of
from hil.vmu.unit import VisionUnit

VMU, DOCKING_MONITOR = "the vision unit", "the docking monitor"
POSE: Final = ("x", "y", "z", "rx", "ry", "rz")
_PERIOD_SHARE: Final = 0.25  # of a frame period: as far as the time of a frame may be off that of its picture


@dataclass(frozen=True)
class ImageComponent:
    """One number of the results. count: in how many it differs; first_s: time of the run of the first such; largest:
    of |difference|, in unit and in the recorded sigmas; None where only one of both is a number."""

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
class PicturesReplayed:
    """What came out. pictures: exposures that were looked at; compared: results (poses or portions) that are in the
    recording and came out again; statuses: (before, now) -> how many; missing, new: results of before and of now
    alone; remarks: why differences are to be expected."""

    of: str
    pictures: int = 0
    compared: int = 0
    missing: int = 0
    new: int = 0
    statuses: Counter[tuple[str, str]] = field(default_factory=Counter)
    differences: list[ImageComponent] = field(default_factory=list)
    remarks: list[str] = field(default_factory=list)

    @property
    def identical(self) -> bool:
        """Whether every status and every number came out again, bit by bit."""
        same = all(before == now for before, now in self.statuses)
        return same and not (self.differences or self.missing or self.new)


class _Compared:
    """Gathers pairs of results, each the numbers of before and of now with the sigmas of before."""

    def __init__(self, names: Sequence[tuple[str, str]]) -> None:
        self._names = names
        self._rows: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = []

    def add(self, t_s: float, apart: np.ndarray, differs: np.ndarray, sigmas: np.ndarray) -> None:
        """Take one result: what is between both numbers, whether they differ in a bit, the sigmas of before."""
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
            known = np.isfinite(sizes)
            worst = int(np.argmax(np.where(known, sizes, -1.0)))
            shares = sizes / sigmas[where, i]
            yield ImageComponent(
                name,
                unit,
                len(where),
                _finite(t_s[where[0]]),
                _finite(sizes[worst]),
                _finite(np.max(shares[np.isfinite(shares)], initial=-math.inf)),
                _finite(t_s[where[worst]]),
            )


class _Pictures:
    """Counts pictures and remembers why they are not all that was seen."""

    def __init__(self) -> None:
        self.count = 0
        self._encodings: set[str] = set()
        self._last = -1
        self._left_out = 0

    def note(self, picture: images.RecordedImage) -> None:
        self.count += 1
        self._encodings.add(picture.encoding)
        self._left_out += max(0, picture.number - self._last - 1)
        self._last = picture.number

    def remarks(self) -> list[str]:
        found = []
        if "jpeg" in self._encodings:
            found.append("the pictures are JPEG and not what was looked at then: differences are expected")
        if self._left_out:
            of = self.count + self._left_out
            found.append(f"{self._left_out} of {of} exposures are not recorded: differences are expected")
        return found


def replay_vision_unit(recorded: Recorded, geometry: VmuGeometry) -> PicturesReplayed:
    """Return what the vision unit with ``geometry`` finds in the recorded pairs beside the frames that came then.

    Frames of a rig with wires are compared as they come off the wire. A frame that was lost on its way is compared
    by its status alone. Raises BadInput.
    """
    unit, seen = VisionUnit(geometry), _Pictures()
    frames = _Frames(recorded)
    found = PicturesReplayed(VMU)
    compared = _Compared([*((name, "m") for name in POSE[:3]), *((name, "rad") for name in POSE[3:]), *_REST])
    on_wires = recorded.run["rig_kind"] != "mock"
    for left, right in images.pairs(recorded.path):
        seen.note(left)
        solution = unit.solve(left.image(recorded.path), right.image(recorded.path), left.bench_s)
        found.statuses[left.status, solution.status] += 1
        before, now = frames.at(left.bench_s), solution.frame(0, left.bench_s)
        if before is None or now is None:
            found.missing += before is not None
            found.new += now is not None and left.status != solution.status
            continue
        compared.add(left.t_s, *_apart(before, _off_the_wire(now) if on_wires else now))
    if not seen.count:
        raise images.no_pictures(recorded.path, VMU)
    found.pictures, found.compared, found.remarks = seen.count, len(compared), seen.remarks()
    found.differences = list(compared.components())
    return found


_REST: Final = (("covariance", ""), ("LEDs used", ""))


class _Frames:
    """The recorded frames by their exposure."""

    def __init__(self, recorded: Recorded) -> None:
        order = np.argsort(recorded.arrivals["frame"]["t_s"], kind="stable")
        self._frames = recorded.arrivals["frame"][order]
        self._t_s = self._frames["t_s"]
        self._reach_s = _PERIOD_SHARE / recorded.rig.vmu.rate_hz

    def at(self, bench_s: float) -> PoseFrame | None:
        if not len(self._t_s):
            return None
        i = int(np.argmin(np.abs(self._t_s - bench_s)))
        return PoseFrame.from_record(self._frames[i]) if abs(self._t_s[i] - bench_s) < self._reach_s else None


def _apart(before: PoseFrame, now: PoseFrame) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return differences, whether each is one, and sigmas, (8,): pose, covariance, LEDs."""
    turn = -quat.to_rotation_vector(quat.multiply(now.q_vt, quat.conjugate(before.q_vt)))
    leds = float((now.leds_left, now.leds_right) != (before.leds_left, before.leds_right))
    covariance = float(np.abs(now.covariance - before.covariance).max())
    apart = np.concatenate((now.t_v - before.t_v, turn, [covariance, leds]))
    turned = _bits(now.q_vt) != _bits(before.q_vt)
    differs = np.concatenate(
        (
            _bits(now.t_v) != _bits(before.t_v),
            np.full(3, turned.any()),
            [(_bits(now.covariance) != _bits(before.covariance)).any(), leds > 0.0],
        )
    )
    sigmas = np.concatenate((np.sqrt(np.diag(before.covariance)), np.full(2, math.nan)))
    return apart, differs, sigmas


def _off_the_wire(frame: PoseFrame) -> PoseFrame:
    """Return ``frame`` with the numbers that its bytes hold."""
    (decoded,) = PoseDecoder().feed(encode(frame), 0.0)
    assert decoded.pose is not None
    return decoded.pose


def replay_monitor(recorded: Recorded, scene: Scene) -> PicturesReplayed:
    """Return what the docking monitor of ``scene`` finds in the recorded frames beside its portions of then.

    Raises BadInput.
    """
    monitor, seen = Monitor(scene, settings_of(recorded.scenario)), _Pictures()
    portions: list[Portion] = []
    found = PicturesReplayed(DOCKING_MONITOR)
    for picture in images.pictures(recorded.path, MONITOR):
        seen.note(picture)
        portions += monitor.feed(_frame(recorded, scene, picture))
        assert monitor.last is not None
        found.statuses[picture.status, monitor.last.status] += 1
    if not seen.count:
        raise images.no_pictures(recorded.path, DOCKING_MONITOR)
    portions += monitor.finish()
    found.pictures, found.remarks = seen.count, seen.remarks()
    _compare_portions(found, recorded.portions, portions, recorded.intact)
    return found


def _frame(recorded: Recorded, scene: Scene, picture: images.RecordedImage) -> VideoFrame:
    image = picture.image(recorded.path)
    size = (scene.camera.width, scene.camera.height)
    if image.shape[::-1] != size:
        text = f"{image.shape[1]} x {image.shape[0]}: must be {size[0]} x {size[1]}, the camera of the scene"
        raise BadInput.single(str(recorded.path), f"{MONITOR} {picture.number}", text)
    half = exposure(scene, picture.number)[1]
    if half != WHOLE:
        image = np.ascontiguousarray(image[::2])  # each line stands in it twice
    return VideoFrame(picture.number, picture.t_s, image, half)


def _compare_portions(found: PicturesReplayed, before: np.ndarray, now: Sequence[Portion], whole: bool) -> None:
    """Lay portions that end with the same frame beside each other.

    whole: the recording has its end; where it broke off, what follows its last portion is not missed in it.
    """
    last_s = math.inf if whole else float(before["t_s"].max(initial=-math.inf))
    units = [name.rpartition("_")[2].replace("mps", "m/s") for name in QUANTITIES]
    compared = _Compared([*zip(QUANTITIES, units, strict=True), ("status, frames, sigmas", "")])
    known = {float(row["t_s"]): row for row in before}
    for portion in now:
        row = known.pop(portion.t_s, None)
        if row is None:
            found.new += portion.t_s <= last_s
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
    found.missing, found.compared = len(known), len(compared)
    found.differences = list(compared.components())


def _bits(values: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(values, dtype=np.float64).view(np.int64)


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None
