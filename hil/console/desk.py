"""What the console knows and does: the session, who commands it, what is ordered. Nothing of the web is in it."""

from __future__ import annotations

import asyncio
import math
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Final

import numpy as np

from hil import parameters
from hil.config.load import load_rig
from hil.console.account import Account, described
from hil.console.client import Client
from hil.console.columns import COLUMNS, NAMES, console_rows
from hil.console.faultboard import FaultBoard
from hil.console.hazards import HAZARDS
from hil.console.lease import Lease, Refused
from hil.console.message import Picture
from hil.console.recording_watch import RecordingWatch
from hil.console.rows import RowStore
from hil.console.session import Choice
from hil.console.session_process import SessionProcess
from hil.console.tuner import Tuner
from hil.errors import BadInput
from hil.messages import CYCLE
from hil.modes import Mode
from hil.orders import OBEYED_IN, Order

PRESENT_EACH_S: Final = 0.2
_KEPT_LOG: Final = 200
_BENCH_AT_REST: Final = frozenset({Mode.OFF, Mode.STANDBY, Mode.ARMED, Mode.HOLD, Mode.SAFE_STOP})


class Desk:
    """Holds the one session of a console and the lease. Every method that takes ``now_s`` wants wall time.

    first: what is offered to begin with. scenarios, rigs: what may be chosen. log: told each line of the console's
    own log.
    """

    def __init__(
        self,
        first: Choice,
        scenarios: Sequence[str],
        rigs: Sequence[str],
        wall_s: Callable[[], float],
        log: Callable[[str], None] = lambda _: None,
    ) -> None:
        self.choice = first
        self.scenarios, self.rigs = tuple(scenarios), tuple(rigs)
        self.lease = Lease(load_rig(first.rig, first.settings).value.console.lease_s)
        self.session: SessionProcess | None = None
        self.faults = FaultBoard()
        self.rows = RowStore()
        self.page_version = 0
        self.clients: list[Client] = []
        self.log: deque[dict[str, Any]] = deque(maxlen=_KEPT_LOG)
        self._say = log
        self._wall_s = wall_s
        self.account = Account({}, "no session is open")
        self._params: np.record | None = None
        self._tuner: Tuner | None = None
        self._tuning = asyncio.Lock()  # each change is built on the one before
        self._present_said: tuple[str, float] = ("", -math.inf)
        self._picture: tuple[int, Picture | None] = (0, None)
        self._tasks: set[asyncio.Task[None]] = set()

    # what the pages ask for

    async def obey(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        """Do what a page asks for; return its answer: ok, text, and ``ask`` where it has to be confirmed first."""
        try:
            return await self._obey(client, command)
        except Refused as refusal:
            return {"ok": False, "text": str(refusal)}
        except BadInput as error:
            return {"ok": False, "text": str(error)}

    async def _obey(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        match command.get("do"):
            case "take":
                self.lease.take(client.key, client.name, self._wall_s())
                self.note(f"{client.name} has the command")
            case "take_over":
                return self._take_over(client, bool(command.get("confirmed")))
            case "release":
                self._release(client)
            case "open":
                self.lease.require(client.key)
                await self._open(command)
            case "order":
                self.lease.require(client.key)
                return await self._order(client, str(command.get("order")), bool(command.get("confirmed")))
            case "jog":
                self.lease.require(client.key)
                self._jog(str(command.get("axis")), command.get("direction"))
            case "adjust":
                self.lease.require(client.key)
                return await self._adjust(client, command)
            case "acknowledge":
                self.lease.require(client.key)
                await self._acknowledge(client)
            case "fault":
                self.lease.require(client.key)
                await self.faults.switch(str(command.get("device")), str(command.get("line")))
                self.note(f"{client.name} switched a fault: {command['device']} {command['line']}")
                self._put_down("fault", client.name, f"{command['device']}: {command['line']}")
            case other:
                raise Refused(f"{other!r}: unknown request")
        return {"ok": True, "text": ""}

    def heard(self, client: Client, got: object = None) -> None:
        """The page of ``client`` is alive, and has ``got`` so many messages, where it says so."""
        if isinstance(got, int):
            client.got = got
        self.lease.renew(client.key, self._wall_s())

    def _take_over(self, client: Client, confirmed: bool) -> dict[str, Any]:
        if self.lease.held and self.lease.key != client.key and not confirmed:
            return {"ok": False, "ask": f"Take the command over from {self.lease.name}? They can only watch then."}
        before = self.lease.take_over(client.key, client.name, self._wall_s())
        self.note(f"{client.name} took the command over from {before}" if before else f"{client.name} has the command")
        return {"ok": True, "text": ""}

    def _release(self, client: Client) -> None:
        self.lease.require(client.key)
        if self._mode not in _BENCH_AT_REST:
            raise Refused(f"the bench is {self._mode.value}: hold or stop it first, or let somebody take over")
        self.lease.release(client.key)
        self.note(f"{client.name} gave the command back")

    async def _open(self, command: dict[str, Any]) -> None:
        if self.session is not None:
            raise Refused("a session is open: stop it first")
        if self.account.unseen:
            raise Refused("an alarm has not been acknowledged: read it, acknowledge it, then open the bench")
        changes: dict[str, Any] = {name: command[name] for name in ("scenario", "rig", "seed") if name in command}
        for name, allowed in (("scenario", self.scenarios), ("rig", self.rigs)):
            if changes.get(name, allowed[0]) not in allowed:
                raise Refused(f"{name} {changes[name]!r}: allowed {', '.join(allowed)}")
        seed = changes.get("seed", 0)
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise Refused(f"seed {seed!r}: allowed a whole number from 0 on")
        choice = self.choice.model_copy(update=changes)
        job = choice.job()
        self.choice = choice
        self._params = parameters.bench(job.rig.value, job.scenario.value.step_s)
        self._tuner = Tuner(job)
        self.account = Account(described(job.rig.value, job.scenario.value), "starting")
        self.lease.lasts_s = job.rig.value.console.lease_s
        self.rows.begin()
        self.session = SessionProcess(choice, self._hear)
        self._present_said = ("", -math.inf)
        self.note(f"{choice.scenario} on {choice.rig}, seed {choice.seed}: session process {self.session.pid}")

    async def _order(self, client: Client, word: str, confirmed: bool) -> dict[str, Any]:
        if word not in [order.value for order in Order if order is not Order.JOG]:
            raise Refused(f"{word!r}: unknown order")
        order = Order(word)
        if self.session is None:
            if order is Order.RESET:
                return self._let_go_of_alarms()
            raise Refused(f"bench: cannot {word}, no session is open")
        if not self.session.ready:
            if order is not Order.STOP:
                raise Refused(f"bench: cannot {word}, it is being opened")
            self.session.interrupt()
            return {"ok": True, "text": ""}
        if order in HAZARDS and self._mode in OBEYED_IN[order] and not confirmed:
            return {"ok": False, "ask": HAZARDS[order]}
        self._say_who_is_there(self.session, self._wall_s())  # whoever orders has the command by then
        text = await self.session.ask(order=word, by=client.name)
        self.note(f"{client.name}: {word}{f' refused: {text}' if text else ''}")
        return {"ok": not text, "text": text}

    def _let_go_of_alarms(self) -> dict[str, Any]:
        if self.account.unseen:
            raise Refused("an alarm has not been acknowledged: read it, acknowledge it, then reset")
        self.account.let_go()
        self.changed()
        return {"ok": True, "text": ""}

    def _jog(self, axis: str, direction: object) -> None:
        if self.session is None or not self.session.ready:
            raise Refused("bench: cannot jog, no session is open")
        if axis not in self.account.bench["axes"] or direction not in (-1, 1):
            raise Refused(f"bench: cannot jog {axis} by {direction}")
        if self._mode in (Mode.STANDBY, Mode.JOGGING):
            self.session.send(jog=[axis, direction])
        else:
            raise Refused(f"bench: cannot jog in {self._mode.value}")

    async def _adjust(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        """Let the loop have another value of one of its settings."""
        if self.session is None or not self.session.ready or self._tuner is None:
            raise Refused("bench: cannot change a setting, no session is open")
        async with self._tuning:
            change = self._tuner.change(command.get("key"), command.get("value"))
            if not command.get("confirmed"):
                return {"ok": False, "ask": change.question}
            self._say_who_is_there(self.session, self._wall_s())
            text = await self.session.ask(adjust=change.as_message(), by=client.name)
            if not text:
                self._tuner.took(change)
        done = f"refused: {text}" if text else f"was {change.before:g}"
        self.note(f"{client.name}: {change.key} = {change.value:g}, {done}")
        return {"ok": not text, "text": text}

    async def _acknowledge(self, client: Client) -> None:
        if self.session is not None and self.session.ready:
            text = await self.session.ask(acknowledge=True, by=client.name)
            if text:
                raise Refused(text)
        self.account.acknowledge()
        self.note(f"{client.name} acknowledged the alarms")

    # what happens by itself

    def tick(self) -> None:
        """Take what the session has written, tell it whether its operator is there; call some 20 times a second."""
        now_s = self._wall_s()
        if lost := self.lease.expire(now_s):
            self.note(f"{lost} is lost: nothing heard for {self.lease.lasts_s:g} s; nobody has the command")
        session = self.session
        if session is None:
            return
        if session.ready and self._params is not None:
            self.rows.add(console_rows(self._params, session.take_rows()))
            self.account.take_status(*session.read_status(), now_s)
            self._say_who_is_there(session, now_s)
            self._look_at_recording(session)
        if session.ended:
            self.session = None
            self.faults.disconnect()
            self._in_background(session.close())
            self.changed()

    def _say_who_is_there(self, session: SessionProcess, now_s: float) -> None:
        """Tell the session whether somebody has the command, and let its recording know who."""
        key, said_s = self._present_said
        if key == self.lease.key and now_s - said_s < PRESENT_EACH_S:
            return
        session.send(present=self.lease.held)
        if key != self.lease.key:
            name = self.lease.name if self.lease.held else "nobody"
            session.send(note=["operator", name, f"{name} has the command"])
        self._present_said = (self.lease.key, now_s)

    def _look_at_recording(self, session: SessionProcess) -> None:
        found = session.read_recording()
        if found is not None and not self.account.closing:
            state, said_s = found
            for line in self.account.recording.look(state, time.monotonic() - said_s):
                self.note(line)

    def _put_down(self, kind: str, who: str, text: str) -> None:
        """Let the session's recording have what somebody did."""
        if self.session is not None and self.session.ready:
            self.session.send(note=[kind, who, text])

    def _hear(self, message: dict[str, Any]) -> None:
        """Take a message of the session."""
        if "hello" in message and self.session is not None:
            self.account.word = ""
            self.account.recording = RecordingWatch(self.session.file)
            self._in_background(self._connect_faults(message["hello"]["addresses"]))
        for line in self.account.hear(message):
            self.note(line)
        self.changed()

    async def _connect_faults(self, addresses: dict[str, str]) -> None:
        with suppress(Refused):  # a device that does not answer has no switches
            await self.faults.connect(addresses)
        self.changed()

    def _in_background(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def show(self, picture: Picture) -> None:
        """Show a camera's picture with its overlay from now on; the pages get the newest one."""
        self._picture = (self._picture[0] + 1, picture)

    def note(self, text: str) -> None:
        """Write a line into the console's log."""
        self.log.append({"wall_s": self._wall_s(), "text": text})
        self._say(text)
        self.changed()

    def changed(self) -> None:
        """Let the pages have the slow part of the state anew."""
        self.page_version += 1

    def warm_up(self) -> None:
        """Compile what is called while a bench moves: it must not keep the console from saying that it is there."""
        job = self.choice.job()
        console_rows(parameters.bench(job.rig.value, job.scenario.value.step_s), np.zeros(2, CYCLE))

    async def close(self) -> None:
        """End the session, the bench first at a stand."""
        if self.session is not None:
            await self.session.close()
            self.session = None
        while self._tasks:
            await asyncio.gather(*self._tasks, return_exceptions=True)

    # what the pages see

    @property
    def _mode(self) -> Mode:
        if self.session is None or not self.session.ready:
            return Mode.OFF
        return self.account.mode

    def news_for(
        self, client: Client
    ) -> tuple[dict[str, Any], dict[str, Any] | None, np.ndarray[Any, Any], int, Picture | None]:
        """Return the arguments of ``message.pack`` for ``client``, of all that it has not seen."""
        page = None
        if client.page_seen != self.page_version:
            client.page_seen, page = self.page_version, self._page()
        number, picture = self._picture
        fresh = number != client.picture_seen
        client.picture_seen = number
        before = client.cursor.seen
        rows = self.rows.since(client.cursor)
        first = 0 if client.cursor.restarted else before
        return self._now(client), page, rows.reshape(-1, COLUMNS), first, picture if fresh else None

    def _now(self, client: Client) -> dict[str, Any]:
        now_s = self._wall_s()
        lease = self.lease
        return {
            "wall_s": now_s,
            "mode": self._mode.value,
            "open": self.session is not None,
            "ready": self.session is not None and self.session.ready,
            "lease": {"holder": lease.name, "mine": lease.held and lease.key == client.key},
            "watching": len(self.clients),
            "recording": self.account.recording.as_json() if self.session is not None else None,
            **self.account.now(now_s),
        }

    def _page(self) -> dict[str, Any]:
        return {
            "session": self.rows.session,
            "columns": NAMES,
            "choice": {"scenario": self.choice.scenario, "rig": self.choice.rig, "seed": self.choice.seed},
            "scenarios": self.scenarios,
            "rigs": self.rigs,
            "obeyed_in": {order.value: [mode.value for mode in modes] for order, modes in OBEYED_IN.items()},
            "log": list(self.log)[-40:],
            "settings": self._tuner.offered() if self._tuner is not None and self.session is not None else [],
            "faults": {"menu": self.faults.menu, "on": self.faults.on},
            **self.account.page(),
        }
