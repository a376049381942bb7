"""Readers in process on damaged files: each of them is read, or refused as bad input."""

from __future__ import annotations

import random
import warnings
from collections.abc import Callable
from pathlib import Path

import pytest

from hil.config.load import configs_folder, load_geometry, load_protocol, load_rig, load_scenario, load_scene
from hil.drivers.turntable.cia402.eds import SHIPPED as EDS
from hil.drivers.turntable.cia402.eds import Eds
from hil.dynamics import gravity_file
from hil.errors import BadInput
from hil.recording import read
from hil.vmu.calibration.views import read_views
from tests.support import moon_reference as reference
from tests.support.hostile_files import NUMBERS, attachment, channel, mcap, message, metadata, readers

_HOSTILE = (
    b"[",
    b"]]",
    b'"',
    b"\0",
    b"\xff",
    b"=",
    b"\n",
    b"nan",
    b"1e400",
    b"-1e308",
    b"{" * 40,
    *map(str.encode, NUMBERS),
)


def _recording(folder: Path) -> bytes:
    """Return a recording of one cycle's time and one log line."""
    models = [
        attachment(name, made.model_dump_json().encode())
        for name, made in (("scenario.json", load_scenario("scheme-1").value), ("rig.json", load_rig("mock").value))
    ]
    schema = b'{"fields": [{"name": "t_s", "type": "f8", "shape": [], "offset": 0}], "size": 8}'
    line = b'{"message": "x", "name": "y", "kind": "event", "t_s": 0, "bench_s": 0, "cycle": 0}'
    log = [channel(2, "/log", b"{}", "json"), message(2, line)]
    head = metadata("hil.run", {"schema_version": "1", "hil": "0"})
    return mcap(head, *models, channel(1, "/cycle", schema, "hil.record"), message(1, bytes(8)), *log)


def _cases(folder: Path) -> dict[str, tuple[str, bytes, Callable[[Path], object]]]:
    """Return suffix, sound content and reader of each kind of file."""
    configs, kinds = configs_folder(), readers(folder)
    views = b"view,rail_x_m,rail_y_m,rail_z_m,roll_deg,pitch_deg,yaw_deg\na,1,2,3,4,5,6\nb,1,2,3,4,5,7\n"
    return {
        "scenario": (".toml", kinds["scenario"].sound, lambda path: load_scenario(str(path))),
        "rig": (".toml", (configs / "rigs" / "mock.toml").read_bytes(), lambda path: load_rig(str(path))),
        "scene": (".toml", kinds["scene"].sound, lambda path: load_scene(str(path))),
        "protocol": (".toml", kinds["protocol"].sound, lambda path: load_protocol(str(path))),
        "geometry": (".json", kinds["geometry"].sound, lambda path: load_geometry(str(path))),
        "eds": (".eds", EDS.read_bytes(), Eds),
        "gravity": (".tab", reference.SHIPPED.read_bytes(), gravity_file.read),
        "views": (".csv", views, read_views),
        "recording": (".mcap", _recording(folder), read.load),
    }


def _mutated(sound: bytes, dice: random.Random) -> bytes:
    """Return ``sound`` with one to four changes: bytes, cuts, repetitions, and hostile words."""
    data = bytearray(sound)
    for _ in range(dice.randrange(1, 5)):
        at = dice.randrange(len(data) + 1)
        match dice.randrange(5):
            case 0:
                data[at : at + 1] = bytes([dice.randrange(256)])
            case 1:
                data[at : at + dice.randrange(1, 200)] = b""
            case 2:
                data[at:at] = data[at : at + dice.randrange(1, 200)] * dice.randrange(1, 20)
            case 3:
                data[at:at] = dice.choice(_HOSTILE)
            case _:
                del data[at:]
    return bytes(data)


@pytest.mark.parametrize("count", [450, pytest.param(10_000, marks=[pytest.mark.slow, pytest.mark.timeout(1800)])])
def test_mutated_files_are_read_or_refused(tmp_path: Path, count: int) -> None:
    dice = random.Random(11)
    cases = list(_cases(tmp_path).items())
    faults, refused = [], 0
    for number in range(count):
        kind, (suffix, sound, reader) = cases[number % len(cases)]
        path = tmp_path / f"{number}{suffix}"
        path.write_bytes(_mutated(sound, dice))
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                reader(path)
        except (BadInput, gravity_file.GravityFileError) as error:
            refused += 1
            if not all(line.isprintable() for line in str(error).split("\n")):
                faults.append(f"{kind} {number}: {error}")
        except Exception as error:
            faults.append(f"{kind} {number}: {error!r}")
        path.unlink()
    assert not faults, f"{len(faults)} of {count}\n" + "\n".join(faults[:40])
    assert refused > count / 3
