"""The shipped layout for Foxglove shows topics, fields and services that exist."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from typing import Any

import pytest

from hil.config.load import configs_folder
from hil.core.camera_images import CAMERAS
from hil.recording import foxglove
from hil.recording.foxglove_images import ANNOTATIONS, PICTURE_TOPICS
from hil_foxglove.process import BENCH_SCHEMA, BENCH_TOPIC, SERVICES

LAYOUT = configs_folder() / "foxglove" / "layout.json"
FIELDS = {topic: table["properties"] for topic, table in foxglove.SCHEMAS.items()} | {
    BENCH_TOPIC: BENCH_SCHEMA["properties"]
}


def values(node: Any, key: str) -> Iterator[Any]:
    """Yield all values of ``key`` in the layout."""
    if isinstance(node, dict):
        for name, value in node.items():
            if name == key:
                yield value
            yield from values(value, key)
    elif isinstance(node, list):
        for value in node:
            yield from values(value, key)


def test_layout_names_what_exists() -> None:
    content = json.loads(LAYOUT.read_text())
    panels = {name.partition("!")[0] for name in content["configById"]}
    assert panels == {"3D", "Image", "Plot", "Indicator", "CallService", "Parameters", "RosOut"}
    placed = [v for key in ("first", "second") for v in values(content["layout"], key) if isinstance(v, str)]
    assert sorted(placed) == sorted(content["configById"])
    paths = [*values(content, "path"), *(s["value"] for paths in values(content, "paths") for s in paths)]
    assert len(paths) > 10
    for path in paths:
        topic, field, index = re.fullmatch(r"(/\w+)\.(\w+)(\[[012]\])?", path).groups()  # type: ignore[union-attr]
        assert (FIELDS[topic][field].get("type") == "array") == bool(index), path
    services = list(values(content, "serviceName"))
    assert {"/hil/hold", "/hil/stop"} <= set(services)
    assert all(name.removeprefix("/hil/") in SERVICES for name in services)
    for topic in values(content, "imageTopic"):
        assert topic.removeprefix(PICTURE_TOPICS) in CAMERAS
    assert all(t.endswith(ANNOTATIONS) for found in values(content, "annotations") for t in found)


def test_shipped_layout_is_that_of_its_script() -> None:
    pytest.importorskip("foxglove")
    from sims.foxglove_layout import text

    assert LAYOUT.read_text() == text()
