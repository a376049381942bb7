"""Files that no reader may trust: wrong, endless, deep, huge, damaged; and the commands that read them."""

from __future__ import annotations

import json
import os
import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import zstandard

from hil.config.load import configs_folder, load_rig, load_scenario

NUMBERS = ("1e308", "-1e308", "1e-320", '"text"', "[]", "{}", "9" * 4301, "0x" + "f" * 5000)
GIB = 1 << 30


@dataclass(frozen=True)
class Hostile:
    """A hostile input. arguments: of the command that reads it, which ends with exit code 2 or 3."""

    name: str
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Reader:
    """A kind of file. sound: a usable one. arguments: of the command that reads the file at a path."""

    suffix: str
    sound: bytes
    arguments: Callable[[Path], tuple[str, ...]]
    is_table: bool = False


def readers(folder: Path) -> dict[str, Reader]:
    """Return each kind of file that the product reads; ``folder`` gets what the commands need besides."""
    configs = configs_folder()
    scenario = (configs / "scenarios" / "scheme-1.toml").read_bytes()
    rig = (configs / "rigs" / "mock.toml").read_bytes()
    scene = (configs / "targets" / "atv.toml").read_bytes()
    protocol = (configs / "protocols" / "acu.toml").read_bytes()
    images = folder / "images"
    for side in ("left", "right"):
        (images / side).mkdir(parents=True, exist_ok=True)
    (folder / "video.mkv").write_bytes(b"no video")
    out = str(folder / "out")

    def lab(key: str) -> Callable[[Path], tuple[str, ...]]:
        def arguments(path: Path) -> tuple[str, ...]:
            rig_file = path.with_name(f"{path.name}.rig.toml")
            table = "turntable.cia402" if key == "eds_file" else "turntable.ascii"
            driver = table.partition(".")[2]
            text = (
                f'extends = "emulated"\nname = "lab"\nturntable.driver = "{driver}"\n{table}.{key} = {_quoted(path)}\n'
            )
            rig_file.write_text(text, encoding="utf-8")
            return ("run", "scheme-1", "--duration", "0.1", "--rig", str(rig_file))

        return arguments

    def case(*before: str, after: tuple[str, ...] = ()) -> Callable[[Path], tuple[str, ...]]:
        return lambda path: (*before, str(path), *after)

    run = ("run", "scheme-1", "--duration", "0.1")
    geometry = json.dumps(_geometry()).encode()
    gravity = b"1738.0, 4902.8, 0.0, 2, 2, 1, 0.0, 0.0\n2, 0, -9.09e-5, 0.0\n2, 1, 1e-9, 0.0\n2, 2, 3.47e-5, 0.0\n"
    return {
        "scenario": Reader(".toml", scenario, case("run", after=("--duration", "0.1")), True),
        "rig": Reader(".toml", rig, case(*run, "--rig"), True),
        "scene": Reader(".toml", scene, case("monitor", str(folder / "video.mkv"), "--out", out, "--scene"), True),
        "geometry": Reader(".json", geometry, case("vmu", str(images), "--out", out, "--geometry"), True),
        "protocol": Reader(".toml", protocol, lab("protocol"), True),
        "eds": Reader(".eds", b"[DeviceInfo]\nVendorName=x\n", lab("eds_file")),
        "gravity": Reader(".tab", gravity, lambda path: (*run, "--set", f"truth.gravity_file={_quoted(path)}")),
        "cof": Reader(".cof", b"POTFIELD", lambda path: (*run, "--set", f"truth.gravity_file={_quoted(path)}")),
        "library": Reader(".so", b"\x7fELF", lambda path: (*run, "--set", f"gnc.library={_quoted(path)}")),
        "report": Reader(".mcap", b"", case("report", after=("-o", out))),
        "replay": Reader(".mcap", b"", case("replay")),
        "export": Reader(".mcap", b"", case("export", after=("--format", "csv", "--out", out))),
        "recover": Reader(".mcap", b"", case("recover")),
        "views": Reader(".csv", b"view\n", case("calibrate", after=("--geometry", str(folder / "g.toml")))),
        "token": Reader(".token", b"", case("console", "--port", "0", "--token-file")),
        "campaign": Reader(
            "", b"", lambda path: ("campaign", "scheme-1", "--runs", "2", "--duration", "0.1", "--out", str(path))
        ),
        "catalogue": Reader("", b"", case("recordings", "list")),
    }


