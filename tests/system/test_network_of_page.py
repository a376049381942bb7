"""The console's page in a browser, over a network that stalls and heals: nothing acts later than the hand meant it."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass, field

import pytest

from hil.parts.console.freshness import ACT_S, JOG_HOLD_S
from tests.support.browsers import ChromiumPage, ask_by, chromium, until
from tests.support.console_client import PATIENT, Page, console
from tests.support.run_settings import typed
from tests.support.stub_console import stub_console
from tests.support.tcp_relay import Relay, relay_to

pytestmark = [pytest.mark.wires, pytest.mark.timeout(1800)]
SCRIPT = 'localStorage.setItem("hil.name", "ann");'
STILL_M = 1e-4
"""Motion of an axis after the end of its command, by its servo."""
BRAKES_S = 0.3
READ_S = 0.45
"""Time for a question, before which it takes no answer."""

ANSWERS = """{
    const ask = window.hil.link.ask.bind(window.hil.link);
    window.hil.link.ask = async (message) => (window.hil.last = await ask(message));
}"""
"""Keeps the last answer: an order that was sent as the network stalled may have been accepted."""


@dataclass
class Outcome:
    """What went wrong in the courses: motion after the release, orders that acted late, refusals that are not shown."""

    courses: int = 0
    late_motion: list[str] = field(default_factory=list)
    late_orders: list[str] = field(default_factory=list)
    not_shown: list[str] = field(default_factory=list)

    @property
    def wrong(self) -> list[str]:
        return [*self.late_motion, *self.late_orders, *self.not_shown]


def text(page: ChromiumPage, name: str) -> str:
    return str(page.evaluate(f"document.getElementById('{name}').textContent"))


def course(page: ChromiumPage, watcher: Page, relay: Relay, dice: random.Random, stall_s: float, seen: Outcome) -> None:
    """Jog an axis, or confirm an order, while the network stalls; let it heal and watch the bench."""
    until(page, "!window.hil.link.old && window.hil.now.mode === 'standby' && document.hasFocus()", 60.0)
    until(page, "window.hil.now.lease.mine || (document.getElementById('take').click(), false)", 60.0)
    what = dice.choice(("jog", "order", "jog and halt"))
    stalled = dice.choice(((relay.up,), (relay.down,), (relay.up, relay.down)))
    name = f"{what}, {'up' * (relay.up in stalled)}{'down' * (relay.down in stalled)}, {stall_s:.1f} s"
    page.evaluate("void (window.hil.last = null)")
    if what == "order":
        ask_by(page, "order_home")
        until(page, "document.getElementById('confirm').open")
        time.sleep(READ_S + dice.uniform(0.0, 0.5))
        relay.hold(*stalled)
        time.sleep(dice.uniform(0.0, 1.0))
        page.key("y", "KeyY")
    else:
        page.key(dice.choice("123"), "Digit1")
        key = dice.choice(("ArrowLeft", "ArrowRight"))
        page.press(key)
        time.sleep(dice.uniform(0.1, 0.8))
        relay.hold(*stalled)
        time.sleep(dice.uniform(0.0, 0.8))
        if what == "jog and halt":
            page.key("h", "KeyH")
        page.release(key)
    begun_s = time.monotonic()
    time.sleep(0.5)
    if what == "jog and halt" and not (text(page, "reach") or text(page, "answer")):
        watcher.look()
        if watcher.now["mode"] == "jogging":
            seen.not_shown.append(f"{name}: HOLD neither acts nor is doubted")
    while time.monotonic() < begun_s + ACT_S + JOG_HOLD_S + BRAKES_S:
        watcher.take(1.0)
    still, was_in = watcher.now["rail_m"], watcher.now["mode"]
    while time.monotonic() < begun_s + stall_s + ACT_S:
        if time.monotonic() > begun_s + stall_s:
            relay.heal()
        watcher.take(1.0)
        moved_m = max(abs(a - b) for a, b in zip(watcher.now["rail_m"], still, strict=True))
        if was_in == "standby" and moved_m > STILL_M:
            seen.late_motion.append(f"{name}: {1e3 * moved_m:.2f} mm")
            break
        if watcher.now["mode"] not in (was_in, "standby", "safe-stop"):
            seen.late_orders.append(f"{name}: {watcher.now['mode']}")
            break
    relay.heal()
    if what == "order" and was_in == "standby" and stall_s > ACT_S:  # within that time it may act
        until(page, "document.getElementById('answer').textContent !== '' || window.hil.link.age_s < 0.3", 10.0)
        if not text(page, "answer") and not page.evaluate("Boolean(window.hil.last && window.hil.last.ok)"):
            seen.not_shown.append(f"{name}: no reason")
    watcher.until(lambda: watcher.now["mode"] == "standby", "standby", 120.0)
    page.evaluate("void document.getElementById('no').click()")
    seen.courses += 1


def fly(rig: str, lease_s: float, seed: int, courses: int, longest_s: float) -> Outcome:
    dice, seen = random.Random(seed), Outcome()
    given = ("--scenario", "scheme-1", "--rig", rig, *typed(f"rig.console.lease_s={lease_s}"), *PATIENT)
    with console(*given) as made, relay_to(made.address) as relay, chromium() as page:
        page.open(f"http://127.0.0.1:{relay.port}/", SCRIPT)
        until(page, "Boolean(window.hil && window.hil.page)")
        ask_by(page, "take")
        until(page, "window.hil.now.lease.mine")
        opened = f'window.hil.link.ask({{do: "open", scenario: "scheme-1", rig: "{rig}", confirmed: true}})'
        assert page.evaluate(opened)["ok"]
        until(page, "window.hil.now.mode === 'standby'", 240.0)
        page.evaluate(ANSWERS)
        watcher = made.page("watcher")
        watcher.until(lambda: watcher.now["mode"] == "standby", "standby")
        for _ in range(courses):
            course(page, watcher, relay, dice, min(longest_s, 0.1 * 300.0 ** dice.random()), seen)
    print(f"{rig}, lease {lease_s:g} s, seed {seed}: {seen}")  # noqa: T201
    return seen


def test_network_that_stalls_moves_nothing_late() -> None:
    assert fly("mock", 60.0, 7, courses=4, longest_s=2.0).wrong == []


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["mock", "emulated"])
@pytest.mark.parametrize(("lease_s", "seed"), [(2.0, 1), (5.0, 2), (30.0, 3), (60.0, 4)])
def test_25_courses_of_a_network(rig: str, lease_s: float, seed: int) -> None:
    if rig == "emulated":
        seed += 100
    assert fly(rig, lease_s, seed, courses=25, longest_s=30.0).wrong == []


ROUND_TRIPS_S = [0.02, 0.08, 0.15]


def slow_down(relay: Relay, round_trip_s: float) -> None:
    """Give both directions half of the round trip, of which a quarter is jitter."""
    for each in (relay.up, relay.down):
        each.delay_s, each.jitter_s = 0.375 * round_trip_s, 0.25 * round_trip_s


@pytest.mark.slow
@pytest.mark.parametrize("round_trip_s", ROUND_TRIPS_S)
def test_healthy_network_refuses_no_order(round_trip_s: float) -> None:
    refused = []
    with chromium() as page, stub_console() as (address, _, stub), relay_to(address) as relay:
        page.open(f"http://127.0.0.1:{relay.port}/", SCRIPT)
        until(page, "Boolean(window.hil && window.hil.page)")
        ask_by(page, "take")
        until(page, "window.hil.now.lease.mine")
        slow_down(relay, round_trip_s)
        for _ in range(334):
            answer = page.evaluate("window.hil.link.ask({do: 'order', order: 'abort', confirmed: true})")
            if not answer["ok"]:
                refused.append(answer["text"])
    print(f"{1e3 * round_trip_s:.0f} ms: {len(stub.orders)} orders, {len(refused)} refused {refused[:3]}")  # noqa: T201
    assert refused == []


@pytest.mark.slow
@pytest.mark.parametrize("round_trip_s", ROUND_TRIPS_S)
def test_healthy_network_interrupts_no_jog(round_trip_s: float) -> None:
    interrupted, presses = 0, 40
    with (
        console("--scenario", "scheme-1", "--rig", "mock", *PATIENT) as made,
        relay_to(made.address) as relay,
        chromium() as page,
    ):
        page.open(f"http://127.0.0.1:{relay.port}/", SCRIPT)
        until(page, "Boolean(window.hil && window.hil.page)")
        ask_by(page, "take")
        until(page, "window.hil.now.lease.mine")
        opened = 'window.hil.link.ask({do: "open", scenario: "scheme-1", rig: "mock", confirmed: true})'
        assert page.evaluate(opened)["ok"]
        until(page, "window.hil.now.mode === 'standby'", 240.0)
        watcher = made.page("watcher")
        slow_down(relay, round_trip_s)
        time.sleep(2.0)
        for press in range(presses):
            page.press(("ArrowLeft", "ArrowRight")[press % 2])
            watcher.until(lambda: watcher.now["mode"] == "jogging", "the jog")
            end_s = time.monotonic() + 5.0
            while time.monotonic() < end_s:
                watcher.take(1.0)
                if watcher.now["mode"] != "jogging":
                    interrupted += 1
                    break
            page.release(("ArrowLeft", "ArrowRight")[press % 2])
            watcher.until(lambda: watcher.now["mode"] == "standby", "the end of the jog")
    print(f"{1e3 * round_trip_s:.0f} ms: {presses} jogs of 5 s, {interrupted} interrupted")  # noqa: T201
    assert interrupted == 0
