"""A network between page and console that stalls and heals: nothing moves later than the finger meant it."""

from __future__ import annotations

import json
import random
import select
import time
from collections.abc import Iterator
from contextlib import suppress

import pytest

from hil.parts.console.freshness import ACT_S, JOG_HOLD_S
from tests.support.console_client import Console, Page, console
from tests.support.tcp_relay import Relay, relay_to

pytestmark = pytest.mark.wires
COURSES = 8
STILL_M = 1e-4
"""Motion that the axis has after the end of its command, by its servo."""


@pytest.fixture(scope="module")
def served() -> Iterator[tuple[Console, Relay]]:
    given = ("--scenario", "scheme-1", "--rig", "mock", "--set", "rig.console.lease_s=60")
    with console(*given) as made, relay_to(made.address) as relay:
        yield made, relay


def page_at(served: tuple[Console, Relay], name: str) -> Page:
    made, relay = served
    through = Console(f"127.0.0.1:{relay.port}", made.process, made._pages)
    return through.page(name, key=name * 8)


def send(page: Page, **request: object) -> None:
    """Send a request without waiting for its answer, given at what the page shows."""
    page._number += 1
    page.socket.send(json.dumps({"seen_s": page.now["wall_s"], "number": page._number, **request}))


def watch(page: Page, wall_s: float) -> None:
    """Take what comes for a while."""
    end_s = time.monotonic() + wall_s
    while (left_s := end_s - time.monotonic()) > 0.0:
        if select.select([page.socket.socket], [], [], min(left_s, 0.02))[0]:
            page.look()


def test_jog_ends_and_orders_are_refused_whatever_the_network_holds(served: tuple[Console, Relay]) -> None:
    dice, relay = random.Random(7), served[1]
    page = page_at(served, "ann")
    page.until(lambda: bool(page.page), "the page")
    assert page.ask("take_over", confirmed=True)["ok"]
    assert page.ask("open", confirmed=True)["ok"]
    page.until_mode("standby")
    watcher = served[0].page("watcher")
    for course in range(COURSES):
        page.look()
        held_s, stall_s, after_s = dice.uniform(0.3, 0.8), dice.uniform(1.0, 4.0), dice.uniform(0.0, 0.8)
        axis, direction = dice.choice(("rails.x", "rails.y", "rails.z")), dice.choice((-1, 1))
        begin_s = time.monotonic()
        stalls = dice.choice(((relay.up,), (relay.down,), (relay.up, relay.down)))
        while (now_s := time.monotonic()) < begin_s + held_s + after_s:
            if now_s > begin_s + held_s:
                for each in stalls:
                    relay.hold(each)
            else:
                with suppress(TimeoutError):
                    page.take(0.0)
            send(page, do="jog", axis=axis, direction=direction)
            time.sleep(0.06)
        for each in stalls:
            relay.hold(each)
        send(page, do="release_key")
        send(page, do="order", order="home", confirmed=True)  # which moves if it is executed
        end_s = time.monotonic() + JOG_HOLD_S + 0.3  # and the braking
        while time.monotonic() < end_s:
            watcher.take(1.0)
        still = watcher.now["rail_m"]
        healed_s = time.monotonic() + stall_s
        while time.monotonic() < healed_s + ACT_S:
            if time.monotonic() > healed_s:
                relay.heal()
            watcher.take(1.0)
            moved = max(abs(a - b) for a, b in zip(watcher.now["rail_m"], still, strict=True))
            assert moved < STILL_M, f"course {course}: {axis} moved by {1e3 * moved:.2f} mm"
            assert watcher.now["mode"] == "standby"
        page.look()
        page.until(lambda: page.now["mode"] == "standby", "the healed page")


def test_stop_passes_when_the_way_back_is_held(served: tuple[Console, Relay]) -> None:
    relay = served[1]
    page, watcher = page_at(served, "bob"), served[0].page("second watcher")
    page.until(lambda: page.now["mode"] == "standby", "the page")
    relay.hold(relay.down)
    time.sleep(2.0)
    send(page, do="order", order="stop")
    watcher.until(lambda: not watcher.now["open"] or watcher.now["mode"] != "standby", "the stop", 10.0)
    relay.heal()
