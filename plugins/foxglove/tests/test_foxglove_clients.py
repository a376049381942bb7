"""Clients in Foxglove: topics of a session, settings and services under the command, hostile input."""

from __future__ import annotations

import asyncio
import base64
import json
import math
import os
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from websockets.exceptions import ConnectionClosed

from hil.core.camera_images import IMAGE, image_row
from hil.core.messages import CYCLE
from hil.errors import BadInput
from hil.frmn.image_memory import RunTime
from hil.frmn.ring import Ring
from hil.parts.console.service import ConsoleService
from hil.parts.console.session import Choice
from hil.parts.console.tuner import Tuner
from hil.recording import schema
from hil.recording.foxglove_images import PICTURE_TOPICS
from hil.recording.recorder import ring_dtypes
from hil.recording.schema import LOG_ENTRY
from hil.recording.writer import RecordingHeader, RunFile
from hil_foxglove.clients import FoxgloveClients
from hil_foxglove.process import BENCH_TOPIC, SERVICES, LiveSession, request_of
from plugins.foxglove.tests.foxglove_client import FoxgloveClient

pytest.importorskip("foxglove")

CODE = "0123-right"
PICTURES_MAX = 600  # one in 50 ms: counted, as a pause of the computer is no failure
LEASE = ("rig.console.lease_s=5",)  # a pause of the computer is no loss of the operator
DEADBAND = "gnc.control.deadband_m"


class Desk:
    """A console with a session that is only its shared memory; its loop takes each order and setting."""

    def __init__(self) -> None:
        self.orders: list[dict[str, Any]] = []
        self.log: list[str] = []
        self.started_ns = time.time_ns()
        self.rings = {
            "telemetry": Ring.create(CYCLE, 256),
            "log": Ring.create(LOG_ENTRY, 16, "log"),
            "images": Ring.create(IMAGE, 4, "images"),
        }
        self.run_time = RunTime()
        self.run_time.set_zero(0.0)
        self._stop = threading.Event()
        self._ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))
        self._thread.start()
        assert self._ready.wait(30.0)

    async def _run(self) -> None:
        self.service = ConsoleService(
            Choice(scenario="scheme-1", rig="mock", settings=LEASE), ["scheme-1"], ["mock"], time.monotonic
        )
        self.clients = FoxgloveClients(0, CODE, self.log.append)
        self.clients.attach(self.service)
        self._ready.set()
        while not self._stop.is_set():
            self.clients.tick()
            await asyncio.sleep(0.01)
        self.clients.close()

    def open(self) -> None:
        """Open the session."""

        async def request(**message: Any) -> dict[str, Any]:
            self.orders.append(message)
            return {"text": ""}

        async def ask(**message: Any) -> str:
            return str((await request(**message))["text"])

        choice = self.service.choice
        self.service.tuner = Tuner(choice.job())
        self.service.session = SimpleNamespace(  # type: ignore[assignment]
            ready=True,
            ask=ask,
            request=request,
            send=lambda **_: True,
            rings=self.rings,
            run_time=self.run_time.descriptor,
            clock=[time.monotonic_ns(), 1.0],
            choice=choice,
        )
        self.service.changed()

    def close(self) -> None:
        self._stop.set()
        self._thread.join()
        for ring in self.rings.values():
            ring.close()
        self.run_time.close()


@pytest.fixture(scope="module")
def desk() -> Iterator[Desk]:
    made = Desk()
    yield made
    made.close()


@pytest.fixture
def client(desk: Desk) -> Iterator[FoxgloveClient]:
    with FoxgloveClient(desk.clients.address) as connected:
        yield connected
    desk.service.lease.expire(math.inf)


@pytest.fixture
def session(desk: Desk, client: FoxgloveClient) -> Desk:
    if desk.service.session is None:
        desk.open()
    client.until(lambda: client.get_parameters() != {}, "the settings")
    return desk


def test_stop_reaches_the_console_without_the_command_and_the_rest_does_not(desk: Desk, client: FoxgloveClient) -> None:
    assert client.call("/hil/stop") == {"ok": False, "text": "bench: cannot stop, no session is open"}
    assert client.call("/hil/open") == {
        "ok": False,
        "text": "no operator has the command: take it before sending orders",
    }
    assert "code: wrong or missing" in client.call("/hil/take", name="ann")["text"]
    assert "code: wrong or missing" in client.call("/hil/take_over", name="ann", code="", confirmed=True)["text"]
    assert not desk.service.lease.held
    client.until(lambda: bool(client.of(BENCH_TOPIC)), "the state of the bench")
    assert client.of(BENCH_TOPIC)[-1].json["mode"] == "off"


