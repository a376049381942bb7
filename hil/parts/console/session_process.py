"""Process of a session, as controlled by the console: start, commands, messages, shared memory, end."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import signal
import socket
import time
from collections.abc import Callable
from typing import Any, Final

import numpy as np

from hil.core.child_process import ChildProcess
from hil.core.messages import CYCLE
from hil.frmn.mailbox import MailboxBlock
from hil.frmn.ring import Reader, Ring
from hil.parts.console.session import Choice
from hil.parts.console.status import CELLS, empty_status
from hil.recording import recorder
from hil.recording.recorder import ring_dtypes

_PACKET: Final = 1 << 18
_MAX_DESCRIPTORS: Final = 16
_DTYPES: Final = {"telemetry": CYCLE, **ring_dtypes()}
_ANSWER_WALL_S: Final = 2.0
_STOP_WALL_S: Final = 5.0  # allowed to stop the bench and end its processes


class SessionProcess:
    """One session. ``on_message`` is called, in the event loop, with each message that is not an answer.

    ready: the bench is open. ended: the process has sent its last message, or has died.
    """

    def __init__(self, choice: Choice, on_message: Callable[[dict[str, Any]], None]) -> None:
        self.choice = choice
        self.ready = False
        self.ended = False
        self.addresses: dict[str, str] = {}
        self._on_message = on_message
        self._answers: dict[int, asyncio.Future[dict[str, Any]]] = {}
        self._numbers = itertools.count(1)
        self._readers: dict[str, Reader] = {}
        self._block: MailboxBlock | None = None
        self._recording: MailboxBlock | None = None
        self.rings: dict[str, Ring] = {}
        """Rings of the session by their names, once it is ready."""
        self.run_time = -1
        """Descriptor of the relation of the run's time to bench time (``RunTime``), -1 before the session is ready."""
        self.clock: list[float] = []
        """``epoch_ns`` and ``speed`` of the clock of bench time."""
        self.file = ""
        """File of the recording; "" without one."""
        self._status = empty_status()
        self._channel, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._channel.setblocking(False)
        configuration = {"choice": choice.model_dump(mode="json"), "channel": there.fileno()}
        try:
            self._child = ChildProcess(
                "console session",
                "hil.parts.console.console_session",
                configuration,
                (there.fileno(),),
                new_session=True,
            )
        finally:
            there.close()
        self._exit_task: asyncio.Task[None] | None = None
        self._loop = asyncio.get_running_loop()
        self._loop.add_reader(self._channel, self._read)

    @property
    def pid(self) -> int:
        return self._child.pid

    async def ask(self, **message: Any) -> str:
        """Send one packet; return "" if it was executed, else the reason of the rejection."""
        return str((await self.request(**message))["text"])

    async def request(self, **message: Any) -> dict[str, Any]:
        """Send one packet and return its answer: ``text``, "" if executed, else the reason of the rejection."""
        number = next(self._numbers)
        answer: asyncio.Future[dict[str, Any]] = self._loop.create_future()
        self._answers[number] = answer
        try:
            if not self.send(**{"until_s": time.monotonic() + _ANSWER_WALL_S, **message}, id=number):
                return {"text": "the session receives no messages", "unsent": True}
            return await asyncio.wait_for(answer, _ANSWER_WALL_S)
        except TimeoutError:
            text = f"no answer of the session within {_ANSWER_WALL_S:g} s: its devices are being opened or closed"
            return {"text": text}
        finally:
            del self._answers[number]

    def send(self, **message: Any) -> bool:
        """Send one packet; return whether it was sent. Never waits."""
        try:
            self._channel.send(json.dumps(message).encode())
        except OSError:  # buffer full, or process ended: its end is detected soon
            return False
        return True

    def read_rows(self, ring: str = "telemetry") -> np.ndarray:
        """Return the new rows of a ring, (n,), by default those of CYCLE; none without such a ring."""
        return self._readers[ring].read() if ring in self._readers else np.empty(0, _DTYPES[ring])

    def read_pictures(self) -> list[np.ndarray]:
        """Return the newest images since the last call, (n,) of ``IMAGE`` each: a pair, and one of the monitor."""
        newest = {"images": 2, "monitor_images": 1}
        return [self._readers[name].newest(n) for name, n in newest.items() if name in self._readers]

    def read_status(self) -> tuple[int, np.ndarray]:
        """Return the number of written status records, and the newest one, STATUS (1,)."""
        if self._block is None:
            return 0, self._status
        return self._block["status"].read(self._status)[0], self._status

    def read_recording(self) -> tuple[np.ndarray, float] | None:
        """Return the recording's state, STATE (1,), and its time by ``time.monotonic``; None without a recording."""
        if self._recording is None:
            return None
        state = np.zeros(1, recorder.STATE)
        _, updated_s = self._recording["state"].read(state)
        return state, updated_s

    def interrupt(self) -> None:
        """Interrupt a session that is still being opened."""
        self._child.signal(signal.SIGINT)

    async def close(self) -> None:
        """End the session: by its STOP command, then by signals. Idempotent."""
        if not self._child.exit_status():
            if not (self.ready and self.send(order="stop", id=0)):
                self.interrupt()
            for number in (signal.SIGTERM, signal.SIGKILL):
                if await self._exited_within(_STOP_WALL_S):
                    break
                self._child.signal(number)
        await self._exited_within(_STOP_WALL_S)
        if self._exit_task is not None:
            await self._exit_task
        self._end()
        self._release()

    async def _exited_within(self, wall_s: float) -> bool:
        end = self._loop.time() + wall_s
        while not self._child.exit_status():
            if self._loop.time() > end:
                return False
            await asyncio.sleep(0.01)
        return True

    def poll_exit(self) -> None:
        """Detect an ended process that the event loop did not report; called periodically.

        uvloop drops a socket with a pending error, which occurs if a session ended with unread packets.
        """
        if not self.ended and self._exit_task is None and self._child.exit_status():
            while self._read():
                pass

    def _read(self) -> bool:
        """Receive one packet; return whether there may be more."""
        try:
            packet, descriptors, _, _ = socket.recv_fds(self._channel, _PACKET, _MAX_DESCRIPTORS)
        except BlockingIOError:
            return False
        except ConnectionResetError:
            return True  # it ended with unread packets; its own last messages still follow, then the end
        except OSError:
            packet, descriptors = b"", []
        if not packet:
            self._loop.remove_reader(self._channel)
            self._exit_task = self._loop.create_task(self._handle_exit())
            return False
        message = json.loads(packet)
        if "hello" in message:
            self._attach(message["hello"], descriptors)
        if "answer" in message:
            answer = self._answers.get(message["answer"])
            if answer is not None and not answer.done():
                answer.set_result(message)
            return True
        self._on_message(message)
        if "ended" in message or "refused" in message:
            self._end()
        return not self.ended

    def _attach(self, hello: dict[str, Any], descriptors: list[int]) -> None:
        self.addresses = hello["addresses"]
        shared = dict(zip(hello["shared"], descriptors, strict=True))
        self.rings = {name: Ring(shared[name], _DTYPES[name], slots, name) for name, slots in hello["slots"].items()}
        self._readers = {name: ring.reader() for name, ring in self.rings.items()}
        self._block = MailboxBlock(shared["status"], CELLS, "console")
        self.run_time, self.clock = shared["run_time"], hello["clock"]
        if "recording" in shared:
            self._recording = MailboxBlock(shared["recording"], recorder.STATE_MAILBOX, "recorder")
            self.file = hello["file"]
        self.ready = True

    async def _handle_exit(self) -> None:
        """Report how the process ended that closed its socket without a final message."""
        await self._exited_within(_STOP_WALL_S)  # it may still be writing its error
        how = self._child.exit_status() or "closed its channel"
        lines = self._child.last_stderr().splitlines()[1:]
        self._on_message({"refused": [f"the session's process {how} without a result", *lines[-12:]]})
        self.ended = True

    def _end(self) -> None:
        self.ended = True
        if self._channel.fileno() >= 0:
            self._loop.remove_reader(self._channel)
            self._channel.close()

    def _release(self) -> None:
        self._readers.clear()
        for ring in self.rings.values():
            ring.close()
        self.rings.clear()
        if self.run_time >= 0:
            os.close(self.run_time)
            self.run_time = -1
        for block in (self._block, self._recording):
            if block is not None:
                block.close()
        self._block = self._recording = None
        self._child.close()