def hostile(folder: Path) -> Iterator[Hostile]:
    """Yield hostile inputs, more than 300; their files are made in ``folder`` one at a time."""
    kinds = readers(folder)
    for kind, reader in kinds.items():
        if kind in ("campaign", "catalogue"):
            continue
        for number, (name, make) in enumerate(_PLACES.items()):
            path = folder / f"{kind}-{number}{reader.suffix}"
            make(path)
            yield Hostile(f"{kind}: {name}", reader.arguments(path))
        for number, (name, content) in enumerate(_contents(reader).items()):
            path = folder / f"{kind}-c{number}{reader.suffix}"
            path.write_bytes(content)
            yield Hostile(f"{kind}: {name}", reader.arguments(path))
    yield from _folders(folder, kinds)
    yield from _settings()
    yield from _recordings(folder, kinds)


def _settings() -> Iterator[Hostile]:
    """Yield each number of the shipped scenario and rig with values that are no values for it."""
    rig, scenario = load_rig("mock").value.model_dump(mode="json"), load_scenario("scheme-1").value.model_dump()
    del scenario["dispersions"]  # of campaigns
    keys = [*_numbers(scenario, ""), *(f"rig.{key}" for key in _numbers(rig, ""))]
    for number, key in enumerate(keys):
        value = NUMBERS[number % len(NUMBERS)]
        yield Hostile(f"--set {key}={value[:20]}", ("run", "scheme-1", "--duration", "0.1", "--set", f"{key}={value}"))
    for text in ("a[b=1", "[=1", "gnc.[=1", "=1", "...=1", "gnc=1", "x=" + "[" * 5000, 'a="\\u0000"', "\x1b[2J=1"):
        yield Hostile(f"--set {text[:20]!r}", ("run", "scheme-1", "--duration", "0.1", "--set", text))
    for option, values in {
        "--duration": ("1e308", "-1", "nan", "inf", "0", "1e7", "9" * 400),
        "--seed": ("-1", "9" * 5000, "1e3", str(2**64)),
        "--speed": ("0", "nan", "1e300"),
        "--case": ("-1", "9" * 4301),
        "--rig": ("x" * 5000, "\x1b[2J", "."),
    }.items():
        for value in values:
            yield Hostile(f"{option} {value[:20]}", ("run", "scheme-1", option, value))
    for step in ("1e-12", "1e-5", "1e3", "0.0"):
        yield Hostile(f"step {step}", ("run", "scheme-1", "--set", f"step_s={step}"))
    yield Hostile("5e9 cycles", ("run", "scheme-1", "--duration", "1e6", "--set", "step_s=2e-4"))


def _numbers(table: dict[str, Any], prefix: str) -> Iterator[str]:
    for key, value in table.items():
        if isinstance(value, dict):
            yield from _numbers(value, f"{prefix}{key}.")
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            yield f"{prefix}{key}"


def _fifo(path: Path) -> None:
    os.mkfifo(path)


def _sparse(path: Path) -> None:
    with path.open("wb") as file:
        file.truncate(20 * GIB)


def _loop(path: Path) -> None:
    path.symlink_to(path.name)


_PLACES: dict[str, Callable[[Path], None]] = {
    "endless device": lambda path: path.symlink_to("/dev/zero"),
    "pipe without a writer": _fifo,
    "folder": Path.mkdir,
    "20 GiB of nothing": _sparse,
    "link to itself": _loop,
    "missing": lambda path: None,
}


