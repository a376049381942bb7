"""STOP and HOLD leave the console's page whatever has the focus: keys, mouse and touch on a stub of a session."""

from __future__ import annotations

import itertools
import json
import re
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from tests.support.browsers import BrowserPage, ChromiumPage, ask_by, chromium, firefox, until
from tests.support.console_client import PATIENT, console
from tests.support.run_settings import NEAR, typed
from tests.support.stub_console import StubSession, stub_console
from tests.support.tcp_relay import relay_to

pytestmark = [pytest.mark.wires, pytest.mark.timeout(900)]

ORDERS = {"stop": "stop", "hold": "order_hold"}
WIDTHS = (1280, 390)
LETTERS = {"stop": ("x", "KeyX", "\u0447", "\u03c7", "F8"), "hold": ("h", "KeyH", "\u0440", "\u03b7", "F2")}
LAYOUTS = ("plain", "shift", "caps lock", "cyrillic", "greek", "input method", "other place", "further key")
CONFIRMED = ("home", "arm", "start", "resume", "abort", "go", "park", "reset")
FIELDS = ("fault_device", "fault_kind", "fault_axis", "fault_value")
SETTING = "#settinglist tr:nth-child(1) input"
SETTING_BUTTON = "#settinglist tr:nth-child(1) button"
FOCUS = ("nothing", *FIELDS, *(f"list {name}" for name in FIELDS[:3]), "settings", "setting", "camera", "log",
         "who name", "who token", *(f"confirm {order}" for order in CONFIRMED), "confirm open",
         "confirm setting")  # fmt: skip
BUDGET_MS = 50.0
YES_AFTER_S = 0.45

SCRIPT = """
localStorage.setItem("hil.name", "ann");
window.cells = { begun: 0, sent: [] };
const send = WebSocket.prototype.send;
WebSocket.prototype.send = function (text) {
  const message = JSON.parse(text);
  if (message.do === "order") window.cells.sent.push([message.order, performance.now() - window.cells.begun]);
  return send.call(this, text);
};
for (const kind of ["keydown", "pointerdown"]) {
  window.addEventListener(kind, () => (window.cells.begun = performance.now()), true);
}
"""


@contextmanager
def opened(page: BrowserPage) -> Iterator[StubSession]:
    """Load the page of a console with a stub, and take the command."""
    with stub_console() as (address, _, stub):
        page.open(f"http://{address}/", SCRIPT)
        until(page, "Boolean(window.hil && window.hil.page)")
        ask_by(page, "take")
        until(page, "window.hil.now.lease.mine && !document.body.classList.contains('away')")
        yield stub


def set_focus(page: BrowserPage, stub: StubSession | None, focus: str) -> None:
    """Bring the page from any state into the one named ``focus``. stub: None for a real session in a run."""
    what, _, name = focus.partition(" ")
    mode = Mode.RUNNING
    if name in CONFIRMED:
        mode = min(OperatorCommand(name).modes, key=lambda mode: mode.value)
    if stub is not None:
        stub.mode = mode
    page.evaluate(
        "import('/page/dialogs.js').then((dialogs) => { for (const id of ['confirm', 'who'])"
        " dialogs.closeDialog(document.getElementById(id)); document.getElementById('shade').hidden = true;"
        " for (const list of document.querySelectorAll('select')) list.removeAttribute('size');"
        " document.getElementById('settings').hidden = true; document.activeElement.blur(); scrollTo(0, 0); })"
    )
    until(page, f"document.getElementById('mode').dataset.mode === '{mode.value}'")
    if what in FIELDS or what in ("camera",):
        page.evaluate(f"void document.getElementById('{what}').focus()")
    elif what == "list":
        page.evaluate(f"document.getElementById('{name}').scrollIntoView({{block: 'center'}})")
        page.point("mouse", *middle(page, name))
        until(page, f"document.getElementById('{name}').size > 1")
    elif what == "log":
        page.evaluate("void document.getElementById('loglist').click()")
    elif what == "who":
        page.evaluate("import('/page/dialogs.js').then((d) => d.openDialog(document.getElementById('who')))")
        page.evaluate(f"void document.getElementById('{name}').focus()")
    elif what in ("settings", "setting") or name == "setting":
        page.evaluate("void document.getElementById('settings_open').click()")
        until(page, "!document.getElementById('settings').hidden")
        if what != "settings":
            page.evaluate(f"void document.querySelector('{SETTING}').focus()")
        if name == "setting":
            page.evaluate(f"void (document.querySelector('{SETTING}').value = '0.0003')")
            until(page, f"!window.hil.link.old && (document.querySelector('{SETTING_BUTTON}').click(), true)")
    elif what == "confirm":
        if name == "open":
            page.evaluate("import('/page/dialogs.js').then((d) => d.openDialog(document.getElementById('confirm')))")
        else:
            ask_by(page, f"order_{name}")
    if what == "confirm":
        until(page, "document.getElementById('confirm').open")


