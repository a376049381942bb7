"""First contact with a computer: no home, no name of the user, nothing writable, no locks, killed processes."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

import hil
from hil.cli.main import BAD_INPUT
from hil.core import surroundings
from tests.support.fmu import example_fmu

HIL = (sys.executable, "-m", "hil")
PACKAGE = Path(hil.__file__).parent
KERNEL_AND_KEY = """
import numpy as np
from hil.core.kernel_folder import kernel_folder, kernel_folder_notice
from hil.errors import BadInput
from hil.parts.links.authentication import users_key_file
from hil.maths.limits import cut_to_range
cut_to_range(np.zeros(3), np.zeros(3), np.ones(3), np.empty(3))
print(kernel_folder())
print(kernel_folder_notice())
try:
    print(users_key_file())
except BadInput as error:
    print(error)
"""
UNKNOWN = 4242  # a number of no user
AS_UNKNOWN = (
    f"setpriv --reuid {UNKNOWN} --regid {UNKNOWN} --clear-groups "
    "--inh-caps +dac_read_search --ambient-caps +dac_read_search env -u HOME"  # the interpreter may be root's own
)
READ_ONLY = "mount -t tmpfs -o ro tmpfs {} && "
NO_LOCKS = """
#include <errno.h>
int flock(int fd, int operation) { (void)fd; (void)operation; errno = ENOLCK; return -1; }
"""
REMEDY = "set HIL_CACHE_DIR to a folder of your own"


def in_namespace(script: str, command: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``command`` at the end of ``script`` with mounts of its own; skip where this user may not have any."""
    if shutil.which("unshare") is None or subprocess.run(["unshare", "-m", "true"], check=False).returncode:
        pytest.skip("this user cannot mount file systems")
    if any(path.is_relative_to("/tmp") for path in (PACKAGE, Path(sys.executable))) and " /tmp" in script:
        pytest.skip("the program lies in /tmp, which a mount would hide")
    whole = ["unshare", "-m", "bash", "-c", f'{script} "$@"', "_", *command]
    return run(whole, **environment)


