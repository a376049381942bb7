"""A flight computer at the wires of an emulated rig: its words open thrusters, its silence stops the bench."""

from __future__ import annotations

import os
import threading
import tty

import numpy as np
import pytest

from hil.drivers.vmu.codecs import frame_codec
from hil.drivers.vmu.frame_codec import FrameDecoder
from hil.parts.links.command_word_codec import Word, encode
from hil.session import build
from tests.support.run_settings import UNHURRIED, make_job

pytestmark = pytest.mark.wires

_THRUSTERS = 0b10_0010  # numbers 2 and 6: against x


@pytest.mark.slow
def test_words_over_a_serial_port_fly_the_bench_and_their_end_stops_it() -> None:
    (words, words_port), (poses, poses_port) = _pty(), _pty()
    settings = (
        *UNHURRIED,
        "rig.flight_computer.command_words=serial",
        "rig.flight_computer.timeout_s=0.3",  # on a computer that is busy
        "rig.flight_computer.lost_s=1.0",
        f"rig.flight_computer.serial.port={words_port}",
        f"rig.flight_computer.poses.port={poses_port}",
    )
    job = make_job(20.0, settings, rig="emulated")
    build.check(job)
    heard, decoder, silent = [], FrameDecoder(frame_codec()), threading.Event()

    def compute() -> None:
        counter = 0
        while len(heard) < 20 and not silent.wait(0.02):  # 3 s of poses
            counter += 1
            os.write(words, encode(Word(counter & 0xFF, _THRUSTERS)))
            try:
                heard.extend(decoder.feed(os.read(poses, 4096), 0.0))
            except BlockingIOError:
                continue

    thread = threading.Thread(target=compute, daemon=True)
    thread.start()
    with build.runner(job) as runner:
        outcome = runner.run()
    silent.set()
    thread.join()
    assert outcome.stop.startswith("flight computer: no command word for 1.0")
    fired = outcome.history["command"]["on"].astype(bool)
    flying = np.flatnonzero(fired.any(axis=1))
    assert {tuple(row) for row in np.nonzero(fired[flying][:, :16])[1].reshape(-1, 2).tolist()} == {(1, 5)}
    assert not fired[flying[-1] + 1 :].any()
    assert outcome.history["truth"]["v_CT_H"][-1, 0] < -0.01
    first = heard[0].t_s
    np.testing.assert_allclose([frame.t_s - first for frame in heard], np.arange(20) * 0.16, atol=1e-3)


def _pty() -> tuple[int, str]:
    here, there = os.openpty()
    tty.setraw(there)
    os.set_blocking(here, False)
    return here, os.ttyname(there)
