"""What the program takes from its surroundings: folders of the user, temporary folders and files, locks.

    what              where                                               if it fails
    kernels, keys     XDG_CACHE_HOME, XDG_CONFIG_HOME, else of the home   hil-UID in a folder for temporary files
    temporary files   TMPDIR                                              /tmp, /var/tmp, /dev/shm
    locks             the file that is locked                             the caller continues without, or refuses

A temporary folder is named by its process and the start of that, so that a later process of the same number is not
taken for it. It is removed after its use, at the latest by ``leave_process``; the next start removes those of killed
processes. A user may have neither a home nor a name. No folder is used that another user could exchange.
"""

from __future__ import annotations

import errno
import fcntl
import os
import pwd
import re
import resource
import shutil
import stat
import time
import zlib
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory, TemporaryFile
from typing import IO, Any, Final, Literal, NoReturn, cast

from hil.errors import BadInput

_SHARED: Final = ("/run/lock", "/tmp")  # folders for locks of all users: the first that can be written
_ATTEMPTS: Final = 3
_END: Final = os._exit
_PLACES: Final = ("/tmp", "/var/tmp", "/dev/shm")
_NAME: Final = re.compile(r"hil-(\d+)-(\d+)-([0-9a-f]{8})-.*")
_KEPT_S: Final = 10 * 86_400.0  # a folder of another boot or container, whose processes cannot be seen
_NO_MEMORY: Final = re.compile("failed to map segment|[Cc]annot allocate memory|Unable to allocate")
_NO_LOCKS: Final = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL)

GARBAGE_THRESHOLD: Final = 50_000
"""Objects between two searches for garbage: what is imported and compiled stays, and searches are in vain."""


def users_own_folder(kind: Literal["cache", "config"]) -> Path | None:
    """Return the folder for files of this user that stay, which need not exist; None if the user has no home."""
    given, home = Path(os.environ.get(f"XDG_{kind.upper()}_HOME", "")), Path(os.path.expanduser("~"))
    folder = (given if given.is_absolute() else home / f".{kind}") / "hil"
    return folder if folder.is_absolute() else None


def user_folders(kind: Literal["cache", "config"], create: bool = False) -> Iterator[Path]:
    """Yield the user's own folder, then the private ones that replace it: those that exist, or that can be created."""
    if (own := users_own_folder(kind)) is not None:
        yield own
    for folder in _places():
        private = folder / f"hil-{os.geteuid()}"
        with suppress(OSError):
            if create:
                private.mkdir(mode=0o700, exist_ok=True)
            if not why_unsafe(os.lstat(private)) and private.is_dir():
                yield private


def settle_matplotlib() -> None:
    """Let matplotlib use a private folder if it cannot write the user's: it would make one in /tmp for each run."""
    for folder in user_folders("config", create=True):
        existing = next(each for each in (folder, *folder.parents) if os.path.exists(each))
        if existing.is_dir() and os.access(existing, os.W_OK):
            if folder != users_own_folder("config"):
                os.environ.setdefault("MPLCONFIGDIR", str(folder / "matplotlib"))
            return


def why_unsafe(status: os.stat_result) -> str:
    """Return how another user than this one and root could change a file or folder, "" if none can."""
    if status.st_uid not in (os.geteuid(), 0):
        return f"belongs to another user (uid {status.st_uid})"
    if status.st_mode & (stat.S_IWGRP | stat.S_IWOTH) and not stat.S_ISLNK(status.st_mode):
        return f"can be written by other users (mode {stat.S_IMODE(status.st_mode):o})"
    return ""


