"""Process of a console's server for Foxglove: reads the rings of a session, passes requests to the console.

It has no part in the loop, and none in the console but a socket. It sends the console, over a pair of sockets with one
JSON object per packet,

    {"call": 7, "client": 2, "request": {"do": "order", "order": "hold"}}    {"alive": [2, 5]}

and receives

    {"answer": 7, "reply": {"ok": true, "text": ""}}     {"bench": {...}}    {"settings": [...]}
    {"session": {...}}, with the descriptors of the shared memory            {"session": null}
"""

from __future__ import annotations

import json
import math
import os
import queue
import select
import socket
import threading
import time
from collections import defaultdict
from concurrent.futures import Future
from contextlib import suppress
from typing import Any, Final

import numpy as np

from hil.core.child_process import Parent
from hil.core.clock import WallClock, utc_ns
from hil.core.files import parse_json
from hil.core.operator_commands import OperatorCommand
from hil.core.part import part_sinks
from hil.errors import BadInput
from hil.frmn.image_memory import RunTime
from hil.frmn.ring import Reader, Ring
from hil.recording import foxglove, foxglove_images, schema
from hil.recording.foxglove import TEXT, number, table
from hil.recording.recorder import ring_dtypes
from hil.recording.run_messages import MessageSchema, RunMessages, fixed_channels, json_schema, record_channel
from hil_foxglove.server import FoxgloveServer, json_service

BENCH_TOPIC: Final = "/bench"
_PACKET: Final = 1 << 18
_MAX_DESCRIPTORS: Final = 16
_POLL_WALL_S: Final = 0.01
_ALIVE_PERIOD_WALL_S: Final = 0.2
_ANSWER_WALL_S: Final = 4.0  # the console waits two seconds for the loop
_CALLS_MAX: Final = 32
_PAYLOAD_MAX: Final = 4096
_ROWS_MAX: Final = 512
_IMAGES_MAX: Final = 2
_NICENESS: Final = 5

_FLAG: Final = {"type": "boolean"}
_CONFIRMED: Final = {"confirmed": _FLAG}
_DIGITS: Final = {"confirmed": {"type": "integer", "description": "digits of the question; with seen_s true"}}
_SEEN: Final = {"seen_s": number("s, wall_s of the newest message of the bench")}
_WHO: Final = {"name": TEXT, "code": TEXT}
_ORDERS: Final = tuple(each.value for each in OperatorCommand if each.value not in ("stop", "hold", "jog"))
SERVICES: Final[dict[str, dict[str, Any]]] = {
    **{key: {} for key in ("stop", "hold")},
    **dict.fromkeys(_ORDERS, _DIGITS | _SEEN),
    "take": _WHO,
    "take_over": _WHO | _CONFIRMED,
    "release": {},
    "open": {"scenario": TEXT, "rig": TEXT, "seed": {"type": "integer"}, **_DIGITS, **_SEEN},
    "acknowledge": {},
    "jog": {"axis": TEXT, "direction": {"type": "integer"}, **_SEEN},
    "fault": {"device": TEXT, "line": TEXT},
    "adjust": {"key": TEXT, "value": {"type": "number"}, **_DIGITS, **_SEEN},
}
"""Services, each under ``/hil/``: the requests of the console with the properties of their JSON objects."""

_NUMBERS: Final = {"type": "array", "items": {"type": ["number", "null"]}}
BENCH_SCHEMA: Final = table(
    "hil.Bench",
    {
        "wall_s": number("s, of the console, for seen_s of a command"),
        "mode": TEXT,
        "open": _FLAG,
        "ready": _FLAG,
        "holder": {"type": "string", "description": "operator who has the command"},
        "run_s": number("s, time of the run"),
        "bench_s": number("s, bench time"),
        "rail_m": _NUMBERS,
        "gimbal_deg": _NUMBERS,
        "overruns": {"type": "integer"},
        "hold_reason": TEXT,
        "text": {"type": "string", "description": "last line of the session"},
        "alarms": {"type": "array", "items": TEXT, "description": "that are not acknowledged"},
    },
)


