"""Authentication of the link between bench and GNC: a key that both sides have, and a tag behind each datagram.

    offset  type  field
         0        datagram  see ``hil.frmn.wire``
       end  16s   tag       first 16 bytes of HMAC-SHA256(key, receiver + datagram)

receiver: u4, little-endian, the writer number of the side to which the datagram is sent, from the header of any
datagram of it; 0 in HELLO, in REFUSED and in the mailbox gnc.setup, which begin the exchange. A recorded exchange
cannot be repeated: a side has another number at each start, and nothing starts before its setup is answered.
"""

from __future__ import annotations

import hmac
import os
import secrets
import struct
from contextlib import suppress
from pathlib import Path
from typing import Final

from hil.core.files import KIB, read_private_text
from hil.core.surroundings import user_folders
from hil.errors import BadInput
from hil.frmn import wire
from hil.frmn.mailboxes import MAILBOXES
from hil.frmn.wire import DatagramKind
from hil.parts.links.udp import Address, UdpSocket

TAG_BYTES: Final = 16
_KEY_FILE: Final = "gnc-link.key"
_KEY_BYTES: Final = 32
_KEY_FILE_BYTES: Final = 4 * KIB
_SHORTEST_KEY: Final = 16
_KIND: Final = struct.Struct("<9xBH")  # of the header: kind, and number of the mailbox
_WRITER: Final = struct.Struct("<16xI")
_RECEIVER: Final = struct.Struct("<I")
_BEGINS: Final = (DatagramKind.HELLO, DatagramKind.REFUSED)
_SETUP: Final = MAILBOXES["gnc.setup"].number


def tag_of(key: bytes, datagram: bytes, receiver: int) -> bytes:
    """Return the tag of ``datagram`` for the side whose writer number is ``receiver``."""
    kind, cell = _KIND.unpack_from(datagram)
    begins = kind in _BEGINS or (kind == DatagramKind.CELL and cell == _SETUP)
    return hmac.digest(key, _RECEIVER.pack(0 if begins else receiver) + datagram, "sha256")[:TAG_BYTES]


def link_key(path: str | None = None) -> bytes:
    """Return the key in the file at ``path``, by default the user's own, which is made if there is none.

    Raises BadInput for a file that others can read, or that is too short.
    """
    file = users_key_file() if path is None else Path(path)
    text = read_private_text(file, _KEY_FILE_BYTES).strip()
    if len(text) < _SHORTEST_KEY:
        text = f"{len(text)} characters, at least {_SHORTEST_KEY}: openssl rand -hex 32 > {file}"
        raise BadInput.single(str(file), "", text)
    return text.encode()


def users_key_file() -> Path:
    """Return the file of the user's key, which is made in the first folder that can be written if there is none."""
    for folder in user_folders("config"):
        if os.path.exists(folder / _KEY_FILE):
            return folder / _KEY_FILE
    reason = "no folder for the files of this user"
    for folder in user_folders("config", create=True):
        try:
            _make(folder / _KEY_FILE)
            return folder / _KEY_FILE
        except OSError as error:
            reason = f"{folder}: {error.strerror or error}"
    raise BadInput.single(_KEY_FILE, "", f"the key of the link cannot be made: {reason}: give --key-file")


def _make(file: Path) -> None:
    """Make the user's key, complete or not at all, unless there is one. Raises OSError."""
    partial = file.with_name(f"{file.name}.{os.getpid()}.part")
    file.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
    descriptor = os.open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    try:
        with os.fdopen(descriptor, "w", encoding="ascii") as out:
            out.write(f"{secrets.token_hex(_KEY_BYTES)}\n")
        with suppress(FileExistsError):  # another process was faster: its key counts
            os.link(partial, file)
    finally:
        partial.unlink()


class AuthenticatedSocket:
    """UDP socket of the side ``writer`` that appends tags, and takes datagrams with a valid one only."""

    def __init__(self, bind: Address, option: str, key: bytes, writer: int) -> None:
        self.socket = UdpSocket(bind, option)
        self._key = key
        self._writer = writer
        self._writers: dict[Address, int] = {}

    def receive(self, from_peer: bool) -> tuple[bytes | None, Address, float] | None:
        """Return the next datagram, None in its place without a valid tag; sender and time; None without any."""
        received = self.socket.receive(from_peer)
        if received is None:
            return None
        sealed, sender, received_s = received
        if len(sealed) > wire.HEADER.size and sealed[:4] == wire.MAGIC and sealed[wire.VERSION_AT] != wire.VERSION:
            return sealed, sender, received_s  # answered by the reason, and not used
        datagram, tag = sealed[:-TAG_BYTES], sealed[-TAG_BYTES:]
        if len(datagram) < wire.HEADER.size or not hmac.compare_digest(tag, tag_of(self._key, datagram, self._writer)):
            return None, sender, received_s
        self._writers[sender] = _WRITER.unpack_from(datagram)[0]
        return datagram, sender, received_s

    def send(self, datagram: bytes, to: Address) -> bool:
        """Send ``datagram``; return whether the kernel accepted it. Never waits, never raises."""
        return self.socket.send(datagram + tag_of(self._key, datagram, self._writers.get(to, 0)), to)
