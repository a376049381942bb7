"""Clients of the console: nothing that one sends ends a session, and each of them can stop the bench."""

from __future__ import annotations

import asyncio
import json
import random
from typing import Any, cast

import pytest

from hil.config.live_tunable import live_ranges, range_of, within
from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.parts.console import app
from hil.parts.console.lease import RequestRejected
from hil.parts.console.live_view import Client
from hil.parts.console.service import ConsoleService
from hil.parts.console.session import Choice
from hil.parts.console.session_manager import CLIENTS_MAX
from hil.parts.console.session_process import SessionProcess
from hil.parts.console.tuner import Tuner
from hil.session.assembly import Job
from tests.support.acts import act

ANN, BOB = Client("a" * 16, "ann"), Client("b" * 16, "bob")


class OpenSession:
    """A session that executes everything. asked: what it was asked."""

    ready = True
    pid = 1

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []
        self.reply: dict[str, Any] = {"text": ""}
        self.interrupted = False

    async def ask(self, **message: Any) -> str:
        return str((await self.request(**message))["text"])

    async def request(self, **message: Any) -> dict[str, Any]:
        self.asked.append(message)
        return self.reply

    def interrupt(self) -> None:
        self.interrupted = True

    def send(self, **_: Any) -> bool:
        return True


@pytest.fixture
def service() -> ConsoleService:
    """Return a service with an open session, whose command ann has."""
    made = ConsoleService(Choice(scenario="scheme-1", rig="mock"), ["scheme-1"], ["mock"], lambda: 100.0)
    made.lease.acquire(ANN, 100.0)
    made.session = cast(SessionProcess, OpenSession())
    return made


def answer(service: ConsoleService, client: Client, **command: Any) -> dict[str, Any]:
    return asyncio.run(act(service, client, command))


@pytest.mark.parametrize("order", ["stop", "hold"])
def test_client_without_the_command_can_stop_and_hold(service: ConsoleService, order: str) -> None:
    assert answer(service, BOB, do="order", order=order)["ok"]
    assert cast(OpenSession, service.session).asked == [{"order": order, **BOB.actor}]


def test_flood_of_holds_is_one_message_and_an_unsent_stop_is_a_signal(service: ConsoleService) -> None:
    session = cast(OpenSession, service.session)

    async def flood() -> list[dict[str, Any]]:
        holds = (act(service, BOB, {"do": "order", "order": "hold"}) for _ in range(1000))
        return list(await asyncio.gather(*holds, act(service, ANN, {"do": "order", "order": "stop"})))

    assert asyncio.run(flood()) == [{"ok": True, "text": ""}] * 1001
    assert session.asked == [{"order": "hold", **BOB.actor}, {"order": "stop", **ANN.actor}]
    session.reply = {"text": "the session receives no messages", "unsent": True}
    answer(service, BOB, do="order", order="stop")
    assert session.interrupted


def test_newcomer_displaces_the_silent_and_idle_but_never_who_has_the_command(service: ConsoleService) -> None:
    service.clients = [Client(str(number) * 16, "watcher", last_rx_s=99.9) for number in range(CLIENTS_MAX - 1)]
    silent, idle = service.clients[7], service.clients[9]
    for each in service.clients:
        each.acted_s = 50.0
    idle.acted_s, silent.last_rx_s, silent.acted_s = 10.0, 90.0, 99.0
    service.clients.append(ANN)
    for displaced in (silent, idle):
        service.admit(Client("n" * 16, "newcomer", acted_s=99.9))
        assert [each for each in service.clients if each.displaced.is_set()] == [displaced]
        service.dismiss(displaced)
    for _ in range(40):
        service.admit(Client("m" * 16, "crowd"))
    assert not ANN.displaced.is_set()


@pytest.mark.parametrize("order", ["home", "arm", "start", "resume", "abort", "go", "park", "reset", "disarm"])
def test_client_without_the_command_can_move_nothing(service: ConsoleService, order: str) -> None:
    text = answer(service, BOB, do="order", order=order, confirmed=True)["text"]
    assert text == "ann has the command: take it before sending orders"
    for request in ({"do": "open", "confirmed": True}, {"do": "jog", "axis": "rails.x", "direction": 1}):
        assert "take it before" in answer(service, BOB, **request)["text"]
    assert not cast(OpenSession, service.session).asked


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ("  ann ", "ann"),
        ("ann\x1b[2J\x07", "ann[2J"),
        ("\ud800ann\udfff", "ann"),
        ("a\nb\r\0c", "abc"),
        ("\u202eevil", "evil"),
        ("x" * 10_000, "x" * 24),
        ("J\u00fcrgen", "J\u00fcrgen"),
    ],
)
def test_names_of_clients_are_printable_and_short(given: str, name: str) -> None:
    assert app.plain_name(given) == name
    assert name.encode().decode() == name