def host_limit(error: BaseException | None) -> str:
    """Return which limit of this host ``error`` or its cause met, and what to do; "" for any other error."""
    while error is not None:
        number, text = getattr(error, "errno", None), str(error)
        if number in (errno.EMFILE, errno.ENFILE):
            most = resource.getrlimit(resource.RLIMIT_NOFILE)[0]
            return f"host: this process may open {most} files: raise the limit, ulimit -n 1024"
        if isinstance(error, FileNotFoundError) and error.filename is None:
            return "host: the working directory has been removed: change to another one"
        if "can't start new thread" in text or number == errno.EAGAIN:
            return "host: no further thread or process can be started: raise the limits, ulimit -u and -v"
        if isinstance(error, MemoryError) or number == errno.ENOMEM or _NO_MEMORY.search(text):
            return "host: this process may use no more memory: raise the limit, ulimit -v, or close other programs"
        if number in (errno.EADDRNOTAVAIL, errno.ENETUNREACH, errno.ENETDOWN):
            return f"host: has no such network address or route ({os.strerror(number)}): ip link set lo up, for its own"
        error = error.__cause__ or error.__context__
    return ""


def temporary_folder(what: str, executable: bool = False, in_memory: bool = False) -> TemporaryDirectory[str]:
    """Return a new folder that only this user can enter; it is removed at the end of ``with``, or by ``cleanup``.

    executable: libraries in it are loaded. in_memory: on no disk, if possible. Raises BadInput.
    """
    folders = list(_places())
    reason = "no folder"
    for folder in reversed(folders) if in_memory else folders:
        try:
            if executable and os.statvfs(folder).f_flag & os.ST_NOEXEC:
                reason = "mounted without execution"
                continue
            return temporary_folder_in(folder, what)
        except OSError as error:
            reason = error.strerror or str(error)
    text = f"{', '.join(map(str, folders)) or 'none'}: cannot be used ({reason}): set TMPDIR to a folder of your own"
    raise BadInput.single("temporary files", "", text)


def temporary_folder_in(folder: Path, what: str) -> TemporaryDirectory[str]:
    """Return a temporary folder in ``folder``, after those there that killed processes left. Raises OSError."""
    _remove(folder, own=False)
    name = f"hil-{'-'.join(_this_process())}-{what}-"
    return TemporaryDirectory(prefix=name, dir=folder, ignore_cleanup_errors=True)


@cache
def prepare_worker_processes() -> None:
    """Let multiprocessing make its sockets in a temporary folder of this process. Raises BadInput if it cannot work."""
    from multiprocessing import Lock, current_process  # slow imports
    from multiprocessing.util import Finalize

    try:
        Lock()
    except (OSError, ImportError) as error:
        text = f"need semaphores in /dev/shm ({getattr(error, 'strerror', '') or error}): give --workers 1"
        raise BadInput.single("worker processes", "", text) from error
    settings = cast(Any, current_process())._config
    if settings.get("tempdir") is None:
        folder = temporary_folder("workers")
        Finalize(None, folder.cleanup, exitpriority=-101)  # after multiprocessing's own
        settings["tempdir"] = folder.name


def unnamed_file() -> IO[bytes]:
    """Return a temporary file without a name, in memory if no folder for such files can be written."""
    for folder in _places():
        with suppress(OSError):
            return TemporaryFile(dir=folder)
    return os.fdopen(os.memfd_create("hil"), "w+b")


def lock(descriptor: int, wait: bool = False) -> bool:
    """Lock an open file until it is closed; return False if its file system has no locks.

    Raises BlockingIOError if another process has the lock, unless it is to ``wait``.
    """
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
    except OSError as error:
        if error.errno in _NO_LOCKS:
            return False
        raise
    return True


def shared_lock(group: str, name: str) -> tuple[int, bool]:
    """Return the descriptor of a lock that all users share, and whether this process has it, until it is closed.

    group: folder of the file. Raises OSError with the name of the file or folder.
    """
    for base in _SHARED:
        if (folder := _shared_folder(Path(base) / group)) is None:
            continue
        descriptor = _opened(folder / name)
        try:
            if lock(descriptor):
                return descriptor, True
        except BlockingIOError:
            return descriptor, False
        os.close(descriptor)
    raise OSError(errno.ENOLCK, "no such folder can be written and has locks", ", ".join(_SHARED))


