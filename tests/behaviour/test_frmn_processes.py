"""Cells and rings between processes: a writer that floods, and one that is killed while it does."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Ring

WORDS = 64
VALUE = np.dtype([("words", "i8", WORDS)])

WRITER = f"""
import sys
import numpy as np
from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Ring

VALUE = np.dtype([("words", "i8", {WORDS})])
kind, descriptor, many = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
if kind == "ring":
    ring = Ring(descriptor, VALUE, 128)
    put = lambda row, n: ring.put(row)
else:
    cell = MailboxBlock(descriptor, {{"cell": VALUE}})["cell"]
    put = lambda row, n: cell.write(row, float(n))
row = np.zeros(1, VALUE)
for n in range(1, many + 1):
    row["words"] = n
    put(row, n)
"""


@contextmanager
def writer(kind: str, descriptor: int, many: int) -> Iterator[subprocess.Popen[bytes]]:
    command = [sys.executable, "-c", WRITER, kind, str(descriptor), str(many)]
    with subprocess.Popen(command, pass_fds=(descriptor,)) as process:
        try:
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize("pause_s", [0.0, 0.002])
def test_reader_of_a_flooded_ring_gets_whole_records_in_order_and_counts_the_rest(pause_s: float) -> None:
    ring = Ring.create(VALUE, 128)
    reader, newest, many = ring.reader(), 0, 300_000
    give_up_s = time.monotonic() + 60.0
    with writer("ring", ring.descriptor, many) as process:
        while reader.got + reader.lost < many:
            assert time.monotonic() < give_up_s
            words = reader.read()["words"]
            assert np.array_equal(words.min(axis=1), words.max(axis=1))
            if len(words):
                assert words[0, 0] > newest
                assert np.all(np.diff(words[:, 0]) == 1)
                newest = int(words[-1, 0])
            time.sleep(pause_s)
        assert process.wait(20.0) == 0
    assert reader.got + reader.lost == ring.written == many
    assert newest == many
    assert reader.got > 0
    ring.close()


def test_reader_of_a_flooded_cell_gets_whole_values_that_never_go_back_also_after_the_writer_is_killed() -> None:
    block = MailboxBlock.create({"cell": VALUE})
    cell, into, before, read = block["cell"], np.zeros(1, VALUE), 0, 0
    give_up_s = time.monotonic() + 60.0
    with writer("cell", block.descriptor, 1_000_000_000) as process:
        while read < 50_000:
            assert time.monotonic() < give_up_s
            number, t_s = cell.read(into)
            if number:
                assert np.all(into["words"] == number)
                assert t_s == number
                assert number >= before
                before, read = number, read + 1
        process.kill()
        process.wait()
        number, t_s = cell.read(into)
        assert np.all(into["words"] == number)
        assert t_s == number >= before
    block.close()
