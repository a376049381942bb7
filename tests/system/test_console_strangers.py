"""Console over TLS, and clients that guess its token while a bench runs."""

from __future__ import annotations

import json
import random
import shutil
import socket
import ssl
import subprocess
import threading
import time
from collections import Counter
from contextlib import AbstractContextManager, ExitStack, suppress
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
from websockets.exceptions import WebSocketException
from websockets.sync.client import connect

from hil.core.operator_keys import new_key, write_operators
from hil.recording.read import load
from tests.support.console_client import Console, Page, console
from tests.support.run_settings import NEAR, UNHURRIED, typed

pytestmark = [pytest.mark.wires, pytest.mark.slow, pytest.mark.timeout(300)]

TOKEN = "0123456789abcdef-right"
GUESSERS = 60
MUTATED = 100_000
CLIENTS = 20


@pytest.fixture
def token_file(tmp_path: Path) -> str:
    path = tmp_path / "token"
    path.touch(mode=0o600)
    path.write_text(TOKEN)
    return str(path)


def start(page: Page) -> None:
    """Take the command, open the bench, close the loop."""
    assert page.ask("take")["ok"]
    page.start_run()


def test_page_and_websocket_over_tls_with_a_certificate_of_the_labs_own(tmp_path: Path) -> None:
    if shutil.which("openssl") is None:
        pytest.skip("no openssl on this computer")
    certificate, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    command = ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "2", "-subj", "/CN=bench"]
    command += ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(certificate)]
    subprocess.run(command, check=True, capture_output=True)
    trusting = ssl.create_default_context(cafile=str(certificate))
    ann, operators = new_key("ann"), tmp_path / "operators.toml"
    write_operators(operators, {ann.id: ann})
    options = ("--host", "0.0.0.0", "--operators", str(operators), "--certificate", str(certificate), "--key", str(key))
    with console("--rig", "mock", *typed(*NEAR), *options) as c:
        c.address = f"127.0.0.1:{c.address.rpartition(':')[2]}"
        with urlopen(f"https://{c.address}/", context=trusting) as answer:
            assert b"<title>hil console</title>" in answer.read()
        page = c.page("ann", operator=ann, ssl=trusting)
        start(page)
        page.order("stop")
        page.until(lambda: not page.now["open"], "the end")
        refused = {"refused": "this console requires the key of an operator: choose its file"}
        assert c.page("eve", operator=new_key("ann"), ssl=trusting).take() == refused
        with pytest.raises(ssl.SSLCertVerificationError):
            c.page("eve", operator=ann, ssl=ssl.create_default_context())
        with pytest.raises((OSError, WebSocketException)):
            connect(f"ws://{c.address}/ws", open_timeout=5.0)


class Guessers:
    """Sockets that guess the token without a pause, from one address, until the block ends."""

    def __init__(self, c: Console) -> None:
        self._address = c.address
        self._ended = threading.Event()
        self.answers: dict[str, int] = {}
        self._threads = [threading.Thread(target=self._guess, args=(n,), daemon=True) for n in range(GUESSERS)]

    def __enter__(self) -> Guessers:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        for thread in self._threads:
            thread.join(10.0)

    def _guess(self, number: int) -> None:
        while not self._ended.is_set():
            there = connect(f"ws://{self._address}/ws", source_address=("127.0.0.2", 0), open_timeout=5.0)
            with suppress(OSError, WebSocketException, TimeoutError), there as page:
                hello = {"key": f"guesser-{number:012d}", "name": "eve", "token": f"0123456789abcdef-{number}"}
                page.recv(10.0)  # the challenge
                page.send(json.dumps(hello))
                text = json.loads(page.recv(10.0))["refused"].partition(":")[0]
                self.answers[text] = self.answers.get(text, 0) + 1


class Lateness:
    """Run times between which a console is attacked, and the wake-up lateness of the loop within and before them."""

    def __init__(self, ann: Page) -> None:
        self._ann = ann
        ann.until(lambda: ann.now["run_s"] > 8.0, "8 s of the run")
        self._from_s = ann.now["run_s"]
        self._to_s = self._from_s

    def attacked_for(self, duration_s: float) -> bool:
        """Return whether the attack has lasted for ``duration_s`` of the run."""
        self._to_s = self._ann.now["run_s"]
        return bool(self._to_s > self._from_s + duration_s)

    def p99_us(self) -> float:
        """End the session; print both distributions and return the 99th percentile under attack."""
        ann = self._ann
        assert ann.now["mode"] == "running", ann.page["alarms"]
        ann.order("stop")
        ann.until(lambda: not ann.now["open"], "the end")
        cycles = load(Path(ann.page["ended"]["recording"]["file"])).cycles
        late_us, t_s = 1e6 * cycles["lateness_s"], cycles["t_s"]
        parts = {"quiet": (t_s > 1.0) & (t_s < self._from_s), "attacked": (t_s >= self._from_s) & (t_s <= self._to_s)}
        found = {name: np.percentile(late_us[which], (50, 99, 100)).round() for name, which in parts.items()}
        print(f"lateness p50 p99 max, us: {found}; {np.count_nonzero(parts['attacked'])} cycles")  # noqa: T201
        return float(found["attacked"][1])


