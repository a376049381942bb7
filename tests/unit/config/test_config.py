"""Scenario and rig files: all errors are reported together, one line per error."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from pydantic import ValidationError

from hil.config.load import load_fmu_mapping, load_rig, load_scenario, shipped
from hil.config.rig import Rig
from hil.errors import BadInput, Problem

Write = Callable[..., str]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Return a function that writes a file that extends a shipped one and returns its path."""

    def put(text: str, extends: str | None = "scheme-1", name: str = "mine.toml") -> str:
        path = tmp_path / name
        path.write_text((f'extends = "{extends}"\n' if extends else "") + text, encoding="utf-8")
        return str(path)

    return put


def scenario_problems(path: str, settings: Iterable[str] = ()) -> dict[str, Problem]:
    """Return the problems of a scenario by their key."""
    with pytest.raises(BadInput) as caught:
        load_scenario(path, settings)
    return {problem.key: problem for problem in caught.value.problems}


def rig_problems(path: str, settings: Iterable[str] = ()) -> dict[str, Problem]:
    with pytest.raises(BadInput) as caught:
        load_rig(path, settings)
    return {problem.key: problem for problem in caught.value.problems}


def test_every_shipped_file_loads() -> None:
    assert {"scheme-1", "scheme-2", "scheme-3"} <= set(shipped("scenarios"))
    for name in shipped("scenarios"):
        assert load_scenario(name).value.name == name
    for name in shipped("rigs"):
        assert load_rig(name).value.name == name


def test_schemes_start_and_see_as_in_table_iv() -> None:
    found = {name: load_scenario(name).value for name in ("scheme-1", "scheme-2", "scheme-3")}
    starts = {name: (s.initial.position_m, s.initial.attitude_deg) for name, s in found.items()}
    assert starts["scheme-1"] == ((5.0, -0.3, 0.3), (3.0, 3.0, -3.0))
    assert starts["scheme-2"] == starts["scheme-3"] == ((10.0, -0.5, 0.5), (5.0, 5.0, -5.0))
    assert [s.gnc.navigation.backend for s in found.values()] == ["builtin", "builtin", "vision_alone"]
    assert all(s.initial.velocity_mps == s.initial.rate_degps == (0.0, 0.0, 0.0) for s in found.values())


def test_every_fault_is_reported_at_once_with_file_key_value_and_what_is_allowed(write: Write) -> None:
    path = write(
        """
        duration_s = -4.0
        [chaser]
        mass_kg = -1000.0
        [gnc.akf]
        gyro_noise_degps = "printed"
        [gnc.control]
        deadband_mm = 2.0
        [vmu]
        sigma_angle_deg = nan
        """
    )
    found = scenario_problems(path)
    assert set(found) == {
        "duration_s",
        "chaser.mass_kg",
        "gnc.akf.gyro_noise_degps",
        "gnc.control.deadband_mm",
        "vmu.sigma_angle_deg",
    }
    assert all(problem.source == path for problem in found.values())
    assert str(found["chaser.mass_kg"]) == f"{path}: chaser.mass_kg: -1000.0: must be greater than 0"
    assert "-4.0" in found["duration_s"].message
    assert "printed" in found["gnc.akf.gyro_noise_degps"].message


def test_nan_is_called_not_finite(write: Write) -> None:
    for number in ("nan", "inf", "-inf"):
        message = scenario_problems(write(f"[vmu]\nsigma_angle_deg = {number}"))["vmu.sigma_angle_deg"].message
        assert "finite" in message
        assert number.lstrip("-") in message.lower()


def test_unknown_key_is_refused_with_a_hint(write: Write) -> None:
    found = scenario_problems(write("[gnc.control]\ndeadbnd_m = 0.002"))
    assert "did you mean deadband_m?" in found["gnc.control.deadbnd_m"].message


def test_unknown_key_that_resembles_nothing_is_refused_with_the_known_ones(write: Write) -> None:
    message = scenario_problems(write("[orbit]\nxyzzy = 1"))["orbit.xyzzy"].message
    assert "unknown key" in message
    assert "altitude_m" in message


