"""The recorder takes everything out of its rings before it ends, and counts what it came too late for."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hil.core.messages import CYCLE
from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Ring
from hil.recording.header import file_digests
from hil.recording.read import contents
from hil.recording.recorder import STATE_MAILBOX, Recorder, record_until_ended
from hil.recording.writer import RecordingHeader, RunFile


@contextmanager
def recorder_of(path: Path, slots: int, rows: int) -> Iterator[tuple[RunFile, Recorder]]:
    """Give a recorder whose ring of ``slots`` has seen ``rows`` cycles, of which it has fetched none yet."""
    ring = Ring.create(CYCLE, slots, "cycles")
    file = RunFile(path, RecordingHeader({"schema_version": "1"}, {}, 0))
    block = MailboxBlock.create(STATE_MAILBOX, "recorder")
    recorder = Recorder(file, {"cycles": ring}, block["state"])
    row = np.zeros(1, CYCLE)
    for k in range(rows):
        row["t_s"] = 0.001 * k
        ring.put(row)
    yield file, recorder
    ring.close()
    block.close()


class _Parent:
    """A parent that sends one message, or ends without one."""

    def __init__(self, message: dict[str, object] | None) -> None:
        self._message = message

    def receive(self, timeout_s: float) -> dict[str, object]:
        if self._message is None:
            raise EOFError
        return self._message


@pytest.mark.parametrize("told", [None, {"end": {"stop": "completed"}, "summary": "{}"}])
def test_all_that_waits_in_the_ring_is_written_before_the_end(tmp_path: Path, told: dict[str, object] | None) -> None:
    path = tmp_path / "run.mcap"
    with recorder_of(path, 2048, 1500) as (file, recorder):
        assert record_until_ended(recorder, _Parent(told)) == told  # type: ignore[arg-type]
        account = file.finish({})
    assert (account.cycles, account.dropped) == (1500, 0)
    np.testing.assert_array_equal(contents(path).flat("/cycle")["t_s"], 0.001 * np.arange(1500))


def test_what_was_overwritten_before_it_was_fetched_is_counted(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    with recorder_of(path, 100, 250) as (file, recorder):
        recorder.drain()
        account = file.finish({})
    assert account.cycles == 99
    assert account.dropped == 151
    assert "151 messages arrived too fast" in account.problem
    end = contents(path).end
    assert end is not None
    assert end["dropped"] == "151"


def test_files_that_the_configuration_names_are_recorded_with_their_digest(tmp_path: Path) -> None:
    (tmp_path / "lamps.json").write_bytes(b"{}")
    table = {"rig": {"vmu": {"geometry_file": str(tmp_path / "lamps.json"), "rate_hz": 25.0}, "eds_file": "/none.eds"}}
    assert file_digests(table) == {
        "calibration_rig.vmu.geometry_file": "lamps.json sha256:"
        "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a",
        "calibration_rig.eds_file": "none.eds missing",
    }