def attacked_console(tmp_path: Path, token_file: str) -> AbstractContextManager[Console]:
    """Return a console whose bench runs on emulated wires."""
    options = ("--rig", "emulated", "--token-file", token_file, *typed(*NEAR, *UNHURRIED, "rig.console.lease_s=10"))
    return console(*options, record=tmp_path)


def test_sixty_sockets_that_guess_the_token_disturb_neither_the_loop_nor_other_clients(
    tmp_path: Path, token_file: str
) -> None:
    with attacked_console(tmp_path, token_file) as c:
        ann = c.page("ann", TOKEN)
        start(ann)
        lateness = Lateness(ann)
        with Guessers(c) as guessers:
            began_s = time.monotonic()
            bob = c.page("bob", TOKEN)
            bob.until(lambda: bob.now["mode"] == "running", "the state")
            joined_s = time.monotonic() - began_s
            ann.until(lambda: lateness.attacked_for(8.0), "8 s more")
        p99_us = lateness.p99_us()
    print(f"bob joined in {joined_s:.2f} s; answers {guessers.answers}")  # noqa: T201
    assert guessers.answers["wrong token"] <= 8
    assert guessers.answers["wrong tokens came from this address"] > 100
    assert joined_s < 3.0
    assert p99_us < 2000.0


MESSAGES = (
    {"do": "beat", "got": 3},
    {"do": "take", "id": 1},
    {"do": "open", "id": 2, "scenario": "scheme-1", "rig": "mock", "seed": 7},
    {"do": "order", "id": 3, "order": "arm", "confirmed": True},
    {"do": "jog", "id": 4, "axis": "rails.x", "direction": 1},
    {"do": "adjust", "id": 5, "key": "gnc.control.deadband_m", "value": 0.004, "confirmed": True},
    {"do": "watch", "id": 6, "camera": "left"},
    {"do": "fault", "id": 7, "device": "rails", "line": "on drop 0.5"},
    {"key": "a" * 24, "name": "eve", "token": "0123456789abcdef-wrong"},
)
"""Without stop and hold, which any client may send."""
ODD = (
    "[" * 4000,
    '{"do":' * 600,
    '{"do": ' + "9" * 4000 + "}",
    '{"do": NaN}',
    '{"do": "order", "order": ["park"]}',
    '{"do": "watch", "camera": {"a": [1e308, null]}}',
    "\x00\ud7ff" * 100,
    "x" * 60_000,
)


def mutated(dice: random.Random) -> str | bytes:
    """Return a message with a few characters changed, removed, doubled or inserted, or an odd one."""
    if dice.random() < 0.05:
        odd = dice.choice(ODD)
        return odd.encode("utf-8") if dice.random() < 0.5 else odd
    text = list(json.dumps(dice.choice(MESSAGES)))
    for _ in range(dice.randrange(4)):
        at = dice.randrange(len(text))
        text[at] = dice.choice(("", text[at] * 2, chr(dice.randrange(1, 0x2000)), '"', "{", "]", "-", "0"))
    return "".join(text)


def test_mutated_messages_disturb_neither_the_loop_nor_other_clients(tmp_path: Path, token_file: str) -> None:
    with attacked_console(tmp_path, token_file) as c:
        ann = c.page("ann", TOKEN)
        start(ann)
        lateness, sent, ended = Lateness(ann), Counter[str](), threading.Event()

        def after_hello(number: int) -> None:
            dice = random.Random(number)
            with connect(f"ws://{c.address}/ws", max_size=None) as eve:
                eve.send(json.dumps({"key": f"eve-{number:012d}", "name": "eve", "token": TOKEN}))
                threading.Thread(target=lambda: [None for _ in eve], daemon=True).start()
                while sent["after"] < MUTATED:
                    eve.send(mutated(dice))
                    sent["after"] += 1
                    time.sleep(0.01)

        def before_hello(number: int) -> None:
            dice = random.Random(number)
            while not ended.is_set():
                there = connect(f"ws://{c.address}/ws", source_address=("127.0.0.2", 0), open_timeout=5.0)
                with suppress(OSError, WebSocketException, TimeoutError), there as eve:
                    eve.recv(10.0)  # the challenge
                    eve.send(mutated(dice))
                    eve.recv(10.0)
                    sent["before"] += 1

        attackers = [
            threading.Thread(target=after_hello if number < CLIENTS else before_hello, args=(number,), daemon=True)
            for number in range(CLIENTS + 4)
        ]
        for each in attackers:
            each.start()
        ann.until(lambda: lateness.attacked_for(0.0) and sent["after"] >= MUTATED, "all messages", 250.0)
        ended.set()
        for each in attackers:
            each.join(20.0)
        assert ann.now["lease"]["mine"]
        p99_us = lateness.p99_us()
    print(f"messages {dict(sent)}")  # noqa: T201
    assert p99_us < 2000.0


def test_idle_connections_of_one_address_do_not_block_others() -> None:
    elsewhere = ("127.0.0.2", 0)
    with console("--rig", "mock") as c, ExitStack() as idle:
        host, _, port = c.address.rpartition(":")
        for _ in range(200):
            idle.enter_context(socket.create_connection((host, int(port)), source_address=elsewhere))
        with urlopen(f"http://{c.address}/", timeout=5.0) as answer:
            assert answer.status == 200
        for _ in range(40):  # that send no first message
            idle.enter_context(connect(f"ws://{c.address}/ws", source_address=elsewhere, close_timeout=0.1))
        page = c.page("ann")
        page.until(lambda: True, "the state")