@pytest.mark.parametrize(
    ("table", "wrong", "right"),
    [
        ("orbit", "altitude_km", "altitude_m"),
        ("initial", "attitude_rad", "attitude_deg"),
        ("chaser", "mass_g", "mass_kg"),
    ],
)
def test_wrong_unit_is_refused_with_the_right_one(write: Write, table: str, wrong: str, right: str) -> None:
    found = scenario_problems(write(f"[{table}]\n{wrong} = 200.0"))
    assert f"did you mean {right} = " in found[f"{table}.{wrong}"].message


def test_missing_key_is_named_with_its_unit(write: Write) -> None:
    found = scenario_problems(write("[[faults]]\ndevice = 'vmu'\nkind = 'no_pose'\n"))
    assert found["faults[0].at_s"].message == "is missing: a value in s"


def test_many_missing_keys_are_one_line(write: Write) -> None:
    with pytest.raises(BadInput) as caught:
        load_scenario(write("[orbit]\n", extends=None))
    (problem,) = caught.value.problems
    assert problem.key.startswith("name, duration_s, step_s, orbit.altitude_m, chaser and ")
    assert "extends" in problem.message


def test_whole_numbers_are_taken_for_floats_and_become_floats(write: Write) -> None:
    value = load_scenario(write("duration_s = 400\n[initial]\nposition_m = [5, 0, 0]")).value
    assert value.duration_s == 400.0
    assert type(value.duration_s) is float
    assert [type(number) for number in value.initial.position_m] == [float] * 3


@pytest.mark.parametrize("value", ['"400.0"', "true", "[400.0]", "2024-05-17"])
def test_what_is_no_number_is_not_taken_for_one(write: Write, value: str) -> None:
    assert set(scenario_problems(write(f"duration_s = {value}"))) == {"duration_s"}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("3", ": 3: must be a valid string or a valid array or an object"),
        ('["x", 3]', "[1]: 3: must be a valid string"),
        ("[]", ": []: must have at least 1 item, not 0"),
        ("{ variables = 3 }", ".variables: 3: must be a valid string or a valid array"),
        ('{ variables = "x", order = 3 }', ".order: 3: must be 'scalar_last' or 'scalar_first'"),
    ],
)
def test_value_of_none_of_its_key_s_types_is_one_line_without_their_names(write: Write, value: str, text: str) -> None:
    file = write(f"[inputs]\nr_CT_H = {value}\n", extends=None)
    with pytest.raises(BadInput) as caught:
        load_fmu_mapping(file)
    (problem,) = caught.value.problems
    assert str(problem) == f"{file}: inputs.r_CT_H{text}"


def test_vector_of_the_wrong_length_is_refused(write: Write) -> None:
    assert any(
        key.startswith("initial.position_m") for key in scenario_problems(write("[initial]\nposition_m = [5.0, 0.0]"))
    )


@pytest.mark.parametrize(
    ("text", "key", "message"),
    [
        ("[chaser]\ninertia_kg_m2 = [[1, 2, 0], [0, 1, 0], [0, 0, 1]]", "chaser.inertia_kg_m2", "symmetric"),
        ("[chaser]\ninertia_kg_m2 = [[1, 2, 0], [2, 1, 0], [0, 0, 1]]", "chaser.inertia_kg_m2", "positive definite"),
        ("[chaser.thrusters]\nposition_m = [[1, 0, 0]]\ndirection = [[1, 1, 0]]", "chaser.thrusters", "unit vector"),
        ("[chaser.thrusters]\nposition_m = [[1, 0, 0]]", "chaser.thrusters", "one each"),
    ],
)
def test_tables_that_contradict_themselves_are_refused(write: Write, text: str, key: str, message: str) -> None:
    assert message in scenario_problems(write(text))[key].message


def test_table_that_no_file_has_is_of_the_option_that_set_it() -> None:
    with pytest.raises(BadInput, match=r"^--set: foo: unknown key: known here: bench, "):
        load_scenario("scheme-1", ("foo.bar=1",))


def test_unknown_scenario_is_answered_with_the_known_ones() -> None:
    with pytest.raises(
        BadInput, match=r"scheme-9: unknown scenario: did you mean scheme-3.* give .*scheme-1, .*scheme-2, .*scheme-3"
    ):
        load_scenario("scheme-9")
    with pytest.raises(BadInput, match=r"nowhere\.toml: no such file"):
        load_scenario("nowhere.toml")
    with pytest.raises(BadInput, match=r"lab: unknown rig: give .*mock"):
        load_rig("lab")


