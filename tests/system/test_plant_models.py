"""Thrusters, motion and IMU in FMUs: the run of the built-in models, refusals, failures in the run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.cli.main import BAD_INPUT, execute
from hil.errors import BadInput
from hil.parts.fmi.package import build
from tests.support.external_gnc import changed
from tests.support.fmu import described, script
from tests.support.rows import assert_same_bits

MODELS = Path(__file__).parents[2] / "examples" / "models_c"
HILL = {
    "truth.relative_motion": "hill",
    "truth.gravity_degree": 0,
    "truth.gravity_gradient": False,
    "truth.solar_pressure": False,
    "truth.flexible_array": False,
    "truth.mass_loss": False,
    "truth.centre_of_mass_offset_m": [0.0, 0.0, 0.0],
}
"""The motion that truth.c has."""


def model_fmu(folder: Path, part: str, *replacements: str, version: int = 2, step_s: float | None = None) -> Path:
    """Return the FMU of a part. replacements: in its source, see ``changed``; step_s: the only step."""
    source = folder / f"{part}.c"
    source.write_text(changed((MODELS / f"{part}.c").read_text(), *replacements))
    out = folder / f"{part}-{version}.fmu"
    build(replace(script(MODELS / "build_fmu.py").part_model(source), step_s=step_s), version, out)
    return out


def flown(overrides: dict[str, Any], duration_s: float = 6.0) -> Any:
    return hil.run("scheme-1", seed=3, duration_s=duration_s, overrides=overrides)


@pytest.mark.parametrize("version", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_valves_in_an_fmu_give_the_recording_of_the_built_in_ones(tmp_path: Path, version: int) -> None:
    """Twelve seconds have full and partial openings: the shortest pulse is longer than a cycle here."""
    pulse = {"chaser.thrusters.minimum_on_s": 0.05}
    fmu = model_fmu(tmp_path, "thrusters", version=version)
    built_in, own = flown(pulse, 12.0), flown({**pulse, "thrusters.fmu": str(fmu)}, 12.0)
    assert (built_in.history["truth"]["thrust_fraction"] % 1.0 > 0.0).any()
    assert_same_bits(built_in.history, own.history, without=("open_s", "lateness_s", "on_wire_s"))


def test_motion_in_an_fmu_is_that_of_the_built_in_model(tmp_path: Path) -> None:
    built_in, own = flown(HILL), flown({**HILL, "truth.fmu": str(model_fmu(tmp_path, "truth"))})
    for field in ("r_CT_H", "v_CT_H", "q_CH", "w_CI_C", "r_T_I", "q_HI", "mean_force_C"):
        difference = np.abs(built_in.history["truth"][field] - own.history["truth"][field])
        assert difference.max() < 1e-12 * max(1.0, np.abs(built_in.history["truth"][field]).max()), field


def test_imu_in_an_fmu_at_five_times_the_rate_of_the_cycle(tmp_path: Path) -> None:
    run = flown({"imu.fmu": str(model_fmu(tmp_path, "imu")), "imu.rate_hz": 250.0})
    imu, truth = run.history["imu"][1:], run.history["truth"][1:]
    error = imu["force_C"] - truth["mean_force_C"] - imu["bias_C"]
    assert error.std() == pytest.approx(1e-4 / np.sqrt(5.0), rel=0.1)
    assert np.all(imu["drift_C"] == [4.85e-8, -4.85e-8, 4.85e-8])


@pytest.mark.slow
def test_all_parts_in_fmus_pass_scheme_1(tmp_path: Path) -> None:
    parts = {f"{part}.fmu": str(model_fmu(tmp_path, part)) for part in ("thrusters", "truth", "imu")}
    run = flown({**HILL, **parts}, 400.0)
    assert run.passed


@pytest.mark.parametrize(
    ("part", "replacement", "words"),
    [
        ("imu", "m->bias[i] = BIAS[i]; => m->bias[i] = t_s > 0.5 ? 0.0 / 0.0 : BIAS[i];", "bias_C_mps2 is not finite"),
        ("thrusters", "return 0;\n}\n\nvoid => return t_s > 0.5;\n}\n\nvoid", "fmi2DoStep returned"),
        ("truth", "s[i] /= length; => s[i] /= t_s > 0.5 ? 2.0 * length : length;", "q_CH has length 0.5"),
    ],
)
def test_failure_in_the_run_stops_the_bench_and_names_the_part(
    tmp_path: Path, part: str, replacement: str, words: str
) -> None:
    run = flown({**HILL, f"{part}.fmu": str(model_fmu(tmp_path, part, replacement))})
    assert run.summary["stop"].startswith(f"{part}: {part}-2.fmu: ")
    assert words in run.summary["stop"]
    assert run.t_s[-1] < 0.6


def test_unsuitable_fmu_is_refused_before_the_run(tmp_path: Path) -> None:
    fmu = model_fmu(tmp_path, "imu")
    for change, words in (
        ('name="rate_radps[1]" => name="rate[1]"', r"has no variable 'rate_radps\[1\]'|has no output rate_radps"),
        ('causality="output" => causality="local"', "has no output rate_radps"),
        ('name="t_s" => name="clock"', "input clock: no field of that name"),
    ):
        with pytest.raises(BadInput, match=words):
            flown({"imu.fmu": str(described(fmu, tmp_path / "changed.fmu", change))})
    with pytest.raises(BadInput, match=r"allows steps of 0.03 s and multiples: the step is 0.02 s"):
        flown({"truth.fmu": str(model_fmu(tmp_path, "truth", step_s=0.03))})
    with pytest.raises(BadInput, match="faults of family imu are of the built-in model"):
        hil.run("scheme-1", overrides={"imu.fmu": str(fmu)}, faults=[{"device": "imu", "kind": "dropout", "at_s": 1.0}])


def test_campaign_refuses_parts_in_fmus_in_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fmu = model_fmu(tmp_path, "imu")
    arguments = ["campaign", "scheme-1", "--runs", "2", "--out", str(tmp_path / "out"), "--set", f"imu.fmu={fmu}"]
    assert execute(arguments) == BAD_INPUT
    assert "imu.fmu" in capsys.readouterr().err