def middle(page: BrowserPage, button: str) -> tuple[float, float]:
    x, y = page.evaluate(
        f"(() => {{ const b = document.getElementById('{button}').getBoundingClientRect();"
        " return [b.x + b.width / 2, b.y + b.height / 2]; })()"
    )
    return x, y


def press(page: BrowserPage, order: str, layout: str) -> None:
    letter, code, cyrillic, greek, further = LETTERS[order]
    key = {"shift": letter.upper(), "caps lock": letter.upper(), "cyrillic": cyrillic, "greek": greek,
           "input method": "Process", "further key": further}.get(layout, letter)  # fmt: skip
    code = {"other place": "KeyJ", "further key": further}.get(layout, code)
    page.key(key, code, shift=layout == "shift")


def cell(page: BrowserPage, stub: StubSession, focus: str, order: str, how: str) -> str:
    """Try one cell; return what is wrong with it, "" for nothing."""
    set_focus(page, stub, focus)
    page.evaluate("void (window.cells.sent = [])")
    if how in ("mouse", "touch"):
        page.point(how, *middle(page, ORDERS[order]))
    else:
        press(page, order, how)
    end_s = time.monotonic() + 1.0
    while not (sent := page.evaluate("window.cells.sent")):
        if time.monotonic() > end_s:
            return "nothing left the page"
    (left, after_ms) = sent[0]
    if left != order or len(sent) > 1:
        return f"sent {json.dumps(sent)}"
    return "" if after_ms < BUDGET_MS else f"{after_ms:.0f} ms"


def wrong_cells(page: BrowserPage, cells: list[tuple[str, str, str, int]]) -> list[str]:
    """Try all ``cells``: focus, order, way, width; return those that are wrong."""
    wrong, width = [], 0
    with opened(page) as stub:
        for focus, order, how, of_width in cells:
            if of_width != width:
                width = of_width
                page.resize(width, 720)
            if text := cell(page, stub, focus, order, how):
                wrong.append(f"{focus}, {order}, {how}, {of_width} px: {text}")
    return wrong


EVERY = [
    (focus, order, how, width)
    for width in WIDTHS
    for focus, order, how in itertools.product(FOCUS, ORDERS, (*LAYOUTS, "mouse", "touch"))
]


def test_stop_and_hold_leave_the_page_whatever_has_the_focus() -> None:
    some = [c for i, c in enumerate(EVERY) if i % 11 == 0 or (c[0] in ("settings", "confirm arm") and c[3] == 390)]
    with chromium() as page:
        assert wrong_cells(page, some) == []


ALIVE = (
    "[...document.querySelectorAll('#left button, #halt button, header button')]"
    ".filter((b) => getComputedStyle(b).borderTopStyle !== 'dotted').map((b) => b.id)"
)


def looks_alive(page: BrowserPage) -> list[str]:
    """Return the buttons that look as if they could be pressed."""
    return page.evaluate(ALIVE)  # type: ignore[no-any-return]


def test_page_shows_when_keys_or_orders_do_not_arrive_and_then_no_button_looks_alive() -> None:
    with chromium() as page, stub_console() as (address, service, stub):
        page.open(f"http://{address}/", SCRIPT)
        until(page, "Boolean(window.hil && window.hil.page)")
        ask_by(page, "take")
        until(page, "window.hil.now.lease.mine && document.getElementById('reach').textContent === ''")
        until(page, f"['stop', 'order_hold', 'order_abort'].every((id) => {ALIVE}.includes(id))")

        page.evaluate("void (document.hasFocus = () => false)")
        until(page, "document.getElementById('reach').textContent.startsWith('Keys do not reach this window')")
        assert looks_alive(page) == []
        page.evaluate("void delete document.hasFocus")
        until(page, "document.getElementById('reach').textContent === ''")

        (client,) = service.clients
        client.got, client.sent = 0, 1000  # the console sends nothing more
        begun_s = time.monotonic()
        until(
            page,
            "document.getElementById('reach').textContent.startsWith('No connection to the console: values are 0.')",
        )
        assert time.monotonic() - begun_s > 0.2  # by the page's own clock less than 1 s
        assert looks_alive(page) == []
        page.evaluate("void document.getElementById('order_abort').click()")
        until(page, "document.getElementById('answer').textContent === 'no connection: abort was not sent'")
        page.key("x", "KeyX")  # may arrive all the same
        until(page, "window.cells.sent.length > 0")
        end_s = time.monotonic() + 20.0
        while "stop" not in stub.orders:
            assert time.monotonic() < end_s, "the order did not arrive"
            time.sleep(0.01)