def test_file_that_is_not_toml_is_named(write: Write) -> None:
    with pytest.raises(BadInput, match=r"mine\.toml: not TOML: .*line 2"):
        load_scenario(write("duration_s = = 4"))


def test_files_that_extend_each_other_in_a_ring_are_refused(write: Write) -> None:
    write("", extends="b.toml", name="a.toml")
    write("", extends="a.toml", name="b.toml")
    own = write("", extends="own.toml", name="own.toml")
    for path in (str(Path(own).with_name("a.toml")), own):
        with pytest.raises(BadInput, match="extend each other in a circle"):
            load_scenario(path)


def test_extends_lays_a_file_over_its_base_key_by_key(write: Write) -> None:
    base = load_scenario("scheme-1").value
    value = load_scenario(write("[gnc.control]\ndeadband_m = 0.004")).value
    assert value.gnc.control.deadband_m == 0.004
    assert value.gnc.control.lead_s == base.gnc.control.lead_s
    assert value.chaser == base.chaser


def test_fault_of_a_base_is_laid_to_the_base(write: Write) -> None:
    base = write("[chaser]\nmass_kg = 0.0", name="base.toml")
    top = write("[orbit]\naltitude_m = 0.0", extends="base.toml", name="top.toml")
    found = scenario_problems(top)
    assert found["chaser.mass_kg"].source == base
    assert found["orbit.altitude_m"].source == top


def test_setting_overrides_the_file_and_is_named_as_the_origin() -> None:
    loaded = load_scenario("scheme-1", ["gnc.control.deadband_m=0.004", "initial.position_m=[4, 0, 0]"])
    assert loaded.value.gnc.control.deadband_m == 0.004
    assert loaded.value.initial.position_m == (4.0, 0.0, 0.0)
    assert loaded.where("gnc.control.deadband_m") == "--set"
    assert loaded.where("gnc.control.lead_s").endswith("scheme-1.toml")


def test_faulty_setting_is_laid_to_the_option_and_not_to_the_file() -> None:
    found = scenario_problems("scheme-1", ["chaser.mass_kg=-1", "gnc.control.deadband_km=1"])
    assert found["chaser.mass_kg"].source == found["gnc.control.deadband_km"].source == "--set"
    assert "-1" in found["chaser.mass_kg"].message


def test_setting_takes_a_bare_string() -> None:
    key, value = "gnc.navigation.backend", "vision_alone"
    for text in (f"{key}={value}", f'{key}="{value}"', f"{key} = {value}"):
        assert load_scenario("scheme-1", [text]).value.gnc.navigation.backend == value


@pytest.mark.parametrize("text", ["duration_s", "=4", " = 4"])
def test_setting_that_is_none_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(BadInput, match=r"^--set: .*must look like gnc\.control\.deadband_m=0\.004"):
        load_scenario("scheme-1", [text])


def test_setting_below_a_number_is_refused() -> None:
    with pytest.raises(BadInput, match=r"--set: .*duration_s is not a table"):
        load_scenario("scheme-1", ["duration_s.longer=4"])


def test_settings_of_the_rig_go_to_the_rig_alone() -> None:
    settings = ["rig.vmu.timeout_s=0.5", "duration_s=100"]
    assert load_rig("mock", settings).value.vmu.timeout_s == 0.5
    assert load_scenario("scheme-1", settings).value.duration_s == 100.0
    found = rig_problems("mock", ["rig.vmu.timeout_s=-1"])
    assert found["rig.vmu.timeout_s"].source == "--set"


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("rig.rails.x.travel_m=[2.0, 1.0]", "must rise"),
        ("rig.rails.x.park_m=99.0", "must lie within travel_m"),
        ("rig.bench.gimbal_order=zyz", "zyx"),
        ("rig.bench.camera_axes=[[1,0,0],[0,1,0],[0,0,-1]]", "right-handed"),
        ("rig.vmu.driver=rs422", "does not go with kind"),
    ],
)
def test_impossible_rig_is_refused(setting: str, text: str) -> None:
    assert any(text in problem.message for problem in rig_problems("mock", [setting]).values())