def request_of(service: str, payload: bytes) -> dict[str, Any]:
    """Return the request to the console that calls ``service``, without /hil/. Raises ValueError."""
    content = parse_json(payload or b"{}") if len(payload) <= _PAYLOAD_MAX else None
    if not isinstance(content, dict):
        raise ValueError(f"expected a JSON object of at most {_PAYLOAD_MAX} bytes")
    if unknown := sorted(set(content) - set(SERVICES[service])):
        raise ValueError(f"{unknown[0][:40]!r}: unknown, allowed: {', '.join(SERVICES[service]) or 'nothing'}")
    if service in (*_ORDERS, "stop", "hold"):
        return {"do": "order", "order": service, **content}
    return {"do": service, **content}


class LiveMessages(RunMessages):
    """Messages of a running session for viewers, at the UTC at which they happened.

    clock: of the bench. run_time: relation of the run's time to it.
    """

    def __init__(self, server: FoxgloveServer, clock: WallClock, run_time: RunTime) -> None:
        self._server = server
        self._clock = clock
        self._run_time = run_time
        self._zero_s = math.nan
        super().__init__()

    def count_lost(self, messages: int) -> None:
        """A viewer misses what it does not read: nothing is counted."""

    def _image(self, camera: str, row: np.void) -> None:
        topic = self._image_channel(camera, "", foxglove_images.PICTURE_SCHEMA)
        overlay = self._image_channel(camera, foxglove_images.ANNOTATIONS, foxglove_images.ANNOTATION_SCHEMA)
        if self._server.is_watched(topic) or self._server.is_watched(overlay):
            super()._image(camera, row)

    def _open_channel(self, topic: str, encoding: str, content: MessageSchema) -> None:
        self._server.open_channel(topic, encoding, content)

    def _add(self, topic: str, message: bytes, time_ns: int, sequence: int = 0) -> None:
        self._server.log(topic, message, time_ns)

    def _time_ns(self, t_s: float, bench_s: float = math.nan) -> int:
        now_ns = utc_ns()
        if not math.isfinite(bench_s):
            zero_s = -self._run_time.at(0.0)
            self._zero_s = zero_s if math.isfinite(zero_s) else self._zero_s
            bench_s = self._zero_s + t_s
        if not math.isfinite(bench_s):
            return now_ns
        return min(now_ns, now_ns - time.monotonic_ns() + self._clock.wall_ns(bench_s))


class LiveSession:
    """Rings of one session, read until it ends. shared: name -> descriptor, of which this object takes ownership."""

    def __init__(self, server: FoxgloveServer, about: dict[str, Any], shared: dict[str, int]) -> None:
        self._run_time = RunTime(shared["run_time"])
        self._rings = {
            name: Ring(shared[name], ring_dtypes()[name], slots, name) for name, slots in about["slots"].items()
        }
        self._readers: dict[str, Reader] = {name: ring.reader(from_now=True) for name, ring in self._rings.items()}
        self._files = about["files"]
        self.messages = LiveMessages(server, WallClock(*about["clock"]), self._run_time)
        of_parts = {sink.topic: name for name, sink in part_sinks().items() if sink.topic}
        for topic, sink in (schema.OPTIONAL | of_parts).items():
            if sink in self._rings:
                server.open_channel(*record_channel(topic))

    def poll(self) -> None:
        """Send the new rows."""
        for name, reader in self._readers.items():
            rows = reader.read(_IMAGES_MAX if "images" in name else _ROWS_MAX)
            if len(rows):
                self.messages.writers[name](rows)

    def send_scene(self) -> None:
        """Send the scene, again to those that have it."""
        self.messages.begin(self._files)

    def close(self) -> None:
        """Release the shared memory."""
        self._readers.clear()
        for ring in self._rings.values():
            ring.close()
        self._run_time.close()


