"""Reads of a slot during continuous writing by another process: none may be torn.

The reader is compiled, for a high number of reads; it follows the protocol of hil/frmn/shared_memory.py. The writer is
the product's.
"""

from __future__ import annotations

import ctypes
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.frmn.shared_memory import Memory, Slots

WORDS = 40  # 320 bytes: five cache lines, more than any processor writes at once
SIZE = 8 * WORDS

READER = """
#include <stdint.h>
#include <string.h>

enum { WORDS = 40 }; /* as below */

/* Returns how many of `many` copies are torn: words that are not alike. found: [0] spoilt, and known as such by the
   second look at the count; [1] torn and not known; [2] copies that found another value than the one before. */
void read_many(const volatile uint8_t *content, int64_t slots, int64_t many, int64_t look_again, int64_t *found)
{
    const volatile int64_t *count = (const volatile int64_t *)content;
    int64_t copy[WORDS], before = -1;
    for (int64_t done = 0; done < many;) {
        int64_t number = *count - 1;
        if (number < 0)
            continue;
        memcpy(copy, (const uint8_t *)content + 64 + number % slots * sizeof copy, sizeof copy);
        __asm__ volatile("" ::: "memory"); /* x86-64 loads in order; the compiler must as well */
        done++;
        if (look_again && *count - slots + 1 > number) {
            found[0]++;
            continue;
        }
        int torn = 0;
        for (int i = 1; i < WORDS; i++)
            torn |= copy[i] != copy[0];
        found[1] += torn;
        found[2] += copy[0] != before;
        before = copy[0];
    }
}
"""

WRITER = f"""
import itertools, sys
from hil.frmn.shared_memory import Memory, Slots
slots = int(sys.argv[2])
memory = Memory(int(sys.argv[1]), "torn", "words", Slots.memory_size({SIZE}, slots))
cells = Slots(memory.content, {SIZE}, slots)
values = [n.to_bytes(8, "little") * {WORDS} for n in range(1, 1000)]
for value in itertools.cycle(values):
    cells.put(value)
"""


@pytest.fixture(scope="module")
def reader(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """Return the compiled reader."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler on this computer")
    folder = tmp_path_factory.mktemp("reader")
    (folder / "reader.c").write_text(READER)
    subprocess.run([compiler, "-O2", "-shared", "-fPIC", "-o", folder / "reader.so", folder / "reader.c"], check=True)
    return ctypes.CDLL(str(Path(folder / "reader.so")))


def read_beside_a_busy_writer(reader: ctypes.CDLL, slots: int, many: int, look_again: bool) -> tuple[int, int, int]:
    """Return how many of ``many`` copies were spoilt and known to be, torn and not known, new."""
    room = Slots.memory_size(SIZE, slots)
    memory = Memory(Memory.create("torn", "words", room), "torn", "words", room)
    found = np.zeros(3, np.int64)
    content = np.frombuffer(memory.content, np.uint8)
    command = [sys.executable, "-c", WRITER, str(memory.descriptor), str(slots)]
    with subprocess.Popen(command, pass_fds=(memory.descriptor,), env=os.environ) as writer:
        reader.read_many(
            ctypes.c_void_p(content.ctypes.data),
            ctypes.c_int64(slots),
            ctypes.c_int64(many),
            ctypes.c_int64(int(look_again)),
            ctypes.c_void_p(found.ctypes.data),
        )
        writer.kill()
    del content
    memory.close()
    return int(found[0]), int(found[1]), int(found[2])


@pytest.mark.parametrize("slots", [2, 8])
def test_no_read_is_torn(reader: ctypes.CDLL, slots: int) -> None:
    _, torn, fresh = read_beside_a_busy_writer(reader, slots, 5_000_000, look_again=True)
    assert torn == 0
    assert fresh > 0


@pytest.mark.slow
@pytest.mark.parametrize("slots", [2, 8])
def test_of_a_hundred_million_reads_none_is_torn(reader: ctypes.CDLL, slots: int) -> None:
    known, torn, fresh = read_beside_a_busy_writer(reader, slots, 100_000_000, look_again=True)
    print(f"{slots} slots: {known} spoilt and known to be, {torn} torn, {fresh} new values")  # noqa: T201
    assert torn == 0
    assert fresh > 1000


@pytest.mark.slow
def test_without_the_second_look_reads_are_torn(reader: ctypes.CDLL) -> None:
    """The test can fail: with one slot, which is always under the pen, and no second look."""
    _, torn, _ = read_beside_a_busy_writer(reader, 1, 20_000_000, look_again=False)
    print(f"{torn} torn")  # noqa: T201
    assert torn > 0