def test_rig_of_hardware_without_wires_names_each_missing_wire(write: Write) -> None:
    path = write(
        'kind = "hardware"\nrails.driver = "modbus"\nturntable.driver = "ascii"\n'
        'vmu.driver = "rs422"\nio.driver = "modbus"',
        extends="mock",
    )
    found = rig_problems(path)
    assert set(found) == {
        "rig.rails.modbus.x.port",
        "rig.rails.modbus.y.port",
        "rig.rails.modbus.z.port",
        "rig.turntable.ascii.port",
        "rig.vmu.rs422.port",
        "rig.io.port",
    }


def test_hardware_states_explicitly_that_it_has_no_digital_lines() -> None:
    table = load_rig("emulated").value.model_dump(mode="json") | {"kind": "hardware", "io": None}
    with pytest.raises(ValidationError, match=r"\[io\] is missing: hardware needs"):
        Rig.model_validate(table, strict=False)
    assert not Rig.model_validate(table | {"io": {"driver": "none"}}, strict=False).has_io


@pytest.mark.parametrize(
    ("setting", "text"),
    [
        ("rig.io.coils.enable=0", "coils.enable has address 0, which is that of coils.charge_pump"),
        ("rig.io.coils.thrusters_first=1", "coils.thrusters_first + 0 has address 1, which is that of coils.enable"),
        ("rig.io.coils.thrusters_first=65530", "must end at 65535"),
        ("rig.io.interlocks.door=1", "interlocks.door has address 1, which is that of inputs.chain_closed"),
        ("rig.io.inputs.estop_closed=-1", "greater than or equal to 0"),
        ("rig.io.thruster_lines=25", "less than or equal to 24"),
        ("rig.io.pump_period_s=0.03", "allowed up to half of pump_timeout_s, 0.025"),
        ("rig.io.driver=modbus", "does not go with kind"),
        ("rig.io.timeout=1.0", "the unit is part of the name, here it is timeout_s"),
    ],
)
def test_impossible_digital_lines_are_refused(setting: str, text: str) -> None:
    assert any(text in problem.message for problem in rig_problems("mock", [setting]).values())


def test_gravity_file_counts_from_the_folder_of_the_file_that_names_it(write: Write, tmp_path: Path) -> None:
    named = load_scenario(write('[truth]\ngravity_file = "moon.tab"\n')).value.truth.gravity_file
    assert named == str(tmp_path / "moon.tab")
    absolute = load_scenario(write('[truth]\ngravity_file = "/fields/moon.tab"\n')).value.truth.gravity_file
    assert absolute == "/fields/moon.tab"
    given = load_scenario("scheme-1", ["truth.gravity_file=moon.tab"]).value.truth.gravity_file
    assert given == "moon.tab"  # on the command line, from the working directory


def test_reactions_that_leave_a_phase_without_an_abort_are_refused() -> None:
    conditions = ("vision_lost", "vision_suspect", "imu_suspect", "thruster_fault", "monitor_disagrees")
    rows = [f'gnc.reactions.{name}.wait="hold"' for name in (*conditions, "covariance_invalid", "unprotected")]
    load_scenario("scheme-1", rows[:-1])
    with pytest.raises(BadInput, match='phase "ready", of kind wait, is left without an abort') as refused:
        load_scenario("scheme-1", rows)
    assert "\n" not in str(refused.value)


def test_keys_are_found_by_their_names_without_units_and_converted_to_si() -> None:
    rig = load_rig("mock").value
    rail, gimbal = rig.rails.x, rig.turntable.yaw
    assert (rail.key_of("rate_max"), gimbal.key_of("rate_max")) == ("rate_max_mps", "rate_max_degps")
    assert rail.limits == (*rail.travel_m, rail.rate_max_mps, rail.acceleration_max_mps2, rail.park_m)
    assert gimbal.si("travel") == tuple(map(math.radians, gimbal.travel_deg))
    assert gimbal.limits[2:4] == (math.radians(gimbal.rate_max_degps), math.radians(gimbal.acceleration_max_degps2))
    with pytest.raises(ValueError, match="too many values"):  # pose_error_max_m and pose_error_max_deg
        rig.guard.si("pose_error_max")
