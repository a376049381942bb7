"""Freshness of requests: what comes late is refused with its reason, jogs have a deadline, STOP always acts."""

from __future__ import annotations

import asyncio
import json
import socket
from typing import Any, cast

import pytest

from hil.core.operator_commands import OperatorCommand
from hil.parts.console.freshness import ACT_S, JOG_HOLD_S, MOVING
from hil.parts.console.live_view import Client
from hil.parts.console.remote_operator import OutgoingMessages, RemoteOperator
from hil.parts.console.service import ConsoleService
from hil.parts.console.session import Choice
from hil.parts.console.session_process import SessionProcess

NOW_S = 100.0


class Session:
    """An open session that executes everything."""

    ready = True

    def __init__(self) -> None:
        self.got: list[dict[str, Any]] = []

    def send(self, **message: Any) -> bool:
        self.got.append(message)
        return True

    async def request(self, **message: Any) -> dict[str, Any]:
        self.got.append(message)
        return {"text": ""}

    async def ask(self, **message: Any) -> str:
        return str((await self.request(**message))["text"])


@pytest.fixture
def ann() -> Client:
    return Client("a" * 16, "ann", page="p")


@pytest.fixture
def service(ann: Client) -> ConsoleService:
    made = ConsoleService(Choice(scenario="scheme-1", rig="mock"), ["scheme-1"], ["mock"], lambda: NOW_S)
    made.lease.acquire(ann, NOW_S)
    made.session = cast(SessionProcess, Session())
    return made


def answer_of(service: ConsoleService, client: Client, **command: Any) -> dict[str, Any]:
    return asyncio.run(service.execute(client, command))


@pytest.mark.parametrize("do", sorted(MOVING))
@pytest.mark.parametrize("age_s", [ACT_S + 0.01, 12.0])
def test_request_that_was_given_long_ago_is_refused(
    service: ConsoleService, ann: Client, do: str, age_s: float
) -> None:
    answer = answer_of(service, ann, do=do, order="start", confirmed=True, seen_s=NOW_S - age_s, number=1)
    assert not answer["ok"]
    assert "the connection delayed it" in answer["text"]
    assert service.session is not None
    assert not [message for message in cast(Session, service.session).got if {"order", "jog"} & set(message)]


@pytest.mark.parametrize("seen_s", [None, True, "100", float("nan"), NOW_S + 0.1, [NOW_S]])
def test_request_without_what_was_seen_is_refused(service: ConsoleService, ann: Client, seen_s: Any) -> None:
    assert "required is wall_s" in answer_of(service, ann, do="order", order="home", seen_s=seen_s, number=1)["text"]


def test_program_may_send_requests_without_what_it_saw(service: ConsoleService) -> None:
    program = Client("c" * 16, "program")
    service.lease.take_over(program, NOW_S)
    assert answer_of(service, program, do="order", order="home", confirmed=True)["ok"]
    old = answer_of(service, program, do="order", order="home", confirmed=True, seen_s=NOW_S - 1.0, number=1)
    assert "the connection delayed it" in old["text"]


def test_request_out_of_order_is_refused(service: ConsoleService, ann: Client) -> None:
    act = {"do": "order", "order": "home", "confirmed": True, "seen_s": NOW_S}
    assert answer_of(service, ann, **act, number=2)["ok"]
    for number in (2, 1, None, True, "3"):
        assert "required is one above 2" in answer_of(service, ann, **act, number=number)["text"]


@pytest.mark.parametrize("order", ["stop", "hold"])
def test_halt_is_never_refused_for_its_age(service: ConsoleService, ann: Client, order: str) -> None:
    stranger = Client("b" * 16, "bob")
    for client in (ann, stranger):
        assert answer_of(service, client, do="order", order=order, seen_s=NOW_S - 1000.0)["ok"]


def test_deadline_of_an_order_goes_with_it(service: ConsoleService, ann: Client) -> None:
    answer_of(service, ann, do="order", order="start", confirmed=True, seen_s=NOW_S - 0.3, number=1)
    assert cast(Session, service.session).got[-1]["until_s"] == pytest.approx(NOW_S - 0.3 + ACT_S)


class Clock:
    s = 50.0

    def __call__(self) -> float:
        return self.s


def make_operator(clock: Clock) -> tuple[RemoteOperator, socket.socket]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    return RemoteOperator(OutgoingMessages(theirs), cast(Any, None), "hold", 2.0, clock), ours


def test_jog_ends_at_its_deadline_and_at_the_release() -> None:
    clock = Clock()
    operator, console = make_operator(clock)

    def take(**message: Any) -> None:
        console.send(json.dumps(message).encode())
        operator._receive()

    with console, operator._messages.channel:
        take(jog=["rails.x", 1], until_s=clock.s + JOG_HOLD_S)
        assert operator.pending[0] is OperatorCommand.JOG
        for clock.s in (50.0, 50.2, 50.0 + JOG_HOLD_S):  # without a further message
            request = operator.jog_request()
            assert request is not None
            assert request.hold_s == 0.0
        clock.s = 50.01 + JOG_HOLD_S
        assert operator.jog_request() is None
        operator.end_jog()
        take(jog=["rails.x", 1], until_s=clock.s - 0.01)  # waited in the socket
        assert operator.jog_request() is None
        take(jog=["rails.x", 1], until_s=clock.s + JOG_HOLD_S)
        take(release=True)
        assert operator.jog_request() is None
