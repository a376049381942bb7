"""The console's page in a real browser, on the emulated rig. HIL_PICTURES names a folder for its screenshots."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from hil.core.operator_keys import new_key, write_key, write_operators
from hil.recording.read import load
from hil.recording.replay import replay
from tests.support.browsers import chromium_browser
from tests.support.console_client import PATIENT, Console, console
from tests.support.run_settings import NEAR, typed

pytestmark = [pytest.mark.wires, pytest.mark.slow, pytest.mark.timeout(600)]


class Screen:
    """A page in the browser and what it asked for outside of the console."""

    def __init__(self, page: Any, address: str, pictures: Path, name: str = "ann", key: Path | None = None) -> None:
        self.page = page
        self.outside: list[str] = []
        self.errors: list[str] = []
        self._pictures = pictures
        page.on("request", lambda request: self._note(request.url, address))
        page.on("pageerror", lambda error: self.errors.append(str(error)))
        page.add_init_script(f"localStorage.setItem('hil.name', '{name}')")
        page.goto(f"http://{address}/")
        if key is not None:
            page.wait_for_selector("#who[open]")
            page.set_input_files("#key_file", key)
            page.click("#enter")
        self.until("window.hil && window.hil.page")

    def _note(self, url: str, address: str) -> None:
        if f"//{address}/" not in url:
            self.outside.append(url)

    def until(self, expression: str, wall_s: float = 120.0) -> None:
        """Wait for ``expression``; by looks from outside, for the page's own policy forbids evaluation in it."""
        end_s = time.monotonic() + wall_s
        while not self.page.evaluate(expression):
            state = self.page.evaluate("window.hil && [window.hil.now, window.hil.page && window.hil.page.log]")
            assert time.monotonic() < end_s, f"{expression} did not come: {state}"
            time.sleep(0.05)

    def until_other(self, look: Callable[[], str], before: str, wall_s: float = 30.0) -> None:
        """Wait until ``look`` gives something else than ``before``."""
        end_s = time.monotonic() + wall_s
        while look() == before:
            assert time.monotonic() < end_s, "nothing changes"
            time.sleep(0.1)

    def until_mode(self, mode: str, wall_s: float = 120.0) -> None:
        self.until(f"document.getElementById('mode').dataset.mode === '{mode}'", wall_s)

    def press(self, key: str, button: str, confirm: bool = False) -> None:
        """Press a key once its button is there to be pressed; answer the question."""
        self.page.wait_for_selector(f"#{button}:not([disabled])", timeout=30_000)
        self.page.keyboard.press(key)
        if confirm:
            self.page.wait_for_selector("#confirm[open]")
            self.page.keyboard.press("y")

    def picture(self, name: str) -> None:
        self.page.screenshot(path=str(self._pictures / f"console-{name}.png"))


