"""A rig is commissioned on a phone: the console's page at a width of 390 px, on the emulated rig."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from hil.checks.compatibility import sign_off_gap
from hil.config.load import load_rig
from hil.core.operator_keys import new_key, write_key, write_operators
from tests.support.browsers import chromium_browser
from tests.support.console_client import console

pytestmark = [pytest.mark.wires, pytest.mark.slow, pytest.mark.timeout(600)]

SEEN = """(() => {
  const reply = document.getElementById("reply_yes").getBoundingClientRect();
  const bottom = document.getElementById("stop").getBoundingClientRect().top;
  return reply.top >= 58 && reply.bottom <= bottom && document.documentElement.scrollWidth <= innerWidth;
})()"""
"""Whether the answers are in view, below the mode and above STOP, and nothing scrolls sideways."""
TAP_S = 0.6  # a page does not take the second tap of a double one
WALL_S = 400.0
TAPS_MAX = 4 + 9  # key, command, commission, confirmation, and the questions


def test_rig_is_commissioned_on_a_phone_and_signed_with_the_key(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    ann = new_key("ann")
    write_key(tmp_path / "ann.key", ann)
    write_operators(tmp_path / "operators.toml", {ann.id: ann})
    (tmp_path / "lab.toml").write_text('extends = "emulated"\nio.pump_timeout_s = 0.5\nio.timeout_s = 1.0\n')
    options = ("--rig", "lab.toml", "--operators", "operators.toml")
    with chromium_browser() as browser, console(*options) as served:
        phone = browser.new_context(viewport={"width": 390, "height": 844}, has_touch=True, is_mobile=True)
        page = phone.new_page()
        page.goto(f"http://{served.address}/")
        page.wait_for_selector("#who[open]")
        page.set_input_files("#key_file", tmp_path / "ann.key")
        taps = 0
        for button in ("enter", "take", "commission", "yes"):
            page.wait_for_selector(f"#{button}:not([disabled])")
            time.sleep(TAP_S)
            page.tap(f"#{button}")
            taps += 1
        answered, end_s = 0, time.monotonic() + WALL_S
        while not (page.evaluate("window.hil.page.ended") or page.evaluate("window.hil.page.stop_reason")):
            assert time.monotonic() < end_s, page.evaluate("window.hil.page.log")
            question = page.evaluate("window.hil.page.question")
            if question and question["number"] != answered:
                answered = question["number"]
                time.sleep(TAP_S)
                seen = page.evaluate(SEEN)
                assert seen, question
                page.tap("#reply_yes")
                taps += 1
            time.sleep(0.05)
        assert page.evaluate("window.hil.page.stop_reason") == "", page.evaluate("window.hil.page.log")
        signed = Path(page.evaluate("document.getElementById('rig').value"))
        assert signed == tmp_path / "lab-signed.toml"
        assert taps <= TAPS_MAX
    rig = load_rig(str(signed))
    assert rig.value.sign_off is not None
    assert (rig.value.sign_off.by, rig.value.sign_off.key) == ("ann", ann.id)
    assert not sign_off_gap(rig.value)
