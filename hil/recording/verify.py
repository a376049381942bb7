"""Comparison of the messages in a recording with the count and digest of each topic in its end.

It finds messages that were removed, added or edited, by any program; the chain of the log is that of ``audit``.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from mcap.records import Message, Metadata

from hil.recording import writer
from hil.recording.content_digest import KEY, ContentDigest
from hil.recording.read import directory
from hil.recording.scan import Scan


def content_problems(paths: Iterable[Path]) -> list[str] | None:
    """Return how the messages of a recording in the files ``paths`` differ from those recorded, one line per topic.

    None if a file does not state what was recorded: it has no end, or is of an earlier version.
    """
    problems = []
    for path in paths:
        stated, actual = _contents(path)
        if not stated:
            return None
        for key, value in stated.items():
            topic, count = key.removeprefix(KEY), value.partition(" ")[0]
            now = actual.get(key, "0").partition(" ")[0]
            if now != count:
                problems.append(f"has {now} of {count} messages of {topic}")
            elif actual[key] != value:
                problems.append(f"{topic}: messages were edited, or have other times")
    return problems


def _contents(path: Path) -> tuple[Mapping[str, str], Mapping[str, str]]:
    """Return the content that the end of a file states, and the one that it has."""
    topics = {number: channel.topic for number, channel in directory(path)[1].items()}
    stated: dict[str, str] = {}
    content = ContentDigest()
    for record in Scan(path).records():
        match record:
            case Message() if record.channel_id in topics:
                content.add(topics[record.channel_id], record.log_time, record.data)
            case Metadata(name=writer.END):
                stated = {key: value for key, value in record.metadata.items() if key.startswith(KEY)}
            case _:
                pass
    return stated, content.keys
