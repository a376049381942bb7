"""Server for Foxglove: topics, services and parameters over a WebSocket, by the Foxglove SDK.

The SDK calls its listener and the services from threads of its own; topics are logged from one thread.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

from hil.errors import BadInput
from hil.recording.run_messages import MessageSchema

if TYPE_CHECKING:
    from foxglove import Channel, Service

HOST: Final = "127.0.0.1"
"""The protocol has no authentication: other computers connect through a tunnel (ssh -L)."""
OPTION: Final = "--foxglove"
_BACKLOG: Final = 256  # messages to one client; the oldest are dropped beyond


class FoxgloveServer:
    """Server on ``HOST`` and ``port``, 0 for any free one. Raises BadInput if it cannot listen.

    listener: of the SDK's ``ServerListener``. capabilities: names of the SDK's ``Capability``.
    """

    def __init__(self, port: int, listener: Any, capabilities: Sequence[str], services: Sequence[Service] = ()) -> None:
        import foxglove
        from foxglove.websocket import Capability

        logging.getLogger("foxglove").setLevel(logging.CRITICAL)  # a line per invalid message would fill a disk
        self._context = foxglove.Context()
        self._channels: dict[str, Channel] = {}
        try:
            self.sdk = foxglove.start_server(
                name="hil",
                host=HOST,
                port=port,
                capabilities=[getattr(Capability, name) for name in capabilities],
                server_listener=listener,
                supported_encodings=["json"],
                services=list(services),
                context=self._context,
                message_backlog_size=_BACKLOG,
            )
        except (RuntimeError, OSError) as error:
            raise BadInput.single(OPTION, "", f"{HOST}:{port}: cannot listen: {error}") from error

    @property
    def address(self) -> str:
        return f"ws://{HOST}:{self.sdk.port}"

    def open_channel(self, topic: str, encoding: str, content: MessageSchema) -> None:
        """Advertise ``topic``; without effect if it is."""
        from foxglove import Channel, Schema

        if topic not in self._channels:
            schema = Schema(name=content.name, encoding=content.encoding, data=content.data)
            self._channels[topic] = Channel(topic, message_encoding=encoding, schema=schema, context=self._context)

    def is_watched(self, topic: str) -> bool:
        """Return whether a client has subscribed to ``topic``."""
        return topic in self._channels and self._channels[topic].base.has_sinks()

    def log(self, topic: str, message: bytes, time_ns: int) -> None:
        """Send one message to the clients that have subscribed to its topic; never waits for them."""
        self._channels[topic].log(message, log_time=time_ns)

    def close(self) -> None:
        """Stop the server; its clients are disconnected."""
        self.sdk.stop()


def json_service(name: str, request: dict[str, Any], handler: Callable[[int, bytes], bytes]) -> Service:
    """Return a service of JSON objects; request: its JSON schema. handler: gets the client's number and the payload."""
    import json

    from foxglove import MessageSchema as ServiceMessage
    from foxglove import Schema, Service, ServiceSchema

    def message(title: str, table: dict[str, Any]) -> ServiceMessage:
        text = json.dumps(table | {"title": title}).encode()
        return ServiceMessage(encoding="json", schema=Schema(name=title, encoding="jsonschema", data=text))

    answer = {"type": "object", "properties": {"ok": {"type": "boolean"}, "text": {"type": "string"}}}
    schema = ServiceSchema(name, request=message(f"{name} request", request), response=message("hil.Answer", answer))
    return Service(name, schema=schema, handler=lambda call: handler(call.client_id, call.payload))
