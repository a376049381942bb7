"""The desk of the console while no session is open: commands that are refused, pictures, and what pages get."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from hil.console.client import Client
from hil.console.confirmations import CONFIRMATIONS
from hil.console.message import ImageMessage, pack, unpack
from hil.console.service import ConsoleService
from hil.console.session import Choice
from hil.console.session_state import SessionState
from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand


@pytest.fixture
def desk() -> ConsoleService:
    choice = Choice(scenario="scheme-1", rig="mock")
    desk = ConsoleService(choice, ["scheme-1", "scheme-2"], ["mock", "emulated"], lambda: 100.0)
    desk.lease.take(ANN.key, ANN.name, 100.0)
    return desk


ANN = Client("a" * 16, "ann")


def ask(desk: ConsoleService, **command: Any) -> str:
    """Return the words with which the desk answers."""
    answer = asyncio.run(desk.obey(ANN, command))
    return str(answer.get("text") or answer.get("ask") or "ok")


@pytest.mark.parametrize(
    ("command", "words"),
    [
        ({"do": "fly"}, "'fly': unknown request"),
        ({}, "None: unknown request"),
        ({"do": "order", "order": "jump"}, "'jump': unknown order"),
        ({"do": "order", "order": "jog"}, "'jog': unknown order"),
        ({"do": "order", "order": "start"}, "bench: cannot start, no session is open"),
        ({"do": "open", "rig": "/etc/passwd"}, "rig '/etc/passwd': allowed mock, emulated"),
        ({"do": "open", "rig": ["mock"]}, "rig ['mock']: allowed mock, emulated"),
        ({"do": "open", "seed": -1}, "seed -1: allowed a whole number from 0 on"),
        ({"do": "open", "seed": 1.5}, "seed 1.5: allowed a whole number from 0 on"),
        ({"do": "open", "seed": True}, "seed True: allowed a whole number from 0 on"),
        ({"do": "jog", "axis": "rails.x", "direction": 1}, "bench: cannot jog, no session is open"),
        ({"do": "fault", "device": "io", "line": "on drop"}, "io: no emulated device with fault switches; here: none"),
    ],
)
def test_what_cannot_be_done_is_refused_in_clear_words(
    desk: ConsoleService, command: dict[str, Any], words: str
) -> None:
    assert ask(desk, **command) == words


def test_every_order_that_moves_the_bench_is_asked_back_and_none_that_stops_it() -> None:
    assert set(OperatorCommand) - set(CONFIRMATIONS) == {
        OperatorCommand.HOLD,
        OperatorCommand.STOP,
        OperatorCommand.DISARM,
        OperatorCommand.JOG,
    }


def test_picture_comes_once_with_its_overlay_and_the_newest_wins(desk: ConsoleService) -> None:
    client = Client("b" * 16, "bob")
    desk.shown.show(ImageMessage("left", 1.0, 640, 480, b"old"))
    desk.shown.show(ImageMessage("left", 2.0, 640, 480, b"new", ({"kind": "cross", "at": [3, 4], "good": True},)))
    header, _, jpeg = unpack(pack(*desk.news_for(client)))
    assert jpeg == b"new"
    assert header["picture"]["overlay"] == [{"kind": "cross", "at": [3, 4], "good": True}]
    assert "picture" not in unpack(pack(*desk.news_for(client)))[0]


def test_page_gets_the_slow_part_of_the_state_when_it_has_changed(desk: ConsoleService) -> None:
    client = Client("b" * 16, "bob")
    assert "page" in unpack(pack(*desk.news_for(client)))[0]
    assert "page" not in unpack(pack(*desk.news_for(client)))[0]
    desk.note("something")
    page = unpack(pack(*desk.news_for(client)))[0]["page"]
    assert page["log"][-1]["text"] == "something"


def test_page_that_tells_what_it_has_gets_no_more_than_it_can_read_in_a_second(desk: ConsoleService) -> None:
    client = Client("b" * 16, "bob", sent=1000)
    assert not client.behind
    desk.heard(client, 981)
    assert not client.behind
    client.sent += 1
    assert client.behind
    desk.heard(client, 990)
    assert not client.behind


def test_lease_that_runs_out_is_logged(desk: ConsoleService) -> None:
    desk.wall_s = lambda: 102.5
    desk.tick()
    assert desk.log[-1]["text"] == "ann is lost: nothing heard for 2 s; nobody has the command"


def alarm(**more: Any) -> dict[str, Any]:
    known = {"t_s": 1.0, "text": "rails.y: drive fault 7, allowed none", "latched": True, "acknowledged": False}
    return known | more


def test_alarm_of_a_session_that_ended_bars_the_next_one_until_it_is_acknowledged_and_reset(
    desk: ConsoleService,
) -> None:
    desk.account.hear({"alarms": [alarm()], "events": [], "hold_reason": ""})
    assert "has not been acknowledged" in ask(desk, do="open")
    assert "has not been acknowledged" in ask(desk, do="order", order="reset")
    assert ask(desk, do="acknowledge") == "ok"
    assert desk.account.page()["alarms"] == [alarm(acknowledged=True)]
    assert ask(desk, do="order", order="reset") == "ok"
    assert desk.account.page()["alarms"] == [alarm(acknowledged=True, latched=False)]


def test_account_logs_each_alarm_and_hold_once() -> None:
    account = SessionState({}, "")
    message = {"alarms": [alarm()], "events": [], "hold_reason": "late cycles"}
    assert account.hear(message) == ["alarm: rails.y: drive fault 7, allowed none", "hold: late cycles"]
    assert account.hear(message) == []
    assert account.mode is Mode.OFF
    assert account.now(5.0) == {}
