"""Dispersion sets: by name, by file, over and under the settings of a scenario."""

from __future__ import annotations

from pathlib import Path

import pytest

from hil.config.load import load_rig, load_scenario, shipped
from hil.errors import BadInput
from hil.parts.campaigns.dispersions import Design


def test_every_shipped_set_disperses_the_shipped_scenarios() -> None:
    assert set(shipped("dispersions")) >= {"shipped", "stress", "data-sheet"}
    for name in shipped("dispersions"):
        loaded = load_scenario("scheme-1", (f"dispersions={name}",))
        assert loaded.value.dispersions.name == name
        design = Design(loaded, 0)
        truth, _ = design.apply(design.values(3))
        assert truth.chaser.mass_kg != 1000.0


def test_shipped_scenarios_have_the_shipped_set() -> None:
    assert load_scenario("scheme-3").value == load_scenario("scheme-3", ("dispersions=shipped",)).value


def test_set_replaces_that_of_the_scenario_and_later_settings_change_it() -> None:
    settings = ("dispersions=stress", "dispersions.vmu.latency_s.high=0.4")
    loaded = load_scenario("scheme-2", settings)
    assert loaded.value.dispersions.vmu["latency_s"] == {"kind": "uniform", "low": 0.0, "high": 0.4}
    assert loaded.value.dispersions.initial["position_m"]["sigma"] == [0.3, 0.1, 0.1]
    assert loaded.where("dispersions.vmu.latency_s.high") == "--set"
    assert loaded.where("dispersions.initial.position_m").endswith("stress.toml")
    assert loaded.where("dispersions.initial.rate_degps").endswith("shipped.toml")


@pytest.mark.parametrize(
    ("own", "value"),
    [
        ('{ kind = "normal", sigma = 0.1 }', {"kind": "normal", "sigma": 0.1}),  # another kind
        (
            '{ kind = "normal", mean = 2.0, sigma = 0.0, relative = true }',  # twice the noise, in all cases
            {"kind": "normal", "mean": 2.0, "sigma": 0.0, "relative": True},
        ),
        (
            '{ kind = "uniform", low = 0.01, high = 0.02 }',  # the same kind, fewer keys
            {"kind": "uniform", "low": 0.01, "high": 0.02},
        ),
    ],
)
@pytest.mark.parametrize("in_scenario", [False, True])
def test_distribution_replaces_that_of_the_same_key_whole(
    tmp_path: Path, own: str, value: dict[str, object], in_scenario: bool
) -> None:
    prefix = "dispersions." if in_scenario else ""
    text = f'extends = "{"scheme-1" if in_scenario else "shipped"}"\n[{prefix}vmu]\nsigma_position_m = {own}\n'
    path = tmp_path / "own.toml"
    path.write_text(text)
    loaded = load_scenario(str(path)) if in_scenario else load_scenario("scheme-1", (f"dispersions={path}",))
    found = loaded.value.dispersions
    assert found.vmu["sigma_position_m"] == value  # shipped: uniform, low 0.8, high 1.2, relative
    assert found.vmu["latency_s"] == {"kind": "uniform", "low": 0.0, "high": 0.1}  # other keys are those of the base
    assert found.initial["position_m"]["sigma"] == [0.05, 0.02, 0.02]
    assert loaded.where("dispersions.vmu.sigma_position_m") == str(path)
    known = {key for key in loaded.origin if key.startswith("dispersions.vmu.sigma_position_m.")}
    assert {key.rpartition(".")[2] for key in known} == set(value)


def test_noise_of_a_set_that_extends_another_is_drawn_as_it_states(tmp_path: Path) -> None:
    path = tmp_path / "twice.toml"
    own = 'sigma_position_m = { kind = "normal", mean = 2.0, sigma = 0.0, relative = true }'
    path.write_text(f'extends = "shipped"\n[vmu]\n{own}\n')
    loaded = load_scenario("scheme-1", (f"dispersions={path}",))
    design = Design(loaded, 0)
    drawn = [design.apply(design.values(case))[0].vmu.sigma_position_m for case in range(3)]
    assert drawn == [2.0 * loaded.value.vmu.sigma_position_m] * 3


def test_distribution_without_a_kind_of_its_own_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "own.toml"
    path.write_text('extends = "shipped"\n[vmu]\nlatency_s = { high = 0.2 }\n')
    with pytest.raises(BadInput, match=r"own\.toml: dispersions\.vmu\.latency_s\.kind: is missing"):
        Design(load_scenario("scheme-1", (f"dispersions={path}",)), 0)


