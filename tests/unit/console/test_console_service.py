"""Console service without a session: rejected requests, images, and updates of clients."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest

from hil.config.load import load_scene
from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from hil.parts.console.live_view import Client
from hil.parts.console.message import ImageMessage, pack, unpack
from hil.parts.console.service import ConsoleService
from hil.parts.console.session import Choice, SignedBy
from hil.parts.console.session_state import SessionState
from tests.support.acts import act


@pytest.fixture
def service() -> ConsoleService:
    choice = Choice(scenario="scheme-1", rig="mock")
    service = ConsoleService(choice, ["scheme-1", "scheme-2"], ["mock", "emulated"], lambda: 100.0)
    service.lease.acquire(ANN, 100.0)
    return service


ANN = Client("a" * 16, "ann", "a" * 16)


def ask(service: ConsoleService, **command: Any) -> str:
    """Return the text of the answer."""
    answer = asyncio.run(act(service, ANN, command))
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
        ({"do": "open", "seed": -1}, "seed -1: allowed an integer of 0 or more"),
        ({"do": "open", "seed": 1.5}, "seed 1.5: allowed an integer of 0 or more"),
        ({"do": "open", "seed": 2**63}, f"seed {2**63}: allowed an integer of 0 or more"),
        ({"do": "open"}, "Open: the devices open and the drives are powered. Is the bench clear of people?"),
        ({"do": "open", "seed": True}, "seed True: allowed an integer of 0 or more"),
        ({"do": "open", "commission": True}, 'mock: rig.kind "mock": there are no devices to commission'),
        ({"do": "reply", "question": 1, "yes": True}, "no question waits for an answer"),
        ({"do": "jog", "axis": "rails.x", "direction": 1}, "bench: cannot jog, no session is open"),
        (
            {"do": "search", "region": [0, 0, 100, 100]},
            "bench: cannot set a region of search, no session is open",
        ),
        (
            {"do": "fault", "device": "io", "line": "on drop"},
            "io: no emulated device with fault switches; present: none",
        ),
    ],
)
def test_impossible_request_is_rejected_with_its_reason(
    service: ConsoleService, command: dict[str, Any], words: str
) -> None:
    assert ask(service, **command) == words


class AnsweringSession:
    """An open session that takes every message."""

    ready = True

    def __init__(self) -> None:
        self.asked: list[dict[str, Any]] = []

    async def ask(self, **message: Any) -> str:
        self.asked.append(message)
        return ""

    def send(self, **message: Any) -> bool:
        return True


def test_only_who_opened_a_commissioning_answers_it_and_no_is_confirmed(service: ConsoleService) -> None:
    session = AnsweringSession()
    service.session = session  # type: ignore[assignment]
    service.choice = service.choice.model_copy(update={"signed_by": SignedBy(name="bob", key="b" * 16)})
    assert ask(service, do="reply", question=1, yes=True).startswith("bob opened the commissioning and answers its ")
    service.choice = service.choice.model_copy(update={"signed_by": SignedBy(name="ann", key="a" * 16)})
    ask(service, do="reply", question=1, yes=True)
    assert ask(service, do="reply", question=2) == "No: the commissioning ends here, and nothing is signed."
    ask(service, do="reply", question=2, confirmed=True)
    replies = [(message["question"], message["reply"]) for message in session.asked]
    assert replies == [(1, True), (2, False)]


def test_region_of_search_is_checked_sent_and_shown_to_all_pages(service: ConsoleService) -> None:
    session = AnsweringSession()
    service.session = session  # type: ignore[assignment]
    none = "bench: no docking monitor measures on images in this session"
    assert ask(service, do="search", region=[10, 20, 300, 200]) == none
    service.television = load_scene("atv").value.camera
    allowed = "must be u,v,width,height in whole px within the image of 768 x 576, at least 32 x 32"
    for wrong in ([10, 20, 300], "all", [10, 20, 30, 200], [-1, 0, 100, 100], [700, 0, 100, 100], [0, 500, 100, 77],
                  [0.5, 0, 100, 100], [True, 0, 100, 100], [0, 0, 10**30, 100], 7):  # fmt: skip
        assert ask(service, do="search", region=wrong).endswith(allowed)
        assert "\n" not in ask(service, do="search", region=wrong)
    assert session.asked == []
    assert ask(service, do="search", region=[10, 20, 300, 200]) == "ok"
    assert session.asked == [{"search": [10, 20, 300, 200], **ANN.actor}]
    assert service.state.page()["search"] == [10, 20, 300, 200]
    assert service.log_lines[-1]["text"] == "ann: the docking monitor searches 10,20,300,200 px"
    assert ask(service, do="search") == "ok"
    assert (session.asked[-1]["search"], service.state.page()["search"]) == (None, None)
    stranger = asyncio.run(act(service, Client("b" * 16, "bob"), {"do": "search", "region": None}))
    assert not stranger["ok"]


def test_every_command_that_moves_the_bench_requires_confirmation_and_none_that_stops_it() -> None:
    assert {order for order in OperatorCommand if not order.question} == {
        OperatorCommand.HOLD,
        OperatorCommand.STOP,
        OperatorCommand.DISARM,
        OperatorCommand.JOG,
    }


def test_image_comes_once_with_its_overlay_and_the_newest_wins(service: ConsoleService) -> None:
    client = Client("b" * 16, "bob")
    service.view.show(ImageMessage("left", 1.0, 640, 480, b"old"))
    service.view.show(ImageMessage("left", 2.0, 640, 480, b"new", ({"kind": "cross", "at": [3, 4], "good": True},)))
    header, _, jpeg = unpack(pack(*service.update_for(client)))
    assert jpeg == b"new"
    assert header["picture"]["overlay"] == [{"kind": "cross", "at": [3, 4], "good": True}]
    assert "picture" not in unpack(pack(*service.update_for(client)))[0]


def test_page_gets_the_slow_part_of_the_state_when_it_has_changed(service: ConsoleService) -> None:
    client = Client("b" * 16, "bob")
    assert "page" in unpack(pack(*service.update_for(client)))[0]
    assert "page" not in unpack(pack(*service.update_for(client)))[0]
    service.log("something")
    page = unpack(pack(*service.update_for(client)))[0]["page"]
    assert page["log"][-1]["text"] == "something"


def test_page_that_acknowledges_gets_no_more_than_it_can_read_in_a_second(service: ConsoleService) -> None:
    client = Client("b" * 16, "bob", sent=1000)
    assert not client.congested
    service.refresh(client, 981)
    assert not client.congested
    client.sent += 1
    assert client.congested
    service.refresh(client, 990)
    assert not client.congested


def test_lease_that_runs_out_is_logged(service: ConsoleService) -> None:
    service.wall_s = lambda: 102.5
    service.tick()
    assert service.log_lines[-1]["text"] == "ann is lost: no message for 2 s; no operator has the command"


def alarm(**more: Any) -> dict[str, Any]:
    known = {"t_s": 1.0, "text": "rails.y: drive fault 7, allowed none", "latched": True, "acknowledged": False}
    return known | more


def test_alarm_of_a_session_that_ended_bars_the_next_one_until_it_is_acknowledged_and_reset(
    service: ConsoleService,
) -> None:
    service.state.apply({"alarms": [alarm()], "events": [], "hold_reason": ""})
    assert "is not acknowledged" in ask(service, do="open")
    assert "is not acknowledged" in ask(service, do="order", order="reset")
    assert ask(service, do="acknowledge") == "ok"
    assert service.state.page()["alarms"] == [alarm(acknowledged=True)]
    assert ask(service, do="order", order="reset") == "ok"
    assert service.state.page()["alarms"] == [alarm(acknowledged=True, latched=False)]


def test_one_alarm_is_acknowledged_and_one_that_returned_to_normal_no_longer_stands(service: ConsoleService) -> None:
    alarms = [alarm(number=1, active=True), alarm(number=2, active=False)]
    service.state.apply({"alarms": alarms, "events": [], "hold_reason": ""})
    assert ask(service, do="acknowledge", alarm=2) == "ok"
    assert [(a["acknowledged"], a["latched"]) for a in service.state.alarms] == [(False, True), (True, False)]
    assert ask(service, do="acknowledge", alarm=3) == "alarm 3: no such alarm"
    assert ask(service, do="acknowledge", alarm="1") == "alarm '1': allowed is its number"
    assert ask(service, do="shelve", alarm=1, lasting_s=60.0) == "no session is open: nothing to shelve"


def test_second_person_confirms_at_another_page_in_time(
    service: ConsoleService, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rig = tmp_path / "two-persons.toml"
    rig.write_text('extends = "mock"\n[console]\nsecond_person = ["open"]\n')
    service.rigs = (*service.rigs, str(rig))
    opened: list[Choice] = []
    monkeypatch.setattr(service, "start_session", lambda choice, _: opened.append(choice))
    bob, anns_tablet = Client("b" * 16, "bob", "b" * 16, "confirm"), Client(ANN.key, "Ann", ANN.key_id)

    def second(client: Client) -> dict[str, Any]:
        return asyncio.run(act(service, client, {"do": "second", "order": "open"}))

    assert "no such command waits" in second(bob)["text"]
    assert ask(service, do="open", rig=str(rig)).startswith("Open: the devices open")
    assert "waits 30 s for the confirmation" in ask(service, do="open", rig=str(rig), confirmed=True)
    assert service.update_for(bob)[0]["second_person"] == {"order": "open", "by": "ann"}
    watcher = Client("e" * 16, "eve", "e" * 16, "watch")
    assert second(watcher)["text"] == "eve may watch, not confirm: see the file of --operators"
    for same in (ANN, anns_tablet):
        assert second(same)["text"] == "open: ann commanded it, another person has to confirm it"
    assert not opened
    assert second(bob)["ok"]
    assert [choice.rig for choice in opened] == [str(rig)]
    assert "no such command waits" in second(bob)["text"]
    ask(service, do="open", rig=str(rig), confirmed=True)
    service.wall_s = lambda: 131.0
    service.lease.acquire(ANN, 131.0)
    assert "no such command waits" in second(bob)["text"]


def test_account_logs_each_alarm_and_hold_once() -> None:
    state = SessionState({}, "")
    message = {"alarms": [alarm()], "events": [], "hold_reason": "late cycles"}
    assert state.apply(message) == ["alarm: rails.y: drive fault 7, allowed none", "hold: late cycles"]
    assert state.apply(message) == []
    assert state.mode is Mode.OFF
    assert state.live(5.0) == {}


@pytest.mark.parametrize(
    ("message", "text"),
    [
        ({"ended": {"stop": "stopped by the operator"}}, "session ended: stopped by the operator"),
        (
            {"refused": ["the session's process ended by SIGKILL without a result"]},
            "the session's process ended by SIGKILL",
        ),
        ({"ended": {"stop": "completed"}}, ""),
    ],
)
def test_reason_of_a_stop_stays_on_the_page_until_it_is_acknowledged(
    service: ConsoleService, message: dict[str, Any], text: str
) -> None:
    def shown() -> str:
        service.changed()
        page = service.update_for(ANN)[1]
        assert page is not None
        return str(page["stop_reason"])

    service._on_message(message)
    service.state = SessionState({}, "another session")
    assert shown().startswith(text)
    assert bool(shown()) == bool(text)
    assert ask(service, do="acknowledge") == "ok"
    assert shown() == ""
