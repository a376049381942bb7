"""Cells and rings in shared memory, the writer's progress in the middle of a copy made up."""

from __future__ import annotations

import math
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
import pytest

from hil.errors import ProtocolError
from hil.frmn.mailbox import NOTHING, MailboxBlock
from hil.frmn.ring import Ring
from hil.frmn.shared_memory import Slots

VALUE = np.dtype([("a", "f8", 3), ("n", "i8")])
CELLS = {"rails": VALUE, "turntable": np.dtype("f8")}


def value(n: int) -> np.ndarray:
    made = np.zeros(1, VALUE)
    made["a"], made["n"] = n, n
    return made


@pytest.fixture
def block() -> Iterator[MailboxBlock]:
    block = MailboxBlock.create(CELLS)
    yield block
    block.close()


@pytest.fixture
def ring() -> Iterator[Ring]:
    ring = Ring.create(VALUE, 8)
    yield ring
    ring.close()


@pytest.fixture
def during_copies(monkeypatch: pytest.MonkeyPatch) -> Callable[[Callable[[], None]], None]:
    """Give a function that lets something happen in the middle of every copy of a reader."""

    def set_up(happens: Callable[[], None]) -> None:
        def copy(slots: Slots, slot: int, n: int) -> bytes:
            start, end = slot * slots.size, (slot + n) * slots.size
            before = bytes(slots._bytes[start:end])
            happens()
            after = bytes(slots._bytes[start:end])
            # of each record the first half from before and the second from after
            return b"".join(
                before[i : i + slots.size // 2] + after[i + slots.size // 2 : i + slots.size]
                for i in range(0, end - start, slots.size)
            )

        monkeypatch.setattr(Slots, "_copy", copy)

    return set_up


def test_reader_gets_the_newest_value_its_number_and_the_writers_time(block: MailboxBlock) -> None:
    into = value(99)
    assert block["rails"].read(into) == (0, 0.0)
    assert into == value(99)
    for n in range(1, 30):
        block["rails"].write(value(n), n * 0.5)
        assert block["rails"].read(into) == (n, n * 0.5)
        assert into == value(n)


def test_cells_of_a_block_are_apart(block: MailboxBlock) -> None:
    block["rails"].write(value(1), 1.0)
    block["turntable"].write(np.array([7.0]), 2.0)
    turntable, rails = np.zeros(1), value(0)
    assert block["turntable"].read(turntable) == (1, 2.0)
    assert block["rails"].read(rails) == (1, 1.0)
    assert (turntable[0], rails["n"][0]) == (7.0, 1)


def test_record_of_another_size_is_refused(block: MailboxBlock) -> None:
    with pytest.raises(ValueError, match="memoryview assignment"):
        block["rails"].write(np.zeros(1), 0.0)


def test_second_user_of_the_descriptor_sees_what_the_first_writes_and_outlives_it() -> None:
    first = MailboxBlock.create(CELLS)
    second = MailboxBlock(os.dup(first.descriptor), CELLS)
    first["rails"].write(value(5), 1.5)
    first.close()
    first.close()
    into = value(0)
    assert second["rails"].read(into) == (1, 1.5)
    assert into == value(5)
    second.close()


@pytest.mark.parametrize("other", [{"rails": VALUE}, {"turntable": np.dtype("f8"), "rails": VALUE}])
def test_user_with_another_layout_is_refused(block: MailboxBlock, other: dict[str, np.dtype]) -> None:
    descriptor = os.dup(block.descriptor)
    with pytest.raises(ProtocolError, match=r"frmn: shared memory of .*(another layout|expected)"):
        MailboxBlock(descriptor, other)
    os.close(descriptor)


def test_reader_overtaken_by_the_writer_tries_again_and_returns_no_torn_value(
    block: MailboxBlock, during_copies: Callable[[Callable[[], None]], None]
) -> None:
    cell, left = block["rails"], [3]

    def overtake() -> None:
        if left[0]:
            left[0] -= 1
            for _ in range(8):
                n = cell._slots.written + 1
                cell.write(value(n), float(n))

    cell.write(value(1), 1.0)
    during_copies(overtake)
    into = value(0)
    assert cell.read(into) == (25, 25.0)
    assert into == value(25)


def test_reader_of_a_writer_that_only_writes_gives_up_with_an_error(
    block: MailboxBlock, during_copies: Callable[[Callable[[], None]], None]
) -> None:
    cell = block["rails"]
    cell.write(value(1), 1.0)
    during_copies(lambda: [cell.write(value(0), 0.0) for _ in range(8)] and None)
    with pytest.raises(ProtocolError, match=r"frmn\.rails: written faster than it can be read"):
        cell.read(value(0))


def test_mailbox_has_its_writer_and_its_age(block: MailboxBlock) -> None:
    into = value(0)
    assert block["rails"].read_stamped(into) == NOTHING
    assert block["rails"].read_stamped(into).age_s(3.0) == math.inf
    block["rails"].write(value(1), 1.5)
    stamp = block["rails"].read_stamped(into)
    assert stamp == (1, 1.5, os.getpid())
    assert stamp.age_s(3.0) == 1.5


def test_value_corrupted_by_another_process_is_not_returned(block: MailboxBlock) -> None:
    cell = block["rails"]
    cell.write(value(1), 1.0)
    cell._slots._bytes[30] ^= 1
    with pytest.raises(ProtocolError, match=r"frmn\.rails: its checksum is wrong"):
        cell.read(value(0))


def test_second_writer_of_a_cell_is_refused_while_the_first_is_alive(block: MailboxBlock) -> None:
    with subprocess.Popen(["sleep", "60"]) as other:
        block["rails"].write(value(1), 1.0)
        slots = block["rails"]._slots
        slots._bytes[8:12] = other.pid.to_bytes(4, "little")
        with (
            another_user(block) as second,
            pytest.raises(ProtocolError, match=rf"a second writer: process {other.pid} is"),
        ):
            second["rails"].write(value(2), 2.0)
        other.kill()  # and not waited for yet
        time.sleep(0.05)
        with another_user(block) as third:
            third["rails"].write(value(2), 2.0)


@contextmanager
def another_user(block: MailboxBlock) -> Iterator[MailboxBlock]:
    """Give another user of the same memory."""
    other = MailboxBlock(os.dup(block.descriptor), CELLS)
    yield other
    other.close()


def test_writer_killed_in_the_middle_of_a_value_leaves_the_whole_one_before_it(block: MailboxBlock) -> None:
    cell = block["rails"]
    cell.write(value(1), 1.0)
    cell.write(value(2), 2.0)
    slots = cell._slots
    slots._bytes[2 * slots.size : 2 * slots.size + 20] = b"\xff" * 20  # half of the third
    into = value(0)
    assert cell.read(into) == (2, 2.0)
    assert into == value(2)
    cell.write(value(3), 3.0)  # its successor
    assert cell.read(into) == (3, 3.0)
    assert into == value(3)


def test_reader_that_keeps_up_gets_every_record_in_order(ring: Ring) -> None:
    reader = ring.reader()
    taken: list[int] = []
    for n in range(40):
        ring.put(value(n))
        if n % 5 == 0:
            taken += reader.read()["n"].tolist()
    taken += reader.read()["n"].tolist()
    assert taken == list(range(40))
    assert (reader.got, reader.lost) == (40, 0)
    assert len(reader.read()) == 0


def test_what_a_slow_reader_missed_is_counted_and_the_rest_is_in_order(ring: Ring) -> None:
    reader = ring.reader()
    for n in range(30):
        ring.put(value(n))
    assert reader.read(at_most=3)["n"].tolist() == [23, 24, 25]
    assert reader.read()["n"].tolist() == [26, 27, 28, 29]
    assert (reader.got, reader.lost) == (7, 23)


def test_reader_may_begin_with_what_is_yet_to_come(ring: Ring) -> None:
    ring.put(value(0))
    reader = ring.reader(from_now=True)
    ring.put(value(1))
    assert reader.read()["n"].tolist() == [1]
    assert (reader.got, reader.lost) == (1, 0)


@pytest.mark.parametrize("overtaken_by", range(1, 12))
def test_records_overwritten_while_they_are_copied_count_as_lost_and_never_show(
    ring: Ring, during_copies: Callable[[Callable[[], None]], None], overtaken_by: int
) -> None:
    for n in range(7):
        ring.put(value(n))
    left = [overtaken_by]

    def write_on() -> None:
        while left[0]:
            left[0] -= 1
            ring.put(value(ring.written))

    during_copies(write_on)
    reader = ring.reader()
    rows = reader.read()
    assert np.array_equal(rows["a"][:, 0], rows["n"])
    assert rows["n"].tolist() == list(range(overtaken_by, 7))  # one more than is surely spoilt: it may be under the pen
    assert (reader.got, reader.lost) == (len(rows), 7 - len(rows))
    reader.read()
    assert reader.got + reader.lost == ring.written
