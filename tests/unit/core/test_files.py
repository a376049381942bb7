"""Files that the program writes: complete or not at all, and never through a link that another has planted."""

from __future__ import annotations

import errno
from pathlib import Path

import pytest

from hil.core.files import replaced, write_text
from hil.core.surroundings import host_limit
from hil.errors import BadInput


def test_planted_link_is_replaced_and_its_target_stays(tmp_path: Path) -> None:
    target, out = tmp_path / "target", tmp_path / "out.json"
    target.write_text("kept")
    for planted in (out, tmp_path / "out.json.part"):
        planted.symlink_to(target)
    write_text("{}", out)
    assert (out.read_text(), out.is_symlink(), target.read_text()) == ("{}", False, "kept")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["out.json", "target"]


def test_failed_writer_leaves_what_was_there(tmp_path: Path) -> None:
    out = tmp_path / "table"
    out.write_text("before")

    def fail() -> None:
        with replaced(out) as partial:
            partial.write_text("half")
            raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        fail()
    assert out.read_text() == "before"
    assert list(tmp_path.iterdir()) == [out]
    with pytest.raises(BadInput, match="missing/file: cannot be written: No such file or directory"):
        write_text("", tmp_path / "missing" / "file")


def test_device_is_written_itself() -> None:
    write_text("text", "/dev/null")
    assert not Path("/dev/null").is_file()


@pytest.mark.parametrize(
    ("error", "word"),
    [
        (OSError(errno.EMFILE, "Too many open files"), "ulimit -n"),
        (RuntimeError("can't start new thread"), "ulimit -u"),
        (MemoryError(), "ulimit -v"),
        (ImportError("x.so: failed to map segment from shared object"), "ulimit -v"),
        (OSError(errno.ENETUNREACH, "Network is unreachable"), "ip link set lo up"),
        (OSError(errno.EACCES, "Permission denied"), ""),
    ],
)
def test_limit_of_the_host_is_one_line_with_its_remedy(error: Exception, word: str) -> None:
    wrapped = ValueError("outer")
    wrapped.__cause__ = error
    assert word in host_limit(wrapped)
    assert bool(host_limit(wrapped)) is bool(word)