def test_log_of_the_console_is_one_printable_line_each(service: ConsoleService) -> None:
    printed: list[str] = []
    service._print = printed.append
    service.log("bob\x1b[2J\nstopped \ud800" + "x" * 5000)
    (line,) = printed
    assert line.isprintable()
    assert len(line) < 1100
    line.encode()


def test_deep_long_and_unknown_messages_are_no_requests() -> None:
    for text in (
        "[" * 4000,
        '{"a":' * 800 + "1" + "}" * 800,
        "{" * 5000,
        "1",
        "null",
        "",
        "9" * 4000,
        '{"a": "\\ud800"}',
    ):
        assert app._table(text) is None
    assert app._table('{"do": "beat"}') == {"do": "beat"}


def test_no_setting_in_flight_switches_off_control_gate_or_supervision() -> None:
    scenario = load_scenario("scheme-1")
    tuner = Tuner(Job(scenario, load_rig("mock"), 0, 10.0, 1.0))
    for key in scenario.value.console.adjustable:
        for value in (1e300, -1e300, 1e9, -1.0, float("inf"), float("nan")):
            with pytest.raises(RequestRejected, match=key):
                tuner.change(key, value)
    with pytest.raises(RequestRejected, match=r"gate_sigma: 100: during a run allowed 2 to 10"):
        tuner.change("gnc.navigation.gate_sigma", 100.0)


@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2", "scheme-3"])
def test_shipped_scenarios_are_within_the_ranges_of_a_run(scheme: str) -> None:
    table = load_scenario(scheme).value.model_dump()
    for key in live_ranges(Scenario):
        value: Any = table
        for name in key.split("."):
            value = value[name]
        allowed = range_of(Scenario, key)
        assert within(allowed, value), key
        assert allowed["low"] is not None
        assert allowed["high"] is not None


REQUESTS = (
    {"do": "order", "order": "start", "confirmed": True, "id": 3},
    {"do": "open", "scenario": "scheme-1", "rig": "mock", "seed": 1},
    {"do": "adjust", "key": "gnc.control.deadband_m", "value": 0.004},
    {"do": "jog", "axis": "rails.x", "direction": 1},
    {"do": "fault", "device": "io", "line": "on drop"},
    {"do": "watch", "camera": "left"},
    {"do": "beat", "got": 12},
    {"do": "take_over", "confirmed": True},
)


def mutated_messages(count: int) -> list[str]:
    """Return requests with damaged bytes, unexpected values, missing and additional keys."""
    dice = random.Random(7)
    values: tuple[Any, ...] = (None, True, -1, 1e308, 2**70, "", "\ud800", "\x1b[2J", [], {}, [[]], "x" * 3000)
    found = []
    for _ in range(count):
        request: dict[str, Any] = dict(dice.choice(REQUESTS))
        for _ in range(dice.randrange(3)):
            request[dice.choice([*request, "do", "\x00", "id"])] = dice.choice(values)
        text = list(json.dumps(request))
        for _ in range(dice.choice((0, 0, 1, 3))):
            text[dice.randrange(len(text))] = chr(dice.randrange(1, 0x2000))
        found.append("".join(text))
    return found


@pytest.mark.parametrize("count", [2000, pytest.param(100_000, marks=pytest.mark.slow)])
def test_mutated_messages_are_answered_and_change_only_what_they_may(service: ConsoleService, count: int) -> None:
    async def talk() -> None:
        for text in mutated_messages(count):
            message = app._table(text)
            if message is not None:
                service.refresh(BOB, message.get("got"))
                reply = await act(service, BOB, message)
                json.dumps(reply)
                assert isinstance(reply["ok"], bool)
            if service.lease.held_by(BOB):
                service.lease.take_over(ANN, 100.0)

    asyncio.run(talk())
    assert {message["order"] for message in cast(OpenSession, service.session).asked} <= {"stop", "hold"}
    assert all(line["text"].isprintable() for line in service.log_lines)
