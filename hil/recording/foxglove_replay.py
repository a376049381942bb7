"""Playback of a recording in Foxglove: its messages at their times, with play, pause, seek and speed."""

from __future__ import annotations

import json
import math
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple

from mcap.records import Attachment, Channel, Message, Metadata, Schema

from hil.core.files import parse_json
from hil.errors import BadInput
from hil.recording import foxglove, parts, writer
from hil.recording.foxglove import encoded, number
from hil.recording.foxglove_scene import SCENE_SCHEMA, scene_of
from hil.recording.foxglove_server import FoxgloveServer, json_service
from hil.recording.read import Scan
from hil.recording.run_messages import MessageSchema, json_schema

_POLL_WALL_S: Final = 0.005
_STATE_PERIOD_WALL_S: Final = 0.5
_BATCH: Final = 2000  # messages between two looks at the controls
_BEFORE_NS: Final = 2_000_000_000  # of each topic the last message so long before a seek is sent with it
_SPEED_MIN, _SPEED_MAX = 0.01, 100.0
_PAYLOAD_MAX: Final = 4096
_NEVER_NS: Final = 1 << 63


class RecordedMessage(NamedTuple):
    """A message of a recording: log time, ns UTC, topic and bytes."""

    time_ns: int
    topic: str
    data: bytes


