"""Request handler of the console: executes the requests of its clients. No web code."""

from __future__ import annotations

import asyncio
from typing import Any, Final

from hil.checks.waivers import waivers
from hil.core.modes import AT_REST, Mode
from hil.core.operator_commands import DEAD_MAN_S, HALTS, OperatorCommand
from hil.core.operator_keys import RIGHTS
from hil.errors import BadInput, one_line
from hil.frmn.search_region import box_text
from hil.parts.console.freshness import ACT_S, MOVING, deadline_of, require_order
from hil.parts.console.lease import RequestRejected
from hil.parts.console.live_view import Client
from hil.parts.console.remote_operator import NO_MONITOR
from hil.parts.console.session import SignedBy
from hil.parts.console.session_process import SessionProcess
from hil.parts.console.updates import ClientUpdates, SecondPerson

COMMISSION_QUESTION: Final = (
    "Commission: emergency stop, safety chain, then each axis moves slowly by itself, then the bench makes a slow dry "
    "run. The questions come to this page. Is the bench clear of people, and is the emergency stop in your hand?"
)
OPEN_QUESTION: Final = "Open: the devices open and the drives are powered. Is the bench clear of people?"
WITHOUT_COMMAND: Final = tuple(command.value for command in HALTS)
NEEDS_KEYS: Final = "the rig requires a second person, whom only a key identifies: start the console with --operators"
SECOND_PERSON_S: Final = 30.0
"""Time in which another person has to confirm a command that requires it, wall clock."""
SEED_MAX: Final = 2**63 - 1
_DEVICE_TEXT: Final = 200  # characters of a fault's line
_REGION_TEXT: Final = 200


def _alarm_number(command: dict[str, Any]) -> int | None:
    """Return the number of the alarm that a request names, None for all."""
    number = command.get("alarm")
    if number is not None and (isinstance(number, bool) or not isinstance(number, int)):
        raise RequestRejected(f"alarm {number!r}: allowed is its number")
    return number


def _box(region: object) -> list[int] | None:
    """Return the four whole numbers of ``region``, zeros if it has no such numbers; None for None."""
    if region is None:
        return None
    if isinstance(region, list) and len(region) == 4 and all(type(number) is int for number in region):
        return region
    return [0, 0, 0, 0]


