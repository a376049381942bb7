"""Declaration of the part."""

from typing import Final

from hil.core.part import Part

PART: Final = Part(
    name="foxglove",
    summary="Foxglove at a running console: topics, images, settings and services, live.",
    viewers={"foxglove": "hil_foxglove.clients:FoxgloveClients"},
)