def test_second_click_of_a_double_click_confirms_nothing_and_presses_nothing_behind_the_dialog() -> None:
    with chromium() as page, opened(page) as stub:
        for width in WIDTHS:
            page.resize(width, 720)
            set_focus(page, stub, "confirm abort")
            page.point("mouse", *middle(page, "yes"))
            assert page.evaluate("document.getElementById('confirm').open")
            time.sleep(0.5)
            page.evaluate("void (window.cells.sent = [])")
            where = middle(page, "yes")
            until(page, "!window.hil.link.old")
            page.point("mouse", *where)
            until(page, "!document.getElementById('confirm').open && window.cells.sent.length === 1")
            page.point("mouse", *where)
            time.sleep(0.2)
            assert page.evaluate("window.cells.sent.map((sent) => sent[0])") == ["abort"]
    assert stub.orders == ["abort", "abort"]


NO_ANSWER = ("held key", "held enter", "second finger")
ANSWERS = ("key", "click", "double click", "touch", "aid", "screen reader", *NO_ANSWER)


def answer(page: ChromiumPage, way: str) -> None:
    """Answer yes to the question that the page asks."""
    x, y = middle(page, "yes")
    if way == "key":
        page.key("y", "KeyY")
    elif way.startswith("held"):
        page.hold(*(("y", "KeyY") if way == "held key" else ("Enter", "Enter")))
    elif way == "double click":
        page.page.mouse.dblclick(x, y)
    elif way == "second finger":
        page.second_finger(*middle(page, "question"), x, y)
    elif way == "aid":  # without pointer events
        page.evaluate("void document.getElementById('yes').dispatchEvent(new MouseEvent('click', {detail: 1}))")
    elif way == "screen reader":
        page.evaluate("void document.getElementById('yes').click()")
    else:
        page.point("mouse" if way == "click" else "touch", x, y)


def wrong_answers(cells: Iterable[tuple[str, str, bool]]) -> list[str]:
    """Answer the question of each cell: order, way, whether later than a question needs; return what is wrong."""
    wrong = []
    with chromium() as page, opened(page) as stub:
        for order, way, late in cells:
            set_focus(page, stub, f"confirm {order}")
            stub.orders.clear()
            if late:
                time.sleep(YES_AFTER_S)
            until(page, "!window.hil.link.old")
            answer(page, way)
            due = [order] if late and way not in NO_ANSWER else []
            end_s = time.monotonic() + (2.0 if due else 0.1)
            while time.monotonic() < end_s and not (due and stub.orders):
                page.evaluate("0")
            time.sleep(0.1)
            if stub.orders != due:
                wrong.append(f"{way} to {order}, {'late' if late else 'early'}: {stub.orders}")
    return wrong


def test_question_is_confirmed_by_one_act_given_after_it_could_be_read() -> None:
    assert wrong_answers(zip(itertools.cycle(CONFIRMED), ANSWERS * 2, [True] * 9 + [False] * 9)) == []


@pytest.mark.slow
def test_every_question_is_confirmed_by_one_act_of_each_way() -> None:
    cells = list(itertools.product(CONFIRMED, ANSWERS, (True, False)))
    wrong = wrong_answers(cells)
    print(f"{len(cells)} answers, {len(wrong)} wrong")  # noqa: T201
    assert wrong == []


@pytest.mark.parametrize("delay_s", [0.6, 1.2, pytest.param(2.5, marks=pytest.mark.slow)])
def test_page_shows_how_old_its_values_are_and_then_sends_halts_alone(delay_s: float) -> None:
    with chromium() as page, stub_console() as (address, _, stub), relay_to(address) as relay:
        page.open(f"http://127.0.0.1:{relay.port}/", SCRIPT)
        until(page, "Boolean(window.hil && window.hil.page)")
        ask_by(page, "take")
        until(page, "window.hil.now.lease.mine && document.getElementById('reach').textContent === ''")
        relay.down.delay_s = delay_s
        until(page, f"window.hil.link.age_s > {delay_s}")
        until(page, "/values are .* s old/i.test(document.getElementById('reach').textContent)")
        shown = page.evaluate("document.getElementById('reach').textContent")
        age = re.search(r"alues are (\S+) s old", shown)
        assert age, shown
        assert delay_s - 0.1 <= float(age[1]) < delay_s + 0.6, shown
        assert looks_alive(page) == []
        page.evaluate("void document.getElementById('order_abort').click()")
        until(
            page,
            "/^(values are .* s old|no connection): abort was not sent$/"
            ".test(document.getElementById('answer').textContent)",
        )
        page.key("x", "KeyX")
        until(page, "window.cells.sent.length > 0")
        assert page.evaluate("window.cells.sent.map((sent) => sent[0])") == ["stop"]
        end_s = time.monotonic() + 20.0
        while "stop" not in stub.orders:
            assert time.monotonic() < end_s, "the order did not arrive"
            time.sleep(0.01)
        relay.heal()
        until(page, "document.getElementById('reach').textContent === ''")


