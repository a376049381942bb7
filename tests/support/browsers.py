"""Chromium by Playwright and the DevTools protocol, Firefox by WebDriver BiDi, with one interface for both."""

from __future__ import annotations

import itertools
import json
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

import pytest
from websockets.sync.client import ClientConnection, connect

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FIREFOX = shutil.which("firefox-esr") or shutil.which("firefox")
SHIFT = 8  # of the DevTools protocol


class BrowserPage(Protocol):
    """One page of a browser."""

    def open(self, address: str, script: str) -> None:
        """Load ``address``; ``script`` runs before the page's own."""

    def evaluate(self, expression: str) -> Any:
        """Return the JSON value of ``expression``, a promise's when it is fulfilled."""

    def resize(self, width: int, height: int) -> None:
        """Set the size of the page, px."""

    def key(self, key: str, code: str, shift: bool = False) -> None:
        """Press and release a key: its letter in the layout, and its place on the keyboard."""

    def point(self, kind: str, x: float, y: float) -> None:
        """Press and release at a point. kind: mouse or touch."""


def until(page: Any, expression: str, wall_s: float = 20.0) -> None:
    """Wait for ``expression`` on a page, also one of Playwright; a failure states the console's answer."""
    end_s = time.monotonic() + wall_s
    while not page.evaluate(expression):
        answer = "document.getElementById('answer') && document.getElementById('answer').textContent"
        assert time.monotonic() < end_s, f"{expression} did not come; the page's answer: {page.evaluate(answer)!r}"
        time.sleep(0.005)


def ask_by(page: Any, button: str) -> None:
    """Click a button that asks the console, while the page receives: after a frame of 0.5 s it sends nothing."""
    until(page, f"!window.hil.link.old && (document.getElementById('{button}').click(), true)")


class ChromiumPage:
    """``BrowserPage`` of Chromium; keys and touches are trusted events."""

    def __init__(self, browser: Any) -> None:
        self.page = browser.new_page(viewport={"width": 1280, "height": 720}, has_touch=True)
        self._devtools = self.page.context.new_cdp_session(self.page)

    def open(self, address: str, script: str) -> None:
        self.page.add_init_script(script)
        self.page.goto(address)

    def evaluate(self, expression: str) -> Any:
        return self.page.evaluate(expression)

    def resize(self, width: int, height: int) -> None:
        self.page.set_viewport_size({"width": width, "height": height})

    def key(self, key: str, code: str, shift: bool = False) -> None:
        number = ord(code[-1]) if code.startswith("Key") else {"F8": 119, "F2": 113}.get(code, 0)
        event = {"key": key, "code": code, "windowsVirtualKeyCode": number, "modifiers": SHIFT if shift else 0}
        text = {"text": key} if len(key) == 1 else {}
        self._devtools.send("Input.dispatchKeyEvent", {"type": "keyDown", **event, **text})
        self._devtools.send("Input.dispatchKeyEvent", {"type": "keyUp", **event})

    def hold(self, key: str, code: str, times: int = 30) -> None:
        """Repeat a key that was pressed before, for as long as a question needs and longer, and release it."""
        event = {"key": key, "code": code, "windowsVirtualKeyCode": 13 if key == "Enter" else ord(code[-1])}
        text = {"text": "\r" if key == "Enter" else key}
        for _ in range(times):
            down = {"type": "keyDown", "autoRepeat": True, **event, **text}
            self._devtools.send("Input.dispatchKeyEvent", down)
            time.sleep(0.03)
        self._devtools.send("Input.dispatchKeyEvent", {"type": "keyUp", **event})

    def press(self, key: str) -> None:
        """Press a key and keep it down."""
        self._devtools.send("Input.dispatchKeyEvent", {"type": "rawKeyDown", "key": key, "code": key})

    def release(self, key: str) -> None:
        """Release a key."""
        self._devtools.send("Input.dispatchKeyEvent", {"type": "keyUp", "key": key, "code": key})

    def second_finger(self, x: float, y: float, at_x: float, at_y: float) -> None:
        """Tap at the second point while a finger rests on the first."""
        first, second = {"x": x, "y": y, "id": 1}, {"x": at_x, "y": at_y, "id": 2}
        for kind, points in (("Start", [first]), ("Start", [first, second]), ("End", [first]), ("End", [])):
            self._devtools.send("Input.dispatchTouchEvent", {"type": f"touch{kind}", "touchPoints": points})

    def point(self, kind: str, x: float, y: float) -> None:
        (self.page.mouse.click if kind == "mouse" else self.page.touchscreen.tap)(x, y)