@pytest.fixture
def pictures(tmp_path: Path) -> Path:
    return Path(os.environ.get("HIL_PICTURES", tmp_path))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Return a headless Chromium."""
    with chromium_browser() as found:
        yield found


def open_screen(browser: Any, c: Console, pictures: Path, key: Path | None = None) -> Screen:
    for context in browser.contexts:
        context.close()  # pages of earlier tests draw and look for their consoles
    page = browser.new_page(viewport={"width": 1280, "height": 720})
    return Screen(page, c.address, pictures, key=key)


def test_scheme_1_is_flown_held_resumed_and_aborted_from_the_keyboard(
    browser: Any, pictures: Path, tmp_path: Path
) -> None:
    with console("--rig", "emulated", *typed(*NEAR), *PATIENT, record=tmp_path / "recordings") as c:
        screen = open_screen(browser, c, pictures)
        screen.press("t", "take")
        screen.press("n", "open", confirm=True)
        screen.until_mode("standby", 400.0)  # a first start compiles

        before_m = screen.page.evaluate("window.hil.now.rail_m[1]")
        screen.page.keyboard.press("2")
        screen.page.keyboard.down("ArrowRight")
        screen.until_mode("jogging")
        time.sleep(0.5)
        screen.page.keyboard.up("ArrowRight")
        screen.until_mode("standby")
        assert screen.page.evaluate("window.hil.now.rail_m[1]") > before_m + 0.002

        screen.page.keyboard.press("m")
        screen.page.wait_for_selector("#confirm[open]")
        screen.picture("asks-back")
        screen.page.keyboard.press("Escape")
        assert screen.page.evaluate("window.hil.now.mode") == "standby"
        screen.press("m", "order_arm", confirm=True)
        screen.until_mode("armed")
        screen.press("s", "order_start", confirm=True)
        screen.until_mode("running")
        screen.until("window.hil.now.run_s > 14")
        assert screen.page.evaluate("window.hil.store.count") > 300
        first, second = screen.page.inner_text("#range"), ""
        for _ in range(50):
            time.sleep(0.1)
            second = screen.page.inner_text("#range")
            if second != first:
                break
        assert second != first
        screen.picture("running")

        screen.press("h", "order_hold")
        screen.until_mode("hold")
        held_s = screen.page.evaluate("window.hil.now.run_s")
        time.sleep(1.0)
        assert screen.page.evaluate("window.hil.now.run_s") == held_s
        screen.press("r", "order_resume", confirm=True)
        screen.until_mode("running")
        screen.press("a", "order_abort", confirm=True)
        screen.until("window.hil.store.last('aborted') > 0")
        screen.until("document.getElementById('phase').textContent.startsWith('ABORT')")

        screen.page.select_option("#fault_device", "io")
        screen.page.select_option("#fault_kind", "estop")
        screen.page.click("#fault_on")
        screen.until("window.hil.page.alarms.length > 0")
        screen.until("document.getElementById('alarmline').textContent.includes('emergency stop pressed, allowed')")
        screen.until("!window.hil.now.open")
        screen.picture("alarm")
        assert screen.page.is_enabled("#acknowledge")
        screen.press("n", "open")
        screen.until("document.getElementById('answer').textContent.includes('is not acknowledged')")
        screen.press("c", "acknowledge")
        screen.until("window.hil.page.alarms.every(alarm => alarm.acknowledged)")
        assert "acknowledged" in screen.page.inner_text("#alarmline")
        assert screen.outside == []
        assert screen.errors == []


def start(screen: Screen) -> None:
    """Take the command, open the bench, close the loop."""
    screen.press("t", "take")
    screen.press("n", "open", confirm=True)
    screen.until_mode("standby", 400.0)  # a first start compiles
    screen.press("m", "order_arm", confirm=True)
    screen.until_mode("armed")
    screen.press("s", "order_start", confirm=True)
    screen.until_mode("running")


def image_of(screen: Screen) -> str:
    """Return a digest of what the camera's canvas shows."""
    return str(screen.page.evaluate("document.getElementById('camera').toDataURL().slice(-4000)"))


