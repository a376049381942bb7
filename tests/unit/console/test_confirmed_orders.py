"""Hazardous orders are confirmed where they are executed: in the loop, whatever the console's copy of its mode."""

from __future__ import annotations

import asyncio
import itertools
import random
from types import SimpleNamespace
from typing import Any, cast

import pytest

from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from hil.parts.console.live_view import Client
from hil.parts.console.remote_operator import RemoteOperator
from hil.parts.console.service import ConsoleService
from hil.parts.console.session import Choice
from hil.parts.console.status import MODES, empty_status
from hil.recording.audit import Actor
from tests.support.acts import act

ANN, BOB = Client("a" * 16, "ann", "a" * 16), Client("b" * 16, "bob", "b" * 16, "confirm")
ORDERS = [order for order in OperatorCommand if order is not OperatorCommand.JOG]
CONFIRMED = [order for order in OperatorCommand if order.question]
SECOND = ("arm", "start", "resume", "home", "park", "reset")
INTERLEAVINGS = 10_000


class Loop:
    """The operator's end of a session in the loop, in ``mode``. It is the session of ``service``."""

    ready = True
    ended = False

    def __init__(self, service: ConsoleService, second_person: tuple[str, ...] = ()) -> None:
        unused = cast(Any, None)  # messages and status
        self.operator = RemoteOperator(unused, unused, "hold", 2.0, service.wall_s, second_person)
        self.modes = SimpleNamespace(mode=Mode.STANDBY)
        self.operator.attach(cast(Any, SimpleNamespace(safety=SimpleNamespace(modes=self.modes))))
        self.next_mode: Mode | None = None
        service.session = cast(Any, self)

    async def request(self, **message: Any) -> dict[str, Any]:
        if self.next_mode is not None:
            self.modes.mode = self.next_mode  # while the order was on its way
        return self.operator._order(message, Actor(message["by"], message["key"]))

    def send(self, **_: Any) -> bool:
        return True

    def executed(self) -> list[OperatorCommand]:
        """Return the commands that were submitted, and forget them."""
        commands = list(self.operator.pending)
        self.operator.pending.clear()
        return commands


def make_service() -> ConsoleService:
    service = ConsoleService(Choice(scenario="scheme-1", rig="mock"), ["scheme-1"], ["mock"], lambda: 100.0)
    service.lease.acquire(ANN, 100.0)
    return service


def show(service: ConsoleService, mode: Mode | None) -> None:
    """Give the console a copy of the mode, None for no copy yet."""
    status = empty_status()
    status["mode"] = MODES.index(mode or Mode.OFF)
    service.state._number = 0
    service.state.set_status(0 if mode is None else 1, status, 100.0)


def test_no_hazardous_order_passes_unconfirmed_or_without_its_second_person() -> None:
    """Orders, modes, confirmations and copies of the mode that are fresh, stale or missing, interleaved at random."""
    dice = random.Random(5)
    service = make_service()
    loops = [Loop(service), Loop(service, SECOND)]
    passed = asked = 0

    async def all_of_them() -> None:
        nonlocal passed, asked
        for _ in range(INTERLEAVINGS):
            loop = dice.choice(loops)
            service.session = cast(Any, loop)
            before, after = dice.choice(MODES), dice.choice(MODES)
            loop.modes.mode, loop.next_mode = before, dice.choice((None, after))
            executing = loop.next_mode or before
            show(service, dice.choice((None, before, after, dice.choice(MODES))))
            order = dice.choice(ORDERS)
            command: dict[str, Any] = {"do": "order", "order": order.value}
            confirmed = dice.choice((True, True, False, None, 1, "yes"))
            if confirmed is not None:
                command["confirmed"] = confirmed
            if dice.random() < 0.5:
                command["mode"] = before.value
            command |= dice.choice(({}, {"second": BOB.key_id}))
            answer = await act(service, ANN, command)
            seconded = "second" in answer and dice.random() < 0.7
            if seconded:
                answer = await act(service, BOB, {"do": "second", "order": order.value})
            done = loop.executed()
            assert done in ([], [order])
            assert bool(done) == answer["ok"]
            asked += "ask" in answer
            if done and order.question:
                passed += 1
                assert confirmed is True
                assert executing in order.modes
                assert command.get("mode", executing.value) == executing.value
                assert seconded == (loop is loops[1] and order.value in SECOND)

    asyncio.run(all_of_them())
    assert passed > 100
    assert asked > 100


@pytest.mark.parametrize(("order", "mode"), list(itertools.product(CONFIRMED, Mode)))
def test_order_is_confirmed_in_each_mode(order: OperatorCommand, mode: Mode) -> None:
    service = make_service()
    loop = Loop(service)
    loop.modes.mode = mode
    answer = asyncio.run(act(service, ANN, {"do": "order", "order": order.value}))
    assert not loop.executed()
    if mode in order.modes:
        assert (answer["ask"], answer["mode"]) == (order.question, mode.value)
        again = {"do": "order", "order": order.value, "confirmed": True}
        assert asyncio.run(act(service, ANN, again)) == {"ok": True, "text": ""}
        assert loop.executed() == [order]
    else:
        assert answer["text"] == f"bench: cannot {order.value} in {mode.value}"


def test_change_of_mode_since_the_confirmation_and_a_late_order_are_refused() -> None:
    service = make_service()
    operator = Loop(service).operator
    order = {"order": "arm", "confirmed": True, "by": "ann"}
    refused = {"text": "bench: arm was confirmed in armed, not for standby: confirm it again"}
    assert operator._order(order | {"mode": "armed"}, Actor("ann")) == refused
    late = {"text": "bench: arm came too late to be executed: command it again"}
    assert operator._order(order | {"until_s": 99.0}, Actor("ann")) == late
    assert not operator.pending


def test_second_person_of_a_session_that_ended_confirms_nothing() -> None:
    service = make_service()
    Loop(service, SECOND)
    answer = asyncio.run(act(service, ANN, {"do": "order", "order": "arm", "confirmed": True}))
    assert answer["second"] == "arm"
    loop = Loop(service, SECOND)
    assert "no such command waits" in asyncio.run(act(service, BOB, {"do": "second", "order": "arm"}))["text"]
    assert not loop.executed()