def test_command_is_held_while_the_client_watches_and_expires_when_it_is_gone(desk: Desk) -> None:
    desk.service.lease.expire(math.inf)  # of an attempt on a computer that paused
    watcher = FoxgloveClient(desk.clients.address, topics=frozenset())
    assert watcher.call("/hil/take", name="eve", code=CODE)["text"] == "subscribe to a topic first: an operator watches"
    watcher.close()
    client = FoxgloveClient(desk.clients.address)
    client.until(lambda: bool(client.of(BENCH_TOPIC)), "a message")
    assert client.call("/hil/take", name="ann", code=CODE) == {"ok": True, "text": ""}
    assert "confirmed" in json.dumps(SERVICES["open"])
    question = client.call("/hil/open")["ask"]
    assert question.startswith("Open: the devices open")
    assert re.search(r" Send confirmed \d\d within 5 s\.$", question)
    assert "seen_s is missing" in client.call("/hil/jog", axis="rails.x", direction=1)["text"]
    client.during(0.5)
    client.until(lambda: desk.service.lease.silent_s(time.monotonic()) < 0.4, "the lease's renewal")
    client.close()
    time.sleep(0.6)
    assert desk.service.lease.silent_s(time.monotonic()) > 0.3
    desk.service.lease.expire(math.inf)


