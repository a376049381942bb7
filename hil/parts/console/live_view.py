"""Live view of a session: plotted rows, camera images, results of the docking monitor, offsets by trackers.

The newest image of each camera is kept, and each client gets those of the camera that it watches; a slow client misses
images and delays no other.
"""

from __future__ import annotations

import asyncio
import itertools
import math
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from hil.core.camera_images import CAMERAS, image_data, overlay_shapes
from hil.core.messages import CYCLE, Array
from hil.core.part import hook, used_parts
from hil.params import bench as bench_params
from hil.parts.console.columns import COLUMNS, console_rows, decimated
from hil.parts.console.message import ImageMessage
from hil.parts.console.session_process import SessionProcess
from hil.parts.console.status import status_of
from hil.parts.monitor.camera import chaser_position
from hil.parts.monitor.params import mounting
from hil.parts.monitor.results import Portion, portion_of
from hil.session.assembly import Job

MAX_ROWS: Final = 250
"""Largest number of rows in a message: delayed rows are decimated, so that no client falls behind."""
BACKLOG: Final = 1500
"""Largest number of earlier rows for a new client."""
_CAPACITY: Final = 60_000  # 20 minutes at 50 Hz; then every second row is dropped


class RowStore:
    """Rows (n, COLUMNS) since the session started; ``session`` is the number of the session."""

    def __init__(self) -> None:
        self.session = 0
        self.total = 0
        """Number of rows since the session started."""
        self._rows = np.empty((0, COLUMNS), "<f4")
        self._count = 0
        self._each = 1  # decimation factor of the stored rows

    def begin(self) -> None:
        """Clear all rows for a new session."""
        self.session += 1
        self.total = self._count = 0
        self._each = 1
        self._rows = np.empty((1024, COLUMNS), "<f4")

    def add(self, rows: np.ndarray[Any, Any]) -> None:
        """Append rows."""
        if not len(rows):
            return
        self.total += len(rows)
        kept = decimated(rows, -(-len(rows) // self._each))
        while self._count + len(kept) > len(self._rows):
            self._grow()
        self._rows[self._count : self._count + len(kept)] = kept
        self._count += len(kept)

    @property
    def kept(self) -> int:
        return self._count

    @property
    def newest(self) -> np.ndarray[Any, Any] | None:
        """The last row, (COLUMNS,)."""
        return self._rows[self._count - 1] if self._count else None

    def all(self) -> np.ndarray[Any, Any]:
        """Return a copy of all stored rows."""
        return self._rows[: self._count].copy()

    def since(self, cursor: Cursor) -> np.ndarray[Any, Any]:
        """Return the rows after ``cursor``, at most MAX_ROWS, and move it to the end."""
        new = cursor.session != self.session or cursor.each != self._each
        first = 0 if new else cursor.seen
        cursor.restarted = new
        cursor.session, cursor.each, cursor.seen = self.session, self._each, self._count
        return decimated(self._rows[first : self._count], BACKLOG if new else MAX_ROWS)

    def _grow(self) -> None:
        if len(self._rows) < _CAPACITY:
            grown = np.empty((2 * len(self._rows), COLUMNS), "<f4")
            grown[: self._count] = self._rows[: self._count]
            self._rows = grown
            return
        half = decimated(self._rows[: self._count], -(-self._count // 2))
        self._rows[: len(half)] = half
        self._count = len(half)
        self._each *= 2


class Cursor:
    """Read position of one client. restarted: the next rows replace all earlier ones."""

    def __init__(self) -> None:
        self.session = -1
        self.each = 1
        self.seen = 0
        self.restarted = True


MAX_UNREAD: Final = 20
"""Largest number of unread messages of a client: about one second."""
_PORTIONS: Final = 3000  # one hour of the docking monitor
_OFFSETS: Final = 18_000  # one hour of a tracker
_OFFSET_S: Final = 0.199  # between two that are shown, at least


@dataclass(slots=True)
class Client:
    """One client. key: its secret, which identifies it to the lease; name: of its operator. number: of its connection.

    key_id: of the operator's key, "" for a self-given name. rights: see ``OperatorKey``. origin: address and device
    from which it is connected. last_rx_s, acted_s: wall-clock times of its last message and of its last request.
    displaced: set when its place is given to another client.
    """

    key: str
    name: str
    key_id: str = ""
    rights: str = "command"
    origin: tuple[str, str] = ("", "")
    number: int = field(default_factory=itertools.count(1).__next__)
    cursor: Cursor = field(default_factory=Cursor)
    page_seen: int = -1
    camera: str = ""
    """Camera whose images it requests; "" for any."""
    picture_seen: int = 0
    seen: dict[str, int] = field(default_factory=dict)
    """Lengths of the lists that it has, by their names."""
    requests: int = 0
    """Number of its last request that may move the bench."""
    page: str = ""
    """Random number of the page that has connected, the same after a loss of the connection."""
    sent: int = 0
    got: int | None = None
    """Number of messages that it has received, None if it does not report it."""
    last_rx_s: float = -math.inf
    acted_s: float = -math.inf
    displaced: asyncio.Event = field(default_factory=asyncio.Event)

    @property
    def actor(self) -> dict[str, str]:
        """Name, key and rights of the operator, as in a message to the session."""
        return {"by": self.name, "key": self.key_id, "rights": self.rights}

    @property
    def congested(self) -> bool:
        """Whether it has too many unread messages: further ones would be outdated when read."""
        return self.got is not None and self.sent - self.got >= MAX_UNREAD


class LiveView:
    """Rows, images, batches of the docking monitor and offsets by trackers since the session started."""

    def __init__(self) -> None:
        self.rows = RowStore()
        self.portions: list[dict[str, Any]] = []
        self.offsets: list[dict[str, Any]] = []
        self._pictures: dict[str, tuple[int, ImageMessage]] = {}
        self._number = 0
        self._cycles, self._taken = 1, 0  # cycles per row, and rows read so far
        self._bench: np.record | None = None
        self._places: np.record | None = None
        self._offset_due_s: dict[str, float] = {}
        self._offsets_of: dict[str, tuple[str, Any]] = {}

    def begin(self, job: Job) -> None:
        """Clear everything for a session of ``job``."""
        scenario, rig = job.scenario.value, job.rig.value
        self._bench = bench_params.bench(rig, scenario.step_s, scenario.bench)
        self._places = mounting(scenario.monitor)
        self._cycles = rig.telemetry_cycles(scenario.step_s)
        self._taken = 0
        self.rows.begin()
        self.portions, self.offsets = [], []
        self._offset_due_s.clear()
        self._offsets_of = {
            each.part.name: (name, hook(each.part, "offsets", sink.offsets))
            for each in used_parts(scenario, rig)
            for name, sink in each.part.sinks.items()
            if sink.offsets
        }
        self._pictures.clear()

    def warm_up(self, job: Job) -> None:
        """Call the kernels of ``update`` once: compiled while a bench moves, they would delay the presence reports."""
        self.begin(job)
        assert self._bench is not None
        assert self._places is not None
        console_rows(self._bench, np.zeros(2, CYCLE))
        chaser_position(self._places, np.ones(3), np.zeros(3))

    def update(self, session: SessionProcess, status: np.ndarray, now_s: float) -> None:
        """Read the new data of ``session``. status: newest STATUS (1,); now_s: wall-clock time."""
        assert self._bench is not None
        rows = session.read_rows()
        self.rows.add(console_rows(self._bench, rows[-self._taken % self._cycles :: self._cycles]))
        self._taken += len(rows)
        for rows in session.read_pictures():
            for row in rows:
                self.show(picture_of(row, status, now_s))
        for row in session.read_rows("portions"):
            if len(self.portions) < _PORTIONS:
                self.portions.append(self._portion(portion_of(row)))
        for name, (sink, offsets) in self._offsets_of.items():
            self.add_offsets(name, *offsets(session.read_rows(sink)))

    def add_offsets(self, name: str, rows: np.ndarray, offsets: Array) -> None:
        """Keep ``offsets`` (n, 3), m, in H, of ``rows`` of the part ``name``, ``_OFFSET_S`` apart."""
        for t_s, offset in zip(rows["t_s"].tolist(), offsets.tolist(), strict=True):
            if t_s >= self._offset_due_s.get(name, -math.inf) and len(self.offsets) < _OFFSETS:
                self._offset_due_s[name] = t_s + _OFFSET_S
                self.offsets.append({"name": name, "t_s": t_s, "off_m": offset})

    def show(self, picture: ImageMessage) -> None:
        """Replace the image of its camera by ``picture``."""
        self._number += 1
        self._pictures[picture.name] = (self._number, picture)

    @property
    def cameras(self) -> list[str]:
        """Cameras with images, the known ones first."""
        return sorted(self._pictures, key=lambda name: (CAMERAS.index(name) if name in CAMERAS else len(CAMERAS), name))

    def picture_for(self, client: Client) -> ImageMessage | None:
        """Return the newest image of the camera that ``client`` watches, None if it already has it."""
        camera = client.camera if client.camera in self._pictures else next(iter(self.cameras), "")
        number, picture = self._pictures.get(camera, (0, None))
        if number == client.picture_seen:
            return None
        client.picture_seen = number
        return picture

    def rows_for(self, client: Client) -> tuple[np.ndarray[Any, Any], int, dict[str, Any]]:
        """Return the rows new to ``client``, the number of their first, and the lists with new ends by their names."""
        before = client.cursor.seen
        rows = self.rows.since(client.cursor)
        if client.cursor.restarted:
            before = 0
            client.seen.clear()
        news = {}
        for name, every in (("portions", self.portions), ("offsets", self.offsets)):
            begin = client.seen.get(name, 0)
            if begin < len(every) or name not in client.seen:
                news[name] = {"first": begin, "list": every[begin:]}
            client.seen[name] = len(every)
        return rows, before, news

    def _portion(self, portion: Portion) -> dict[str, Any]:
        assert self._places is not None
        d, phi = portion.values[:3], portion.values[3:6]
        is_finite = bool(np.isfinite(d).all() and np.isfinite(phi).all())
        return {
            "t_s": portion.t_s,
            "status": portion.status,
            "frames": portion.frames,
            "values": _numbers(portion.values),
            "sigmas": _numbers(portion.sigmas),
            "r_m": chaser_position(self._places, d, phi).tolist() if is_finite else None,
        }


def picture_of(row: np.void, status: np.ndarray, now_s: float) -> ImageMessage:
    """Return the image of ``row`` (``IMAGE``) with its age by bench time, or else by the run's time."""
    bench = status_of(status)
    late_s = float(bench.bench_s - row["bench_s"])
    if not math.isfinite(late_s):
        late_s = float(bench.run_s - row["t_s"])
    return ImageMessage(
        row["camera"].decode(errors="replace"),
        float(row["t_s"]),
        int(row["width_px"]),
        int(row["height_px"]),
        image_data(row),
        overlay_shapes(row),
        row["encoding"].decode(errors="replace"),
        row["status"].decode(errors="replace"),
        now_s - (max(0.0, late_s) if math.isfinite(late_s) else 0.0),
    )


def _numbers(values: Array) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]