def test_images_of_each_camera_change_and_the_monitor_s_numbers_are_next_to_them(browser: Any, pictures: Path) -> None:
    rendered = ("--set", "vmu.source=rendered", "--set", "monitor.source=rendered")
    with console("--rig", "emulated", *rendered, *typed(*NEAR), *PATIENT) as c:
        screen = open_screen(browser, c, pictures)
        start(screen)
        screen.until("window.hil.now.cameras.join() === 'vmu.left,vmu.right,monitor'", 240.0)
        for camera, words in (("vmu.left", "VMU left"), ("vmu.right", "VMU right"), ("monitor", "Monitor")):
            screen.until(f"document.getElementById('camera_text').textContent.startsWith('{words} at')")
            screen.until(f"window.hil.camera.picture.name === '{camera}' && window.hil.camera.picture.image !== null")
            assert screen.page.evaluate("window.hil.camera.picture.overlay.length") > 0
            at_s, shown = screen.page.evaluate("window.hil.camera.picture.t_s"), image_of(screen)
            screen.until(f"window.hil.camera.picture.t_s > {at_s}")
            screen.until_other(lambda: image_of(screen), shown)
            screen.picture(f"camera-{camera.replace('.', '-')}")
            screen.press("i", "camera_next")
        screen.until("window.hil.camera.picture.name === 'vmu.left'")
        screen.until("window.hil.store.portions.filter((portion) => portion.r_m).length > 2", 240.0)
        off_m = screen.page.evaluate(
            "(() => { const s = window.hil.store, p = s.portions.findLast((portion) => portion.r_m);"
            " return Math.abs(p.r_m[0] - s.at(Math.min(s.from(p.t_s), s.count - 1), 'bench_m.x')); })()"
        )
        assert off_m < 0.02  # off the encoders, in the plot of both
        screen.page.click("#camera_choice button[data-camera=monitor]")
        screen.press("l", "camera_large")
        screen.until("document.querySelectorAll('#monitor_numbers tr').length === 12")
        assert "\u00b1" in screen.page.inner_text("#monitor_numbers")
        screen.until("window.hil.camera.picture.name === 'monitor'")
        time.sleep(1.0)
        screen.picture("monitor")
        box = screen.page.locator("#camera").bounding_box()
        middle = (box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"])
        screen.page.mouse.move(*middle)
        screen.page.mouse.down()
        screen.page.mouse.move(middle[0] + 150, middle[1] - 100, steps=4)
        screen.page.mouse.up()
        screen.until("window.hil.page.search !== null")
        screen.until("window.hil.camera.picture.overlay.some((shape) => shape.part === 'search')")
        screen.picture("monitor-region")
        screen.press("u", "whole")
        screen.until("window.hil.page.search === null")
        screen.page.keyboard.press("l")
        screen.page.wait_for_selector("#view:not(.big)")
        screen.press("x", "stop")
        screen.until("!window.hil.now.open", 240.0)
        assert screen.errors == []


def test_setting_is_changed_from_the_page_seen_in_the_log_and_recorded(
    browser: Any, pictures: Path, tmp_path: Path
) -> None:
    with console("--rig", "mock", *typed(*NEAR), record=tmp_path) as c:
        screen = open_screen(browser, c, pictures)
        start(screen)
        screen.page.wait_for_selector("#recording.good")
        screen.press("p", "settings_open")
        screen.page.wait_for_selector("#settinglist tr:nth-child(9)")
        screen.page.type("#settinglist tr:nth-child(1) input", "-1\n")
        screen.until("document.getElementById('answer').textContent.includes('-1: during a run allowed 0 to 0.2')")
        screen.page.type("#settinglist tr:nth-child(1) input", "0.0005\n")
        screen.page.wait_for_selector("#confirm[open]")
        question = screen.page.inner_text("#question")
        assert question == "gnc.control.deadband_m: from 0 to 0.0005 m, from the next cycle?"
        screen.picture("settings")
        screen.page.keyboard.press("y")
        screen.until("window.hil.page.log.some((line) => line.text === 'ann: gnc.control.deadband_m = 0.0005, was 0')")
        screen.until("document.querySelector('#settinglist tr td b').textContent === '0.0005'")
        screen.page.keyboard.press("Escape")
        screen.page.wait_for_selector("#settings", state="hidden")
        screen.press("x", "stop")
        screen.until("!window.hil.now.open", 300.0)  # a first run compiles what judges it
        ended = screen.page.evaluate("window.hil.page.ended")
        assert screen.errors == []
    recorded = load(Path(ended["recording"]["file"]))
    (entry,) = [entry for entry in recorded.log if entry["kind"] == "setting"]
    assert (entry["name"], entry["message"]) == ("ann", "gnc.control.deadband_m=0.0005")
    assert 0 < entry["cycle"] < len(recorded.cycles)
    assert replay(recorded, recorded.scenario).identical


def test_arming_takes_a_second_person_and_alarms_are_acknowledged_and_shelved_one_by_one(
    browser: Any, pictures: Path, tmp_path: Path
) -> None:
    blind = "faults=[{device='vmu', kind='no_pose', at_s=3, until_s=9}, {device='imu', kind='stuck', at_s=14}]"
    settings = typed(*NEAR, blind, "rig.console.second_person=['arm']", "rig.console.lease_s=30")
    operators, keys = tmp_path / "operators.toml", {name: new_key(name) for name in ("ann", "bob")}
    write_operators(operators, {key.id: key for key in keys.values()})
    for key in keys.values():
        write_key(tmp_path / key.name, key)
    with console("--rig", "mock", "--operators", str(operators), *settings) as c:
        screen = open_screen(browser, c, pictures, tmp_path / "ann")
        view = {"width": 1280, "height": 720}
        other = Screen(browser.new_page(viewport=view), c.address, pictures, "bob", tmp_path / "bob")
        screen.press("t", "take")
        screen.press("n", "open", confirm=True)
        screen.until_mode("standby", 400.0)  # a first start compiles
        screen.press("m", "order_arm", confirm=True)
        screen.until("!document.getElementById('second').hidden")
        screen.picture("second-waits")
        screen.page.click("#second")
        screen.until("document.getElementById('answer').textContent.includes('another person has to confirm it')")
        assert screen.page.evaluate("window.hil.now.mode") == "standby"
        other.until("!document.getElementById('second').hidden && !document.getElementById('second').disabled")
        other.picture("second")
        other.page.click("#second")
        screen.until_mode("armed")
        screen.press("s", "order_start", confirm=True)
        lost = "window.hil.page.alarms.find(alarm => alarm.quantity === 'accepted poses')"
        screen.until(f"{lost} && {lost}.active")
        screen.picture("conditions")
        row = screen.page.locator("#alarmlist li", has_text="accepted poses")
        assert "medium, active, NEW" in row.inner_text()
        row.click()
        screen.until(f"{lost}.acknowledged && {lost}.acknowledged_by === 'ann'")
        screen.until(f"!{lost}.latched", 60.0)  # poses are back, and it was acknowledged
        new = screen.page.locator("#alarmlist li", has_text="readings")
        new.click(modifiers=["Shift"], timeout=60_000)
        readings = "window.hil.page.alarms.find(alarm => alarm.quantity === 'readings')"
        screen.until(f"{readings}.shelved_until_s > 0 && !{readings}.acknowledged")
        screen.picture("shelved")
        screen.press("x", "stop")
        screen.until("!window.hil.now.open", 300.0)
        assert screen.errors == other.errors == []


def test_reset_leads_out_of_an_alarm_before_the_run_into_standby(browser: Any, pictures: Path) -> None:
    with console("--rig", "emulated", *typed(*NEAR), *PATIENT) as c:
        screen = open_screen(browser, c, pictures)
        screen.press("t", "take")
        screen.press("n", "open", confirm=True)
        screen.until_mode("standby", 400.0)  # a first start compiles
        screen.until("Object.keys(window.hil.page.faults.menu).length == 4")
        screen.page.select_option("#fault_device", "rails")
        screen.page.select_option("#fault_kind", "drive_fault")
        screen.page.select_option("#fault_axis", "y")
        screen.page.click("#fault_on")
        screen.until_mode("safe-stop")
        screen.until("document.getElementById('alarmline').textContent.includes('rails.y')")
        screen.press("c", "acknowledge")
        screen.until("window.hil.page.alarms.every(alarm => alarm.acknowledged && alarm.latched)")
        screen.page.click("#fault_clear")
        screen.press("e", "order_reset", confirm=True)
        screen.until_mode("standby")
        screen.until("window.hil.page.alarms.every(alarm => !alarm.latched)")
        assert screen.page.inner_text("#alarmline") == ""


def test_page_that_lost_its_console_greys_out_and_comes_back(browser: Any, pictures: Path) -> None:
    with console("--rig", "mock") as c:
        screen = open_screen(browser, c, pictures)
        screen.press("t", "take")
        screen.until("window.hil.now.lease.mine")
        c.process.send_signal(signal.SIGSTOP)
        screen.page.wait_for_selector("body.lost")
        c.process.send_signal(signal.SIGCONT)
        screen.page.wait_for_selector("body:not(.lost)")
        assert screen.errors == []


def test_page_fits_the_small_screen_and_every_button_has_a_name(browser: Any, pictures: Path) -> None:
    with console("--rig", "mock") as c:
        screen = open_screen(browser, c, pictures)
        size = screen.page.evaluate("[document.documentElement.scrollWidth, document.documentElement.scrollHeight]")
        assert size == [1280, 720]
        bottom = screen.page.evaluate("document.getElementById('faults').getBoundingClientRect().bottom")
        assert bottom <= 720
        names = screen.page.evaluate("[...document.querySelectorAll('button')].map(b => b.textContent || b.ariaLabel)")
        assert len(names) >= 18
        assert all(names)
        keys = screen.page.evaluate("[...document.querySelectorAll('button[data-key]')].map(b => b.dataset.key)")
        assert len(keys) == len(set(keys))


def test_axes_of_a_target_that_is_rotated_fit_the_page_and_are_jogged(browser: Any, pictures: Path) -> None:
    with console("--rig", "mock-manipulator") as c:
        screen = open_screen(browser, c, pictures)
        screen.press("t", "take")
        screen.press("n", "open", confirm=True)
        screen.until_mode("standby", 400.0)  # a first start compiles
        screen.until("document.querySelectorAll('.axis').length === 9")
        screen.page.keyboard.press("9")
        assert screen.page.inner_text(".axis.chosen span") == "9 t.yaw"
        screen.page.keyboard.down("ArrowLeft")
        screen.until("window.hil.now.target_deg && window.hil.now.target_deg[2] < -0.5")
        screen.picture("manipulator")
        assert screen.page.inner_text(".axis.chosen .where b").endswith("\u00b0/s")
        screen.page.keyboard.up("ArrowLeft")
        screen.until_mode("standby")
        assert screen.page.evaluate("document.getElementById('faults').getBoundingClientRect().bottom") <= 720
        wide = "[...document.querySelectorAll('.axis .where')].filter(at => at.scrollWidth > at.clientWidth).length"
        assert screen.page.evaluate(wide) == 0
        assert "target" in screen.page.inner_text("#ages")
        screen.press("x", "stop")
        screen.until("!window.hil.now.open", 240.0)
        assert screen.errors == []


def test_waived_protections_are_asked_about_and_shown_in_red(browser: Any, pictures: Path, tmp_path: Path) -> None:
    lab = tmp_path / "lab.toml"
    lab.write_text(
        'extends = "emulated"\nname = "lab"\nkind = "hardware"\nio.driver = "none"\nsign_off.waived = true\n'
        'turntable.cia402.channel = "/dev/null"\nvmu.rs422.port = "/dev/null"\n'
        'host.require_realtime = false\nhost.on_overrun = "log"\n'
        + "".join(f"rails.modbus.{name}.port = {port}\n" for port, name in enumerate("xyz", 1))
    )
    with console("--rig", str(lab)) as c:
        screen = open_screen(browser, c, pictures)
        screen.press("t", "take")
        screen.press("n", "open")
        screen.page.wait_for_selector("#confirm[open]")
        assert screen.page.inner_text("#question").count("WAIVED rig.") == 5
        screen.page.keyboard.press("y")
        screen.until("document.querySelectorAll('#waived li').length === 5")
        screen.picture("waived")
        line = screen.page.locator("#waived li").first
        assert line.inner_text().startswith("WAIVED rig.io.driver = none")
        assert line.evaluate("line => getComputedStyle(line).backgroundColor") == "rgb(184, 79, 0)"
        assert screen.errors == []


def test_sensors_have_ages_and_sizes_and_an_excluded_one_is_marked(browser: Any, pictures: Path) -> None:
    fault = '[{device = "sensor.ranger", kind = "offset", at_s = 6.0, value = 0.3}]'
    sensors = ("sensors.ranger.kind=range_finder", "sensors.mocap.kind=pose", 'sensors.mocap.use="witness"')
    with console("--rig", "mock", *typed(*NEAR, *sensors, f"faults={fault}")) as c:
        screen = open_screen(browser, c, pictures)
        screen.press("t", "take")
        screen.press("n", "open", confirm=True)
        screen.until_mode("standby", 400.0)
        screen.press("m", "order_arm", confirm=True)
        screen.until_mode("armed")
        screen.press("s", "order_start", confirm=True)
        screen.until(
            "(window.hil.now.sensors || []).some(s => s.name === 'ranger' && s.sigmas !== null && s.age_s < 0.5)"
        )
        assert [each["name"] for each in screen.page.evaluate("window.hil.now.sensors")] == ["ranger", "mocap"]
        screen.until("window.hil.now.sensors[0].state === 'suspect'")
        screen.until("document.querySelector('#ages span.old')")
        screen.picture("sensors")
        assert screen.page.inner_text("#ages span.old") == "ranger suspect"
        assert "mocap" in screen.page.inner_text("#ages")
        assert screen.errors == []
        screen.press("x", "stop")
        screen.until("!window.hil.now.open", 240.0)