def test_scenario_names_a_set_in_its_folder_and_another_extends_that(tmp_path: Path) -> None:
    (tmp_path / "own-set.toml").write_text(
        'name = "own"\nsampling = "sobol"\n[chaser]\nmass_kg = { kind = "normal", sigma = 5.0 }\n'
    )
    (tmp_path / "base.toml").write_text('extends = "scheme-1"\ndispersions = "own-set.toml"\n')
    (tmp_path / "top.toml").write_text(
        'extends = "base.toml"\n[dispersions.chaser]\nmass_kg = { kind = "normal", sigma = 7.0 }\n'
    )
    base, top = (load_scenario(str(tmp_path / name)).value.dispersions for name in ("base.toml", "top.toml"))
    assert (base.name, base.sampling, base.vmu) == ("own", "sobol", {})
    assert top.chaser == {"mass_kg": {"kind": "normal", "sigma": 7.0}}
    assert (top.name, top.sampling) == ("own", "sobol")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (None, ("own-set.toml", "no such file", "stress")),
        ("[chaser]\nmass_kg = { kind = 'normal', sigma = -1.0 }", ("own-set.toml", "sigma = -1", "not be negative")),
        ("[chaser]\nmas_kg = { kind = 'normal', sigma = 1.0 }", ("own-set.toml", "did you mean mass_kg")),
        ("[chaser]\ninertia_kg_m2 = { kind = 'normal', sigma = [1.0] }", ("own-set.toml", "relative = true")),
        ("[weather]\nwind = 1.0", ("own-set.toml", "weather", "unknown key")),
        ("extends = 'own-set.toml'", ("own-set.toml", "circle")),
        ("[chaser", ("own-set.toml", "not TOML")),
    ],
)
def test_bad_set_is_one_line_with_its_file(tmp_path: Path, text: str | None, words: tuple[str, ...]) -> None:
    path = tmp_path / "own-set.toml"
    if text is not None:
        path.write_text(text)
    with pytest.raises(BadInput) as caught:
        Design(load_scenario("scheme-1", (f"dispersions={path}",)), 0)
    (line,) = str(caught.value).splitlines()
    for word in words:
        assert word in line


def test_unknown_set_is_answered_with_the_names_of_all() -> None:
    with pytest.raises(
        BadInput,
        match=r"strss: unknown dispersion set: did you mean stress\? give data-sheet, shipped, stress, tumbling",
    ):
        load_scenario("scheme-1", ("dispersions=strss",))


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("vmu.errors.bias_m=[0.1, 0.2]", ("vmu.errors.bias_m",)),
        ("vmu.errors.outlier_probability=1.5", ("vmu.errors.outlier_probability", "1.5")),
        ("vmu.errors.correlation_time_s=0.0", ("vmu.errors.correlation_time_s", "greater than 0")),
        ("vmu.errors.bias_mm=[0.0, 0.0, 1.0]", ("vmu.errors.bias_mm", "did you mean bias_m?")),
        ("imu.errors.gyro_scale_error=[0.6, 0.0, 0.0]", ("imu.errors.gyro_scale_error[0]", "0.6")),
        ("imu.errors.gyro_quantum_degps=-1.0", ("imu.errors.gyro_quantum_degps", "-1")),
        ("chaser.thrusters.errors.delay_s=-0.1", ("chaser.thrusters.errors.delay_s", "-0.1")),
        ("chaser.thrusters.errors.half_pressure_kg=0.0", ("half_pressure_kg", "greater than 0")),
    ],
)
def test_term_of_an_error_model_out_of_range_is_one_line(setting: str, words: tuple[str, ...]) -> None:
    with pytest.raises(BadInput) as caught:
        load_scenario("scheme-1", (setting,))
    (line,) = str(caught.value).splitlines()
    for word in words:
        assert word in line


def test_delay_of_more_steps_than_are_kept_is_rejected() -> None:
    from hil.checks.faults import check_faults

    scenario = load_scenario("scheme-1", ("chaser.thrusters.errors.delay_s=0.6", "imu.rate_hz=250.0"))
    (problem,) = check_faults(scenario, load_rig("mock"))
    assert str(problem) == (
        "--set: chaser.thrusters.errors.delay_s: 0.6: at most 128 steps of the truth are kept, 0.512 s"
    )


def test_plumes_modes_and_propellant_are_dispersed_like_any_number() -> None:
    settings = (
        "chaser.solar_array.further_modes.second={frequency_hz = 0.7, damping = 0.01}",
        *(
            f'dispersions.chaser.{key}={{kind = "uniform", low = 0.1, high = 0.2}}'
            for key in (
                "propellant_gyration_m",
                "solar_array.mode_translation_coupling",
                "solar_array.further_modes.second.frequency_hz",
                "thrusters.errors.plume_target_radius_m",
            )
        ),
    )
    design = Design(load_scenario("scheme-1", settings), 0)
    truth, gnc = design.apply(design.values(3))
    chaser, array = truth.chaser, truth.chaser.solar_array
    assert array is not None
    drawn = (
        *chaser.propellant_gyration_m,
        *array.mode_translation_coupling,
        array.further_modes["second"].frequency_hz,
        chaser.thrusters.errors.plume_target_radius_m,
    )
    assert all(0.1 < value < 0.2 for value in drawn)
    assert len(set(drawn)) == 8
    assert gnc.chaser.propellant_gyration_m == (0.0, 0.0, 0.0)
