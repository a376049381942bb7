"""``hil recordings verify``: who did what in a recorded session, and a file that was tampered with."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.records import Attachment, Channel, Message, Metadata, Schema
from mcap.writer import Writer

import hil
from hil.cli.main import FAILED, PASSED, execute
from hil.core.surroundings import local_user
from hil.recording.read import Scan

Records = list[Any]


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a short run, with its catalogue next to it."""
    run = hil.run("scheme-1", duration_s=0.5, record=tmp_path_factory.mktemp("recordings"))
    return Path(run.summary["recording"]["file"])


def is_log(record: Any, channels: dict[int, str]) -> bool:
    return isinstance(record, Message) and channels[record.channel_id] == "/log"


def rewritten(path: Path, out: Path, change: Callable[[Records, list[int]], None]) -> Path:
    """Write the recording at ``path`` to ``out`` after ``change`` of its records; the places of the log's are given."""
    records = [record for record in Scan(path).records() if isinstance(record, (Message, Attachment, Metadata))]
    schemas = {record.id: record for record in Scan(path).records() if isinstance(record, Schema)}
    channels = {record.id: record for record in Scan(path).records() if isinstance(record, Channel)}
    topics = {number: channel.topic for number, channel in channels.items()}
    change(records, [place for place, record in enumerate(records) if is_log(record, topics)])
    with out.open("wb") as file:
        writer = Writer(file)
        writer.start("hil", "another program")
        known = {n: writer.register_schema(s.name, s.encoding, s.data) for n, s in schemas.items()}
        opened = {
            n: writer.register_channel(c.topic, c.message_encoding, known[c.schema_id]) for n, c in channels.items()
        }
        for record in records:
            match record:
                case Message():
                    writer.add_message(opened[record.channel_id], record.log_time, record.data, record.publish_time)
                case Attachment():
                    writer.add_attachment(0, 0, record.name, record.media_type, record.data)
                case Metadata():
                    writer.add_metadata(record.name, record.metadata)
        writer.finish()
    return out


def verify(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = execute(["recordings", "verify", str(path)])
    return code, capsys.readouterr().out


def test_sound_recording_shows_who_started_it_and_with_what_rights(
    recorded: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    code, text = verify(recorded, capsys)
    assert code == PASSED
    assert f"{local_user()}" in text
    assert "local   started this run" in text
    assert text.splitlines()[-1].startswith(f"PASS audit of {recorded.name}: ")
    assert verify(rewritten(recorded, tmp_path / recorded.name, lambda *_: None), capsys)[0] == PASSED
    assert execute(["recordings", "verify", str(recorded), "--json", "-"]) == PASSED
    (audit,) = json.loads(capsys.readouterr().out)["audits"]
    assert audit["problems"] == []
    assert audit["acts"][0]["name"] == local_user()
    assert len(audit["acts"][0]["configuration"]) == 64


def edited(records: Records, log: list[int]) -> None:
    line = json.loads(records[log[0]].data) | {"name": "somebody else"}
    records[log[0]].data = json.dumps(line).encode()


def removed(records: Records, log: list[int]) -> None:
    del records[log[2]]


def shortened(records: Records, log: list[int]) -> None:
    del records[log[-1]]


def reordered(records: Records, log: list[int]) -> None:
    records[log[1]], records[log[2]] = records[log[2]], records[log[1]]


def another_rig(records: Records, _: list[int]) -> None:
    rig = next(record for record in records if isinstance(record, Attachment) and record.name == "rig.json")
    rig.data = rig.data.replace(b'"mock"', b'"emulated"', 1)


def another_seed(records: Records, _: list[int]) -> None:
    records[0].metadata["seed"] = "1"


def without_end(records: Records, _: list[int]) -> None:
    records[:] = [record for record in records if not (isinstance(record, Metadata) and record.name == "hil.end")]


def without_audit(records: Records, _: list[int]) -> None:
    del records[0].metadata["audit"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (edited, "entry 0, 'started this run"),
        (removed, "entries were removed, inserted, moved or lost"),
        (shortened, "shortened, or its end was changed"),
        (reordered, "entries were removed, inserted, moved or lost"),
        (another_rig, "is of another configuration than the recorded one"),
        (another_seed, "the header, configuration or entry was changed"),
        (without_end, "without an end of the audit: broken off, or shortened"),
        (without_audit, "has no audit: recorded by an earlier version, or removed"),
    ],
)
def test_file_that_was_tampered_with_is_found(
    change: Callable[[Records, list[int]], None],
    words: str,
    recorded: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    code, text = verify(rewritten(recorded, tmp_path / "changed.mcap", change), capsys)
    assert code == FAILED
    assert words in text
    assert text.splitlines()[-1].startswith("FAIL audit of changed.mcap")