class FoxgloveListener:
    """Callbacks of the SDK, from its threads: subscriptions, parameters. ``calls``: passes requests to the console."""

    def __init__(self, calls: ConsoleCalls) -> None:
        self._calls = calls
        self._lock = threading.Lock()
        self._topics: defaultdict[int, set[str]] = defaultdict(set)
        self._settings: dict[str, float] = {}
        self.scene_wanted = threading.Event()
        self.rejections: queue.SimpleQueue[str] = queue.SimpleQueue()

    @property
    def alive(self) -> list[int]:
        """Clients that have subscribed to a topic: of others the end of the connection is not reported."""
        with self._lock:
            return [client for client, topics in self._topics.items() if topics]

    def set_settings(self, settings: list[dict[str, Any]]) -> None:
        """Set the settings that are adjustable now: ``key`` and ``value`` of each."""
        with self._lock:
            self._settings = {setting["key"]: setting["value"] for setting in settings}

    def on_subscribe(self, client: Any, channel: Any) -> None:
        """Note a subscription."""
        with self._lock:
            self._topics[client.id].add(channel.topic)
        if channel.topic == foxglove.SCENE_TOPIC:
            self.scene_wanted.set()

    def on_unsubscribe(self, client: Any, channel: Any) -> None:
        """Note the end of a subscription, or of its connection."""
        with self._lock:
            self._topics[client.id].discard(channel.topic)
            if not self._topics[client.id]:
                del self._topics[client.id]

    def on_get_parameters(self, client: Any, names: list[str], request_id: str | None = None) -> list[Any]:
        """Return the adjustable settings of ``names``, all if it is empty."""
        return self.parameters(names)

    def parameters(self, names: list[str] | tuple[str, ...] = ()) -> list[Any]:
        """Return the adjustable settings of ``names``, all if it is empty, as parameters."""
        from foxglove import Parameter

        with self._lock:
            return [Parameter(key, value=value) for key, value in self._settings.items() if not names or key in names]

    def on_set_parameters(self, client: Any, parameters: list[Any], request_id: str | None = None) -> list[Any]:
        """Ask for each change of a setting; return all present values.

        A parameter carries no digits: one that a stalled network has held would act late. The service does.
        """
        for parameter in parameters:
            reply = self._calls.ask(client.id, {"do": "adjust", "key": parameter.name, "value": parameter.get_value()})
            ask = f"{reply['ask']} By /hil/adjust with key and value." if "ask" in reply else ""
            self.rejections.put(f"{parameter.name}: not changed: {ask or reply.get('text', '')}")
        return self.parameters()

    def on_parameters_subscribe(self, names: list[str]) -> None: ...

    def on_parameters_unsubscribe(self, names: list[str]) -> None: ...


class ConsoleCalls:
    """Requests to the console and their answers; ``ask`` is called from any thread."""

    def __init__(self, channel: socket.socket) -> None:
        self._channel = channel
        self._lock = threading.Lock()
        self._answers: dict[int, Future[dict[str, Any]]] = {}
        self._number = 0
        self.has_client: Any = lambda _: True

    def ask(self, client: int, request: dict[str, Any]) -> dict[str, Any]:
        """Return the console's answer: ok, text, and ``ask`` if it requires a confirmation."""
        if request["do"] in ("take", "take_over") and not self.has_client(client):
            return {"ok": False, "text": "subscribe to a topic first: an operator watches"}
        answer: Future[dict[str, Any]] = Future()
        with self._lock:
            if len(self._answers) >= _CALLS_MAX:
                return {"ok": False, "text": f"{_CALLS_MAX} requests are waiting: try again"}
            self._number += 1
            number_ = self._number
            self._answers[number_] = answer
        try:
            self.send({"call": number_, "client": client, "request": request})
            return answer.result(_ANSWER_WALL_S)
        except (TimeoutError, OSError, ValueError):
            return {"ok": False, "text": f"no answer of the console within {_ANSWER_WALL_S:g} s"}
        finally:
            with self._lock:
                del self._answers[number_]

    def send(self, message: dict[str, Any]) -> None:
        """Send the console one packet. Raises OSError, and ValueError for values that JSON does not have."""
        self._channel.send(json.dumps(message, allow_nan=False).encode())

    def resolve(self, number_: int, reply: dict[str, Any]) -> None:
        """Give the answer to the request ``number_``."""
        with self._lock:
            answer = self._answers.get(number_)
        if answer is not None:
            answer.set_result(reply)

    def service(self, name: str, client: int, payload: bytes) -> bytes:
        """Return the answer to a call of the service ``name``, as JSON."""
        try:
            reply = self.ask(client, request_of(name, payload))
        except ValueError as error:
            reply = {"ok": False, "text": str(error)[:200]}
        return json.dumps(reply).encode()


