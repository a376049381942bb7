"""``hil console``: its server, its session and its security, by a client that is no browser."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.error import HTTPError
from urllib.request import Request, urlopen

import numpy as np
import pytest

from hil.cli.main import BAD_INPUT, PASSED, execute
from hil.config.tables.verdict import PART_COLUMNS
from hil.core.operator_keys import new_key, write_operators
from hil.core.own_code import trusting
from hil.parts.console.serve import is_loopback
from hil.parts.console.session import Choice
from hil.parts.console.session_process import SessionProcess
from hil.recording.catalogue import Catalogue
from hil.recording.read import load
from hil.recording.replay import replay
from tests.support.console_client import Console, Page, console
from tests.support.external_gnc import c_example
from tests.support.run_settings import NEAR, typed

pytestmark = pytest.mark.wires

TOKEN = "0123456789abcdef-right"


@pytest.fixture(scope="module")
def idle() -> Iterator[Console]:
    """Return a console that has no session."""
    with console("--rig", "mock") as c:
        yield c


def start(page: Page) -> None:
    """Take the command, open the bench, close the loop."""
    assert page.ask("take")["ok"]
    assert "Open: the devices open and the drives are powered" in page.ask("open")["ask"]
    page.start_run()
    page.until(lambda: len(page.rows) > 20, "rows of the run")


def test_numbers_move_and_hold_resume_abort_and_a_lost_page_take_effect_and_are_recorded(tmp_path: Path) -> None:
    anns, bobs = new_key("ann"), new_key("bob")
    write_operators(tmp_path / "keys.toml", {key.id: key for key in (anns, bobs)})
    options = ("--operators", str(tmp_path / "keys.toml"), "--set", "rig.console.lease_s=3")
    with console("--rig", "mock", *options, *typed(*NEAR), record=tmp_path) as c:
        ann = c.page("ann", operator=anns)
        start(ann)
        bob = c.page("bob", operator=bobs)  # ignored while the bench opens, seconds on a busy computer
        assert np.all(np.diff(ann.column("t_s")) > 0.0)
        assert np.isfinite(ann.column("estimate_m.x")[-1])

        answer = bob.ask("order", order="resume")
        assert answer["text"] == "ann has the command: take it before sending orders"
        assert "watch, or take it over" in bob.ask("take")["text"]
        assert ann.ask("order", order="abort")["ask"].startswith("Abort: the chaser brakes and retreats")

        bob.order("hold")  # without the command
        ann.until_mode("hold")
        held_s = ann.now["run_s"]
        ann.order("resume")
        ann.until(lambda: ann.now["mode"] == "running" and ann.now["run_s"] > held_s + 0.2, "the run's time to go on")
        ann.order("abort")
        ann.until(lambda: ann.column("aborted")[-1] > 0.0, "the abort")

        ann.beats = False
        bob.until_mode("hold")
        bob.until(lambda: "operator's page silent" in bob.page["hold_reason"], "the reason")
        assert bob.now["lease"]["holder"] == ""

        assert bob.ask("take")["ok"]
        bob.order("stop")
        bob.until(lambda: not bob.now["open"], "the end")
        ended = bob.page["ended"]
        assert ended["stop"] == "stopped by the operator"
        assert ended["accepted"] is False
        assert list(ended["parts"]) == ended["required_parts"] == list(PART_COLUMNS)
        assert (ended["recording"]["dropped"], ended["recording"]["problem"]) == (0, "")
        assert bob.ask("order", order="hold")["text"] == "bench: cannot hold, no session is open"
    recorded = load(Path(ended["recording"]["file"]))
    assert recorded.intact
    assert recorded.summary is not None
    assert len(recorded.cycles) == ended["cycles"]
    assert replay(recorded, recorded.scenario).identical
    did = [(entry["key"], entry["rights"], entry["message"]) for entry in recorded.log if entry["kind"] == "operator"]
    here = "has the command at 127.0.0.1"
    assert did[0][:2] == ("", "local")
    assert did[1:5] == [(anns.id, "command", text) for text in ("opened the bench", f"ann {here}", "arm", "start")]
    assert did[-3] == ("", "", "no operator has the command")
    assert did[-2:] == [(bobs.id, "command", f"bob {here}"), (bobs.id, "command", "stop")]
    assert execute(["recordings", "verify", str(recorded.path)]) == PASSED
    digest = ended["recording"]["audit"]["digest"]
    assert digest == recorded.log[-1]["digest"]
    modes = [entry["message"] for entry in recorded.log if entry["kind"] == "mode"]
    assert modes[-5:] == ["running", "hold", "running", "hold", "safe-stop"]
    (entry,) = Catalogue(tmp_path).runs()
    assert (entry["stop"], entry["cycles"]) == ("stopped by the operator", ended["cycles"])


@pytest.mark.slow
@pytest.mark.parametrize("rig", ["mock", "emulated"])
def test_unconfirmed_orders_from_the_first_moment_of_a_session_move_nothing(rig: str) -> None:
    hazardous = ("arm", "home", "start", "resume", "park", "reset", "go", "abort")
    with console("--rig", rig, "--set", "rig.console.lease_s=30") as c:
        page = c.page("ann")
        assert page.ask("take")["ok"]
        assert page.ask("open", confirmed=True)["ok"]
        answers, end_s = [], time.monotonic() + 400.0
        while time.monotonic() < end_s and sum("ask" in answer for answer in answers) < 100:
            answers += [page.ask("order", order=order) for order in hazardous]
            assert page.now["mode"] in ("off", "standby")
        assert sum("ask" in answer for answer in answers) >= 100
        assert not [answer for answer in answers if answer["ok"]]
        before = page.now["rail_m"]
        page.until(lambda: page.now["bench_s"] > 0.0, "the time")
        assert page.now["rail_m"] == pytest.approx(before, abs=1e-4)
        page.order("stop")


def test_axes_of_a_target_that_is_rotated_are_shown_and_jogged() -> None:
    with console("--rig", "mock-manipulator") as c:
        page = c.page("ann")
        assert page.ask("take")["ok"]
        assert page.ask("open", confirmed=True)["ok"]
        page.until_mode("standby")
        axes = page.page["bench"]["axes"]
        assert list(axes)[6:] == ["target.roll", "target.pitch", "target.yaw"]
        assert axes["target.pitch"] == [-80.0, 80.0]
        page.until(lambda: page.now["homing"] == [2] * 9 and page.now["limit"] == [0] * 9, "nine axes")
        assert page.now["target_deg"] == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)

        def pressed() -> bool:
            page.socket.send('{"do": "jog", "axis": "target.pitch", "direction": 1}')
            assert page.now["target_degps"][1] < 1.5  # with the overshoot of the axis
            steady = page.now["target_degps"][1] == pytest.approx(1.0, abs=0.1)  # a tenth of 10 deg/s
            return bool(page.now["target_deg"][1] > 0.3 and steady)

        page.until(pressed, "a jog")
        assert page.now["mode"] == "jogging"
        page.until_mode("standby")
        assert page.now["target_deg"][1] < 5.0
        turned = page.now["relative"]["gimbal_deg"][1]  # what a target at angles of zero would see
        assert turned == pytest.approx(page.now["gimbal_deg"][1] - page.now["target_deg"][1], abs=0.01)
        assert page.ask("jog", axis="target.w", direction=1)["text"] == "bench: cannot jog target.w by 1"
        page.order("stop")
        page.until(lambda: not page.now["open"], "the end")


@pytest.mark.slow
def test_further_axes_are_shown_and_jogged_by_name(tmp_path: Path) -> None:
    gimbal = "{ travel_deg = [-90.0, 90.0], rate_max_degps = 30.0, acceleration_max_degps2 = 60.0 }"
    rail = "{ travel_m = [0.0, 2.0], rate_max_mps = 1.0, acceleration_max_mps2 = 2.0, encoder = 'incremental' }"
    servo = "driver = 'mock'\nservo = { gain_per_s = 30.0, lag_s = 0.006 }"
    rig = tmp_path / "lamp.toml"
    rig.write_text(
        f"extends = 'mock'\nname = 'lamp'\n[linear_axes.lamp]\n{servo}\nplace_m = [0.0]\nu = {rail}\n"
        f"[rotary_axes.arm]\n{servo}\nplace_deg = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n"
        + "".join(f"{name} = {gimbal}\n" for name in ("roll", "pitch", "yaw", "a", "b", "c"))
    )
    with console("--rig", str(rig)) as c:
        page = c.page("ann")
        assert page.ask("take")["ok"]
        assert page.ask("open", confirmed=True)["ok"]
        page.until_mode("standby")
        axes = page.page["bench"]["axes"]
        assert list(axes)[6:] == ["lamp.u", *(f"arm.{name}" for name in ("roll", "pitch", "yaw", "a", "b", "c"))]
        assert (axes["lamp.u"], axes["arm.c"]) == ([0.0, 2.0], [-90.0, 90.0])
        assert page.page["bench"]["units"] == {"rails": "m", "turntable": "deg", "lamp": "m", "arm": "deg"}
        page.until(lambda: page.now["homing"] == [2] * 6 + [0] + [2] * 6, "thirteen axes")
        page.until(lambda: 0.0 <= page.now["ages_s"]["lamp"] < 0.4, "the age of its feedback")

        def pressed() -> bool:
            page.socket.send('{"do": "jog", "axis": "arm.c", "direction": -1}')
            return bool(page.now["further_axes"]["arm"]["deg"][5] < -0.3)

        page.until(pressed, "a jog")
        page.until_mode("standby")
        further = page.now["further_axes"]
        assert further["arm"]["deg"][:5] == pytest.approx([0.0] * 5, abs=1e-6)
        assert further["lamp"] == {"m": pytest.approx([0.0]), "mps": pytest.approx([0.0])}
        assert page.ask("jog", axis="arm.x", direction=1)["text"] == "bench: cannot jog arm.x by 1"
        page.order("stop")
        page.until(lambda: not page.now["open"], "the end")


def test_region_of_search_goes_from_the_page_to_the_monitor_and_its_frame_comes_back(tmp_path: Path) -> None:
    settings = typed(*NEAR, "monitor.source=rendered")
    with console("--rig", "mock", "--set", "rig.console.lease_s=30", *settings, record=tmp_path) as c:
        ann = c.page("ann")
        start(ann)
        assert ann.ask("watch", camera="monitor")["ok"]
        assert "within the image of 768 x 576" in ann.ask("search", region=[0, 0, 5000, 100])["text"]
        assert ann.ask("search", region=[0, 0, 96, 64])["ok"]
        ann.until(lambda: ann.page["search"] == [0, 0, 96, 64], "the region")
        ann.until(lambda: searched(ann) == [[0, 0], [96, 0], [96, 64], [0, 64]], "the frame")
        ann.until(lambda: ann.picture["status"] == "no_target", "an empty region")
        assert ann.ask("search", region=None)["ok"]
        ann.until(lambda: ann.picture["status"] == "near" and not searched(ann), "the target")
        assert ann.page["search"] is None
        ann.order("stop")
        ann.until(lambda: not ann.now["open"], "the end")
    (file,) = tmp_path.rglob("*.mcap")
    did = [entry["message"] for entry in load(file).log if entry["kind"] == "operator"]
    assert "the docking monitor searches 0,0,96,64 px" in did
    assert "the docking monitor searches the whole image" in did


def searched(page: Page) -> list[list[float]]:
    """Return the corners of the region of search on the newest image."""
    return [shape["from"] for shape in page.picture.get("overlay", []) if shape.get("part") == "search"]


@pytest.mark.slow
def test_gnc_of_the_users_own_is_flown_held_and_aborted_from_the_page(tmp_path: Path) -> None:
    settings = typed(*NEAR, f"gnc.library={c_example(tmp_path)}")
    with console("--rig", "mock", *settings, record=tmp_path) as c:
        page = c.page("ann")
        start(page)
        page.until(lambda: bool(np.isfinite(page.column("estimate_m.x")[-1])), "the library's estimate")
        assert abs(page.column("position_error_mm.x")[-1]) < 50.0
        page.order("hold")
        page.until_mode("hold")
        page.order("resume")
        page.until_mode("running")
        page.order("abort")
        page.until(lambda: page.column("aborted")[-1] > 0.0, "the abort")
        page.order("stop")
        page.until(lambda: not page.now["open"], "the end")
        file = page.page["ended"]["recording"]["file"]
    with trusting(True):
        assert replay(load(Path(file)), load(Path(file)).scenario).identical


@pytest.mark.slow
def test_recorder_that_dies_is_reported_on_the_page_and_the_bench_continues(tmp_path: Path) -> None:
    with console("--rig", "mock", *typed(*NEAR), record=tmp_path) as c:
        page = c.page("ann")
        start(page)
        page.until(lambda: page.now["recording"]["size_bytes"] > 0, "a recording")
        assert page.now["recording"]["trouble"] == ""
        (line,) = [line for line in page.log() if "recorder process" in line]
        os.kill(int(line.split()[-1]), signal.SIGKILL)
        page.until(lambda: "no report of its process" in page.now["recording"]["trouble"], "the trouble")
        at_s = page.now["run_s"]
        page.until(lambda: page.now["run_s"] > at_s + 0.2, "the run to go on")
        page.order("stop")
        page.until(lambda: not page.now["open"], "the end")
        assert any("recording stopped, the bench continues" in line for line in page.log())
        assert "ended by SIGKILL" in page.page["ended"]["recording"]["problem"]


@pytest.mark.slow
def test_disk_that_fills_up_is_reported_on_the_page_and_the_bench_continues(small_disk: Path) -> None:
    with console("--rig", "mock", *typed(*NEAR), record=small_disk) as c:
        page = c.page("ann")
        start(page)
        page.until(lambda: page.now["recording"]["size_bytes"] > 0, "a recording")
        with suppress(OSError):
            (small_disk / "other").write_bytes(bytes(2_000_000))
        page.until(lambda: page.now["recording"]["trouble"] == "No space left on device", "the trouble")
        page.until(lambda: page.now["recording"]["lost"] > 100, "what is lost")
        assert page.now["mode"] == "running"
        assert any("recording stopped, the bench continues" in line for line in page.log())
        page.order("stop")
        page.until(lambda: not page.now["open"], "the end")
        told = page.page["ended"]["recording"]
        assert "No space left on device" in told["problem"]
        assert "hil recover" in told["problem"]
        assert len(load(Path(told["file"])).cycles) > 10  # what was written stands


def test_takeover_requires_confirmation_and_is_logged(idle: Console) -> None:
    ann, bob = idle.page("ann"), idle.page("bob")
    assert ann.ask("take")["ok"]
    assert bob.ask("take_over")["ask"] == "Take the command over from ann, who can then only watch?"
    assert bob.ask("take_over", confirmed=True)["ok"]
    bob.until(lambda: bob.now["lease"]["mine"], "the lease")
    assert "bob took the command over from ann" in bob.log()
    assert ann.ask("open")["text"] == "bob has the command: take it before sending orders"


def test_wrong_token_and_other_sites_are_turned_away_in_clear_words(tmp_path: Path) -> None:
    path = tmp_path / "token"
    path.write_text(TOKEN + "\n")
    path.chmod(0o600)
    with console("--rig", "mock", "--token-file", str(path)) as c:
        for token, words in (("0123456789abcdef-wrong", "wrong token"), ("", "this console requires a token")):
            assert c.page("eve", token).take() == {"refused": words}
        page = c.page("ann", TOKEN)
        page.until(lambda: True, "the state")
        assert not page.refused
        other = c.page("eve", TOKEN, origin="http://elsewhere.example")
        assert other.take() == {"refused": "this console rejects pages of other sites"}
        short = c.page("eve", TOKEN, key="short")
        assert "at least 16" in (short.take() or {})["refused"]
        with pytest.raises(HTTPError) as rebound:
            urlopen(Request(f"http://{c.address}/", headers={"Host": "rebound.example"}))
        assert rebound.value.code == 421
        rebound.value.close()


def test_page_needs_nothing_from_outside(idle: Console) -> None:
    folder = Path(__file__).parents[2] / "hil" / "parts" / "console" / "page"
    for name in ["", *(f"page/{path.name}" for path in folder.iterdir())]:
        with urlopen(f"http://{idle.address}/{name}") as answer:
            text = answer.read().decode()
            assert "default-src 'self'" in answer.headers["Content-Security-Policy"]
        outside = [word for word in ("http://", "https://", "//cdn") if word in text.replace("http://www.w3.org", "")]
        assert not outside, f"{name}: {outside}"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--host", "0.0.0.0"), "--host: 0.0.0.0: reachable from other computers: give --operators, --cert"),
        (("--host", "0.0.0.0", "--token-file", "TOKEN"), "reachable from other computers: give --operators"),
        (("--operators", "KEYS", "--token-file", "TOKEN"), "not together with --operators"),
        (("--operators", "TOKEN"), "not TOML"),
        (("--set", "rig.console.second_person=['arm']"), "--operators: is missing: the rig requires a second person"),
        (("--port", "70000"), "--port: 70000: allowed 0 to 65535"),
        (("--rig", "no-such"), "no-such: unknown rig"),
        (("--seed", "-1"), "--seed: -1: must not be negative"),
        (("--token-file", "/does/not/exist"), "--token-file: /does/not/exist: cannot be read"),
        (("--host", "0.0.0.0", "--operators", "KEYS"), "0.0.0.0: reachable from other computers: give --certificate"),
        (("--host", "not.an.address.invalid", "--operators", "KEYS", "--behind-tunnel"), "cannot listen"),
        (("--certificate", "TOKEN"), "--key: is missing: give both"),
        (("--certificate", "TOKEN", "--key", "TOKEN"), "not a certificate and its private key"),
        (("--token-file", "OPEN"), "readable by other users, mode 644: chmod 600"),
        (("--token-file", "SHORT"), "5 characters, at least 16"),
    ],
)
def test_bad_options_are_refused_in_one_line(
    arguments: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ann = new_key("ann")
    write_operators(tmp_path / "KEYS", {ann.id: ann})
    for name, text, mode in (("TOKEN", TOKEN, 0o600), ("OPEN", TOKEN, 0o644), ("SHORT", "12345", 0o600)):
        (tmp_path / name).write_text(text)
        (tmp_path / name).chmod(mode)
    given = [str(tmp_path / a) if (tmp_path / a).exists() and a.isupper() else a for a in arguments]
    assert execute(["console", *given]) == BAD_INPUT
    said = capsys.readouterr().err
    assert words in said
    assert len(said.strip().splitlines()) == 1


@pytest.mark.slow
def test_console_ends_with_its_session_on_ctrl_c() -> None:
    with console("--rig", "mock", *typed(*NEAR)) as c:
        page = c.page("ann")
        start(page)
        (line,) = [line for line in page.log() if "session process" in line]
        pid = int(line.split()[-1])
    assert c.process.returncode == 0
    with pytest.raises(ProcessLookupError):
        os.kill(pid, 0)


@pytest.mark.slow
def test_session_of_a_console_that_is_killed_brings_the_bench_to_a_stand_and_ends() -> None:
    with console("--rig", "mock", *typed(*NEAR)) as c:
        page = c.page("ann")
        start(page)
        (line,) = [line for line in page.log() if "session process" in line]
        pid = int(line.split()[-1])
        c.process.kill()
        c.process.wait()
        end_s = time.monotonic() + 20.0
        while Path(f"/proc/{pid}").exists():
            assert time.monotonic() < end_s, "the session goes on without its console"
            time.sleep(0.05)


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        ("127.0.0.1", True),
        ("127.5.0.1", True),
        ("::1", True),
        ("localhost", True),
        ("0.0.0.0", False),
        ("::", False),
        ("192.168.1.2", False),
        ("lab-computer", False),
    ],
)
def test_only_this_computers_own_addresses_go_without_a_token(host: str, expected: bool) -> None:
    assert is_loopback(host) is expected


def test_missing_extra_is_reported_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None if name == "uvicorn" else object())
    assert execute(["console"]) == BAD_INPUT
    assert capsys.readouterr().err == "hil console: uvicorn missing: pip install 'hil-bench[console]'\n"


@pytest.mark.parametrize("line_is_dropped", [pytest.param(False, marks=pytest.mark.slow), True])
def test_last_message_of_a_session_arrives_even_if_it_left_input_unread(line_is_dropped: bool) -> None:
    async def talk() -> list[dict[str, Any]]:
        heard: list[dict[str, Any]] = []
        choice = Choice(scenario="scheme-1", rig="mock", settings=("rig.rails.x.park_m=99",))
        session = SessionProcess(choice, heard.append)
        for _ in range(50):
            session.send(present=True)
        os.waitid(os.P_PID, session.pid, os.WEXITED | os.WNOWAIT)  # nothing is read before it is gone
        if line_is_dropped:  # as uvloop does
            asyncio.get_running_loop().remove_reader(session._channel)
        end_s = time.monotonic() + 20.0
        while not session.ended:
            assert time.monotonic() < end_s, heard
            session.poll_exit()
            await asyncio.sleep(0.01)
        await session.close()
        return heard

    (word,) = asyncio.run(talk())[-1]["refused"]
    assert "park_m must lie within travel_m" in word
