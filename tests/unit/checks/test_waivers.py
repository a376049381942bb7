"""What a hardware rig waives stands in its JSON, its reports and on the console's page, with what it takes away."""

from __future__ import annotations

import asyncio
import io
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console

import hil
from hil.checks.waivers import waivers
from hil.config.load import load_rig, load_scenario
from hil.console.live_view import Client
from hil.console.service import OPEN_QUESTION, ConsoleService
from hil.console.session import Choice
from hil.console.session_state import bench_description
from hil.report.page import report
from hil.report.summary import summary_of
from hil.report.table import print_waived
from tests.support.run_settings import HARDWARE_WIRES

LAB = f'extends = "emulated"\nname = "lab"\nkind = "hardware"\n{HARDWARE_WIRES}'
EACH = {
    "rig.io.driver=none": "rig.io.driver = none: emergency stop, interlocks and safety chain are not read",
    "rig.sign_off.waived=true": "rig.sign_off.waived = true: axes, limits and safety chain may differ",
    "rig.host.require_realtime=false": "rig.host.require_realtime = false: the loop may run without",
    "rig.host.on_overrun=log": "rig.host.on_overrun = log: lost periods are counted only",
    "rig.console.on_loss=continue": "rig.console.on_loss = continue: the bench moves on unattended",
}


@pytest.fixture
def lab(tmp_path: Path) -> str:
    path = tmp_path / "lab.toml"
    path.write_text(LAB)
    return str(path)


@pytest.mark.parametrize(("setting", "words"), EACH.items())
def test_waiver_is_found_with_what_it_takes_away(lab: str, setting: str, words: str) -> None:
    (waiver,) = waivers(load_rig(lab, [setting]).value)
    assert str(waiver).startswith(f"WAIVED {words}")


def test_hardware_with_all_protections_waives_nothing_and_other_rigs_never_do(lab: str) -> None:
    assert waivers(load_rig(lab).value) == []
    assert waivers(load_rig("emulated", list(EACH)).value) == []


def test_brake_without_contact_and_command_set_without_checksum_are_found(lab: str, tmp_path: Path) -> None:
    without_contact = tmp_path / "without.toml"
    without_contact.write_text(LAB.replace("io.inputs.brakes_closed = 9\n", ""))
    (brake,) = waivers(load_rig(str(without_contact)).value)
    assert str(brake).startswith("WAIVED rig.io.inputs.brakes_closed = not set: holding brakes are not read back")
    ascii_line = ["rig.turntable.driver=ascii", "rig.turntable.ascii.port=/dev/null"]
    lacking = waivers(load_rig(lab, [*ascii_line, "rig.turntable.ascii.protocol=acu"]).value)
    assert {each.key for each in lacking} == {"rig.turntable.driver"}
    gone = waivers(load_rig(lab, [*ascii_line, f"rig.turntable.ascii.protocol={tmp_path}/gone.toml"]).value)
    assert "gone.toml" in gone[0].takes_away


def test_all_of_them_stand_in_the_terminal_the_page_the_console_and_the_json(lab: str, tmp_path: Path) -> None:
    rig = load_rig(lab, list(EACH)).value
    run = hil.run("scheme-1", duration_s=2.0, record=tmp_path)
    assert run.summary["waived"] == []
    recorded = replace(hil.open(run.summary["recording"]["file"]).recorded, rig=rig, summary=None)
    found = summary_of(recorded)["waived"]
    assert len(found) == len(EACH)
    terminal = io.StringIO()
    print_waived(found, Console(file=terminal, force_terminal=True, width=250))
    html = report([recorded])
    page = bench_description(rig, load_scenario("scheme-1").value)["waived"]
    choice = Choice(scenario="scheme-1", rig=lab, settings=tuple(EACH))
    service = ConsoleService(choice, ["scheme-1"], [lab], lambda: 0.0)
    ann = Client("a" * 16, "ann")
    service.lease.acquire(ann.key, ann.name, 0.0)
    asked = asyncio.run(service.execute(ann, {"do": "open"}))["ask"]
    assert asked.endswith(OPEN_QUESTION)
    red = "\x1b[1;31m"
    for words in EACH.values():
        assert f"{red}WAIVED {words}" in terminal.getvalue()
        assert f'<p class="waived">WAIVED {words}' in html
        assert f"WAIVED {words}" in asked
    assert page == found


def test_recording_without_the_list_gets_it_from_its_rig(lab: str, tmp_path: Path) -> None:
    run = hil.run("scheme-1", duration_s=1.0, record=tmp_path)
    recorded = hil.open(run.summary["recording"]["file"]).recorded
    earlier = {key: value for key, value in run.summary.items() if key != "waived"}
    rig = load_rig(lab, ["rig.host.on_overrun=log"]).value
    (waiver,) = summary_of(replace(recorded, rig=rig, summary=earlier))["waived"]
    assert waiver["key"] == "rig.host.on_overrun"