class FoxgloveProcess:
    """Server, listener and the present session; ``step`` is called in a loop."""

    def __init__(self, port: int, channel: socket.socket) -> None:
        self._channel = channel
        self._calls = ConsoleCalls(channel)
        self._listener = FoxgloveListener(self._calls)
        self._calls.has_client = lambda client: client in self._listener.alive
        services = [
            json_service(
                f"/hil/{name}",
                {"type": "object", "properties": properties},
                lambda client, payload, name=name: self._calls.service(name, client, payload),  # type: ignore[misc]
            )
            for name, properties in SERVICES.items()
        ]
        self.server = FoxgloveServer(port, self._listener, ("Parameters", "Services", "Time"), services)
        self._session: LiveSession | None = None
        self._alive_s = -math.inf
        self.server.open_channel(BENCH_TOPIC, "json", json_schema(BENCH_SCHEMA))
        for each in fixed_channels():  # subscribed to before a session opens
            self.server.open_channel(*each)

    def step(self) -> bool:
        """Receive messages of the console, send the session's; return whether the console is still there."""
        ready, _, _ = select.select([self._channel], [], [], _POLL_WALL_S)
        if ready and not self._receive():
            return False
        if self._session is not None:
            self._session.poll()
            if self._listener.scene_wanted.is_set():
                self._listener.scene_wanted.clear()
                self._session.send_scene()
        while not self._listener.rejections.empty():
            self._publish_rejection(self._listener.rejections.get())
        now_s = time.monotonic()
        if now_s - self._alive_s >= _ALIVE_PERIOD_WALL_S:
            self._alive_s = now_s
            with suppress(OSError):
                self._calls.send({"alive": self._listener.alive})
        return True

    def _receive(self) -> bool:
        packet, descriptors, _, _ = socket.recv_fds(self._channel, _PACKET, _MAX_DESCRIPTORS)
        if not packet:
            return False
        message = json.loads(packet)
        if "answer" in message:
            self._calls.resolve(message["answer"], message["reply"])
        if "bench" in message:
            time_ns = utc_ns()
            self.server.sdk.broadcast_time(time_ns)
            self.server.log(BENCH_TOPIC, foxglove.encoded(message["bench"]), time_ns)
        if "settings" in message:
            self._listener.set_settings(message["settings"])
            self.server.sdk.publish_parameter_values(self._listener.parameters())
        if "session" in message:
            self._end_session()
            if message["session"] is not None:
                about = message["session"]
                shared = dict(zip(about["shared"], descriptors, strict=True))
                self._session = LiveSession(self.server, about, shared)
                self._session.send_scene()
        return True

    def _publish_rejection(self, text: str) -> None:
        from foxglove import StatusLevel

        self.server.sdk.publish_status(text, StatusLevel.Warning)

    def _end_session(self) -> None:
        if self._session is not None:
            self._session.poll()
            self._session.close()
            self._session = None

    def close(self) -> None:
        """Stop the server and release the session."""
        self.server.close()
        self._end_session()


def run_child(parent: Parent) -> None:
    """Serve until the console ends."""
    with suppress(OSError):
        os.nice(_NICENESS)
    np.seterr(all="ignore")
    with socket.socket(fileno=parent.configuration["channel"]) as channel:
        try:
            process = FoxgloveProcess(parent.configuration["port"], channel)
        except BadInput as error:
            parent.send(problem=error.problems[0].message)
            return
        parent.send(problem="", address=process.server.address)
        try:
            while process.step():
                pass
        finally:
            process.close()