class FirefoxPage:
    """``BrowserPage`` of Firefox. Keys are made events, as its protocol has no layouts."""

    def __init__(self, connection: ClientConnection) -> None:
        self._socket = connection
        self._numbers = itertools.count(1)
        self._send("session.new", capabilities={})
        self._context = self._send("browsingContext.getTree")["contexts"][0]["context"]

    def _send(self, method: str, **params: Any) -> Any:
        number = next(self._numbers)
        self._socket.send(json.dumps({"id": number, "method": method, "params": params}))
        while (answer := json.loads(self._socket.recv(60.0))).get("id") != number:
            pass
        assert answer["type"] == "success", answer
        return answer["result"]

    def open(self, address: str, script: str) -> None:
        script += "Document.prototype.hasFocus = () => true;"  # its headless windows never have the focus
        self._send("script.addPreloadScript", functionDeclaration=f"() => {{ {script} }}")
        self._send("browsingContext.navigate", context=self._context, url=address, wait="complete")

    def evaluate(self, expression: str) -> Any:
        wrapped = f"(async () => JSON.stringify(await ({expression}) ?? null))()"
        answer = self._send("script.evaluate", expression=wrapped, target={"context": self._context}, awaitPromise=True)
        assert answer["type"] == "success", answer
        return json.loads(answer["result"]["value"])

    def resize(self, width: int, height: int) -> None:
        self._send("browsingContext.setViewport", context=self._context, viewport={"width": width, "height": height})

    def key(self, key: str, code: str, shift: bool = False) -> None:
        event = json.dumps({"key": key, "code": code, "shiftKey": shift, "bubbles": True, "cancelable": True})
        self.evaluate(f"void document.activeElement.dispatchEvent(new KeyboardEvent('keydown', {event}))")

    def point(self, kind: str, x: float, y: float) -> None:
        steps = [{"type": "pointerMove", "x": round(x), "y": round(y)}]
        steps += [{"type": "pointerDown", "button": 0}, {"type": "pointerUp", "button": 0}]
        pointer = {"type": "pointer", "id": kind, "parameters": {"pointerType": kind}, "actions": steps}
        self._send("input.performActions", context=self._context, actions=[pointer])


@contextmanager
def chromium_browser() -> Iterator[Any]:
    """Give a headless Chromium; skip the test without one."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if CHROMIUM is None:
        pytest.skip("no Chromium on this computer: apt-get install chromium")
    with playwright.sync_playwright() as p:
        browser = p.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", "--disable-gpu"])
        yield browser
        browser.close()


@contextmanager
def chromium() -> Iterator[ChromiumPage]:
    """Give a page of a headless Chromium; skip the test without one."""
    with chromium_browser() as browser:
        yield ChromiumPage(browser)


@contextmanager
def firefox(folder: Path) -> Iterator[FirefoxPage]:
    """Give a page of a headless Firefox with its profile in ``folder``; skip the test without one."""
    if FIREFOX is None:
        pytest.skip("no Firefox on this computer: apt-get install firefox-esr")
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    command = [FIREFOX, "--headless", "--no-remote", "--profile", str(folder), "--remote-debugging-port", str(port)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            end_s = time.monotonic() + 60.0
            while True:
                with suppress(OSError), socket.create_connection(("127.0.0.1", port)):
                    break
                assert time.monotonic() < end_s, "Firefox does not listen"
                time.sleep(0.1)
            with connect(f"ws://127.0.0.1:{port}/session", max_size=None) as connection:
                yield FirefoxPage(connection)
        finally:
            process.terminate()
            with suppress(subprocess.TimeoutExpired):
                process.wait(10.0)
            process.kill()