def test_page_that_loads_shows_that_stop_does_not_work_yet() -> None:
    with chromium() as page, stub_console() as (address, _, _):
        page.page.route("**/page/*.js", lambda route: route.abort())
        page.open(f"http://{address}/", "")
        shown = page.evaluate("document.getElementById('reach').innerText")
        assert shown == "This page is loading: STOP does not work yet, use the emergency stop"


@pytest.mark.slow
@pytest.mark.parametrize("browser", ["chromium", "firefox"])
def test_every_cell_of_stop_and_hold(browser: str, tmp_path: Path) -> None:
    with chromium() if browser == "chromium" else firefox(tmp_path) as page:
        wrong = wrong_cells(page, EVERY)
    print(f"{browser}: {len(EVERY)} cells, {len(wrong)} wrong")  # noqa: T201
    assert wrong == []


KINDS = ("nothing", "fault_value", "list fault_device", "setting", "who name", "confirm abort", "confirm setting")
WAYS = ("plain", "shift", "caps lock", "cyrillic", "greek", "mouse", "touch")
STOPPED = {"stop": ("safe-stop", "standby", "off"), "hold": ("hold",)}
STOPS_WITHIN_MS = 500.0
WATCH = """
setInterval(() => {
  const { cells, hil } = window;
  if (!cells.goal || cells.reached || !cells.goal.includes(hil.now.mode)) return;
  cells.reached = performance.now() - cells.begun;
}, 5);
"""


def ask(page: BrowserPage, **message: object) -> dict[str, object]:
    answer: dict[str, object] = page.evaluate(f"window.hil.link.ask({json.dumps(message)})")
    return answer


def bring_to_run(page: BrowserPage, rig: str) -> None:
    """Bring the session into a run, from wherever it is."""
    mode = "document.getElementById('mode').dataset.mode"
    if page.evaluate("window.hil.now.mode") == "hold":
        assert ask(page, do="order", order="resume", confirmed=True)["ok"]
    elif page.evaluate("window.hil.now.mode") != "running":
        until(page, "!window.hil.now.open", 300.0)  # the first one compiles what judges a run
        ask(page, do="acknowledge")
        assert ask(page, do="open", scenario="scheme-1", rig=rig, confirmed=True)["ok"]
        for order, before in (("arm", "standby"), ("start", "armed")):
            until(page, f"{mode} === '{before}'", 240.0)
            while not ask(page, do="order", order=order, confirmed=True)["ok"]:
                time.sleep(0.1)  # the console has the mode a little before the loop receives orders
    until(page, f"{mode} === 'running'", 60.0)


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["mock", "emulated"])
def test_bench_is_off_or_on_hold_within_half_a_second(rig: str) -> None:
    cells = [
        (focus, "hold" if (i + j) % 2 else "stop", way, WIDTHS[(i // 2 + j) % 2])
        for i, focus in enumerate(KINDS)
        for j, way in enumerate(WAYS)
    ]
    took_ms = []
    with console("--rig", rig, *typed(*NEAR), *PATIENT) as c, chromium() as page:
        page.open(f"http://{c.address}/", SCRIPT)
        until(page, "Boolean(window.hil && window.hil.page)")
        page.evaluate(WATCH)
        assert ask(page, do="take")["ok"]
        for focus, order, way, width in cells:
            page.resize(width, 720)
            bring_to_run(page, rig)
            set_focus(page, None, focus)
            page.evaluate(f"void Object.assign(window.cells, {{ reached: 0, goal: {json.dumps(STOPPED[order])} }})")
            if way in ("mouse", "touch"):
                page.point(way, *middle(page, ORDERS[order]))
            else:
                press(page, order, way)
            until(page, "window.cells.reached > 0")
            took_ms.append((page.evaluate("window.cells.reached"), focus, order, way, width))
            page.evaluate("void (window.cells.goal = null)")
    slow = [cell for cell in took_ms if cell[0] > STOPS_WITHIN_MS]
    print(f"{rig}: {len(took_ms)} cells, {len(slow)} slow, longest {max(took_ms)}")  # noqa: T201
    assert slow == []
