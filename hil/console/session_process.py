"""The console's hold on a session's process: starts it, sends orders, keeps what it says, reads its shared memory."""

from __future__ import annotations

import asyncio
import itertools
import json
import signal
import socket
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hil.console.bench import RINGS
from hil.console.session import Choice
from hil.console.status import CELLS, empty_status
from hil.core.child_process import ChildProcess
from hil.core.messages import CYCLE
from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Reader, Ring
from hil.monitor.results import PORTION
from hil.recording import recorder

_PACKET: Final = 1 << 18
_SHARED_AT_MOST: Final = 8
_DTYPES: Final = {"telemetry": CYCLE, **RINGS}
_ANSWER_WALL_S: Final = 2.0
_STOP_WALL_S: Final = 5.0  # for a bench to be stopped and its processes ended


class SessionProcess:
    """One session. ``on_message`` is called, in the event loop, with each message that is not an answer.

    ready: the bench is up. ended: the process has sent its last message, or has died.
    """

    def __init__(self, choice: Choice, on_message: Callable[[dict[str, Any]], None]) -> None:
        self.choice = choice
        self.ready = False
        self.ended = False
        self.addresses: dict[str, str] = {}
        self._on_words = on_message
        self._answers: dict[int, asyncio.Future[str]] = {}
        self._numbers = itertools.count(1)
        self._rings: dict[str, Ring] = {}
        self._readers: dict[str, Reader] = {}
        self._block: MailboxBlock | None = None
        self._recording: MailboxBlock | None = None
        self.file = ""
        """That the session is recorded into; "" where it is not."""
        self._status = empty_status()
        self._channel, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._channel.setblocking(False)
        configuration = {"choice": choice.model_dump(mode="json"), "channel": there.fileno()}
        try:
            self._child = ChildProcess(
                "console session", "hil.processes.console_session", configuration, (there.fileno(),), new_session=True
            )
        finally:
            there.close()
        self._dying: asyncio.Task[None] | None = None
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._channel, self._read)

    @property
    def pid(self) -> int:
        return self._child.pid

    async def ask(self, **message: Any) -> str:
        """Send one packet that wants an answer; return it: "" for done, else why not."""
        number = next(self._numbers)
        answer: asyncio.Future[str] = self._loop.create_future()
        self._answers[number] = answer
        try:
            if not self.send(**message, id=number):
                return "the session does not listen"
            return await asyncio.wait_for(answer, _ANSWER_WALL_S)
        except TimeoutError:
            return f"the session has not answered within {_ANSWER_WALL_S:g} s: its devices are being opened or closed"
        finally:
            del self._answers[number]

    def send(self, **message: Any) -> bool:
        """Send one packet; return whether it left. Never waits."""
        try:
            self._channel.send(json.dumps(message).encode())
        except OSError:  # no room, or nobody there: then its end is read soon
            return False
        return True

    def read_rows(self) -> np.ndarray:
        """Return the rows of CYCLE, (n,), that came since the last call."""
        return self._take("telemetry", CYCLE)

    def read_portions(self) -> np.ndarray:
        """Return what the docking monitor said since the last call, (n,) of PORTION."""
        return self._take("portions", PORTION)

    def read_pictures(self) -> list[np.ndarray]:
        """Return the newest pictures since the last call, (n,) of PICTURE each: a pair, and one of the monitor's."""
        newest = {"pictures": 2, "monitor_pictures": 1}
        return [self._readers[name].newest(n) for name, n in newest.items() if name in self._readers]

    def _take(self, name: str, dtype: np.dtype) -> np.ndarray:
        return self._readers[name].read() if name in self._readers else np.empty(0, dtype)

    @property
    def lost_rows(self) -> int:
        """How many rows were overwritten before they were taken."""
        return self._readers["telemetry"].lost if self._readers else 0

    def read_status(self) -> tuple[int, np.ndarray]:
        """Return how often the status was written, and the newest one, STATUS (1,)."""
        if self._block is None:
            return 0, self._status
        return self._block["status"].read(self._status)[0], self._status

    def read_recording(self) -> tuple[np.ndarray, float] | None:
        """Return how the recording stands, STATE (1,), and when its process said so by ``time.monotonic``.

        None where the session is not recorded.
        """
        if self._recording is None:
            return None
        state = np.zeros(1, recorder.STATE)
        _, said_s = self._recording["state"].read(state)
        return state, said_s

    def interrupt(self) -> None:
        """Let a session that is still being opened end."""
        self._child.signal(signal.SIGINT)

    async def close(self) -> None:
        """End the session: by its own way out, then at once. Idempotent."""
        if not self._child.exit_status():
            if not (self.ready and self.send(order="stop", id=0)):
                self.interrupt()
            for number in (signal.SIGTERM, signal.SIGKILL):
                if await self._gone_within(_STOP_WALL_S):
                    break
                self._child.signal(number)
        await self._gone_within(_STOP_WALL_S)
        if self._dying is not None:
            await self._dying
        self._end()
        self._forget()

    async def _gone_within(self, wall_s: float) -> bool:
        end = self._loop.time() + wall_s
        while not self._child.exit_status():
            if self._loop.time() > end:
                return False
            await asyncio.sleep(0.01)
        return True

    def poll_exit(self) -> None:
        """Notice a process that has ended though the event loop never said so; call it now and then.

        uvloop lets go of a line on which an error stands, and one does where a session ended with packets unread.
        """
        if not self.ended and self._dying is None and self._child.exit_status():
            while self._read():
                pass

    def _read(self) -> bool:
        """Take one packet; return whether there may be more."""
        try:
            packet, descriptors, _, _ = socket.recv_fds(self._channel, _PACKET, _SHARED_AT_MOST)
        except BlockingIOError:
            return False
        except ConnectionResetError:
            return True  # it ended without reading all that was sent; its own last words come yet, then the end
        except OSError:
            packet, descriptors = b"", []
        if not packet:
            self._loop.remove_reader(self._channel)
            self._dying = self._loop.create_task(self._died())
            return False
        message = json.loads(packet)
        if "hello" in message:
            self._attach(message["hello"], descriptors)
        if "answer" in message:
            answer = self._answers.get(message["answer"])
            if answer is not None and not answer.done():
                answer.set_result(message["text"])
            return True
        self._on_words(message)
        if "ended" in message or "refused" in message:
            self._end()
        return not self.ended

    def _attach(self, hello: dict[str, Any], descriptors: list[int]) -> None:
        self.addresses = hello["addresses"]
        shared = dict(zip(hello["shared"], descriptors, strict=True))
        self._rings = {name: Ring(shared[name], _DTYPES[name], slots, name) for name, slots in hello["slots"].items()}
        self._readers = {name: ring.reader() for name, ring in self._rings.items()}
        self._block = MailboxBlock(shared["status"], CELLS, "console")
        if "recording" in shared:
            self._recording = MailboxBlock(shared["recording"], recorder.CELLS, "recorder")
            self.file = hello["file"]
        self.ready = True

    async def _died(self) -> None:
        """Say how the process ended that has closed its end without a last word."""
        await self._gone_within(_STOP_WALL_S)  # it may be writing down why
        how = self._child.exit_status() or "closed its channel"
        lines = self._child.last_stderr().splitlines()[1:]
        self._on_words({"refused": [f"the session's process {how} without a result", *lines[-12:]]})
        self.ended = True

    def _end(self) -> None:
        self.ended = True
        if self._channel.fileno() >= 0:
            self._loop.remove_reader(self._channel)
            self._channel.close()

    def _forget(self) -> None:
        self._readers.clear()
        for ring in self._rings.values():
            ring.close()
        self._rings.clear()
        for block in (self._block, self._recording):
            if block is not None:
                block.close()
        self._block = self._recording = None
        self._child.close()
