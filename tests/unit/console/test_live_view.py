"""Images and the docking monitor's numbers on their way to a page: the newest of the camera that it watches."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
import pytest

from hil.core.camera_images import IMAGE, Exposure, image_row
from hil.core.messages import CYCLE
from hil.frmn.ring import Ring
from hil.maths import euler
from hil.parts.console.live_view import Client, LiveView, picture_of
from hil.parts.console.message import ImageMessage, pack, unpack
from hil.parts.console.session_process import SessionProcess
from hil.parts.console.status import empty_status
from hil.parts.monitor.camera import chaser_position, view
from hil.parts.monitor.params import mounting
from hil.parts.monitor.results import PORTION, Portion, portion_row
from hil.parts.tracker.rows import SAMPLE
from tests.support.run_settings import make_job

JOB = make_job(1.0, ("rig.tracker.driver=mock", "rig.tracker.chaser.body=1", "rig.tracker.target.body=2"))


class Session:
    """What a session has in its shared memory."""

    def __init__(self) -> None:
        self.pictures: list[np.ndarray] = []
        self.rows = {
            "telemetry": np.empty(0, CYCLE), "portions": np.empty(0, PORTION), "tracker_samples": np.empty(0, SAMPLE)
        }  # fmt: skip

    def read_rows(self, ring: str = "telemetry") -> np.ndarray:
        return self.rows[ring]

    def read_pictures(self) -> list[np.ndarray]:
        return self.pictures


def status(bench_s: float, run_s: float) -> np.ndarray:
    found = empty_status()
    found["bench_s"], found["run_s"] = bench_s, run_s
    return found


def take(live_view: LiveView, pictures: Sequence[np.ndarray] = (), **rows: np.ndarray) -> None:
    session = Session()
    session.pictures = list(pictures)
    session.rows |= rows
    live_view.update(cast(SessionProcess, session), status(12.0, 2.0), 100.0)


def test_the_page_gets_the_rows_of_the_telemetry_rate() -> None:
    view = LiveView()
    view.begin(make_job(1.0, ("rig.telemetry.rate_hz=10.0",)))
    rows = np.zeros(23, CYCLE)
    rows["t_s"] = 0.02 * np.arange(23)
    for first in (0, 3, 9):
        take(view, telemetry=rows[first : {0: 3, 3: 9, 9: 23}[first]])
    np.testing.assert_allclose(view.rows.all()[:, 0], [0.0, 0.1, 0.2, 0.3, 0.4], atol=1e-6)


@pytest.fixture
def live_view() -> LiveView:
    made = LiveView()
    made.begin(JOB)
    return made


def page(**more: Any) -> Client:
    return Client("k" * 16, "ann", **more)


def test_each_page_gets_the_newest_image_of_its_camera_once(live_view: LiveView) -> None:
    pair = [image_row(camera, 1.5, b"l" + camera.encode(), "png", (8, 6)) for camera in ("vmu.left", "vmu.right")]
    take(live_view, pictures=[np.concatenate(pair), image_row("monitor", 1.0, b"tv")])
    anyone, watcher, lost = page(), page(camera="monitor"), page(camera="no such camera")
    assert live_view.cameras == ["vmu.left", "vmu.right", "monitor"]
    for client, name in ((anyone, "vmu.left"), (watcher, "monitor"), (lost, "vmu.left")):
        found = live_view.picture_for(client)
        assert found is not None
        assert found.name == name
        assert live_view.picture_for(client) is None
    watcher.camera = "vmu.right"
    found = live_view.picture_for(watcher)
    assert found is not None
    assert (found.name, found.data, found.encoding, found.width_px) == ("vmu.right", b"lvmu.right", "png", 8)
    take(live_view, pictures=[image_row("monitor", 1.4, b"newer")])
    assert live_view.picture_for(watcher) is None  # of another camera
    live_view.begin(JOB)
    assert live_view.cameras == []
    assert live_view.picture_for(page()) is None


@pytest.mark.parametrize(
    ("t_s", "bench_s", "age_s"),
    [(1.5, 11.25, 0.75), (1.5, math.nan, 0.5), (math.nan, 11.0, 1.0), (math.nan, math.nan, 0.0), (3.0, math.nan, 0.0)],
)
def test_age_of_an_image_counts_from_its_exposure(t_s: float, bench_s: float, age_s: float) -> None:
    (row,) = image_row("vmu.left", t_s, b"x", exposure=Exposure(bench_s))
    picture = picture_of(row, status(12.0, 2.0), 100.0)
    header = unpack(pack({"wall_s": 100.5}, None, np.empty((0, 1)), 0, picture))[0]["picture"]
    assert header["age_s"] == pytest.approx(age_s + 0.5)
    assert header["t_s"] == (None if math.isnan(t_s) else t_s)


def test_image_without_a_time_is_new() -> None:
    assert ImageMessage("left", 0.0, 1, 1).header(5.0)["age_s"] == 0.0


def test_portions_come_once_and_all_of_them_to_a_page_that_comes_late(live_view: LiveView) -> None:
    places = mounting(JOB.scenario.value.monitor)
    r, q = np.array([1.2, 0.03, -0.02]), euler.to_quaternion(np.array([0.02, -0.03, 0.01]), euler.YAW_PITCH_ROLL)
    near = np.full(12, 0.1)
    near[:3], near[3:6] = view(places, r, q)
    far = np.full(12, np.nan)
    rows = [portion_row(Portion(1.0, 25, "near", near, near)), portion_row(Portion(2.0, 12, "far", far, far))]
    early = page()
    assert news_for(live_view, early) == {"first": 0, "list": []}
    take(live_view, portions=np.concatenate(rows))
    one, other = news_for(live_view, early)["list"]
    np.testing.assert_allclose(one["r_m"], r, atol=1e-12)
    assert (other["status"], other["r_m"], other["values"][0]) == ("far", None, None)
    assert live_view.rows_for(early)[2] == {}
    assert news_for(live_view, page()) == {"first": 0, "list": [one, other]}
    take(live_view, portions=rows[0])
    assert news_for(live_view, early)["first"] == 2


def test_the_page_gets_how_far_a_tracker_has_the_chaser_from_the_encoders(live_view: LiveView) -> None:
    """At 5 Hz, and only what was measured: rows of other bodies and of poor samples are not shown."""
    rows = np.zeros(60, SAMPLE)
    rows["t_s"] = 0.01 * np.arange(60)
    rows["off_m"] = [0.001, -0.002, 0.0005]
    rows["body"][::20], rows["status"][1::20] = 1, 1
    client = page()
    take(live_view, tracker_samples=rows)
    shown = news_for(live_view, client, "offsets")["list"]
    assert [each["t_s"] for each in shown] == pytest.approx([0.02, 0.22, 0.42])
    assert {each["name"] for each in shown} == {"tracker"}
    assert shown[0]["off_m"] == [0.001, -0.002, 0.0005]
    header = unpack(pack({"wall_s": 0.0}, None, np.empty((0, 4), "<f4"), 0, None, live_view.rows_for(page())[2]))[0]
    assert header["offsets"]["list"] == shown


def news_for(live_view: LiveView, client: Client, name: str = "portions") -> dict[str, Any]:
    news: dict[str, Any] = live_view.rows_for(client)[2][name]
    return news


def test_chaser_is_where_its_docking_camera_s_view_has_it(rng: np.random.Generator) -> None:
    places = mounting(JOB.scenario.value.monitor)
    for _ in range(20):
        r = rng.uniform([0.4, -0.5, -0.5], [20.0, 0.5, 0.5])
        q = euler.to_quaternion(rng.uniform(-0.3, 0.3, 3), euler.YAW_PITCH_ROLL)
        np.testing.assert_allclose(chaser_position(places, *view(places, r, q)), r, atol=1e-12)


def test_reader_that_wants_the_newest_passes_over_the_rest_and_counts_none_of_it_as_lost() -> None:
    ring = Ring.create(IMAGE, 4, "pictures")
    reader = ring.reader()
    assert len(reader.newest(2)) == 0
    for number in range(7):
        ring.put(image_row("monitor", float(number), b"x"))
    assert reader.newest(2)["t_s"].tolist() == [5.0, 6.0]
    assert len(reader.newest(2)) == 0
    ring.put(image_row("monitor", 7.0, b"x"))
    assert reader.newest(9)["t_s"].tolist() == [7.0]
    for number in range(20):
        ring.put(image_row("monitor", float(number), b"x"))
    assert reader.newest(9)["t_s"].tolist() == [17.0, 18.0, 19.0]
    assert reader.lost == 0
    ring.close()
