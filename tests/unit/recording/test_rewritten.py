"""Recordings that other programs have rewritten, damaged ones, and what this program does not read.

400 s rewritten in twelve ways by two writers, and 1,000 damages; a folder with npm's @mcap/core, lz4js, zstd-codec:

    HIL_MCAP_NPM=FOLDER pytest -m slow tests/unit/recording/test_rewritten.py
"""

from __future__ import annotations

import os
import random
import shutil
import struct
import subprocess
import zlib
from contextlib import suppress
from pathlib import Path
from typing import Any

import lz4.frame
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer

import hil
from hil.cli.main import BAD_INPUT, FAILED, INCOMPLETE, PASSED, execute
from hil.errors import BadInput
from hil.recording.lz4_frame import unpacked
from hil.recording.read import Contents, contents, load, ordered_log
from tests.support.hostile_files import chunk, message

KINDS = {"none": CompressionType.NONE, "lz4": CompressionType.LZ4, "zstd": CompressionType.ZSTD}

WAYS = [
    (4, "none", True),
    (8, "lz4", True),
    (64, "zstd", True),
    (4, "zstd", False),
    (8, "none", False),
    (64, "lz4", False),
]
NPM = os.environ.get("HIL_MCAP_NPM")


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a recording of a run of 0.6 s, with lines of the log from before and after it."""
    run = hil.run("scheme-1", duration_s=0.6, record=tmp_path_factory.mktemp("recordings"))
    return Path(run.summary["recording"]["file"])


def rewritten(
    path: Path, out: Path, compression: str = "lz4", summary: bool = True, chunking: bool = True, block_mib: int = 8
) -> Path:
    """Return ``out``, written by the mcap package with the messages of ``path`` in the order of their times."""
    with path.open("rb") as file, out.open("wb") as stream:
        reader = make_reader(file)
        writer = Writer(
            stream, chunk_size=block_mib << 20, compression=KINDS[compression], use_chunking=chunking,
            index_types=IndexType.ALL if summary else IndexType.NONE, repeat_channels=summary, repeat_schemas=summary,
            use_statistics=summary, use_summary_offsets=summary,
        )  # fmt: skip
        writer.start()
        for attachment in reader.iter_attachments():
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        channels: dict[int, int] = {}
        for schema, channel, found in reader.iter_messages():
            if channel.id not in channels and schema is not None:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, number)
            writer.add_message(channels[channel.id], found.log_time, found.data, found.publish_time)
        writer.finish()
    return out


def verify(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    code = execute(["recordings", "verify", str(path)])
    return code, capsys.readouterr().out


@pytest.mark.parametrize("compression", KINDS)
@pytest.mark.parametrize(("summary", "chunking"), [(True, True), (False, True), (True, False)])
def test_rewritten_recording_is_whole_and_verified(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], compression: str, summary: bool, chunking: bool
) -> None:
    out = rewritten(path, tmp_path / path.name, compression, summary, chunking)
    before, now = load(path), load(out)
    assert now.intact
    assert now.rewritten
    assert not before.rewritten
    assert now.cycles.tobytes() == before.cycles.tobytes()
    assert now.log == before.log
    code, text = verify(out, capsys)
    assert code == PASSED
    assert f"PASS audit of {out.name}: rewritten, content unchanged: " in text


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_long_recording_rewritten_by_two_writers_is_whole_and_verified(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    recorded = Path(hil.run("scheme-1", duration_s=400.0, record=tmp_path).summary["recording"]["file"])
    before = load(recorded)
    for npm in (False, True) if NPM else (False,):
        for block_mib, compression, summary in WAYS:
            out = tmp_path / f"{'npm' if npm else 'python'}-{block_mib}-{compression}-{summary}.mcap"
            if npm:
                script = shutil.copy(Path(__file__).parents[2] / "support" / "rewrite_recording.mjs", str(NPM))
                words = [recorded, out, block_mib, compression, int(summary)]
                subprocess.run(["node", script, *map(str, words)], check=True)
            else:
                rewritten(recorded, out, compression, summary, block_mib=block_mib)
            now = load(out)
            assert now.cycles.tobytes() == before.cycles.tobytes()
            assert len(now.cycles) == 20_001
            code, text = verify(out, capsys)
            assert code == PASSED
            assert "rewritten, content unchanged" in text
            out.unlink()


@pytest.mark.parametrize(
    ("kind", "problem"), [(0x80, ""), (0xFF, ""), (0x70, "not supported: a record of the unknown")]
)
def test_private_record_of_another_program_is_skipped(path: Path, tmp_path: Path, kind: int, problem: str) -> None:
    out = rewritten(path, tmp_path / "other.mcap", summary=False)
    data = out.read_bytes()
    at = 8 + 9 + int.from_bytes(data[9:17], "little")  # behind the header
    out.write_bytes(data[:at] + bytes([kind, 5]) + bytes(7) + b"notes" + data[at:])
    found = contents(out)
    assert found.problem.startswith(problem)
    assert bool(found.problem) == bool(problem)
    assert found.records["/cycle"] == contents(path).records["/cycle"]


def test_rewritten_recording_is_replayed_bit_by_bit(path: Path, tmp_path: Path) -> None:
    out = rewritten(path, tmp_path / "other.mcap")
    assert execute(["replay", str(out)]) == PASSED
    assert execute(["export", str(out), "--out", str(tmp_path / "other.csv")]) == PASSED


def edited(messages: list[list[Any]], topic: str) -> None:
    data = bytearray(messages[3][2])
    data[-2] ^= 1
    messages[3][2] = bytes(data)


def removed(messages: list[list[Any]], topic: str) -> None:
    del messages[3]


def moved(messages: list[list[Any]], topic: str) -> None:
    messages[2][2], messages[4][2] = messages[4][2], messages[2][2]


@pytest.mark.parametrize("change", [edited, removed, moved])
@pytest.mark.parametrize("topic", ["/cycle", "/tf", "/state"])
def test_messages_of_any_topic_that_were_changed_are_found(
    path: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: Any, topic: str
) -> None:
    out = tmp_path / "changed.mcap"
    with path.open("rb") as file, out.open("wb") as stream:
        reader, writer = make_reader(file), Writer(stream)
        writer.start()
        for attachment in reader.iter_attachments():
            writer.add_attachment(0, 0, attachment.name, attachment.media_type, attachment.data)
        for metadata in reader.iter_metadata():
            writer.add_metadata(metadata.name, metadata.metadata)
        for schema, channel, _ in {c.id: (s, c, m) for s, c, m in reader.iter_messages()}.values():
            assert schema is not None
            number = writer.register_schema(schema.name, schema.encoding, schema.data)
            identity = writer.register_channel(channel.topic, channel.message_encoding, number)
            messages = [[m.log_time, c.topic, m.data] for _, c, m in reader.iter_messages(topics=[channel.topic])]
            if channel.topic == topic:
                change(messages, topic)
            for time_ns, _, data in messages:
                writer.add_message(identity, time_ns, data, time_ns)
        writer.finish()
    code, text = verify(out, capsys)
    assert code == FAILED
    assert topic in text


def test_log_sorted_by_time_is_read_by_number_unless_a_line_is_at_another_time() -> None:
    """Lines from before and after a run have the time of its start."""
    times = (None, 0.1, 0.3, None)
    lines = [{"number": number, "t_s": t_s} for number, t_s in enumerate(times)]
    by_time = [lines[number] for number in (0, 3, 1, 2)]
    found = Contents(Path("x"), lines={"/log": by_time}, log_times=[7, 7, 100_000_007, 300_000_007])
    assert ordered_log(found) == lines
    found.log_times[2] += 1
    assert ordered_log(found) == by_time
    found.log_times, by_time[:2] = [7, 7, 100_000_007, 300_000_007], [lines[3], lines[0]]
    assert ordered_log(found) == by_time


@pytest.mark.parametrize("count", [60, pytest.param(1000, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_no_damage_of_a_byte_is_silent(path: Path, count: int) -> None:
    whole, rng, copy = path.read_bytes(), random.Random(8), path.with_name("damaged.mcap")
    expected = {topic: b"".join(rows) for topic, rows in contents(path).records.items()}
    for _ in range(count):
        data = bytearray(whole)
        data[rng.randrange(len(data))] ^= rng.randrange(1, 256)
        copy.write_bytes(data)
        try:
            found = contents(copy)
        except BadInput:
            continue
        assert found.problem or {topic: b"".join(rows) for topic, rows in found.records.items()} == expected


def test_damage_of_a_length_costs_its_block_alone(path: Path, tmp_path: Path) -> None:
    """The blocks after it are found by the index."""
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    blocks, data = summary.chunk_indexes, bytearray(path.read_bytes())
    data[blocks[1].chunk_start_offset + 2] ^= 0xFF
    copy = tmp_path / "damaged.mcap"
    copy.write_bytes(data)
    found = contents(copy)
    assert found.problem.startswith("damaged in 1 place: ")
    assert 0 < len(contents(path).records["/cycle"]) - len(found.records["/cycle"]) <= 6


def test_less_than_the_file_has_is_one_line_and_exit_code_5(
    path: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    data, cut = path.read_bytes(), tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) // 2])
    for command in (["export", str(cut), "--out", str(tmp_path / "o.csv")], ["replay", str(cut)]):
        caplog.clear()
        assert execute(command) == INCOMPLETE
        assert f"{cut}: cut: it has no end, the recorder was killed or the file shortened: " in caplog.text


@pytest.mark.parametrize(
    ("block", "reason"),
    [
        (
            chunk(b"x" * 40, 40, "brotli"),
            "not supported: blocks compressed by 'brotli', only by zstd, lz4 or not at",
        ),
        (chunk(b"", (256 << 20) + 1, "zstd"), "not supported: a block of 268435457 bytes unpacked, allowed 268435456"),
        (chunk(b"x" * 40, 40, "lz4"), "damaged in 1 place"),
        (chunk(message(1, bytes(8))[:-3], 27, ""), "damaged in 1 place"),
    ],
)
def test_what_is_not_supported_is_not_called_damaged(path: Path, tmp_path: Path, block: bytes, reason: str) -> None:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    data, first = path.read_bytes(), summary.chunk_indexes[2].chunk_start_offset
    other = tmp_path / "other.mcap"
    other.write_bytes(data[:first] + block + data[first:-40])
    problem = contents(other).problem
    assert problem.startswith(reason)
    assert "messages are read" in problem
    recovered = execute(["recover", str(other)])
    assert recovered == (BAD_INPUT if problem.startswith("not supported") else INCOMPLETE)
    assert other.with_name("other.recovered.mcap").exists() == (recovered == INCOMPLETE)


def test_own_recordings_state_the_checksum_of_their_data(path: Path) -> None:
    data = path.read_bytes()
    end = data.rindex(b"\x0f\x04\0\0\0\0\0\0\0")
    assert int.from_bytes(data[end + 9 : end + 13], "little") == zlib.crc32(data[:end])


CONTENT = b"abcdefgh" * 100 + b"xy"
BLOCK = b"\x8fabcdefgh\x08\x00" + bytes((255, 255, 255, 8)) + b"\x20xy"  # 8 literals, a match of 792, 2 literals
FRAME = b"\x04\x22\x4d\x18\x40\x70\xdf" + struct.pack("<I", len(BLOCK)) + BLOCK + bytes(4)


def test_block_of_lz4_that_ends_by_a_match_is_read() -> None:
    """The library refuses it: the format asks for 5 literals at the end, and lz4js does not always write them."""
    with pytest.raises(RuntimeError):
        lz4.frame.decompress(FRAME)
    assert unpacked(FRAME, len(CONTENT), has_checksum=True) == CONTENT
    with pytest.raises(RuntimeError):
        unpacked(FRAME, len(CONTENT), has_checksum=False)


@pytest.mark.parametrize("at", range(4, len(FRAME) - 4))
def test_damaged_block_of_lz4_is_refused_or_unpacks_to_no_more_than_stated(at: int) -> None:
    for bit in range(8):
        data = bytearray(FRAME)
        data[at] ^= 1 << bit
        with suppress(RuntimeError, ValueError, LookupError, struct.error):
            content = unpacked(bytes(data), len(CONTENT), has_checksum=True)
            assert len(content) <= len(CONTENT) + len(FRAME)