def _shared_folder(folder: Path) -> Path | None:
    """Return ``folder``, in which every user can make files; None if this one cannot."""
    try:
        folder.mkdir(exist_ok=True)
        if folder.stat().st_uid == os.getuid():
            folder.chmod(0o1777)
    except OSError:
        return None
    return folder if os.access(folder, os.W_OK) else None


def _opened(path: Path) -> int:
    """Return the descriptor of the lock file. All users may lock it, of whatever owner and umask it is."""
    flags = os.O_NOFOLLOW | os.O_CLOEXEC
    for _ in range(_ATTEMPTS):
        with suppress(FileExistsError):  # made by another process since
            if not path.exists():
                descriptor = os.open(path, flags | os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o666)
                os.fchmod(descriptor, 0o666)
                return descriptor
        with suppress(FileNotFoundError):
            try:
                return os.open(path, flags | os.O_RDWR)  # without O_CREAT: sticky folders reject that for other users
            except PermissionError:
                return os.open(path, flags | os.O_RDONLY)  # suffices for a lock
    raise FileNotFoundError(errno.ENOENT, "is made and removed all the time", str(path))


def remove_temporary_folders() -> None:
    """Remove the temporary folders of this process, and of processes that were killed."""
    for folder in _places():
        _remove(folder, own=True)


def leave_process(code: int) -> NoReturn:
    """End this process without the interpreter's own end, which takes longer than stopping the bench."""
    try:
        remove_temporary_folders()
    finally:
        _END(code)


def _places() -> Iterator[Path]:
    """Yield the folders for temporary files in which no user can exchange files of another."""
    for name in dict.fromkeys((os.environ.get("TMPDIR") or "/tmp", *_PLACES)):
        with suppress(OSError, ValueError):
            mode = os.stat(name).st_mode
            if stat.S_ISDIR(mode) and (mode & stat.S_ISVTX or not mode & (stat.S_IWGRP | stat.S_IWOTH)):
                yield Path(name).absolute()


def _this_process() -> tuple[str, str, str]:
    return str(os.getpid()), _start_of(os.getpid()) or "0", _namespace()


def _start_of(process: int | str) -> str:
    """Return when a process was started, in ticks since the boot; "" if there is no such process."""
    try:
        state, *fields = Path(f"/proc/{process}/stat").read_bytes().rpartition(b")")[2].split()
    except OSError:
        return ""
    return "" if state in b"ZX" else fields[18].decode()  # field 22 of proc(5)


@cache
def _namespace() -> str:
    """Return a text for this boot and this namespace of processes, in which numbers and starts of processes count."""
    try:
        boot, processes = Path("/proc/sys/kernel/random/boot_id").read_text(), os.stat("/proc/self/ns/pid").st_ino
    except OSError:
        return "0" * 8
    return f"{zlib.crc32(f'{boot} {processes}'.encode()):08x}"


def _remove(within: Path, own: bool) -> None:
    """Remove the folders of processes that have ended and, if ``own``, of this one."""
    with suppress(OSError), os.scandir(within) as entries:
        for entry in entries:
            if (name := _NAME.fullmatch(entry.name)) and _is_left(name.groups(), entry, own):
                shutil.rmtree(entry.path, ignore_errors=True)


def _is_left(process: tuple[str | None, ...], entry: os.DirEntry[str], own: bool) -> bool:
    status = entry.stat(follow_symlinks=False)
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != os.geteuid():
        return False
    if process == _this_process():
        return own
    number, start, namespace = process
    if namespace != _namespace():
        return status.st_mtime < time.time() - _KEPT_S
    return _start_of("self") != "" and _start_of(str(number)) != start  # "": no /proc here


def local_user() -> str:
    """Return the name of the account from the operating system, not from the environment."""
    try:
        return pwd.getpwuid(os.getuid()).pw_name
    except KeyError:
        return f"user {os.getuid()}"
