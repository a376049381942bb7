"""Client of the Foxglove protocol (subprotocol foxglove.sdk.v1), independent of the Foxglove SDK."""

from __future__ import annotations

import json
import re
import struct
import time
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from websockets.sync.client import connect
from websockets.typing import Subprotocol

_UNKNOWN = re.compile(r"Unknown channel ID: (\d+)")


@dataclass
class Received:
    """A message: topic, log time and time of arrival, ns UTC, and its bytes."""

    topic: str
    time_ns: int
    arrived_ns: int
    data: bytes

    @property
    def json(self) -> dict[str, Any]:
        content: dict[str, Any] = json.loads(self.data)
        return content


@dataclass
class FoxgloveClient:
    """A connection to ``address`` (ws://...). ``topics``: subscribed ones, None for all."""

    address: str
    topics: frozenset[str] | None = None
    info: dict[str, Any] = field(default_factory=dict)
    channels: dict[str, dict[str, Any]] = field(default_factory=dict)
    services: dict[str, int] = field(default_factory=dict)
    messages: defaultdict[str, list[Received]] = field(default_factory=lambda: defaultdict(list))
    """By topic: a client that looks through all of them for each new one is slower than the server."""
    parameters: dict[str, Any] = field(default_factory=dict)
    statuses: list[str] = field(default_factory=list)
    answers: dict[int, dict[str, Any]] = field(default_factory=dict)
    keep: bool = True
    """Whether messages are kept."""
    _topics: dict[int, str] = field(default_factory=dict)
    _number: int = 0
    _awaited: str = ""

    def __post_init__(self) -> None:
        self._opened = connect(
            self.address,
            subprotocols=[Subprotocol("foxglove.sdk.v1")],
            max_size=None,
            open_timeout=30.0,
            compression=None,
            close_timeout=0.1,
        )
        self.socket = self._opened.__enter__()
        self.until(lambda: bool(self.info), "the server's information")

    def close(self) -> None:
        self._opened.__exit__(None, None, None)

    def __enter__(self) -> FoxgloveClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def send(self, **message: Any) -> None:
        self.socket.send(json.dumps(message))

    def take(self, timeout_s: float = 1.0) -> bool:
        """Take one message; return whether one came."""
        try:
            message = self.socket.recv(timeout_s)
        except TimeoutError:
            return False
        if isinstance(message, str):
            self._text(json.loads(message))
        else:
            self._binary(message)
        return True

    def until(self, condition: Callable[[], bool], what: str, wall_s: float = 60.0) -> None:
        """Take messages until ``condition`` holds."""
        end_s = time.monotonic() + wall_s
        while not condition():
            assert time.monotonic() < end_s, f"{what} did not come"
            self.take()

    def during(self, wall_s: float) -> None:
        """Take messages for ``wall_s``."""
        end_s = time.monotonic() + wall_s
        while (left_s := end_s - time.monotonic()) > 0.0:
            self.take(left_s)

    def of(self, topic: str) -> list[Received]:
        return self.messages[topic]

    def call(self, service: str, **request: Any) -> dict[str, Any]:
        """Call a service of JSON objects; return its answer."""
        return self.call_bytes(service, json.dumps(request).encode())

    def confirm(self, service: str, **request: Any) -> dict[str, Any]:
        """Call a service, and again with the digits of its question; return the answer to that."""
        digits = re.findall(r"confirmed (\d\d)", self.call(service, **request)["ask"])
        return self.call(service, **request, confirmed=int(digits[-1]))

    def call_bytes(self, service: str, payload: bytes) -> dict[str, Any]:
        self.until(lambda: service in self.services, f"the service {service}")
        self._number += 1
        number = self._number
        encoding = b"json"
        head = struct.pack("<BIII", 2, self.services[service], number, len(encoding))
        self.socket.send(head + encoding + payload)
        self.until(lambda: number in self.answers, f"the answer of {service}")
        return self.answers[number]

    def set_parameter(self, name: str, value: Any) -> dict[str, Any]:
        """Set a parameter; return all values that the server then reports."""
        return self._parameters(op="setParameters", parameters=[{"name": name, "value": value}])

    def get_parameters(self) -> dict[str, Any]:
        return self._parameters(op="getParameters", parameterNames=[])

    def _parameters(self, **request: Any) -> dict[str, Any]:
        self._number += 1
        number = str(self._number)
        self.parameters = {}
        self._awaited = number
        self.send(**request, id=number)
        self.until(lambda: self._awaited == "", "the parameters")
        return self.parameters

    def _text(self, message: dict[str, Any]) -> None:
        match message["op"]:
            case "serverInfo":
                self.info = message
            case "advertise":
                for channel in message["channels"]:
                    self.channels[channel["topic"]] = channel
                    self._topics[channel["id"]] = channel["topic"]
                wanted = [
                    {"id": c["id"], "channelId": c["id"]}
                    for c in message["channels"]
                    if self.topics is None or c["topic"] in self.topics
                ]
                if wanted:
                    self.send(op="subscribe", subscriptions=wanted)
            case "advertiseServices":
                self.services |= {service["name"]: service["id"] for service in message["services"]}
            case "parameterValues":
                self.parameters |= {p["name"]: p.get("value") for p in message["parameters"]}
                if message.get("id") == self._awaited:
                    self._awaited = ""
            case "serviceCallFailure":
                self.answers[message["callId"]] = {"failure": message["message"]}
            case "status" if (unknown := _UNKNOWN.fullmatch(message["message"])) and int(unknown[1]) in self._topics:
                # the SDK advertises a channel before it takes subscriptions to it
                number = int(unknown[1])
                self.send(op="subscribe", subscriptions=[{"id": number, "channelId": number}])
            case "status":
                self.statuses.append(message["message"])

    def _binary(self, message: bytes) -> None:
        match message[0]:
            case 1:
                number, time_ns = struct.unpack_from("<IQ", message, 1)
                if self.keep:
                    topic = self._topics[number]
                    self.messages[topic].append(Received(topic, time_ns, time.time_ns(), message[13:]))
            case 3:
                _, number, length = struct.unpack_from("<III", message, 1)
                self.answers[number] = json.loads(message[13 + length :])
