"""What a hardware rig waives stands in its JSON, its reports and on the console's page, with what it takes away."""

from __future__ import annotations

import asyncio
import io
import json
import math
import re
from collections import Counter
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError
from rich.console import Console

import hil
from hil.checks.compatibility import check_scenario_limits
from hil.checks.waivers import Waiver, waivers
from hil.cli.main import execute
from hil.config.key_reference import all_keys
from hil.config.load import load_rig, load_scenario, shipped
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.limits import RIG_LIMITS, SCENARIO_LIMITS, Kind, Limit, excess, values
from hil.errors import BadInput
from hil.parts.console.live_view import Client
from hil.parts.console.service import OPEN_QUESTION, ConsoleService
from hil.parts.console.session import Choice
from hil.parts.console.session_state import bench_description
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


@cache
def scheme() -> Scenario:
    return load_scenario("scheme-1").value


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


def beyond(limit: Limit, bound: float) -> float:
    return bound * (0.5 if limit.weak_below else 2.0)


def bad_text(key: str, value: float, rig: str) -> str:
    """Return the error of a value that is given on the command line, "" if it is accepted."""
    setting = [f"{key}={value!r}"]
    try:
        scenario, loaded = load_scenario("scheme-1", setting), load_rig(rig, setting)
    except BadInput as error:
        return "; ".join(map(str, error.problems))
    return "; ".join(map(str, check_scenario_limits(scenario, loaded)))


KINDS: tuple[Kind, ...] = ("mock", "emulated", "hardware")
RAILS = "{ travel_m = [-0.5, 0.5], rate_max_mps = 0.2, acceleration_max_mps2 = 0.4 }"
TARGET = f"""[target_manipulator]
servo = {{ gain_per_s = 10.0, lag_s = 0.02 }}
x = {RAILS}
y = {RAILS}
z = {RAILS}
driver = """
LAMP = f"""[linear_axes.lamp]
driver = "DRIVER"
servo = {{ gain_per_s = 10.0, lag_s = 0.02 }}
place_m = [0.0]
x = {RAILS}
"""
SUN = """[rotary_axes.lamp]
driver = "DRIVER"
servo = { gain_per_s = 10.0, lag_s = 0.02 }
place_deg = [0.0]
roll = { travel_deg = [-10.0, 10.0], rate_max_degps = 30.0, acceleration_max_degps2 = 60.0 }
"""
SPLIT = '[[turntable.controllers]]\naxes = ["roll"]\ndriver = "cia402"\ncia402 = { channel = "/dev/zero" }\n'
WIRED = '"modbus"\nmodbus = { x = { port = 506 }, y = { port = 507 }, z = { port = 508 } }\n'
RANGE = 'extends = "scheme-1"\n[sensors.range]\nkind = "range_finder"\n[gnc.integrity]\nvision_range_m = 8.0\n'


def on_each_kind(folder: Path, key: str) -> list[tuple[Kind, BaseModel]]:
    """Return the table of a rig of each kind, or of a scenario for them, that has ``key``."""
    if not key.startswith("rig."):
        path = folder / "scenario.toml"
        path.write_text(RANGE)
        return [(kind, load_scenario(str(path)).value) for kind in KINDS]
    found: list[tuple[Kind, BaseModel]] = []
    rotates, floats = key.startswith("rig.rotary_manipulator"), key.startswith("rig.floating")
    for kind in KINDS:
        base = ("mock" if kind == "mock" else "emulated") + "-manipulator" * rotates + "-floating" * floats
        text = f'extends = "{base}"\nname = "each"\n'
        if kind == "hardware":
            wires = "vmu.udp.port = 504\nio.port = 505\n" if floats else HARDWARE_WIRES
            text += f'kind = "hardware"\n{wires}' + ('rotary_manipulator.cia402.channel = "/dev/zero"\n' * rotates)
        path = folder / f"{kind}.toml"
        target = TARGET + ('"mock"\n' if kind == "mock" else WIRED)
        lamp = LAMP.replace("DRIVER", "mock" if kind == "mock" else "modbus")
        lamp += "" if kind == "mock" else "modbus = { x = { port = 506 } }\n"
        sun = SUN.replace("DRIVER", "mock" if kind == "mock" else "cia402")
        sun += "" if kind == "mock" else 'cia402 = { channel = "/dev/zero" }\n'
        text += lamp * key.startswith("rig.linear_axes") + sun * key.startswith("rig.rotary_axes")
        split = SPLIT.replace('driver = "cia402"', 'driver = "mock"') if kind == "mock" else SPLIT
        text += split * key.startswith("rig.turntable.controllers")
        path.write_text(text + target * key.startswith("rig.target"))
        found.append((kind, load_rig(str(path)).value))
    return found


def with_value(table: BaseModel, key: str, value: float) -> BaseModel:
    """Return ``table`` with another value. Raises ValidationError."""
    content: Any = table.model_dump(by_alias=True, exclude_unset=True)
    *tables, name = key.split(".")
    at = content
    for each in tables:
        at = at.setdefault(each, {}) if isinstance(at, dict) else at[int(each)]
    at[name] = (-value, value) if name.startswith("travel") else value
    return type(table).model_validate(content)


def concrete(limit: Limit) -> str:
    """Return the key with the first axis, or the sensor, in the place of a ``*``."""
    star = "roll" if "deg" in limit.key else "range" if "sensors" in limit.key else "x"
    return limit.key.replace("axes.*", "axes.lamp").replace("controllers.*", "controllers.0").replace("*", star)