def test_every_topic_of_a_recording_is_live_with_its_schema_and_all_its_messages(
    session: Desk, client: FoxgloveClient, tmp_path: Path
) -> None:
    client.until(lambda: bool(client.of("/scene")), "the scene")
    client.get_parameters()  # answered when all subscriptions have been taken
    client.messages.clear()
    session.open()  # a run of its own: /state keeps its rate by the run's time
    client.until(lambda: bool(client.of("/scene")), "the scene of the new session")
    rng = np.random.default_rng(20240517)
    rows = np.frombuffer(bytearray(rng.standard_normal(60 * CYCLE.itemsize // 8).tobytes()), CYCLE)
    rows["t_s"] = 0.001 * np.arange(60)
    entry = np.zeros(1, LOG_ENTRY)
    entry[["t_s", "bench_s", "cycle", "kind", "source", "text"]] = (0.0, 0.0, 3, b"event", b"gnc", b"ready")
    for row in rows:
        session.rings["telemetry"].put(row.reshape(1))
    session.rings["log"].put(entry)
    client.until(lambda: len(client.of("/cycle")) == 60 and bool(client.of("/log")), "the rows")
    picture = f"{PICTURE_TOPICS}left"
    for _ in range(PICTURES_MAX):  # the topic appears with the first image
        session.rings["images"].put(image_row("left", 0.02, b"\xff\xd8"))
        client.during(0.05)
        if client.of(picture):
            break
    assert client.of(picture), f"no picture came: {client.statuses}"
    assert client.of(picture)[-1].json["data"] == base64.b64encode(b"\xff\xd8").decode()
    assert b"".join(message.data for message in client.of("/cycle")) == rows.tobytes()
    assert len(client.of("/state")) == 1
    assert client.of("/log")[-1].json["message"] == "ready"
    late_ns = [message.arrived_ns - message.time_ns for message in client.of("/cycle")]
    assert min(late_ns) >= 0

    file = RunFile(tmp_path / "run.mcap", RecordingHeader({"schema_version": "3"}, {}, 0))
    file.write_cycles(rows)
    file.finish({"stop": "completed"}, "")
    with (tmp_path / "run.mcap").open("rb") as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    for channel in summary.channels.values():
        live, recorded = client.channels[channel.topic], summary.schemas[channel.schema_id]
        assert (live["encoding"], live["schemaName"], live["schema"]) == (
            channel.message_encoding,
            recorded.name,
            recorded.data.decode(),
        )


def test_setting_changes_only_under_the_command_and_within_its_range(session: Desk, client: FoxgloveClient) -> None:
    before = client.get_parameters()
    assert set(before) == set(session.service.choice.job().scenario.value.console.adjustable)
    assert client.set_parameter(DEADBAND, 0.0004)[DEADBAND] == before[DEADBAND]
    client.until(lambda: bool(client.statuses), "the reason")
    assert client.statuses[-1].startswith(f"{DEADBAND}: not changed: no operator has the command")

    client.until(lambda: bool(client.of(BENCH_TOPIC)), "a message")
    assert client.call("/hil/take", name="ann", code=CODE)["ok"]
    client.statuses.clear()
    assert client.set_parameter(DEADBAND, 0.0004)[DEADBAND] == before[DEADBAND]
    client.until(lambda: bool(client.statuses), "the question")
    digits = int(re.findall(r"Send confirmed (\d\d) within 5 s\. By /hil/adjust", client.statuses[-1])[-1])
    asked = {"key": DEADBAND, "value": 0.0004}
    assert "digits that are shown" in client.call("/hil/adjust", **asked, confirmed=True)["text"]
    assert not session.orders
    assert not client.call("/hil/adjust", **asked, confirmed=digits)["ok"]  # of a question before the last one
    assert client.confirm("/hil/adjust", **asked)["ok"]
    client.until(lambda: client.get_parameters()[DEADBAND] == 0.0004, "the new value")
    assert (session.orders[-1]["by"], session.orders[-1]["adjust"]["value"]) == ("ann", 0.0004)
    for value, reason in ((9.0, "during a run allowed"), ("x", "is not a number"), (True, "is not a number")):
        client.statuses.clear()
        assert client.set_parameter(DEADBAND, value)[DEADBAND] == 0.0004
        client.until(lambda: bool(client.statuses), "the reason")
        assert reason in client.statuses[-1]
    assert "gnc.pkf.r" not in client.set_parameter("gnc.pkf.r", 1.0)


def test_second_client_watches_stops_and_holds_but_does_not_command(session: Desk, client: FoxgloveClient) -> None:
    client.until(lambda: bool(client.of(BENCH_TOPIC)), "a message")
    assert client.call("/hil/take", name="ann", code=CODE)["ok"]
    with FoxgloveClient(session.clients.address) as other:
        other.until(lambda: bool(other.of(BENCH_TOPIC)), "a message")
        assert "ann has the command" in other.call("/hil/abort", confirmed=True)["text"]
        assert "ann has the command" in other.call("/hil/take", name="bob", code=CODE)["text"]
        for order in ("hold", "stop"):
            assert other.call(f"/hil/{order}")["ok"]
            assert session.orders[-1]["order"] == order
        assert other.call("/hil/take_over", name="bob", code=CODE)["ask"].startswith("Take the command over from ann")


@pytest.mark.parametrize(
    ("service", "payload", "words"),
    [
        (
            "open",
            b'{"scenario": "x", "path": "/etc/passwd"}',
            "'path': unknown, allowed: scenario, rig, seed, confirmed",
        ),
        ("stop", b'{"confirmed": true}', "'confirmed': unknown, allowed: nothing"),
        ("hold", b"[1]", "expected a JSON object"),
        ("hold", b'{"a":' * 2000, "expected a JSON object of at most 4096 bytes"),
        ("hold", b"\xff", "codec"),
    ],
)
def test_request_that_is_none_is_refused(service: str, payload: bytes, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        request_of(service, payload)


def test_garbage_harms_neither_the_server_nor_other_clients(desk: Desk, client: FoxgloveClient) -> None:
    rng = np.random.default_rng(1)
    texts = ["", "{", "[]", '{"op":"subscribe","subscriptions":[{"id":1e99}]}', "[" * 100_000, '{"op":"setParameters"}']
    with FoxgloveClient(desk.clients.address, topics=frozenset()) as hostile, suppress(ConnectionClosed):
        for text in texts:
            hostile.socket.send(text)
        for _ in range(200):
            hostile.socket.send(rng.bytes(int(rng.integers(0, 200))))
        for number in range(256):
            hostile.socket.send(bytes([number]) + rng.bytes(20))
    assert client.call_bytes("/hil/hold", b'{"a": NaN}')["ok"] is False
    host, port = desk.clients.address.removeprefix("ws://").split(":")
    for text in (b"\x00" * 100, b"GET / HTTP/1.1\r\n\r\n", b"GET / HTTP/1.1\r\nX: " + b"a" * 100_000):
        with socket.create_connection((host, int(port)), timeout=5.0) as raw:
            raw.sendall(text)
    client.messages.clear()
    client.until(lambda: len(client.of(BENCH_TOPIC)) > 2, "the state of the bench")
    assert desk.log == []


def test_port_in_use_is_refused(desk: Desk) -> None:
    port = int(desk.clients.address.rpartition(":")[2])
    with pytest.raises(BadInput, match=f"--foxglove: 127.0.0.1:{port}: cannot listen"):
        FoxgloveClients(port, CODE, print)


def test_dead_process_leaves_the_console_alone() -> None:
    desk = Desk()
    desk.clients._child.kill()
    end_s = time.monotonic() + 10.0
    while not desk.log and time.monotonic() < end_s:
        time.sleep(0.02)
    assert desk.log == ["foxglove: its process was ended by SIGKILL; console and bench continue"]
    desk.close()


@pytest.mark.parametrize("topic", schema.OPTIONAL)
def test_rows_that_only_some_runs_have_reach_the_viewers_of_a_live_session(topic: str) -> None:
    sink = schema.OPTIONAL[topic]
    ring, run_time = Ring.create(ring_dtypes()[sink], 8, sink), RunTime()
    opened: list[str] = []
    logged: list[str] = []
    server = SimpleNamespace(
        open_channel=lambda topic, *_: opened.append(topic),
        log=lambda topic, message, log_time: logged.append(opened[opened.index(topic)]),
    )
    about = {"slots": {sink: 8}, "clock": [0, 1.0], "files": {}}
    shared = {sink: os.dup(ring.descriptor), "run_time": os.dup(run_time.descriptor)}
    session = LiveSession(server, about, shared)  # type: ignore[arg-type]
    ring.put(np.zeros(1, ring_dtypes()[sink]))
    session.poll()
    session.close()
    assert logged == [topic]