def _contents(reader: Reader) -> dict[str, bytes]:
    found = {
        "empty": b"",
        "zeros": bytes(4096),
        "noise": random.Random(1).randbytes(65536),
        "not UTF-8": b'name = "\xff\xfe"\n',
        "UTF-16": "name = 1\n".encode("utf-16"),
        "one long line": b"x" * 900_000,
        "many lines": b"x\n" * 400_000,
        "BOM twice": "\ufeff\ufeffname = 1\n".encode(),
    }
    if not reader.is_table:
        return found
    deep = 20_000
    if reader.suffix == ".json":
        return found | {
            "deep array": b"[" * deep + b"]" * deep,
            "deep table": b'{"a":' * deep + b"1" + b"}" * deep,
            "long integer": b'{"leds_m": ' + b"9" * 4301 + b"}",
            "half a surrogate": b'{"\\ud800": "\\udfff"}',
            "escape sequence": b'{"\\u001b[2J\\n": 1}',
            "key with a bracket": b'{"a[b": 1}',
            "number": b"1",
            "list": b"[1]",
            "null": b"null",
            "many keys": json.dumps({f"k{i}": i for i in range(40_000)}).encode(),
        }
    return found | {
        "deep array": b"name = " + b"[" * deep + b"]" * deep,
        "deep table": b"name = " + b"{a=" * deep + b"1" + b"}" * deep,
        "deep key": b".".join([b"a"] * 400_000) + b" = 1",
        "deep header": b"[" + b".".join([b"a"] * 400_000) + b"]",
        "long integer": b"duration_s = " + b"9" * 4301,
        "long hexadecimal": b"duration_s = 0x" + b"f" * 100_000,
        "zero in a text": b'name = "a\\u0000b"',
        "escape sequence": b'"\\u001b[2J\\n" = 1\n' + reader.sound,
        "key with a bracket": b'"a[b" = 1\n' + reader.sound,
        "key of brackets": b'"[" = {"]" = 1}\n' + reader.sound,
        "many keys": b"".join(b"k%d = 1\n" % i for i in range(40_000)),
        "extends itself": b'extends = "."\n',
        "extends a long name": b'extends = "' + b"x" * 5000 + b'"\n',
        "carriage returns only": reader.sound.replace(b"\n", b"\r"),
        "half": reader.sound[: len(reader.sound) // 2] + b"\n[",
    }


def _folders(folder: Path, kinds: dict[str, Reader]) -> Iterator[Hostile]:
    for number, content in enumerate((b"", b"{", b"[" * 20_000, b"[]", b'"x"', b"\xff", b'{"scenario": 1}')):
        place = folder / f"campaign-{number}"
        place.mkdir()
        (place / "campaign.json").write_bytes(content)
        yield Hostile(f"campaign.json {content[:8]!r}", kinds["campaign"].arguments(place))
    place = folder / "campaign-device"
    place.mkdir()
    (place / "campaign.json").symlink_to("/dev/zero")
    yield Hostile("campaign.json endless", kinds["campaign"].arguments(place))
    for number, content in enumerate((b"x" * 100, b"SQLite format 3\0" + b"\xff" * 200, bytes(8192))):
        place = folder / f"recordings-{number}"
        place.mkdir()
        (place / "catalogue.sqlite").write_bytes(content)
        yield Hostile(f"catalogue {content[:8]!r}", kinds["catalogue"].arguments(place))


def _geometry() -> dict[str, Any]:
    camera = {"fx": 1200.0, "fy": 1200.0, "cx": 512.0, "cy": 512.0, "width": 1024, "height": 1024}
    leds = [[0.1, 0.0, -0.06], [0.0, 0.1, 0.0], [-0.1, 0.0, 0.0], [0.0, -0.1, 0.0]]
    return {"leds_m": leds, "left": camera, "right": camera, "baseline_m": [0.2, 0.0, 0.0]}


# recordings: MCAP files made byte by byte

MAGIC = b"\x89MCAP0\r\n"


def record(opcode: int, content: bytes) -> bytes:
    """Return one MCAP record."""
    return struct.pack("<BQ", opcode, len(content)) + content


def text(value: str | bytes) -> bytes:
    """Return a text with its length, as in MCAP."""
    data = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(data)) + data


def metadata(name: str, pairs: dict[str, str]) -> bytes:
    """Return a Metadata record."""
    inner = b"".join(text(key) + text(value) for key, value in pairs.items())
    return record(0x0C, text(name) + text(inner))


def attachment(name: str, data: bytes, stated: int | None = None) -> bytes:
    """Return an Attachment record; stated: length in it, if it is not the data's."""
    head = struct.pack("<QQ", 0, 0) + text(name) + text("application/json")
    return record(0x09, head + struct.pack("<Q", len(data) if stated is None else stated) + data + bytes(4))


def chunk(data: bytes, stated: int, compression: str) -> bytes:
    """Return a Chunk record; stated: its size unpacked."""
    head = struct.pack("<QQQI", 0, 0, stated, 0) + text(compression)
    return record(0x06, head + struct.pack("<Q", len(data)) + data)