def run(command: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``command`` without a folder for the kernels, unless ``environment`` has one."""
    base = {key: value for key, value in os.environ.items() if key not in ("HIL_CACHE_DIR", "TMPDIR")}
    whole = base | {"PYTHONPATH": str(PACKAGE.parent)} | environment
    return subprocess.run(command, capture_output=True, text=True, env=whole, timeout=280, check=False)


def lines_of(done: subprocess.CompletedProcess[str]) -> list[str]:
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout.splitlines()


def kernel_and_key(script: str, **environment: str) -> list[str]:
    """Return folder of the kernels, notice, and file or refusal of the key, with a memory of its own in /tmp."""
    code = [sys.executable, "-c", KERNEL_AND_KEY]
    return lines_of(in_namespace(f"mount -t tmpfs tmpfs /tmp && {script}", code, **environment))


@pytest.mark.parametrize(
    ("script", "environment", "reason"),
    [
        (AS_UNKNOWN, {}, "this user has no home"),
        ("", {"HOME": "/etc/passwd"}, "/etc/passwd/.cache/hil: cannot be written (Not a directory)"),
        (READ_ONLY.format("/mnt"), {"HOME": "/mnt"}, "/mnt/.cache/hil: cannot be written (Read-only file system)"),
        (
            "mount -t tmpfs -o size=64k tmpfs /mnt && ",
            {"XDG_CACHE_HOME": "/mnt", "XDG_CONFIG_HOME": "/proc/none"},
            "/mnt/hil: has 0 MiB of free space, 32 are needed",
        ),
    ],
    ids=["unknown user without home", "home is a file", "read-only home", "full cache folder"],
)
def test_kernels_and_key_are_in_a_private_folder_if_the_home_is_full(
    script: str, environment: dict[str, str], reason: str
) -> None:
    removed = dict.fromkeys(("XDG_CACHE_HOME", "XDG_CONFIG_HOME"), "") | environment
    folder, notice, key = kernel_and_key(script, **removed)
    user = UNKNOWN if script == AS_UNKNOWN else os.getuid()
    assert folder == f"/tmp/hil-{user}/kernels"
    assert notice == f"kernel cache: {reason}: kernels are kept in {folder}; {REMEDY}"
    assert key == f"/tmp/hil-{user}/gnc-link.key"


def test_kernels_stay_in_memory_if_nothing_can_be_written() -> None:
    script = "".join(READ_ONLY.format(folder) for folder in ("/tmp", "/var/tmp", "/dev/shm")) + AS_UNKNOWN
    folder, notice, key = kernel_and_key(script)
    assert folder == "None"
    assert "kept in memory, and compiled again at each start" in notice
    assert key.startswith("gnc-link.key: the key of the link cannot be made: no folder for the files of this user")
    done = in_namespace(script, [*HIL, "warm-up"])
    assert (done.returncode, len(done.stderr.splitlines())) == (BAD_INPUT, 1)
    assert done.stderr.startswith("warm-up: kernel cache: this user has no home: kernels are kept in memory")


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this computer")
def test_kernels_are_compiled_and_kept_on_a_file_system_without_locks(tmp_path: Path) -> None:
    source, library = tmp_path / "no_locks.c", tmp_path / "no_locks.so"
    source.write_text(NO_LOCKS)
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(library), str(source)], check=True)
    code = """
import hil.core.kernel_folder as folder
held = folder.lock_kernel_file("a/b")
print(folder.lock(held.fileno()))
folder.write_kernel_file("a/b", b"code")
print(folder.read_kernel_file("a/b"))
"""
    preload = {"LD_PRELOAD": str(library), "HIL_CACHE_DIR": str(tmp_path)}
    assert lines_of(run([sys.executable, "-c", code], **preload)) == ["False", "b'code'"]
    assert os.listdir(tmp_path / "kernels" / "a") == ["b"]


@pytest.mark.parametrize("name", ["nowhere/at/all", "file"])
def test_odd_folder_for_temporary_files_is_not_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("TMPDIR", str(tmp_path / name))
    with surroundings.temporary_folder("test") as folder, surroundings.unnamed_file():
        assert Path(folder).parent == Path("/tmp")
        assert os.stat(folder).st_mode & 0o777 == 0o700


def test_matplotlib_uses_a_private_folder_only_if_the_user_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    for home, folder in (("/etc/passwd", str(tmp_path / f"hil-{os.geteuid()}" / "matplotlib")), (str(tmp_path), None)):
        monkeypatch.setenv("XDG_CONFIG_HOME", home)
        monkeypatch.setenv("MPLCONFIGDIR", "")
        monkeypatch.delenv("MPLCONFIGDIR")
        surroundings.settle_matplotlib()
        assert os.environ.get("MPLCONFIGDIR") == folder


def test_folder_in_which_others_could_exchange_files_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    tmp_path.chmod(0o777)
    assert tmp_path not in surroundings._places()
    tmp_path.chmod(0o1777)
    assert next(surroundings._places()) == tmp_path


@pytest.mark.parametrize("kind", ["link", "others may write", "another user"])
def test_private_folder_that_others_have_prepared_is_not_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    monkeypatch.setattr(surroundings, "_PLACES", ())
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    private = tmp_path / f"hil-{os.geteuid()}"
    assert list(surroundings.user_folders("cache", create=True))[-1] == private
    if kind == "others may write":
        private.chmod(0o770)
    elif os.geteuid() != 0:
        pytest.skip("only root can give a folder away")
    else:
        private.rmdir()
        target = tmp_path / "own"
        target.mkdir()
        private.symlink_to(target) if kind == "link" else private.mkdir()
        os.chown(private, UNKNOWN, UNKNOWN, follow_symlinks=False)
    assert private not in list(surroundings.user_folders("cache", create=True))


def test_folders_of_ended_processes_are_removed_and_those_of_others_are_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(surroundings, "_PLACES", ())
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    process, start, namespace = surroundings._this_process()
    parent = surroundings._start_of(os.getppid())
    kept = [f"hil-{os.getppid()}-{parent}-{namespace}-fmu-a", f"hil-{process}-{start}-00000000-fmu-b", "hil-1", "other"]
    ended = [
        f"hil-{os.getppid()}-{int(parent) - 1}-{namespace}-fmu-c",  # its number was given to another process
        f"hil-4194305-1-{namespace}-fmu-d",  # above all numbers
        f"hil-{process}-{start}-00000001-fmu-e",  # of another boot, long ago
        f"hil-{process}-{start}-{namespace}-fmu-f",
    ]
    for name in (*kept, *ended):
        (tmp_path / name / "inner").mkdir(parents=True)
    os.utime(tmp_path / ended[2], (0.0, time.time() - 11 * 86_400.0))
    with surroundings.temporary_folder("test"):
        assert ended[3] in os.listdir(tmp_path)  # of this process, which may need it
    surroundings.remove_temporary_folders()
    assert sorted(os.listdir(tmp_path)) == sorted(kept)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler on this computer")
@pytest.mark.parametrize("process", ["false", "true"])
def test_nothing_remains_of_a_run_with_an_fmu_and_of_a_killed_one_nothing_after_the_next_start(
    tmp_path: Path, process: str
) -> None:
    source, temporary = tmp_path / "fmu", tmp_path / "temporary"
    source.mkdir()
    temporary.mkdir()
    settings = ["--set", f"gnc.fmu={example_fmu(source)}", "--set", f"gnc.fmu_process={process}"]
    command = [*HIL, "run", "scheme-1", *settings]
    environment = os.environ | {"TMPDIR": str(temporary)}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    subprocess.run([*command, "--duration", "0.4"], env=environment, check=False, **quiet)
    assert os.listdir(temporary) == []
    with subprocess.Popen(command, env=environment, start_new_session=True, **quiet) as killed:
        end_s = time.monotonic() + 200.0
        while not os.listdir(temporary):
            assert time.monotonic() < end_s
            assert killed.poll() is None
            time.sleep(0.05)
        os.killpg(killed.pid, signal.SIGKILL)
    assert os.listdir(temporary) != []
    subprocess.run([*HIL, "list", "scenarios"], env=environment, check=True, **quiet)
    assert os.listdir(temporary) == []
