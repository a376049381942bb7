"""What the console does for its pages: obeys what they ask for, tells what there is. Nothing of the web is in it."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from hil.console.client import Client
from hil.console.columns import COLUMNS, NAMES
from hil.console.confirmations import CONFIRMATIONS
from hil.console.lease import LeaseRefused
from hil.console.message import ImageMessage
from hil.console.session_manager import SessionManager
from hil.core.modes import Mode
from hil.core.operator_commands import ALLOWED_IN, OperatorCommand
from hil.errors import BadInput

_BENCH_AT_REST: Final = frozenset({Mode.OFF, Mode.STANDBY, Mode.ARMED, Mode.HOLD, Mode.SAFE_STOP})


class ConsoleService(SessionManager):
    """The keeper of the session behind its counter."""

    # what the pages ask for

    async def obey(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        """Do what a page asks for; return its answer: ok, text, and ``ask`` where it has to be confirmed first."""
        try:
            return await self._obey(client, command)
        except LeaseRefused as refusal:
            return {"ok": False, "text": str(refusal)}
        except BadInput as error:
            return {"ok": False, "text": str(error)}

    async def _obey(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        match command.get("do"):
            case "take":
                self.lease.take(client.key, client.name, self.wall_s())
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
            case "watch":
                client.camera = str(command.get("camera"))
            case "acknowledge":
                self.lease.require(client.key)
                await self._acknowledge(client)
            case "fault":
                self.lease.require(client.key)
                await self.faults.switch(str(command.get("device")), str(command.get("line")))
                self.note(f"{client.name} switched a fault: {command['device']} {command['line']}")
                self.put_down("fault", client.name, f"{command['device']}: {command['line']}")
            case other:
                raise LeaseRefused(f"{other!r}: unknown request")
        return {"ok": True, "text": ""}

    def _take_over(self, client: Client, confirmed: bool) -> dict[str, Any]:
        if self.lease.held and self.lease.key != client.key and not confirmed:
            return {"ok": False, "ask": f"Take the command over from {self.lease.name}? They can only watch then."}
        before = self.lease.take_over(client.key, client.name, self.wall_s())
        self.note(f"{client.name} took the command over from {before}" if before else f"{client.name} has the command")
        return {"ok": True, "text": ""}

    def _release(self, client: Client) -> None:
        self.lease.require(client.key)
        if self.mode not in _BENCH_AT_REST:
            raise LeaseRefused(f"the bench is {self.mode.value}: hold or stop it first, or let somebody take over")
        self.lease.release(client.key)
        self.note(f"{client.name} gave the command back")

    async def _open(self, command: dict[str, Any]) -> None:
        if self.session is not None:
            raise LeaseRefused("a session is open: stop it first")
        if self.account.unseen:
            raise LeaseRefused("an alarm has not been acknowledged: read it, acknowledge it, then open the bench")
        changes: dict[str, Any] = {name: command[name] for name in ("scenario", "rig", "seed") if name in command}
        for name, allowed in (("scenario", self.scenarios), ("rig", self.rigs)):
            if changes.get(name, allowed[0]) not in allowed:
                raise LeaseRefused(f"{name} {changes[name]!r}: allowed {', '.join(allowed)}")
        seed = changes.get("seed", 0)
        if isinstance(seed, bool) or not isinstance(seed, int) or seed < 0:
            raise LeaseRefused(f"seed {seed!r}: allowed a whole number from 0 on")
        self.begin(self.choice.model_copy(update=changes))

    async def _order(self, client: Client, word: str, confirmed: bool) -> dict[str, Any]:
        if word not in [order.value for order in OperatorCommand if order is not OperatorCommand.JOG]:
            raise LeaseRefused(f"{word!r}: unknown order")
        order = OperatorCommand(word)
        if self.session is None:
            if order is OperatorCommand.RESET:
                return self._let_go_of_alarms()
            raise LeaseRefused(f"bench: cannot {word}, no session is open")
        if not self.session.ready:
            if order is not OperatorCommand.STOP:
                raise LeaseRefused(f"bench: cannot {word}, it is being opened")
            self.session.interrupt()
            return {"ok": True, "text": ""}
        if order in CONFIRMATIONS and self.mode in ALLOWED_IN[order] and not confirmed:
            return {"ok": False, "ask": CONFIRMATIONS[order]}
        self.say_who_is_there(self.session, self.wall_s())  # whoever orders has the command by then
        text = await self.session.ask(order=word, by=client.name)
        self.note(f"{client.name}: {word}{f' refused: {text}' if text else ''}")
        return {"ok": not text, "text": text}

    def _let_go_of_alarms(self) -> dict[str, Any]:
        if self.account.unseen:
            raise LeaseRefused("an alarm has not been acknowledged: read it, acknowledge it, then reset")
        self.account.let_go()
        self.changed()
        return {"ok": True, "text": ""}

    def _jog(self, axis: str, direction: object) -> None:
        if self.session is None or not self.session.ready:
            raise LeaseRefused("bench: cannot jog, no session is open")
        if axis not in self.account.bench["axes"] or direction not in (-1, 1):
            raise LeaseRefused(f"bench: cannot jog {axis} by {direction}")
        if self.mode in (Mode.STANDBY, Mode.JOGGING):
            self.session.send(jog=[axis, direction])
        else:
            raise LeaseRefused(f"bench: cannot jog in {self.mode.value}")

    async def _adjust(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        """Let the loop have another value of one of its settings."""
        if self.session is None or not self.session.ready or self.tuner is None:
            raise LeaseRefused("bench: cannot change a setting, no session is open")
        async with self.tuning:
            change = self.tuner.change(command.get("key"), command.get("value"))
            if not command.get("confirmed"):
                return {"ok": False, "ask": change.question}
            self.say_who_is_there(self.session, self.wall_s())
            text = await self.session.ask(adjust=change.as_message(), by=client.name)
            if not text:
                self.tuner.took(change)
        done = f"refused: {text}" if text else f"was {change.before:g}"
        self.note(f"{client.name}: {change.key} = {change.value:g}, {done}")
        return {"ok": not text, "text": text}

    async def _acknowledge(self, client: Client) -> None:
        if self.session is not None and self.session.ready:
            text = await self.session.ask(acknowledge=True, by=client.name)
            if text:
                raise LeaseRefused(text)
        self.account.acknowledge()
        self.note(f"{client.name} acknowledged the alarms")

    # what the pages see

    def news_for(
        self, client: Client
    ) -> tuple[
        dict[str, Any], dict[str, Any] | None, np.ndarray[Any, Any], int, ImageMessage | None, dict[str, Any] | None
    ]:
        """Return the arguments of ``message.pack`` for ``client``, of all that it has not seen."""
        page = None
        if client.page_seen != self.page_version:
            client.page_seen, page = self.page_version, self._page()
        rows, first, portions = self.shown.rows_for(client)
        return self._now(client), page, rows.reshape(-1, COLUMNS), first, self.shown.picture_for(client), portions

    def _now(self, client: Client) -> dict[str, Any]:
        now_s = self.wall_s()
        lease = self.lease
        return {
            "wall_s": now_s,
            "mode": self.mode.value,
            "open": self.session is not None,
            "ready": self.session is not None and self.session.ready,
            "lease": {"holder": lease.name, "mine": lease.held and lease.key == client.key},
            "watching": len(self.clients),
            "cameras": self.shown.cameras,
            "recording": self.account.recording.as_json() if self.session is not None else None,
            **self.account.now(now_s),
        }

    def _page(self) -> dict[str, Any]:
        return {
            "session": self.shown.rows.session,
            "columns": NAMES,
            "choice": {"scenario": self.choice.scenario, "rig": self.choice.rig, "seed": self.choice.seed},
            "scenarios": self.scenarios,
            "rigs": self.rigs,
            "obeyed_in": {order.value: [mode.value for mode in modes] for order, modes in ALLOWED_IN.items()},
            "log": list(self.log)[-40:],
            "settings": self.tuner.offered() if self.tuner is not None and self.session is not None else [],
            "faults": {"menu": self.faults.menu, "on": self.faults.on},
            **self.account.page(),
        }