def channel(number: int, topic: str, schema: bytes, encoding: str) -> bytes:
    """Return Schema and Channel records."""
    described = record(0x03, struct.pack("<H", number) + text("x") + text("hil.fields") + text(schema))
    return described + record(0x04, struct.pack("<HH", number, number) + text(topic) + text(encoding) + text(b""))


def message(number: int, data: bytes) -> bytes:
    """Return a Message record."""
    return record(0x05, struct.pack("<HIQQ", number, 0, 0, 0) + data)


def mcap(*records: bytes) -> bytes:
    """Return a file of these records, without an end."""
    return MAGIC + record(0x01, text("hil") + text("hil")) + b"".join(records)


def _recordings(folder: Path, kinds: dict[str, Reader]) -> Iterator[Hostile]:
    head = metadata("hil.run", {"schema_version": "2", "hil": "0"})
    packer = zstandard.ZstdCompressor(level=19)
    bomb = packer.compress(bytes(GIB))
    unsized = zstandard.ZstdCompressor(write_content_size=False).compress(bytes(GIB))
    small = packer.compress(record(0x05, bytes(22)) * 250_000)
    field = '{"name": "t_s", "type": "f8", "shape": [], "offset": 0}'
    deep = b"[" * 20_000
    models = attachment("scenario.json", b"{}") + attachment("rig.json", b"{}")
    files = {
        "magic only": MAGIC,
        "header only": mcap(),
        "no attachments": mcap(head),
        "other version": mcap(metadata("hil.run", {"schema_version": "\x1b[2J99", "hil": "\n"})),
        "empty models": mcap(head, models),
        "deep model": mcap(head, attachment("scenario.json", deep), attachment("rig.json", b"{}")),
        "long integer": mcap(head, attachment("scenario.json", b'{"a": ' + b"9" * 4301 + b"}")),
        "list for a model": mcap(head, attachment("scenario.json", b"[]"), attachment("rig.json", b"1")),
        "deep schema": mcap(head, channel(1, "/cycle", deep, "hil.record")),
        "object type": mcap(head, channel(1, "/cycle", _schema(field.replace("f8", "O"), 8), "hil.record")),
        "huge shape": mcap(head, channel(1, "/cycle", _schema(field.replace("[]", "[1000000000]"), 8), "hil.record")),
        "negative offset": mcap(head, channel(1, "/cycle", _schema(field.replace("0}", "-8}"), 8), "hil.record")),
        "huge record": mcap(head, channel(1, "/cycle", _schema(field, 1 << 62), "hil.record")),
        "text for a size": mcap(head, channel(1, "/cycle", b'{"fields": [], "size": "8"}', "hil.record")),
        "short message": mcap(head, models, channel(1, "/cycle", _schema(field, 8), "hil.record"), message(1, b"abc")),
        "deep log line": mcap(head, models, channel(1, "/log", b"{}", "json"), message(1, deep)),
        "log line is a list": mcap(head, models, channel(1, "/log", b"{}", "json"), message(1, b"[]")),
        "log line without text": mcap(head, models, channel(1, "/log", b"{}", "json"), message(1, b"{}")),
        "bomb of a stated size": mcap(head, chunk(bomb, GIB, "zstd")),
        "bomb of a false size": mcap(head, chunk(bomb, 1000, "zstd")),
        "bomb of no size": mcap(head, chunk(unsized, GIB, "zstd")),
        "three bombs": mcap(head, *[chunk(bomb, GIB, "zstd")] * 3),
        "many small bombs": mcap(head, *[chunk(small, 250_000 * 31, "zstd")] * 60),
        "attachment of an exabyte": mcap(head, attachment("scenario.json", b"", 1 << 60)),
        "record of an exabyte": mcap(head) + struct.pack("<BQ", 0x06, 1 << 60),
        "summary is a list": mcap(head, models, attachment("summary.json", b"[]")),
    }
    for number, (name, content) in enumerate(files.items()):
        path = folder / f"recording-{number}.mcap"
        path.write_bytes(content)
        for kind in ("report", "replay", "export"):
            yield Hostile(f"{kind}: {name}", kinds[kind].arguments(path))


def _schema(field: str, size: int) -> bytes:
    return f'{{"fields": [{field}], "size": {size}}}'.encode()


def _quoted(path: Path) -> str:
    return json.dumps(str(path))
