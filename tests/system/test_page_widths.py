"""The console's page on any screen, in a real browser with a stub of a session: layout and contrast at each width."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hil.core.modes import Mode
from hil.core.operator_keys import OperatorKey, write_key
from hil.parts.console.strangers import Access
from hil.report import html
from tests.support.browsers import ChromiumPage, ask_by, chromium, until
from tests.support.stub_console import stub_console

pytestmark = [pytest.mark.wires(limit_s=1.0), pytest.mark.timeout(120)]

SIZES = ((1280, 720), (1024, 768), (768, 1024), (390, 844))
LONG_ALARM = "turntable.pitch: distance from the demand 3.42 deg, allowed 0.8 deg at rest and 0.05 s of its speed"
STATES = ("running", "settings", "confirm", "who", "lost", "asked")
AXE = Path(__file__).parents[1] / "accessibility/node_modules/axe-core/axe.min.js"
SERIOUS = """axe.run().then((result) => result.violations
  .filter((found) => ["serious", "critical"].includes(found.impact))
  .map((found) => `${found.id}: ${found.nodes.map((node) => node.target).join(", ")}`))"""
ALWAYS = ("stop", "order_hold", "mode", "alarmline")
LAYOUT = """() => {
  const dialog = document.querySelector("dialog[open]"), over = dialog && dialog.getBoundingClientRect();
  const level = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const { position, zIndex } = getComputedStyle(at);
      if (position !== "static" && zIndex !== "auto") return Number(zIndex);
    }
    return 0;
  };
  const hidden = (id) => {
    const element = document.getElementById(id), r = element.getBoundingClientRect();
    if (r.width < 20 || r.top < 0 || r.left < 0 || r.bottom > innerHeight || r.right > innerWidth) return "outside";
    const beside = !over || r.bottom <= over.top || r.top >= over.bottom;
    if (!beside) return "covered by the dialog";
    const top = document.elementFromPoint(r.left + r.width / 2, r.top + r.height / 2);
    if (dialog ? level(element) <= level(document.getElementById("shade")) : !element.contains(top)) return "behind";
    return "";
  };
  const found = Object.fromEntries(IDS.map((id) => [id, hidden(id)]).filter(([, why]) => why));
  if (document.documentElement.scrollWidth > innerWidth) found.scroll = document.documentElement.scrollWidth;
  return found;
}""".replace("IDS", str(list(ALWAYS)))
CONTRAST = """() => {
  const numbers = (color) => color.match(/[\\d.]+/g).map(Number);
  const light = (color) => {
    const [r, g, b] = numbers(color).map((v) => ((v /= 255) <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4));
    return 0.2126 * r + 0.7152 * g + 0.0722 * b;
  };
  const ratio = (a, b) => (Math.max(light(a), light(b)) + 0.05) / (Math.min(light(a), light(b)) + 0.05);
  const behind = (element) => {
    for (let at = element; at; at = at.parentElement) {
      const color = getComputedStyle(at).backgroundColor;
      if ((numbers(color)[3] ?? 1) === 1) return color;
    }
    return "rgb(255, 255, 255)";
  };
  const weak = [];
  for (const element of document.querySelectorAll("body *")) {
    if (!element.checkVisibility() || element.closest("[inert], h1, .unseen, canvas")) continue;
    const style = getComputedStyle(element), name = `${element.tagName} ${element.id || element.parentElement.id}`;
    const says = [...element.childNodes].some((node) => node.nodeType === 3 && node.textContent.trim());
    const text = ratio(style.color, behind(element));
    if (says && text < 4.5) weak.push(`${name}: text ${text.toFixed(2)}`);
    if (!/^(BUTTON|SELECT|INPUT|FIELDSET)$/.test(element.tagName)) continue;
    const border = ratio(style.borderTopColor, behind(element.parentElement));
    if (border < 3) weak.push(`${name}: border ${border.toFixed(2)}`);
  }
  return weak;
}"""


@pytest.fixture(scope="module")
def screens() -> Iterator[ChromiumPage]:
    """Return the page of a running session with an alarm, of an operator who has the command."""
    with chromium() as page, stub_console() as (address, service, stub):
        stub.mode = Mode.RUNNING
        alarm = {
            "t_s": 1.0,
            "text": LONG_ALARM,
            "latched": True,
            "acknowledged": False,
            "priority": "high",
            "number": 1,
        }
        service.state.apply({"alarms": [alarm], "events": [], "hold_reason": ""})
        service.changed()
        page.open(f"http://{address}/", "localStorage.setItem('hil.name', 'ann')")
        until(page, "Boolean(window.hil && window.hil.page)")
        ask_by(page, "take")
        until(page, "window.hil.now.lease.mine && document.getElementById('alarmline').textContent")
        yield page


def show(page: ChromiumPage, state: str) -> None:
    """Bring the page into ``state``."""
    page.evaluate(
        f"""import('/page/dialogs.js').then((dialogs) => {{
          for (const id of ['confirm', 'who']) dialogs.closeDialog(document.getElementById(id));
          document.getElementById('shade').hidden = true;
          document.getElementById('settings').hidden = '{state}' !== 'settings';
          document.getElementById('question').textContent = 'Abort: the chaser brakes and retreats. '.repeat(4);
          if (['confirm', 'who'].includes('{state}')) dialogs.openDialog(document.getElementById('{state}'));
          document.body.classList.toggle('lost', '{state}' === 'lost');
          document.getElementById('procedure').hidden = '{state}' !== 'asked';
          document.getElementById('step').textContent = 'rails.x: commanded +20.00 mm, encoder +20.00 mm';
          document.getElementById('asked').textContent = 'Has the carriage moved along rails.x by +20.00 mm?';
        }})"""
    )


@pytest.mark.parametrize("size", SIZES, ids=lambda size: str(size[0]))
@pytest.mark.parametrize("state", STATES)
def test_nothing_scrolls_sideways_and_what_stops_the_bench_is_always_in_view(
    screens: ChromiumPage, state: str, size: tuple[int, int]
) -> None:
    screens.resize(*size)
    show(screens, state)
    for place in ("0", "document.body.scrollHeight / 2", "document.body.scrollHeight"):
        screens.evaluate(f"scrollTo(0, {place})")
        assert screens.evaluate(LAYOUT) == {}


@pytest.mark.parametrize("size", SIZES, ids=lambda size: str(size[0]))
def test_alarm_of_two_lines_covers_no_question_of_a_commissioning(screens: ChromiumPage, size: tuple[int, int]) -> None:
    screens.resize(*size)
    show(screens, "asked")
    screens.evaluate("scrollTo(0, 0)")
    assert screens.evaluate(LAYOUT.replace(str(list(ALWAYS)), str(["step", "asked", "reply_yes", "reply_no"]))) == {}


@pytest.mark.parametrize("state", STATES)
def test_contrast_of_texts_and_borders_is_sufficient(screens: ChromiumPage, state: str) -> None:
    screens.resize(1280, 720)
    show(screens, state)
    time.sleep(0.1)  # drawn once
    assert screens.evaluate(CONTRAST) == []


@pytest.mark.skipif(not AXE.exists(), reason="axe-core is not installed: npm ci --prefix tests/accessibility")
@pytest.mark.parametrize("size", SIZES, ids=lambda size: str(size[0]))
@pytest.mark.parametrize("state", STATES)
def test_axe_finds_nothing_serious(screens: ChromiumPage, state: str, size: tuple[int, int]) -> None:
    screens.resize(*size)
    show(screens, state)
    if not screens.evaluate("Boolean(window.axe)"):
        screens.evaluate(AXE.read_text(encoding="utf-8"))
    time.sleep(0.1)  # drawn once
    assert screens.evaluate(SERIOUS) == []


def test_settings_leave_every_plot_in_view(screens: ChromiumPage) -> None:
    screens.resize(1280, 720)
    show(screens, "settings")
    covered = screens.evaluate(
        """(() => {
          const s = document.getElementById('settings').getBoundingClientRect();
          const meets = (r) => r.right > s.left && r.left < s.right && r.bottom > s.top && r.top < s.bottom;
          const plots = [...document.querySelectorAll('#plots canvas')];
          return plots.filter((plot) => meets(plot.getBoundingClientRect())).map((plot) => plot.id);
        })()"""
    )
    assert covered == []


def test_lateness_before_a_run_is_no_figure(screens: ChromiumPage) -> None:
    drawn = screens.evaluate(
        """import('/page/chart.js').then(({ Lateness }) => { const canvas = document.createElement('canvas');
        document.body.append(canvas); const texts = []; const context = canvas.getContext('2d');
        context.fillText = (text) => texts.push(text); new Lateness(canvas).draw({ count: 0 }); canvas.remove();
        return texts; })"""
    )
    assert drawn[0] == "Lateness us"


def test_key_is_chosen_once_kept_over_a_reload_and_forgotten_on_signing_out(
    screens: ChromiumPage, tmp_path: Path
) -> None:
    ann = OperatorKey("ann", "a1" * 32)
    write_key(tmp_path / "ann.key", ann)
    (tmp_path / "no.key").write_text("-----BEGIN PRIVATE KEY-----")
    access = Access(operators={ann.id: ann})
    with stub_console(access) as (address, service, _), screens.page.context.browser.new_page() as page:
        page.goto(f"http://{address}/")
        page.wait_for_selector("#who[open] #key_file")
        assert not page.is_visible("#name")
        page.set_input_files("#key_file", tmp_path / "no.key")
        page.click("#enter")
        page.wait_for_selector("#who_text:has-text('not the key file of an operator')")
        page.set_input_files("#key_file", tmp_path / "ann.key")
        page.click("#enter")
        until(page, "window.hil.page && window.hil.now.me.name === 'ann'")
        ask_by(page, "take")
        until(page, "window.hil.now.lease.mine")
        page.reload()
        until(page, "window.hil.page && window.hil.now.lease.mine")  # the command continues
        service.session = None
        until(page, "!window.hil.now.open")
        page.click("#leave")
        page.wait_for_selector("#who[open]")
        page.reload()
        page.wait_for_selector("#who[open] #key_file")


@pytest.mark.parametrize("width", [1280, 794, 768, 390])
@pytest.mark.parametrize("media", ["screen", "print"])
def test_reports_fit_any_screen_and_paper(screens: ChromiumPage, tmp_path: Path, width: int, media: str) -> None:
    rows = [
        ["calibration_motion", "sha256:" + "0123456789abcdef" * 4, "20261125T230617Z-scheme-1-emulated-s0-18c5.mcap"]
    ]
    body = [
        html.heading(1, "Report"),
        html.table(["key", "value", "file"], rows, words=True),
        html.folded("log", "x" * 400),
    ]
    path = tmp_path / "report.html"
    path.write_text(html.page("Report", body))
    with screens.page.context.browser.new_page(viewport={"width": width, "height": 800}) as page:
        page.emulate_media(media=media)
        page.goto(f"file://{path}")
        page.evaluate("document.querySelector('details').open = true")
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") == 0
