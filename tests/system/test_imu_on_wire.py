"""IMU on the table of an emulated rig, in lock-step: its rates, its silence, what it does not go with, its frames."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.config.load import load_frame
from hil.drivers.vmu.codecs import frame_codec
from hil.errors import BadInput
from hil.parts.emulation.fault_injection import FaultControl
from hil.session.build import check, wired_bench
from tests.support.run_settings import make_job

RIG = """
extends = "emulated"
name = "lab"
host.time = "lock_step"
imu.rotation_deg = [0.0, 0.0, 90.0]
imu.earth_rate_degps = [0.0, 0.003, -0.003]
"""
TEXT = """
name = "gyros"
rotation = "none"
fields = [{ name = "counter" }, { name = "time" }, { name = "rate", scale = 0.017453292519943295 }]
checksum.kind = "xor8"
text = { start = "$GYRO," }
"""

MESSAGES = """
name = "gyros"
byte_order = "little"
sync = "01 81"
checksum.kind = "none"
rotation = "none"
fields = [
    { name = "counter", type = "u16" }, { name = "time", type = "u32", scale = 1e-6 }, { name = "rate", type = "f32" },
]
"""
CAN = "imu.can.identifiers = [0x181, 0x281, 0x381]\n"


def lab(folder: Path, more: str = "") -> str:
    (folder / "lab.toml").write_text(RIG + more)
    return str(folder / "lab.toml")


def rates(run: Any, name: str) -> np.ndarray:
    values: np.ndarray = run.to_pandas()[[f"{name}[{axis}]" for axis in range(3)]].to_numpy()
    return values


@pytest.mark.parametrize("wire", ["serial", "text in datagrams", "CAN"])
def test_rates_of_the_table_are_those_of_the_chaser_and_are_replayed(wire: str, tmp_path: Path) -> None:
    (tmp_path / "gyros.toml").write_text(MESSAGES if wire == "CAN" else TEXT)
    more = "" if wire == "serial" else f'imu.frames = "{tmp_path / "gyros.toml"}"\n'
    more += {"serial": "", "CAN": CAN}.get(wire, 'imu.port = "udp://127.0.0.1:9"\n')
    run = hil.run("scheme-1", lab(tmp_path, more), 3, 6.0, record=tmp_path)
    assert run.stop == "completed"
    later = slice(100, None)  # the table has reached the chaser's rate
    off = np.degrees(rates(run, "imu.rate_C") - rates(run, "truth.mean_rate_C"))[later]
    assert np.abs(off.mean(axis=0)).max() < 5e-4  # Earth's rotation is 0.004, H's in the truth 0.05 deg/s
    assert np.isnan(rates(run, "imu.drift_C")[later]).all()  # of a true one no value is known
    assert run.summary["imu"]["frames"] > 1000
    (path,) = tmp_path.glob("*.mcap")
    assert hil.open(path).replay().identical


def test_silence_stops_the_bench_and_names_the_imu(tmp_path: Path) -> None:
    with wired_bench(make_job(2.0, (), rig=lab(tmp_path))) as bench:
        runner, control = bench.runner(), FaultControl(bench.addresses["imu.faults"])
        control.send("on link_down")
        outcome = runner.run()
        control.close()
    assert str(outcome.stop).startswith("imu: no rate for ")


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        (
            ("imu.rate_hz=200",),
            "imu.rate_hz: 200: does not go with the IMU on the table of rig lab, allowed one sample",
        ),
        (
            ("rig.imu.can.identifiers=[385]",),
            'rig.imu.frames: sync "eb 90 21": does not go .* allowed "01 81", imu.can.identifiers',
        ),
        (("rig.imu.rate_hz=20",), "rig.imu.rate_hz: 20: does not go .* allowed from 50, one frame per cycle"),
        (("rig.turntable.roll.fixed_deg=0",), "rig.turntable: roll fixed: does not go .* three driven gimbals"),
        (("gnc.navigation.backend=vision_alone",), "gnc.navigation.backend: one without an IMU: does not go"),
    ],
)
def test_what_gyros_of_a_table_cannot_measure_is_refused(settings: Sequence[str], words: str, tmp_path: Path) -> None:
    with pytest.raises(BadInput, match=words):
        check(make_job(4.0, tuple(settings), rig=lab(tmp_path)))


def test_frame_of_an_imu_has_its_rate_and_no_pose(tmp_path: Path) -> None:
    codec = frame_codec("imu")
    frame = codec.encode_rate(7, 1.25, np.array([0.1, -0.2, 0.3]))
    (decoded,) = codec.decoder().feed(frame, 1.3)
    assert decoded.rate is not None
    np.testing.assert_array_equal(decoded.rate, [0.1, -0.2, 0.3])
    assert not codec.decoder().feed(codec.encode_rate(8, 1.3, np.full(3, np.nan)), 1.3)
    for given, words in (
        (TEXT.replace('{ name = "time" }, ', ""), "fields: time: missing"),
        (
            TEXT.replace('{ name = "time" }', '{ name = "time" }, { name = "position" }'),
            "fields: position: not of an IMU",
        ),
        (TEXT.replace('"none"\nfields', '"t_to_v"\nfields'), 'rotation "t_to_v": an IMU.s frame has no pose'),
    ):
        (tmp_path / "frame.toml").write_text(given)
        with pytest.raises(BadInput, match=words):
            load_frame(str(tmp_path / "frame.toml"))
