"""Archives of FMUs that are cut, hostile or absurd are refused with one line, and nothing is written outside."""

from __future__ import annotations

import stat
import zipfile
from pathlib import Path

import pytest

from hil.parts.fmi import archive
from hil.parts.fmi.archive import DESCRIPTION, Archive, FmuError
from hil.parts.fmi.description import parse


def made(path: Path, files: dict[str, bytes]) -> Path:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as made_of:
        for name, content in files.items():
            made_of.writestr(name, content)
    return path


def refusal(path: Path, folder: Path) -> str:
    def read() -> None:
        with Archive(path) as found:
            found.description()
            found.unpack(folder)

    with pytest.raises(FmuError) as caught:
        read()
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", ["../evil", "a/../../evil", "/evil", "C:/evil", "a\\..\\evil", ".."])
def test_paths_that_leave_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    path = made(tmp_path / "a.fmu", {DESCRIPTION: b"<x/>", name: b"evil"})
    assert "relative paths inside the archive" in refusal(path, tmp_path / "in")
    assert not (tmp_path / "evil").exists()
    assert not (tmp_path / "in").exists()


def test_link_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w") as made_of:
        entry = zipfile.ZipInfo("link")
        entry.external_attr = (stat.S_IFLNK | 0o777) << 16
        made_of.writestr(entry, "/etc/passwd")
    assert "no regular file" in refusal(path, tmp_path / "in")


def test_bomb_is_refused_before_it_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "_UNPACKED_MAX", 1 << 20)
    path = made(tmp_path / "a.fmu", {DESCRIPTION: b"<x/>", "zeros": bytes(2 << 20)})
    assert path.stat().st_size < 10_000
    assert "allowed 1048576" in refusal(path, tmp_path / "in")


def test_entry_longer_than_stated_is_refused(tmp_path: Path) -> None:
    path = made(tmp_path / "a.fmu", {DESCRIPTION: b"<x/>", "zeros": bytes(100_000)})
    data = bytearray(path.read_bytes())
    for mark, place in ((b"PK\x03\x04", 22), (b"PK\x01\x02", 24)):  # uncompressed size in both headers
        at = data.rfind(mark)
        data[at + place : at + place + 4] = (10).to_bytes(4, "little")
    path.write_bytes(data)
    assert "zeros" in refusal(path, tmp_path / "in")


@pytest.mark.parametrize("left", [0, 10, 200, -30])
def test_cut_archive_is_refused(tmp_path: Path, left: int) -> None:
    path = made(tmp_path / "a.fmu", {DESCRIPTION: b"<x/>" * 100, "b": bytes(range(256)) * 4})
    path.write_bytes(path.read_bytes()[:left])
    assert "cut off" in refusal(path, tmp_path / "in")


def test_damaged_entry_is_refused(tmp_path: Path) -> None:
    path = made(tmp_path / "a.fmu", {DESCRIPTION: b"<x/>" * 100})
    data = bytearray(path.read_bytes())
    data[50] ^= 0xFF
    path.write_bytes(data)
    assert "cannot be unpacked" in refusal(path, tmp_path / "in")


def test_archive_without_description_is_refused(tmp_path: Path) -> None:
    assert refusal(made(tmp_path / "a.fmu", {"b": b""}), tmp_path / "in") == f"has no {DESCRIPTION}"


BOMB = (
    b'<!DOCTYPE a [<!ENTITY a "aaaaaaaa"><!ENTITY b "&a;&a;&a;&a;&a;">]><fmiModelDescription>&b;</fmiModelDescription>'
)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (BOMB, "entities are not allowed"),
        (b"<a>" * 100 + b"</a>" * 100, "nested too deeply"),
        (b"<fmiModelDescription", "is not XML"),
        (b"", "is not XML"),
        (b"<other/>", "expected fmiModelDescription"),
        (b'<fmiModelDescription fmiVersion="1.0"/>', "allowed 2.0, 3.0"),
        (b'<fmiModelDescription fmiVersion="2.0"><ModelExchange/></fmiModelDescription>', "model exchange only"),
        (
            b'<fmiModelDescription fmiVersion="2.0"><CoSimulation modelIdentifier="../a"/></fmiModelDescription>',
            "expected a name of C",
        ),
        (
            b'<fmiModelDescription fmiVersion="3.0"><CoSimulation modelIdentifier="a"/><ModelVariables>'
            b'<Float64 name="x" valueReference="-1"/></ModelVariables></fmiModelDescription>',
            "expected a whole number",
        ),
        (
            b'<fmiModelDescription fmiVersion="3.0"><CoSimulation modelIdentifier="a"/><ModelVariables>'
            b'<Float64 name="x" valueReference="1"><Dimension start="100000"/><Dimension start="100000"/></Float64>'
            b"</ModelVariables></fmiModelDescription>",
            "elements, allowed",
        ),
    ],
)
def test_model_description_that_cannot_be_used_is_refused(text: bytes, says: str) -> None:
    with pytest.raises(FmuError, match=says):
        parse(text)


@pytest.mark.parametrize("encoding", ["utf-7", "utf-32", "no-such-encoding"])
def test_encoding_that_the_parser_does_not_have_is_an_error_of_the_file(encoding: str) -> None:
    with pytest.raises(FmuError, match="is not XML in UTF-8 or UTF-16"):
        parse(f'<?xml version="1.0" encoding="{encoding}"?><fmiModelDescription/>'.encode())


def test_program_in_the_resources_can_be_run_after_unpacking(tmp_path: Path) -> None:
    path = tmp_path / "a.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        for name, mode in (("resources/run.sh", 0o6755), ("resources/table.txt", 0o644)):
            entry = zipfile.ZipInfo(name)
            entry.create_system, entry.external_attr = 3, (stat.S_IFREG | mode) << 16
            archive.writestr(entry, "x")
    with Archive(path) as archive_:
        archive_.unpack(tmp_path / "out")
    modes = {file.name: stat.S_IMODE(file.stat().st_mode) for file in (tmp_path / "out" / "resources").iterdir()}
    assert modes["run.sh"] & 0o7100 == 0o100
    assert modes["table.txt"] & 0o7111 == 0