class ConsoleService(ClientUpdates):
    """Session manager with the requests and the updates of clients."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self._halts: dict[str, asyncio.Task[dict[str, Any]]] = {}
        """STOP and HOLD that are being executed."""

    async def execute(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        """Execute a request; return the answer: ok, text, and ``ask`` if it requires a confirmation."""
        try:
            if str(command.get("do")) in MOVING and command.get("order") not in WITHOUT_COMMAND:
                command = {**command, "until_s": self._deadline(client, command)}
            return await self._execute(client, command)
        except (RequestRejected, BadInput) as error:
            return {"ok": False, "text": str(error)}

    async def _execute(self, client: Client, command: dict[str, Any], second: str = "") -> dict[str, Any]:
        """``execute``. second: key of another person who has confirmed the command, "" for none."""
        match command.get("do"):
            case "take":
                self._require_rights(client, "command")
                self.lease.acquire(client, self.wall_s())
                self.log(f"{client.name} has the command")
            case "take_over":
                return self._take_over(client, bool(command.get("confirmed")))
            case "release":
                self._release(client)
            case "open":
                self.lease.require(client)
                return self._open(client, command, second)
            case "second":
                return await self._second(client, str(command.get("order")), command["until_s"])
            case "order":
                if command.get("order") not in WITHOUT_COMMAND:
                    self.lease.require(client)
                return await self._order(client, str(command.get("order")), command, second)
            case "reply":
                self.lease.require(client)
                return await self._reply(client, command)
            case "jog":
                self.lease.require(client)
                self._jog(command)
            case "release_key":
                if self.lease.held_by(client) and self.session is not None:
                    self.session.send(release=True)
            case "adjust":
                self.lease.require(client)
                return await self._adjust(client, command)
            case "search":
                self.lease.require(client)
                await self._search(client, command.get("region"))
            case "watch":
                client.camera = str(command.get("camera"))
            case "acknowledge":
                self.lease.require(client)
                await self._acknowledge(client, _alarm_number(command))
            case "shelve":
                self.lease.require(client)
                await self._shelve(client, _alarm_number(command), command.get("lasting_s"))
            case "fault":
                self.lease.require(client)
                device, line = (one_line(str(command.get(key)), _DEVICE_TEXT) for key in ("device", "line"))
                await self.faults.switch(device, line)
                self.log(f"{client.name} switched a fault: {device} {line}")
                self.record_event("fault", client, f"{device}: {line}")
            case other:
                raise RequestRejected(f"{other!r}: unknown request")
        return {"ok": True, "text": ""}

    def _deadline(self, client: Client, command: dict[str, Any]) -> float:
        """Return until when a request of ``client`` may act. Programs that are no pages may send no ``seen_s``."""
        if not client.page and "seen_s" not in command:
            return self.wall_s() + (DEAD_MAN_S if command["do"] == "jog" else ACT_S)
        client.requests = require_order(command, client.requests)
        return deadline_of(command, self.wall_s())

    def _require_rights(self, client: Client, rights: str) -> None:
        """Raise RequestRejected unless the operator has ``rights`` or more."""
        if RIGHTS.index(client.rights) < RIGHTS.index(rights):
            raise RequestRejected(f"{client.name} may {client.rights}, not {rights}: see the file of --operators")

    def _take_over(self, client: Client, confirmed: bool) -> dict[str, Any]:
        self._require_rights(client, "command")
        if self.lease.held and not self.lease.held_by(client) and not confirmed:
            return {"ok": False, "ask": f"Take the command over from {self.lease.name}, who can then only watch?"}
        before = self.lease.take_over(client, self.wall_s())
        self.log(f"{client.name} took the command over from {before}" if before else f"{client.name} has the command")
        return {"ok": True, "text": ""}

    def _release(self, client: Client) -> None:
        self.lease.require(client)
        if self.mode not in AT_REST:
            raise RequestRejected(
                f"the bench is {self.mode.value}: hold or stop it first, or let another operator take over"
            )
        self.lease.release(client)
        self.log(f"{client.name} released the command")

    def _wait_for_second(self, client: Client, word: str, command: dict[str, Any]) -> dict[str, Any]:
        """Keep a confirmed command until another person confirms it; return the answer to its client."""
        if not client.key_id:
            raise RequestRejected(f"{word}: {NEEDS_KEYS}")
        self.second_person = SecondPerson(word, client, command, self.wall_s() + SECOND_PERSON_S, self.session)
        self.log(f"{client.name}: {word} waits for a second person")
        text = f"{word}: waits {SECOND_PERSON_S:g} s for the confirmation of a second person at another page"
        return {"ok": False, "text": text, "second": word}

    async def _second(self, client: Client, word: str, until_s: float) -> dict[str, Any]:
        """Confirm the command of another client, and execute it until ``until_s``, as this client saw the bench."""
        awaited = self.awaited()
        if awaited is None or awaited.word != word:
            raise RequestRejected(f"{word}: no such command waits for a second person")
        self._require_rights(client, "confirm")
        if client.key_id == awaited.client.key_id:
            raise RequestRejected(f"{word}: {awaited.client.name} commanded it, another person has to confirm it")
        self.second_person = None
        self.log(f"{client.name} confirmed {word} of {awaited.client.name} as the second person")
        self.record_event("operator", client, f"confirmed {word} of {awaited.client.name} as the second person")
        return await self._execute(awaited.client, {**awaited.command, "until_s": until_s}, client.key_id)

    def _open(self, client: Client, command: dict[str, Any], second: str) -> dict[str, Any]:
        if self.session is not None:
            raise RequestRejected("a session is open: stop it first")
        if self.state.unacknowledged:
            raise RequestRejected("an alarm is not acknowledged: read and acknowledge it, then open the bench")
        changes: dict[str, Any] = {name: command[name] for name in ("scenario", "rig", "seed") if name in command}
        for name, allowed in (("scenario", self.scenarios), ("rig", self.rigs)):
            if changes.get(name, allowed[0]) not in allowed:
                raise RequestRejected(f"{name} {changes[name]!r}: allowed {', '.join(allowed)}")
        seed = changes.get("seed", 0)
        if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed <= SEED_MAX:
            raise RequestRejected(f"seed {seed!r}: allowed an integer of 0 or more")
        is_commissioning = command.get("commission") is True
        changes["signed_by"] = SignedBy(name=client.name, key=client.key_id) if is_commissioning else None
        choice = self.choice.model_copy(update=changes)
        job = choice.job()
        rig = job.rig.value
        if is_commissioning and rig.kind == "mock":
            raise RequestRejected(f'{choice.rig}: rig.kind "mock": there are no devices to commission')
        if not command.get("confirmed"):
            question = COMMISSION_QUESTION if is_commissioning else OPEN_QUESTION
            return {"ok": False, "ask": "\n".join([*map(str, waivers(rig, job.scenario.value)), question])}
        if "open" in rig.console.second_person and not second:
            return self._wait_for_second(client, "open", command)
        self.start_session(choice, client)
        return {"ok": True, "text": ""}

    async def _reply(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        """Answer a question of the commissioning; who opened it answers all of them, and signs."""
        signer = self.choice.signed_by
        if self.session is None or not self.session.ready or signer is None:
            raise RequestRejected("no question waits for an answer")
        if (client.name, client.key_id) != (signer.name, signer.key):
            raise RequestRejected(
                f"{signer.name} opened the commissioning and answers its questions: STOP it, and open another one"
            )
        is_yes = command.get("yes") is True
        if not is_yes and not command.get("confirmed"):
            return {"ok": False, "ask": "No: the commissioning ends here, and nothing is signed."}
        self.report_operator(self.session, self.wall_s())
        text = await self.session.ask(reply=is_yes, question=command.get("question"), **client.actor)
        self.log(f"{client.name}: {text or ('yes' if is_yes else 'no')}")
        return {"ok": not text, "text": text}

    async def _order(self, client: Client, word: str, command: dict[str, Any], second: str) -> dict[str, Any]:
        if word not in [order.value for order in OperatorCommand if order is not OperatorCommand.JOG]:
            raise RequestRejected(f"{word!r}: unknown order")
        order = OperatorCommand(word)
        if self.session is None:
            if order is OperatorCommand.RESET:
                return self._reset_alarms()
            raise RequestRejected(f"bench: cannot {word}, no session is open")
        if not self.session.ready:
            if order is not OperatorCommand.STOP:
                raise RequestRejected(f"bench: cannot {word} while it is being opened")
            self.session.interrupt()
            return {"ok": True, "text": ""}
        self.report_operator(self.session, self.wall_s())  # the session then has the present holder of the lease
        if word in WITHOUT_COMMAND:
            return await self._halt(client, word, self.session)
        terms = {key: command[key] for key in ("confirmed", "mode", "until_s") if key in command}
        answer = await self.session.request(order=word, second=second, **client.actor, **terms)
        if "ask" in answer:
            return {"ok": False, "ask": answer["ask"], "mode": answer["mode"]}
        if "second" in answer:
            return self._wait_for_second(client, word, {**command, "mode": answer["mode"]})
        return self._answer(client, word, answer)

    async def _halt(self, client: Client, word: str, session: SessionProcess) -> dict[str, Any]:
        """Execute STOP or HOLD. While one is being executed further ones of the same kind share its answer: a flood of
        them delays no other command."""
        if word not in self._halts:

            async def execute() -> dict[str, Any]:
                try:
                    answer = await session.request(order=word, **client.actor)
                    if answer.get("unsent") and word == OperatorCommand.STOP.value:
                        session.interrupt()
                    return self._answer(client, word, answer)
                finally:
                    del self._halts[word]

            self._halts[word] = asyncio.create_task(execute())
        return await asyncio.shield(self._halts[word])

    def _answer(self, client: Client, word: str, answer: dict[str, Any]) -> dict[str, Any]:
        """Return the answer of the session to an order for its client, and log it."""
        text = str(answer["text"])
        self.log(f"{client.name}: {word}{f' rejected: {text}' if text else ''}")
        return {"ok": not text, "text": text}

    def _reset_alarms(self) -> dict[str, Any]:
        if self.state.unacknowledged:
            raise RequestRejected("an alarm is not acknowledged: read and acknowledge it, then reset")
        self.state.unlatch()
        self.changed()
        return {"ok": True, "text": ""}

    def _ready(self, text: str) -> SessionProcess:
        """Return the session once it is open; raise RequestRejected with ``text`` otherwise."""
        if self.session is None or not self.session.ready:
            raise RequestRejected(text)
        return self.session

    def _jog(self, command: dict[str, Any]) -> None:
        axis, direction = str(command.get("axis")), command.get("direction")
        session = self._ready("bench: cannot jog, no session is open")
        if axis not in self.state.bench["axes"] or direction not in (-1, 1):
            raise RequestRejected(f"bench: cannot jog {axis} by {direction}")
        if self.mode in (Mode.STANDBY, Mode.JOGGING):
            session.send(jog=[axis, direction], until_s=command["until_s"])
        else:
            raise RequestRejected(f"bench: cannot jog in {self.mode.value}")

    async def _adjust(self, client: Client, command: dict[str, Any]) -> dict[str, Any]:
        """Send a changed setting to the loop."""
        if self.session is None or not self.session.ready or self.tuner is None:
            raise RequestRejected("bench: cannot change a setting, no session is open")
        async with self.tuning:
            change = self.tuner.change(command.get("key"), command.get("value"))
            if not command.get("confirmed"):
                return {"ok": False, "ask": change.question}
            self.report_operator(self.session, self.wall_s())
            text = await self.session.ask(adjust=change.as_message(), until_s=command["until_s"], **client.actor)
            if not text:
                self.tuner.applied(change)
        done = f"rejected: {text}" if text else f"was {change.before:g}"
        self.log(f"{client.name}: {change.key} = {change.value:g}, {done}")
        return {"ok": not text, "text": text}

    async def _search(self, client: Client, region: object) -> None:
        """Set the docking monitor's region of search: [u, v, width, height], px, None for the whole image."""
        session = self._ready("bench: cannot set a region of search, no session is open")
        camera = self.television
        if camera is None:
            raise RequestRejected(NO_MONITOR)
        box = _box(region)
        if box is not None and (error := camera.region_error(box)):
            raise RequestRejected(one_line(f"region {region!r}: {error}", _REGION_TEXT))
        if text := await session.ask(search=box, **client.actor):
            raise RequestRejected(text)
        self.state.search = box
        self.log(f"{client.name}: the docking monitor searches {box_text(box)}")

    async def _acknowledge(self, client: Client, number: int | None) -> None:
        if number is not None and number not in {alarm.get("number") for alarm in self.state.alarms}:
            raise RequestRejected(f"alarm {number}: no such alarm")
        if self.session is not None and self.session.ready:
            text = await self.session.ask(acknowledge=True if number is None else number, **client.actor)
            if text:
                raise RequestRejected(text)
        self.state.acknowledge(number)
        self.stop_reason = "" if number is None else self.stop_reason
        self.log(f"{client.name} acknowledged {'the alarms' if number is None else f'alarm {number}'}")

    async def _shelve(self, client: Client, number: int | None, lasting_s: object) -> None:
        session = self._ready("no session is open: nothing to shelve")
        if number is None or isinstance(lasting_s, bool) or not isinstance(lasting_s, int | float):
            raise RequestRejected("shelve needs alarm, its number, and lasting_s, in s")
        if text := await session.ask(shelve=[number, float(lasting_s)], **client.actor):
            raise RequestRejected(text)
        self.log(f"{client.name} shelved alarm {number} for {lasting_s:g} s")
