"""``hil list`` and ``hil keys``, and what a misspelt key is answered with."""

from __future__ import annotations

import json

import pytest

from hil.cli.main import execute
from hil.config.key_reference import all_keys
from hil.config.load import load_rig, load_scenario, shipped
from hil.config.tables.units import converted, split
from hil.core.build_info import VERSION
from hil.errors import BadInput


def test_list_has_each_shipped_file_with_a_line_and_each_driver(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["list", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    for kind in ("scenarios", "rigs", "dispersions", "targets", "bodies", "frames", "protocols"):
        assert set(found[kind]) == set(shipped(kind))
        assert all(found[kind].values()), kind
    assert found["drivers"]["rig.rails.driver=modbus"] == "hil"
    assert "gnc.navigation.backend=vision_alone" in found["backends"]


def test_list_has_each_part_with_version_origin_commands_and_tables(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["list", "parts", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)
    parts = {each["name"]: each for each in found["parts"]}
    assert (parts["vision"]["version"], parts["vision"]["origin"]) == (VERSION, "hil")
    assert parts["vision"]["commands"] == ["vmu", "targets", "calibrate"]
    assert all(set(each) == {"name", "version", "origin", "commands", "tables"} for each in found["parts"])


def test_list_prints_one_kind(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["list", "rigs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 1 + len(shipped("rigs"))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["list", "rig"], "did you mean rigs?"),
        (["keys", "dedband"], "no key of scenario or rig has this in its name; similar: deadband_m"),
        (["list", "--json", "/"], "is a folder"),
    ],
)
def test_wrong_names_are_answered_with_near_ones(
    arguments: list[str], text: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert text in line


def test_keys_of_sensor_modules_are_keys_as_well(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["keys", "sensors*bias_sigma*", "--json", "-"]) == 0
    found = {row["meaning"]: row for row in json.loads(capsys.readouterr().out)["keys"]}
    row = found["range_finder: its standard deviation, as the filters assume it"]
    assert (row["key"], row["unit"], row["default"]) == ("sensors.NAME.bias_sigma_m", "m", "0.001")


def test_keys_have_unit_range_default_and_meaning(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["keys", "rig.*.lead_s", "--json", "-"]) == 0
    found = json.loads(capsys.readouterr().out)["keys"]
    assert {key["key"] for key in found} >= {"rig.rails.x.lead_s", "rig.turntable.yaw.lead_s"}
    assert {(key["file"], key["unit"], key["allowed"], key["default"]) for key in found} == {
        ("rig", "s", "from -0.2 to 0.2", "`0.0`")
    }
    assert all(key["meaning"] for key in found)


def test_every_key_is_listed_once_under_the_name_that_set_takes() -> None:
    names = [key.name for key in all_keys()]
    assert len(names) == len(set(names))
    assert {"gnc.control.deadband_m", "rig.vmu.timeout_s", "rig.vmu.udp.port", "rig.host.time"} <= set(names)


@pytest.mark.parametrize(
    ("setting", "meant"),
    [
        ("gnc.control.deadband_mm=4", "deadband_m = 0.004"),
        ("gnc.control.deadband_rad=0.01", "deadband_deg = 0.572957795131"),
        ("gnc.control.deadband_cm=true", "deadband_m?"),
        ("rig.vmu.timeout_ms=400", "timeout_s = 0.4"),
    ],
)
def test_key_in_another_unit_is_answered_with_that_of_its_dimension(setting: str, meant: str) -> None:
    with pytest.raises(BadInput, match=f"unknown key: did you mean {meant}"):
        load_scenario("scheme-1", (setting,)) if not setting.startswith("rig.") else load_rig("mock", (setting,))


def test_units_are_converted_within_their_dimension_only() -> None:
    assert split("deadband") == ("deadband", "")
    assert split("gnc.pkf.viscous_n_per_mps") == ("gnc.pkf.viscous", "n_per_mps")
    assert converted("rate_mps", 1.0, ("rate_degps",)) == ""
    assert converted("rate_radps", 1.0, ("rate_mps", "rate_degps")).startswith("rate_degps = 57.29")
