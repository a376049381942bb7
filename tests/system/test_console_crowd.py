"""An operator's page opens and stops the bench whatever crowd is at the console."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import pytest
from websockets.exceptions import WebSocketException
from websockets.sync.client import ClientConnection, connect

from hil.parts.console.app import _REQUEST_PERIOD_S
from hil.parts.console.strangers import Access
from tests.support.console_client import Page, console
from tests.support.run_settings import NEAR, typed
from tests.support.stub_console import stub_console

pytestmark = [pytest.mark.wires, pytest.mark.timeout(300)]

TOKEN = "0123456789abcdef-right"
OPENS_WITHIN_S, STOPS_WITHIN_S = 1.0, 0.5


@contextmanager
def hello(address: str, name: str, token: str = TOKEN) -> Iterator[ClientConnection]:
    """Connect, and send the first message, from the address of the operator."""
    with connect(f"ws://{address}/ws", open_timeout=10.0, close_timeout=0.1, max_size=None) as there:
        there.send(json.dumps({"key": name * 16, "name": name, "token": token}))
        yield there


def sockets(address: str, number: int, stack: ExitStack) -> None:
    """Open sockets that send no first message."""
    for _ in range(number):
        with suppress(OSError, WebSocketException, TimeoutError):
            stack.enter_context(connect(f"ws://{address}/ws", open_timeout=2.0, close_timeout=0.1))


def idle(address: str, number: int, stack: ExitStack) -> None:
    """Open pages that send nothing more and read nothing."""
    for n in range(number):
        stack.enter_context(hello(address, f"idle{n}"))


def guesses(address: str, number: int, stack: ExitStack) -> None:
    """Send wrong tokens."""
    for _ in range(number):
        with suppress(OSError, WebSocketException, TimeoutError), hello(address, "guess", TOKEN + "x") as there:
            there.recv(5.0)  # the challenge
            there.recv(5.0)


def flood(address: str, number: int, stack: ExitStack) -> None:
    """Let pages without the command send HOLD, requests to watch, and garbage without a pause."""
    ended = threading.Event()

    def send(there: ClientConnection) -> None:
        with suppress(OSError, WebSocketException):
            while not ended.is_set():
                for text in (
                    '{"do": "order", "order": "hold", "id": 1}',
                    '{"do": "watch", "camera": "x", "id": 2}',
                    "{",
                ):
                    there.send(text)

    def drain(there: ClientConnection) -> None:
        with suppress(OSError, WebSocketException, TimeoutError):
            while not ended.is_set():
                there.recv(1.0)

    stack.callback(ended.set)
    for n in range(number):
        there = stack.enter_context(hello(address, f"viewer{n}"))
        for work in (send, drain):
            threading.Thread(target=work, args=(there,), daemon=True).start()
    time.sleep(0.5)


Crowd = Callable[[str, int, ExitStack], None]


@contextmanager
def opened_page(address: str) -> Iterator[tuple[Page, float]]:
    """Give an operator's page that has received the state, and the time that took."""
    begun_s = time.monotonic()
    with hello(address, "ann") as there:
        page = Page(there)
        page.until(lambda: True, "the state", 10.0)
        yield page, time.monotonic() - begun_s


@pytest.mark.parametrize(("crowd", "number"), [(sockets, 60), (idle, 32), (guesses, 60), (flood, 5)])
def test_operator_stops_a_stub_in_a_crowd(crowd: Crowd, number: int) -> None:
    """Server and crowd share one interpreter: how long it takes is measured below."""
    with stub_console(Access(TOKEN)) as (address, _, stub), ExitStack() as stack:
        begun_s = time.monotonic()
        crowd(address, number, stack)
        with opened_page(address) as (page, _):
            assert page.ask("order", order="stop")["ok"]
        holds, took_s = stub.orders.count("hold"), time.monotonic() - begun_s
        assert "stop" in stub.orders
    if crowd is flood:
        assert holds > 0
        assert holds <= number * (1.0 + took_s / (3.0 * _REQUEST_PERIOD_S))  # each third message of a page is one


@pytest.mark.slow
@pytest.mark.parametrize(("crowd", "number"), [(sockets, 500), (idle, 32), (guesses, 1000), (flood, 20)])
def test_operator_s_page_opens_within_1_s_and_stops_within_half_a_second(
    crowd: Crowd, number: int, tmp_path: Path
) -> None:
    token = tmp_path / "token"
    token.touch(mode=0o600)
    token.write_text(TOKEN)
    options = ("--rig", "mock", "--token-file", str(token), *typed(*NEAR, "rig.console.lease_s=60"))
    with console(*options) as c:
        page = c.page("bob", TOKEN)
        assert page.ask("take_over", confirmed=True)["ok"]
        page.start_run()
        page.socket.close()
        with ExitStack() as stack:
            crowd(c.address, number, stack)
            with opened_page(c.address) as (ann, took_s):
                begun_s = time.monotonic()
                assert ann.ask("order", order="stop")["ok"]
                ann.until(lambda: ann.now["mode"] in ("safe-stop", "standby", "off"), "the stop", 10.0)
                stopped_s = time.monotonic() - begun_s
    print(f"{crowd.__name__}, {number}: page after {took_s:.3f} s, stopped after {stopped_s:.3f} s")  # noqa: T201
    assert took_s < OPENS_WITHIN_S
    assert stopped_s < STOPS_WITHIN_S
