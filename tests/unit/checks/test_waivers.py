"""What a hardware rig waives stands in its JSON, its reports and on the console's page, with what it takes away."""

from __future__ import annotations

import asyncio
import io
import json
import math
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest
from rich.console import Console

import hil
from hil.checks.compatibility import check_scenario_limits
from hil.checks.waivers import Waiver, waivers
from hil.cli.main import execute
from hil.config.limits import RIG_LIMITS, SCENARIO_LIMITS, Limit, values
from hil.config.load import Loaded, load_rig, load_scenario, shipped
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.console.live_view import Client
from hil.console.service import OPEN_QUESTION, ConsoleService
from hil.console.session import Choice
from hil.console.session_state import bench_description
from hil.errors import BadInput
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


def waived_by(rig: Rig) -> list[Waiver]:
    return waivers(rig, load_scenario("scheme-1").value)


@pytest.fixture
def lab(tmp_path: Path) -> str:
    path = tmp_path / "lab.toml"
    path.write_text(LAB)
    return str(path)


@pytest.mark.parametrize(("setting", "words"), EACH.items())
def test_waiver_is_found_with_what_it_takes_away(lab: str, setting: str, words: str) -> None:
    (waiver,) = waived_by(load_rig(lab, [setting]).value)
    assert str(waiver).startswith(f"WAIVED {words}")


def test_hardware_with_all_protections_waives_nothing_and_other_rigs_have_no_switches_to_waive(lab: str) -> None:
    assert waived_by(load_rig(lab).value) == []
    assert waived_by(load_rig("emulated", list(EACH)).value) == []


def test_brake_without_contact_and_command_set_without_checksum_are_found(lab: str, tmp_path: Path) -> None:
    without_contact = tmp_path / "without.toml"
    without_contact.write_text(LAB.replace("io.inputs.brakes_closed = 9\n", ""))
    (brake,) = waived_by(load_rig(str(without_contact)).value)
    assert str(brake).startswith("WAIVED rig.io.inputs.brakes_closed = not set: holding brakes are not read back")
    ascii_line = ["rig.turntable.driver=ascii", "rig.turntable.ascii.port=/dev/null"]
    lacking = waived_by(load_rig(lab, [*ascii_line, "rig.turntable.ascii.protocol=acu"]).value)
    assert {each.key for each in lacking} == {"rig.turntable.driver"}
    gone = waived_by(load_rig(lab, [*ascii_line, f"rig.turntable.ascii.protocol={tmp_path}/gone.toml"]).value)
    assert "gone.toml" in gone[0].takes_away


def test_all_of_them_stand_in_the_terminal_the_page_the_console_and_the_json(
    lab: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hil.report.page.figures", lambda *_: ())
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
    service.lease.acquire(ann, 0.0)
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


def present(limits: tuple[Limit, ...], lab: str, prefix: str) -> list[tuple[str, Limit]]:
    """Return the limits that a hardware rig, or the scenario, has, with their whole keys."""
    table = load_rig(lab).value if prefix else load_scenario("scheme-1").value
    return [(f"{prefix}{limit.key}", limit) for limit, _ in values(limits, table)]


def beyond(limit: Limit, bound: float) -> float:
    return bound * (0.5 if limit.weak_below else 2.0)


scenario_with, rig_with = cache(load_scenario), cache(load_rig)


def loaded_with(key: str, value: float, rig: str) -> tuple[Loaded[Scenario], Loaded[Rig]]:
    """Return scheme-1 and ``rig`` with a value of one of them. Raises BadInput."""
    setting = (f"{key}={value!r}",)
    if key.startswith("rig."):
        return scenario_with("scheme-1"), rig_with(rig, setting)
    return scenario_with("scheme-1", setting), rig_with(rig)


def bad_text(key: str, value: float, rig: str) -> str:
    """Return the error of a value, "" if it is accepted."""
    try:
        scenario, loaded = loaded_with(key, value, rig)
    except BadInput as error:
        return "; ".join(map(str, error.problems))
    return "; ".join(map(str, check_scenario_limits(scenario, loaded)))


def test_each_limit_is_bounded_per_kind_of_rig_and_weak_ones_are_named(lab: str) -> None:
    """Weaker than recommended is a waiver on each kind of rig; weaker than accepted is an error with the range."""
    unsaid = []
    for key, limit in [*present(RIG_LIMITS, lab, "rig."), *present(SCENARIO_LIMITS, lab, "")]:
        whole = isinstance(limit.recommended, int)
        for rig, bound in (("mock", limit.simulated), ("emulated", limit.simulated), (lab, limit.hardware)):
            for value in (0.0, -1.0, 1e9, math.nan, beyond(limit, limit.recommended), beyond(limit, bound)):
                given = int(value) if whole and math.isfinite(value) else value
                if text := bad_text(key, given, rig):
                    assert key in text
                    assert "allowed" in text or "must be" in text or "finite" in text, text
                    continue
                scenario, chosen = loaded_with(key, given, rig)
                found = waivers(chosen.value, scenario.value)
                if limit.is_weaker(value, limit.recommended) and key not in [waiver.key for waiver in found]:
                    unsaid.append((key, value, rig))
                assert not limit.is_weaker(value, bound), (key, value, rig)
    assert unsaid == []


def test_bound_is_an_error_of_one_line_with_what_is_allowed(lab: str) -> None:
    text = bad_text("rig.host.overruns_max", 1_000_000, lab)
    where = "--set: rig.host.overruns_max: 1e+06: allowed on hardware 100 or less, recommended 10 or less"
    assert text == f"{where}: it protects from a bench that moves on late setpoints"
    assert bad_text("rig.host.overruns_max", 1_000_000, "emulated") == ""
    assert "keep_out.radius_m" not in bad_text("keep_out.radius_m", 0.0, lab)


def test_shipped_rigs_and_scenarios_have_the_recommended_limits() -> None:
    for rig in shipped("rigs"):
        for scenario in shipped("scenarios"):
            assert waivers(rig_with(rig).value, scenario_with(scenario).value) == []


def test_weak_limit_of_a_mock_rig_and_of_a_scenario_stands_in_the_json_and_with_the_verdict(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    weak = ["--set", "rig.guard.axis_error_max_m=1.0", "--set", "keep_out.radius_m=0"]
    execute(["run", "scheme-1", "--duration", "1", *weak, "--json", str(tmp_path / "run.json")])
    waived = json.loads((tmp_path / "run.json").read_text())["waived"]
    assert [waiver["key"] for waiver in waived] == ["rig.guard.axis_error_max_m", "keep_out.radius_m"]
    assert "2 protections waived or weak" in capsys.readouterr().out


OPEN_VOLUME = {
    "rig.bench.bodies=[]": "none: collisions of carriage and turntable with the target are not monitored",
    "keep_out.bodies=[]": "none: chaser and target are kept apart by their reference points alone",
    "keep_out.docks=true": "true: within the corridor the chaser may move up to contact",
    "keep_out.inspects=true": "true: no half-space keeps the chaser in front of the target",
}


@pytest.mark.parametrize(("setting", "words"), OPEN_VOLUME.items())
@pytest.mark.parametrize("rig", ["mock", "emulated", "lab"])
def test_guard_volume_that_lacks_a_part_is_a_waiver_on_each_kind_of_rig(
    lab: str, rig: str, setting: str, words: str
) -> None:
    chosen = load_rig(lab if rig == "lab" else rig, [setting]).value
    (waiver,) = waivers(chosen, load_scenario("scheme-1", [setting]).value)
    assert str(waiver).startswith(f"WAIVED {setting.partition('=')[0]} = {words}")
