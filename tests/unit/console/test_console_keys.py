"""Who is who at a console with keys: forged names, copied keys and duplicated tabs, at the websocket."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from websockets.exceptions import ConnectionClosedError
from websockets.sync.client import connect

from hil.core.operator_keys import OperatorKey
from hil.parts.console.service import ConsoleService
from hil.parts.console.strangers import Access
from tests.support.console_client import Page, hello
from tests.support.stub_console import StubSession, stub_console

ANN = OperatorKey("ann", "a1" * 32)
BOB = OperatorKey("bob", "b2" * 32, "confirm")
EVE = OperatorKey("eve", "e3" * 32, "watch", ("10.0.0.1",))
KNOWN = {key.id: key for key in (ANN, BOB, EVE)}
STRANGER = OperatorKey("ann", "5a" * 32)
REQUIRED = {"refused": "this console requires the key of an operator: choose its file"}


class Lab:
    """A console with a session that is a stub, and its pages."""

    def __init__(self, address: str, service: ConsoleService, stub: StubSession, pages: ExitStack) -> None:
        self.address, self.service, self.stub, self._pages = address, service, stub, pages

    def page(
        self, known: OperatorKey | None, page: str = "p" * 16, device: str = "", source: str = "127.0.0.1", **more: str
    ) -> Page:
        """Return a page that has sent its first message. more: other values in it."""
        there = connect(f"ws://{self.address}/ws", source_address=(source, 0), close_timeout=0.1)
        made = Page(self._pages.enter_context(there))
        first = hello(made.challenge(), self.address, page, known, "ann", "")
        made.socket.send(json.dumps({**first, "device": device, **more}))
        return made


@pytest.fixture
def lab() -> Iterator[Lab]:
    with stub_console(Access(operators=KNOWN)) as (address, service, stub), ExitStack() as pages:
        yield Lab(address, service, stub, pages)


def shown(page: Page) -> dict[str, Any]:
    page.until(lambda: True, "the state", 10.0)
    me: dict[str, Any] = page.now["me"]
    return me


def test_name_comes_from_the_key_and_a_forged_one_is_ignored_or_refused(lab: Lab) -> None:
    assert shown(lab.page(BOB, name="ann")) == {"name": "bob", "key": BOB.id, "rights": "confirm"}
    for forged in (
        lab.page(None),  # a name alone
        lab.page(STRANGER),  # a key of its own with the name of another
        lab.page(BOB, operator=ANN.id),  # the proof of another key
        lab.page(ANN, proof=""),
        lab.page(ANN, key="q" * 16),  # a proof that was made for another page
        lab.page(ANN, proof=ANN.proof("0" * 64, lab.address, "p" * 16)),  # for another challenge
    ):
        assert forged.take() == REQUIRED


def test_copied_key_on_another_machine_is_refused_and_logged_while_the_key_is_in_use(lab: Lab) -> None:
    ann = lab.page(ANN, device="desk")
    assert ann.ask("take")["ok"]
    for copy, place in (
        (lab.page(ANN, source="127.0.0.2", device="desk"), "refused from 127.0.0.2: it is in use at 127.0.0.1"),
        (lab.page(ANN, device="other"), "refused from 127.0.0.1: it is in use at 127.0.0.1 by another browser"),
    ):
        assert copy.take() == {"refused": f"the key of ann was {place}"}
    ann.until(lambda: any("if that is a copy, replace the key" in line for line in ann.log()), "the warning")
    ann.until(lambda: ann.now["lease"]["mine"], "the command")
    assert lab.page(EVE).take() == {"refused": "the key of eve is not accepted from 127.0.0.1, only from 10.0.0.1"}


def test_duplicated_tab_watches_and_a_reloaded_one_continues(lab: Lab) -> None:
    first, duplicate = lab.page(ANN), lab.page(ANN)
    assert first.ask("take")["ok"]
    assert duplicate.ask("take")["text"] == "ann has the command at another page: watch, or take it over"
    assert "take it before" in duplicate.ask("order", order="arm", confirmed=True)["text"]
    first.socket.close()
    duplicate.until(lambda: lab.service.lease.number == 0, "the end of the first tab")
    assert "take it before" in duplicate.ask("order", order="arm", confirmed=True)["text"]
    reloaded = lab.page(ANN)
    reloaded.until(lambda: reloaded.now["lease"]["mine"], "the lease")
    assert not duplicate.now["lease"]["mine"]


def test_rights_bound_what_a_key_may_do_and_everyone_may_stop(lab: Lab) -> None:
    bob = lab.page(BOB)
    assert bob.ask("take")["text"] == "bob may confirm, not command: see the file of --operators"
    assert bob.ask("take_over", confirmed=True)["text"].startswith("bob may confirm, not command")
    assert bob.ask("order", order="stop")["ok"]
    sent = lab.stub.sent[-1]
    assert (sent["by"], sent["key"], sent["rights"]) == ("bob", BOB.id, "confirm")


def test_second_person_has_another_key_and_none_without_keys() -> None:
    with stub_console() as (address, _, stub), ExitStack() as pages:
        page = Lab(address, ConsoleService.__new__(ConsoleService), stub, pages).page(None)
        assert page.ask("take")["ok"]
        reply = {"text": "", "second": "arm", "mode": "standby"}

        async def request(**_: Any) -> dict[str, Any]:
            return reply

        stub.request = request  # type: ignore[method-assign]
        text = page.ask("order", order="arm", confirmed=True)["text"]
        assert text.endswith("whom only a key identifies: start the console with --operators")


def test_first_message_that_a_network_holds_back_is_no_refusal(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    """A page that is refused asks who its operator is; one whose reply was late connects again by itself."""
    monkeypatch.setattr("hil.parts.console.app._HELLO_TIMEOUT_WALL_S", 0.2)
    with connect(f"ws://{lab.address}/ws", close_timeout=0.1) as silent:
        assert "challenge" in json.loads(silent.recv(5.0))
        with pytest.raises(ConnectionClosedError) as closed:
            silent.recv(5.0)
    assert closed.value.rcvd is not None
    assert (closed.value.rcvd.code, closed.value.rcvd.reason) == (4408, "no first message within 0.2 s")