@dataclass
class RecordedMessages:
    """Messages of the recording at ``path`` with its later parts, in the order of writing. Raises BadInput."""

    path: Path
    channels: dict[str, tuple[str, MessageSchema]] = field(default_factory=dict)
    """Topic -> encoding of its messages and schema."""
    files: dict[str, str] = field(default_factory=dict)
    start_ns: int = 0
    end_ns: int = 0
    _topics: list[dict[int, str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        first_ns, last_ns = _NEVER_NS, -1
        for part in (self.path, *parts.later_parts(self.path)):
            for record in self._directory(part):
                first_ns, last_ns = min(first_ns, record.log_time), max(last_ns, record.log_time)
        if last_ns < 0:
            raise BadInput.single(str(self.path), "", "has no messages")
        self.start_ns, self.end_ns = first_ns, last_ns

    def _directory(self, part: Path) -> Iterator[Message]:
        """Read channels and attachments of one file; yield its messages."""
        schemas: dict[int, Schema] = {}
        topics: dict[int, str] = {}
        known = False
        for record in Scan(part).records():
            match record:
                case Message():
                    yield record
                case Schema():
                    schemas[record.id] = record
                case Channel():
                    topics[record.id] = record.topic
                    content = schemas.get(record.schema_id, Schema(0, b"", "", ""))
                    named = MessageSchema(content.name, content.encoding, content.data)
                    self.channels.setdefault(record.topic, (record.message_encoding, named))
                case Attachment():
                    self.files[record.name] = record.data.decode(errors="replace")
                case Metadata(name=writer.RUN):
                    known = True
                case _:
                    pass
        if not known:
            text = f"not a recording of hil: an MCAP file without the metadata {writer.RUN}"
            raise BadInput.single(str(part), "", text)
        self._topics.append(topics)

    def since(self, time_ns: int) -> Iterator[RecordedMessage]:
        """Yield the messages from ``time_ns`` on; a few before it may come first."""
        for part, topics in zip((self.path, *parts.later_parts(self.path)), self._topics, strict=False):
            for record in Scan(part, from_ns=time_ns).records():
                if isinstance(record, Message) and record.channel_id in topics:
                    yield RecordedMessage(record.log_time, topics[record.channel_id], record.data)


class RecordingPlayer:
    """Playback of ``recorded`` at a server on ``port``. The viewer controls it; it begins with the first subscription.

    Raises BadInput if the server cannot listen.
    """

    def __init__(self, recorded: RecordedMessages, port: int) -> None:
        self._recorded = recorded
        self._lock = threading.Lock()  # of all that follows
        self._playing = False
        self._begun = False
        self._speed = 1.0
        self._now_ns = recorded.start_ns
        self._anchor_s = time.monotonic()
        self._sought = True
        self._scene_wanted = False
        services = [
            json_service("/hil/play", _object({"speed": number("relative to real time")}), self._play),
            json_service("/hil/pause", _object({}), self._pause),
            json_service("/hil/seek", _object({"t_s": number("s, from the start of the recording")}), self._seek),
        ]
        self._server = FoxgloveServer(
            port, self, ("PlaybackControl", "Services", "Time"), services, (recorded.start_ns, recorded.end_ns)
        )
        self.address = self._server.address
        for topic, (encoding, content) in recorded.channels.items():
            self._server.open_channel(topic, encoding, content)
        self._server.open_channel(foxglove.SCENE_TOPIC, "json", json_schema(SCENE_SCHEMA))

    def run(self, stopped: threading.Event | None = None) -> None:
        """Serve until ``stopped`` is set, or the caller is interrupted."""
        messages: Iterator[RecordedMessage] = iter(())
        due: RecordedMessage | None = None
        state_s = -math.inf
        while stopped is None or not stopped.is_set():
            with self._lock:
                sought, now_ns, scene_wanted = self._sought, self._time_ns(), self._scene_wanted
                self._sought = self._scene_wanted = False
            if scene_wanted or sought:
                self._send_scene(now_ns)
            if sought:
                messages, due = self._from(now_ns)
            sent = 0
            while due is not None and due.time_ns <= now_ns and sent < _BATCH:
                self._send(due)
                due = next(messages, None)
                sent += 1
            self._server.sdk.broadcast_time(now_ns)
            if due is None:
                with self._lock:
                    ended = self._playing and not self._sought
                    if ended:
                        self._set(False, self._recorded.end_ns)
                state_s = -math.inf if ended else state_s
            if time.monotonic() - state_s >= _STATE_PERIOD_WALL_S:
                state_s = time.monotonic()
                self._server.sdk.broadcast_playback_state(self._state(False, None))
            if sent < _BATCH:
                time.sleep(_POLL_WALL_S)

    def close(self) -> None:
        """Stop the server."""
        self._server.close()

    def _from(self, time_ns: int) -> tuple[Iterator[RecordedMessage], RecordedMessage | None]:
        """Send the last message of each topic before ``time_ns``; return the messages from there on, and the first."""
        messages = self._recorded.since(time_ns - _BEFORE_NS)
        newest: dict[str, RecordedMessage] = {}
        first = next(messages, None)
        while first is not None and first.time_ns < time_ns:
            newest[first.topic] = first
            first = next(messages, None)
        for before in newest.values():
            self._send(before)
        return messages, first

    def _send(self, message: RecordedMessage) -> None:
        if message.topic != foxglove.SCENE_TOPIC:
            self._server.log(message.topic, message.data, message.time_ns)

    def _send_scene(self, time_ns: int) -> None:
        """Send the scene, which recordings have at their start only, and earlier ones have not."""
        if (scene := scene_of(self._recorded.files, time_ns)) is not None:
            self._server.log(foxglove.SCENE_TOPIC, encoded(scene), time_ns)

    # time of the playback; under the lock

    def _time_ns(self) -> int:
        passed_s = (time.monotonic() - self._anchor_s) * self._speed if self._playing else 0.0
        return min(self._now_ns + round(1e9 * passed_s), self._recorded.end_ns)

    def _set(self, playing: bool, now_ns: int, speed: float | None = None) -> None:
        self._playing, self._now_ns, self._anchor_s = playing, now_ns, time.monotonic()
        if speed is not None and math.isfinite(speed):
            self._speed = min(max(speed, _SPEED_MIN), _SPEED_MAX)

    def _control(self, playing: bool, speed: float | None, seek_ns: int | None) -> None:
        with self._lock:
            self._begun = True
            now_ns = self._time_ns()
            if seek_ns is None and playing and now_ns >= self._recorded.end_ns:
                seek_ns = self._recorded.start_ns  # play again
            if seek_ns is not None:
                now_ns = min(max(seek_ns, self._recorded.start_ns), self._recorded.end_ns)
                self._sought = True
            self._set(playing, now_ns, speed)

    def _state(self, sought: bool, request: str | None) -> Any:
        from foxglove.websocket import PlaybackState, PlaybackStatus

        with self._lock:
            now_ns = self._time_ns()
            at_end = now_ns >= self._recorded.end_ns and not self._playing
            playing = PlaybackStatus.Ended if at_end else PlaybackStatus.Paused
            status = PlaybackStatus.Playing if self._playing else playing
            return PlaybackState(status, now_ns, self._speed, sought, request)

    # callbacks of the SDK, from its threads

    def on_playback_control_request(self, request: Any) -> Any:
        """Play, pause or seek as the viewer asks; return the new state."""
        from foxglove.websocket import PlaybackCommand

        playing = request.playback_command == PlaybackCommand.Play
        self._control(playing, request.playback_speed, request.seek_time)
        return self._state(request.seek_time is not None, request.request_id)

    def on_subscribe(self, _client: Any, channel: Any) -> None:
        """Begin to play with the first subscription; send the scene to a new subscriber."""
        with self._lock:
            if not self._begun:
                self._begun = True
                self._set(True, self._time_ns())
            self._scene_wanted = self._scene_wanted or channel.topic == foxglove.SCENE_TOPIC

    def on_unsubscribe(self, _client: Any, _channel: Any) -> None: ...

    def _play(self, _client: int, payload: bytes) -> bytes:
        return self._service(payload, "speed", lambda speed: self._control(True, speed, None))

    def _pause(self, _client: int, payload: bytes) -> bytes:
        return self._service(payload, "", lambda _: self._control(False, None, None))

    def _seek(self, _client: int, payload: bytes) -> bytes:
        def seek(t_s: float | None) -> None:
            if t_s is None:
                raise ValueError("t_s is missing")
            self._control(self._playing, None, self._recorded.start_ns + round(1e9 * t_s))

        return self._service(payload, "t_s", seek)

    def _service(self, payload: bytes, key: str, act: Any) -> bytes:
        """Call ``act`` with the number at ``key`` of the request, None without one; return the answer as JSON."""
        try:
            content = parse_json(payload or b"{}") if len(payload) <= _PAYLOAD_MAX else None
            value = content.get(key) if isinstance(content, dict) else math.nan
            if value is not None and not (isinstance(value, (int, float)) and math.isfinite(value)):
                raise ValueError("expected a JSON object of finite numbers")
            act(value)
        except (ValueError, OverflowError) as error:
            return json.dumps({"ok": False, "text": str(error)[:200]}).encode()
        return b'{"ok":true,"text":""}'


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    return {"type": "object", "properties": properties}