ALL_LIMITS = [*((f"rig.{limit.key}", limit) for limit in RIG_LIMITS), *((each.key, each) for each in SCENARIO_LIMITS)]


@pytest.mark.parametrize(
    "kinds", [("hardware",), pytest.param(KINDS, marks=pytest.mark.slow)], ids=["hardware", "all values and rigs"]
)
def test_each_limit_at_each_value_is_an_error_or_red_unless_it_is_as_strong_as_recommended(
    tmp_path: Path, kinds: tuple[Kind, ...]
) -> None:
    """0, negative, 1e9, nan, weaker than recommended and than accepted, on each kind of rig: 0 lines are silent."""
    plain = (0.0, -1.0, math.nan) if kinds == KINDS else ()
    outcomes: Counter[str] = Counter()
    tables: dict[str, list[tuple[Kind, BaseModel]]] = {}
    for whole, limit in ALL_LIMITS:
        key, of_rig = concrete(limit), whole.startswith("rig.")
        limits = RIG_LIMITS if of_rig else SCENARIO_LIMITS
        group = (
            whole.partition("_manipulator")[0]
            if "_manipulator" in whole
            else whole[:14]
            if "_axes." in whole or "controllers" in whole
            else "rig.floating"
            if "floating." in whole
            else "rig."
            if of_rig
            else ""
        )
        if group not in tables:
            tables[group] = on_each_kind(tmp_path, whole)
        for kind, table in tables[group]:
            for value in (*plain, 1e9, beyond(limit, limit.recommended), beyond(limit, limit.accepted(kind))):
                if kind not in kinds:
                    continue
                is_whole = isinstance(limit.recommended, int) and math.isfinite(value)
                try:
                    changed = with_value(table, key, int(value) if is_whole else value)
                except ValidationError as error:
                    outcome = "error" if key.rpartition(".")[2] in str(error) else "other error"
                else:
                    (given,) = [found for name, _, found in values((limit,), changed) if name == key]
                    rig = changed if isinstance(changed, Rig) else load_rig("mock").value
                    scenario = changed if isinstance(changed, Scenario) else scheme()
                    red = [waiver.key for waiver in waivers(rig, scenario)]
                    if limit.is_weaker(given, limit.accepted(kind)):
                        outcome = "error" if key in [name for name, _ in excess(limits, changed, kind)] else "silent"
                    elif limit.is_weaker(given, limit.recommended):
                        outcome = "red" if whole.replace(limit.key, key) in red else "silent"
                    else:
                        outcome = "as recommended"
                outcomes[outcome] += 1
                assert outcome in ("error", "red", "as recommended"), (key, kind, value, outcome)
    print(f"{len(ALL_LIMITS)} keys: {dict(outcomes)}")  # noqa: T201
    assert outcomes["red"] > 100 * len(kinds)
    assert outcomes["error"] > 200 * len(kinds)


PROTECTS = re.compile(
    r"(timeout|limit|lost|within|lease|heartbeat|_age|reaction_s|interlock|_after|persistence|coast|confidence|mismatch"
    r"|per_speed|torque_delay|sigmas|_max)(_|$)|_max_"
)
NO_PROTECTION = {
    r"drive_following|mechanics\.|sign_off\.": "of emulated drives, or what was measured",
    r"jerk_max|exchange_rate_max": "smoothness and load of the wires: an axis within speed and acceleration is safe",
    r"rig\.(target_)?arm\.(kuka|abb)_": "of packages of robots, with ranges of their own; controllers have limits too",
    r"rig\.tracker\.": "within ranges of their own; a tracker protects the verdict, the bench is held either way",
    r"drift_check\.": "of a measurement that the operator starts; its result has its own probability",
    r"enable_timeout": "a drive that is not enabled does not move",
    r"exchange_max_s|late_wakeup": "counted in reports alone",
    r"lock_step_timeout|reply_timeout_fraction": "of simulated time, or a fraction of a cycle with its own bounds",
    r"pair_within_s": "which images of two cameras are of one moment",
    r"deadband_sigmas|exposure_max_s|range_max_m|status_bits|map\.|limit_cycle|settle": "no limit: control, "
    "camera, range of a sensor, bits on a wire, motion of the target",
}


def test_each_key_that_is_named_like_a_limit_is_one_or_has_a_reason() -> None:
    known = [re.compile(re.escape(key).replace(r"\.\*", r"(\.[\w]+|\[\])") + "$") for key, _ in ALL_LIMITS]
    unsaid = [
        each.name
        for each in all_keys()
        if each.row.type in ("number", "integer")
        and PROTECTS.search(each.name.rpartition(".")[2])
        and not any(pattern.match(each.name) for pattern in known)
        and not any(re.search(pattern, each.name) for pattern in NO_PROTECTION)
    ]
    assert unsaid == []


def test_bound_is_an_error_of_one_line_with_what_is_allowed(lab: str) -> None:
    text = bad_text("rig.host.overruns_max", 1_000_000, lab)
    where = "--set: rig.host.overruns_max: 1e+06: allowed on hardware 100 or less, recommended 10 or less"
    assert text == f"{where}: it protects from a bench that moves on late setpoints"
    assert bad_text("rig.host.overruns_max", 1_000_000, "emulated") == ""
    assert "keep_out.radius_m" not in bad_text("keep_out.radius_m", 0.0, lab)


def test_shipped_rigs_and_scenarios_have_the_recommended_limits() -> None:
    scenarios = [load_scenario(name).value for name in shipped("scenarios")]
    for rig in (load_rig(name).value for name in shipped("rigs")):
        assert all(waivers(rig, scenario) == [] for scenario in scenarios)


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
