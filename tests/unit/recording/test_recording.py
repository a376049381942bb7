"""What goes into a recording comes out of it again, also when the file broke off or is damaged."""

from __future__ import annotations

import errno
import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from hil.config.load import load_rig
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.camera_images import IMAGE_BYTES, image_row
from hil.core.fields import record_dtype
from hil.core.messages import CYCLE, CYCLE_FIELDS, POSE_FIELDS
from hil.errors import BadInput
from hil.parts.export import table as table_export
from hil.parts.export.table import export
from hil.recording import read, schema
from hil.recording.read import contents, load
from hil.recording.recover import recover
from hil.recording.schema import LOG_ENTRY
from hil.recording.writer import RecordingHeader, RunFile

STEP_S = 0.02


def rows_of(n: int, rng: np.random.Generator) -> np.ndarray:
    """Return ``n`` rows of CYCLE, full of noise but for their times."""
    rows = np.frombuffer(bytearray(rng.standard_normal(n * CYCLE.itemsize // 8).tobytes()), CYCLE)
    rows["t_s"] = STEP_S * np.arange(n)
    return rows


def run_file(path: Path, version: str = str(schema.VERSION), files: dict[str, str] | None = None) -> RunFile:
    run = {"schema_version": version, "hil": "0.0.7", "run": "r"}
    return RunFile(path, RecordingHeader(run, files or {}, 1_000_000_000))


def cycles_in(path: Path) -> int:
    return len(contents(path).records.get("/cycle", []))


@pytest.mark.parametrize("topic", schema.records())
def test_every_recorded_field_has_unit_frame_and_meaning_in_its_schema(topic: str) -> None:
    text = schema.describe(*schema.records()[topic])
    fields, dtype = json.loads(text)["fields"], record_dtype(schema.records()[topic][1])
    assert sum(np.dtype(f["type"]).itemsize * int(np.prod(f["shape"])) for f in fields) == dtype.itemsize
    assert all(f["unit"] and f["description"] for f in fields)
    assert schema.layout_of(text, "x") == schema.flat_dtype(dtype)


def test_rows_come_back_bit_by_bit_and_plain_mcap_reads_them(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "run.mcap"
    rows = rows_of(60, rng)
    file = run_file(path)
    file.write_cycles(rows)
    account = file.finish({"stop": "completed"}, "{}")
    assert (account.cycles, account.dropped, account.problem) == (60, 0, "")
    found = contents(path)
    assert found.intact
    assert b"".join(found.records["/cycle"]) == rows.tobytes()
    np.testing.assert_array_equal(found.flat("/cycle")["truth.r_CT_H"], rows["truth"]["r_CT_H"])
    with path.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        messages = [message for _, channel, message in reader.iter_messages() if channel.topic == "/cycle"]
        states = [json.loads(m.data) for _, channel, m in reader.iter_messages() if channel.topic == "/state"]
        tables = {s.name: json.loads(s.data) for s in reader.get_summary().schemas.values()}  # type: ignore[union-attr]
    assert [message.log_time for message in messages] == [1_000_000_000 + k * 20_000_000 for k in range(60)]
    assert len(states) == 12  # one in 0.1 s
    assert set(states[0]) == set(tables["hil.State"]["properties"])
    assert {"foxglove.FrameTransform", "foxglove.Log"} <= set(tables)


@pytest.mark.parametrize(("rate_hz", "messages"), [(50.0, 60), (5.0, 6)])
def test_messages_for_viewers_have_the_rate_of_the_telemetry(
    tmp_path: Path, rng: np.random.Generator, rate_hz: float, messages: int
) -> None:
    path = tmp_path / "run.mcap"
    file = run_file(
        path, files={"rig.json": load_rig("mock", (f"rig.telemetry.rate_hz={rate_hz}",)).value.model_dump_json()}
    )
    file.write_cycles(rows_of(60, rng))
    file.finish({})
    found = contents(path)
    assert len(found.lines["/state"]) == messages
    assert len(found.records["/cycle"]) == 60


def test_data_of_0_1_s_ago_are_in_the_file_while_the_run_continues(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "run.mcap"
    file = run_file(path)
    rows = rows_of(120, rng)
    for k in range(120):
        file.write_cycles(rows[k : k + 1])
        if k % 7 == 0:
            assert k + 1 - cycles_in(path) <= 5
    file.finish({})


def test_a_file_cut_anywhere_gives_what_was_whole_and_recovers(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "run.mcap"
    file = run_file(path)
    file.write_cycles(rows_of(50, rng))
    file.finish({})
    whole = path.read_bytes()
    before = 0
    for size in np.linspace(whole.index(b"hil.run") + 200, len(whole) - 1, 23).astype(int):
        cut = tmp_path / f"cut{size}.mcap"
        cut.write_bytes(whole[:size])
        n = cycles_in(cut)
        assert n >= before
        before = n
        found = recover(cut)
        assert found.out is not None
        assert cycles_in(found.out) == n
        assert contents(found.out).intact
        assert cut.read_bytes() == whole[:size]
    assert before == 50


def test_a_damaged_block_is_left_out_and_the_rest_stands(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "run.mcap"
    file = run_file(path)
    file.write_cycles(rows_of(50, rng))
    file.finish({})
    whole = bytearray(path.read_bytes())
    whole[len(whole) // 2] ^= 0xFF
    path.write_bytes(whole)
    assert 50 - 5 <= cycles_in(path) < 50
    assert not contents(path).intact
    assert recover(path).problem.startswith("damaged in 1 place: ")


def test_damage_to_the_block_that_names_the_channels_costs_that_block_alone(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    path = tmp_path / "run.mcap"
    file = run_file(path)
    file.write_cycles(rows_of(50, rng))
    file.finish({})
    whole = bytearray(path.read_bytes())
    whole[whole.index(b"zstd") + 100] ^= 0xFF
    path.write_bytes(whole)
    assert 44 <= cycles_in(path) < 50
    found = recover(path)
    assert found.out is not None
    assert cycles_in(found.out) == cycles_in(path)


def test_damage_of_any_kind_ends_in_rows_or_in_one_clear_line(tmp_path: Path, rng: np.random.Generator) -> None:
    path = tmp_path / "run.mcap"
    file = run_file(path)
    file.write_cycles(rows_of(20, rng))
    file.finish({})
    whole = path.read_bytes()
    for _ in range(150):
        spoilt = bytearray(whole)
        for place in rng.integers(0, len(whole), 3):
            spoilt[place] = rng.integers(256)
        path.write_bytes(spoilt)
        try:
            n = cycles_in(path)
        except BadInput as error:
            n = 0 if str(path) in str(error) else -1
        assert 0 <= n <= 20


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "too short"),
        (b"PNG", "too short"),
        (b"\x89PNG\r\n\x1a\n" + bytes(99), "no MCAP"),
        (b"t_s,x\n" * 9, "no MCAP"),
    ],
)
def test_file_of_another_kind_is_refused_in_one_line(tmp_path: Path, content: bytes, word: str) -> None:
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    for opened in (load, recover):
        with pytest.raises(BadInput, match="not a recording") as caught:
            opened(path)
        assert len(caught.value.problems) == 1


def test_an_mcap_file_of_another_program_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "ros.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.finish()
    with pytest.raises(BadInput, match="not a recording of hil"):
        load(path)


def test_an_older_version_is_named_with_the_program_that_reads_it_and_exports(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    path = tmp_path / "old.mcap"
    file = run_file(path, version="0")
    file.write_cycles(rows_of(3, rng))
    file.finish({})
    with pytest.raises(BadInput, match=r"schema version 0, written by hil 0\.0\.7.*hil export"):
        load(path)
    assert export(path, "csv", tmp_path / "old.csv")[0] == (tmp_path / "old.csv", 3)


def test_a_recording_of_version_1_is_loaded_with_zeros_for_later_fields(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, scheme_1: Scenario, mock_rig: Rig
) -> None:
    pose = tuple(field for field in POSE_FIELDS if field.name not in ("covariance_cross", "status"))
    fields = tuple(replace(field, type=pose) if field.name == "pose" else field for field in CYCLE_FIELDS)
    monkeypatch.setitem(schema.RECORDS, "/cycle", ("hil.Cycle", fields))
    old = record_dtype(fields)
    rows = np.frombuffer(bytearray(rng.standard_normal(3 * old.itemsize // 8).tobytes()), old)
    path = tmp_path / "old.mcap"
    files = {"scenario.json": scheme_1.model_dump_json(), "rig.json": mock_rig.model_dump_json()}
    file = run_file(path, "1", files)
    file.write_cycles(rows)
    file.finish({})
    monkeypatch.undo()
    cycles = load(path).cycles
    assert cycles.dtype == CYCLE
    flat = schema.flat_dtype(old)
    for name in flat.names or ():
        np.testing.assert_array_equal(cycles.view(schema.flat_dtype(CYCLE))[name], rows.view(flat)[name])
    assert not cycles["pose"]["covariance_cross"].any()
    assert not cycles["pose"]["status"].any()


def test_a_recording_of_version_2_reports_no_protection_level(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch, scheme_1: Scenario, mock_rig: Rig
) -> None:
    appended = ("protection_level_m", "protection_level_rad", "health", "reaction")
    fields = tuple(
        replace(field, type=tuple(part for part in field.type if part.name not in appended))
        if field.name in ("navigation", "supervision") and isinstance(field.type, tuple)
        else field
        for field in CYCLE_FIELDS
    )
    monkeypatch.setitem(schema.RECORDS, "/cycle", ("hil.Cycle", fields))
    path = tmp_path / "old.mcap"
    files = {"scenario.json": scheme_1.model_dump_json(), "rig.json": mock_rig.model_dump_json()}
    file = run_file(path, "2", files)
    file.write_cycles(np.zeros(3, record_dtype(fields)))
    file.finish({})
    monkeypatch.undo()
    recorded = load(path)
    navigation = recorded.cycles["navigation"]
    assert np.isnan(navigation["protection_level_m"]).all()
    assert np.isnan(navigation["protection_level_rad"]).all()
    assert not navigation["health"].any()
    assert not recorded.cycles["supervision"]["reaction"].any()
    assert {name.partition(".")[2] for name in recorded.absent} == set(appended)


def test_a_full_disk_keeps_what_was_written_and_counts_the_rest(
    tmp_path: Path, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.mcap"
    file = run_file(path)
    rows = rows_of(100, rng)
    file.write_cycles(rows[:50])
    file.flush()
    size = path.stat().st_size
    write, room = os.write, [1000]

    def full(descriptor: int, data: bytes) -> int:
        if not room[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        taken = write(descriptor, data[: room[0]])
        room[0] -= taken
        return taken

    monkeypatch.setattr(os, "write", full)
    file.write_cycles(rows[50:])
    account = file.finish({"stop": "completed"}, "{}")
    monkeypatch.undo()
    assert path.stat().st_size == size
    assert "No space left on device" in account.problem
    assert "hil recover" in account.problem
    assert account.dropped == 50 + 2 * 10  # rows, and what is shown of each fifth
    assert b"".join(contents(path).records["/cycle"]) == rows[:50].tobytes()
    assert recover(path).messages == 50 + 2 * 10


def test_notes_and_images_have_the_names_of_foxglove(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    file = run_file(path)
    note = np.zeros(1, LOG_ENTRY)
    note[["t_s", "bench_s", "cycle", "kind", "source", "text"]] = (
        np.nan, 3.5, -1, b"alarm", b"rails.x", "zu heiß".encode(),
    )  # fmt: skip
    file.write_log(note)
    file.write_images(image_row("left", 2.5, b"\xff\xd8jpeg\x00\xff\xd9"))
    file.finish({})
    found = contents(path)
    assert found.lines["/log"][0]["message"] == "zu heiß"
    assert found.lines["/log"][0]["level"] == 4
    assert found.lines["/log"][0]["t_s"] is None
    picture = found.lines["/pictures/left"][0]
    assert picture["format"] == "jpeg"
    assert picture["data"] == "/9hqcGVnAP/Z"
    assert picture["timestamp"] == {"sec": 3, "nsec": 500_000_000}


def test_image_beyond_its_capacity_is_refused() -> None:
    with pytest.raises(BadInput, match="left"):
        image_row("left", 0.0, bytes(IMAGE_BYTES + 1))


def test_text_that_a_spreadsheet_would_compute_is_marked_as_text_in_csv(tmp_path: Path) -> None:
    out = tmp_path / "log.csv"
    table_export._write_csv({"t_s": np.array([-1.0, 2.0]), "=message": ["=1+1", "a = b"]}, out)
    assert out.read_text().splitlines() == ["t_s,'=message", "-1.0,'=1+1", "2.0,a = b"]


def test_csv_gives_back_the_very_numbers(recorded_run: Path, tmp_path: Path) -> None:
    out = tmp_path / "run.csv"
    written = dict(export(recorded_run, "csv", out))
    recorded = load(recorded_run)
    assert written[out] == len(recorded.cycles) == 401
    assert written[tmp_path / "run-frames.csv"] == len(recorded.arrivals)
    table = np.genfromtxt(out, delimiter=",", names=True, deletechars="", dtype=None, encoding="utf-8")
    np.testing.assert_array_equal(table["truth.r_CT_H[2]"], recorded.cycles["truth"]["r_CT_H"][:, 2])
    np.testing.assert_array_equal(table["navigation.nis_position"], recorded.cycles["navigation"]["nis_position"])


def test_parquet_has_units_with_its_columns(recorded_run: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    out = tmp_path / "run.parquet"
    export(recorded_run, "parquet", out)
    table = parquet.read_table(out)
    recorded = load(recorded_run)
    np.testing.assert_array_equal(table["feedback.rail_m[0]"].to_numpy(), recorded.cycles["feedback"]["rail_m"][:, 0])
    assert table.schema.field("truth.v_CT_H[1]").metadata == {b"unit": b"m/s in H"}


def test_without_pyarrow_parquet_is_refused_in_one_line(
    recorded_run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import sys

    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(BadInput, match=r"hil-bench\[parquet\].*--format csv"):
        export(recorded_run, "parquet", tmp_path / "run.parquet")


def test_part_of_a_recording_that_is_not_installed_is_one_line() -> None:
    about = {"version": "1.0", "origin": "acme-robot", "topics": ["/robot"]}
    files = {schema.PARTS_FILE: json.dumps({"monitor": about, "robot": about})}
    (line,) = read._missing_parts(read.Contents(Path("run.mcap"), files=files))
    assert line.startswith("run.mcap: part robot of package acme-robot 1.0 is not installed")
