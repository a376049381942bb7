"""``hil fusion``: the filters reach the bound of the linear problem, by any implementation."""

from __future__ import annotations

import json
import math
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.stats import chi2

from hil.cli.main import execute
from hil.config.scenario import Scenario
from hil.core.messages import new
from hil.parts.campaigns import fusion
from hil.parts.campaigns.fusion import INITIAL_SIGMA, VMU_SIGMA, Reading, Study, run_batch, run_fusion
from hil.parts.campaigns.fusion_interval import largest_ratio
from hil.parts.campaigns.fusion_kernel import STUDY_RESULT

READINGS: tuple[Reading, Reading] = ("swapped", "printed")
AXES = ("position_rmse_m", "position_bound_m", "position_ratio", "position_max_m",
        "attitude_rmse_deg", "attitude_bound_deg", "attitude_ratio", "attitude_max_deg")  # fmt: skip


class Studies(NamedTuple):
    """Sixty runs of each reading: what is reported of them, and the result of each."""

    reported: dict[Reading, dict[str, Any]]
    results: dict[Reading, np.ndarray]


@pytest.fixture(scope="module")
def studies() -> Studies:
    """Return the runs of both readings, done side by side: the kernels let go of the interpreter."""
    results: dict[Reading, list[np.ndarray]] = {reading: [] for reading in READINGS}

    def kept(settings: tuple[str, ...], reading: Reading, *more: int) -> np.ndarray:
        results[reading].append(run_batch(settings, reading, *more))
        return results[reading][-1]

    with pytest.MonkeyPatch.context() as patched, ThreadPoolExecutor(2) as pool:
        patched.setattr(fusion, "run_batch", kept)
        done = list(pool.map(lambda reading: run_fusion(reading, 60, 0, (), 1, lambda n: None), READINGS))
    whole = {reading: np.concatenate(batches) for reading, batches in results.items()}
    return Studies(dict(zip(READINGS, done, strict=True)), whole)


@pytest.mark.parametrize("reading", READINGS)
def test_errors_sit_on_the_bound_and_covariances_are_honest(studies: Studies, reading: Reading) -> None:
    found = studies.reported[reading]
    assert (found["vmu_noise"], found["runs"], found["seed"]) == (reading, 60, 0)
    for quantity, unit in (("position", "m"), ("attitude", "deg")):
        ratio = np.array(found[f"{quantity}_ratio"])
        rmse, bound = (np.array(found[f"{quantity}_{kind}_{unit}"]) for kind in ("rmse", "bound"))
        np.testing.assert_allclose(ratio, rmse / bound)
        assert np.all((ratio > 0.85) & (ratio < 1.15))
        assert np.all(np.array(found[f"{quantity}_max_{unit}"]) > 2.0 * bound)
    assert sorted(found["nees_at_s"]) == ["100", "200", "300", "400"]
    for moment in found["nees_at_s"].values():
        for name, freedom in (("pkf", 9), ("akf", 6)):
            band = moment[name]
            assert [band["low"], band["high"]] == pytest.approx(chi2.ppf([0.0005, 0.9995], 60 * freedom) / 60)
            assert band["low"] < band["mean"] < band["high"]
    assert (found["nees_pkf"], found["nees_akf"]) == tuple(found["nees_at_s"]["400"][name] for name in ("pkf", "akf"))
    for name in ("nis_pkf", "nis_akf"):
        assert found[name]["low"] < found[name]["mean"] < found[name]["high"]
    assert found["rejected"] <= 1


def test_filters_in_the_plane_are_consistent() -> None:
    start = "initial.position_m=[10.0, 0.0, 0.5]", "initial.attitude_deg=[0.0, 3.0, 0.0]"
    whole = run_fusion("swapped", 60, 0, start, 1, lambda n: None)
    found = run_fusion("swapped", 60, 0, ("chaser.planar=true", *start), 1, lambda n: None)
    for moment in found["nees_at_s"].values():
        for name, freedom in (("pkf", 7), ("akf", 4)):
            band = moment[name]
            assert [band["low"], band["high"]] == pytest.approx(chi2.ppf([0.0005, 0.9995], 60 * freedom) / 60)
            assert band["low"] < band["mean"] < band["high"]
    for name, kept in (("position_rmse_m", [0, 2]), ("attitude_rmse_deg", [1])):
        assert [i for i in range(3) if found[name][i] != 0.0] == kept
        assert np.all(np.array(found[name])[kept] < 1.0001 * np.array(whole[name])[kept])


def test_numbers_do_not_depend_on_the_number_of_workers() -> None:
    told: list[int] = []
    coarse = ("step_s=0.08",)  # half a frame
    alone = run_fusion("swapped", 41, 7, coarse, 1, told.append)
    assert run_fusion("swapped", 41, 7, coarse, 2, told.append) == alone
    assert told == [20, 40, 41, 20, 40, 41]


def test_every_run_has_its_own_noise_from_seed_and_number() -> None:
    errors, coarse = [], ("step_s=0.08",)
    for seed, number in ((0, 0), (0, 1), (1, 0), (0, 0)):
        result = new(STUDY_RESULT)
        Study(coarse, "swapped", seed).run(number, result)
        errors.append(tuple(result.square_error))
    assert errors[0] == errors[3]
    assert len(set(errors)) == 3
    batch = run_batch(coarse, "swapped", 0, 1, 2)
    assert tuple(batch[0].square_error) == errors[1]
    assert not np.any(batch[0].square_error == batch[1].square_error)


def test_further_sensor_is_fused_and_its_covariance_is_honest() -> None:
    alone = Study((), "swapped", 0).bound()
    sensors = ("sensors.ranger.kind=range_finder", "sensors.gnss.kind=relative_gnss", "sensors.gnss.range_min_m=0.1")
    found = run_fusion("swapped", 20, 3, sensors, 1, lambda n: None)
    assert found["position_bound_m"][0] < 0.6 * math.sqrt(alone.variance[0])
    assert max(found["position_ratio"]) < found["position_ratio_limit"]
    for moment in found["nees_at_s"].values():
        for band in moment.values():
            assert band["low"] < band["mean"] < band["high"]


@pytest.mark.parametrize(
    ("reading", "position_m", "attitude_100_s_deg", "attitude_400_s_deg"),
    [("swapped", 0.00087, 0.0014, 0.0012), ("printed", 0.0041, 0.00035, 0.00020)],
)
def test_bound_is_the_published_one(
    scheme_2: Scenario, reading: Reading, position_m: float, attitude_100_s_deg: float, attitude_400_s_deg: float
) -> None:
    trace, result = np.zeros((20000, 12)), new(STUDY_RESULT)
    Study((), reading, 0).run(0, result, trace, noisy=False)
    assert np.abs(trace[:, :6]).max() < 1e-11  # without noise the filters follow the truth
    frames = trace[7::8, 6:]
    after_100_s = frames[frames.shape[0] // 4 :]
    np.testing.assert_allclose(after_100_s[:, :3], position_m, rtol=0.03)
    np.testing.assert_allclose(np.degrees(after_100_s[0, 3:]), attitude_100_s_deg, rtol=0.03)
    np.testing.assert_allclose(np.degrees(after_100_s[-1, 3:]), attitude_400_s_deg, rtol=0.03)
    bound = np.sqrt(Study((), reading, 0).bound().variance)
    np.testing.assert_allclose(bound, np.sqrt((trace[5000:, 6:] ** 2).mean(axis=0)), rtol=1e-9)


@pytest.mark.parametrize("reading", READINGS)
def test_bound_is_that_of_one_axis_alone(scheme_2: Scenario, reading: Reading) -> None:
    """A double integrator with bias and a rotation with drift, in numpy: no orbit, no lever arm."""
    dt, imu, (sigma_m, sigma_deg) = 0.02, scheme_2.imu, VMU_SIGMA[reading]
    r_0, v_0, bias_0, turn_0, drift_0 = INITIAL_SIGMA
    noise = imu.accelerometer_noise_mps2 * np.array([0.5 * dt**2, dt, 0.0])
    problems = [
        (
            np.array([[1, dt, -0.5 * dt**2], [0, 1, -dt], [0, 0, 1]]),
            np.outer(noise, noise) + np.diag([0.0, 0.0, (dt * imu.accelerometer_bias_noise_mps3) ** 2]),
            np.diag([r_0, v_0, bias_0]) ** 2,
            sigma_m,
        ),
        (
            np.array([[1, -dt], [0, 1]]),
            dt**2 * np.diag(np.radians([imu.gyro_noise_degps, imu.gyro_drift_noise_degps2]) ** 2),
            np.diag([turn_0, drift_0]) ** 2,
            math.radians(sigma_deg),
        ),
    ]
    bound = np.sqrt(Study((), reading, 0).bound().variance).reshape(2, 3)
    for (f, q, p, sigma), expected in zip(problems, bound, strict=True):
        total = 0.0
        for k in range(1, 20001):
            p = f @ p @ f.T + q
            if k % 8 == 0:
                p = p - np.outer(p[0], p[0]) / (p[0, 0] + sigma**2)
            total += p[0, 0] if k > 5000 else 0.0
        np.testing.assert_allclose(expected, math.sqrt(total / 15000), rtol=0.01)


@pytest.mark.parametrize(("setting", "code"), [("step_s=0.02", 0), ("gnc.pkf.accelerometer_noise_mps2=1e-2", 1)])
def test_exit_code_reports_whether_the_filters_reach_the_bound(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], setting: str, code: int
) -> None:
    path, seed = tmp_path / "fusion.json", 0
    assert execute(["fusion", "--runs", "2", "--set", setting, "--json", str(path)]) == code
    assert ("PASS" if code == 0 else "FAIL") in capsys.readouterr().out
    found = json.loads(path.read_text())
    assert (found["vmu_noise"], found["runs"], found["seed"]) == ("swapped", 2, seed)
    for key in AXES:
        assert len(found[key]) == 3
        assert min(found[key]) > 0.0
    for key in ("nees_pkf", "nees_akf", "nis_pkf", "nis_akf"):
        assert sorted(found[key]) == ["high", "low", "mean"]
    for name in ("position", "attitude"):
        assert found[f"{name}_ratio_limit"] > 1.05
    fits = all(max(found[f"{name}_ratio"]) <= found[f"{name}_ratio_limit"] for name in ("position", "attitude"))
    nees = [band["low"] <= band["mean"] <= band["high"] for at in found["nees_at_s"].values() for band in at.values()]
    assert (fits and all(nees)) == (code == 0)
    assert [entry.name for entry in tmp_path.iterdir()] == ["fusion.json"]


def test_json_to_standard_output_is_all_that_stands_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["fusion", "--vmu-noise", "printed", "--runs", "1", "--json=-"]) in (0, 1)
    assert json.loads(capsys.readouterr().out)["vmu_noise"] == "printed"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--runs", "0"), ("--runs", "0", "at least 1")),
        (("--runs", "-3"), ("--runs", "-3", "at least 1")),
        (("--runs", "many"), ("--runs", "many")),
        (("--seed", "-1"), ("--seed", "-1", "must not be negative")),
        (("--workers", "-1"), ("--workers", "-1", "at least 0")),
        (("--vmu-noise", "both"), ("--vmu-noise", "both", "swapped", "printed")),
        (("--json", "/no/such/folder/f.json"), ("--json", "/no/such/folder", "does not exist")),
        (("--figure", "/no/such/folder/f.png"), ("--figure", "/no/such/folder", "does not exist")),
        (("--set", "gnc.akf.colour=3"), ("gnc.akf.colour", "unknown key", "gyro_noise_degps")),
        (("--set", "gnc.akf.form=as_printed"), ("gnc.akf.form", "unknown key")),
        (("--set", "sensors.r.kind=range_finder", "--set", "sensors.r.use=witness"), ("sensors.r", "no witnesses")),
        (("--set", "sensors.r.kind=ranger"), ("sensors.r.kind", "no such sensor")),
        (("--no-such-option", "1"), ("--no-such-option",)),
    ],
)
def test_bad_input_is_refused_in_one_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    assert execute(["fusion", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.strip().splitlines()) == 1, printed.err
    assert all(word in printed.err for word in words), printed.err


@pytest.mark.parametrize(
    ("option", "value"),
    [("--runs", "1.5"), ("--figure", "{folder}/picture.foo"), ("--json", "{folder}"), ("--set", "rig.vmu.colour=3")],
)
def test_bad_input_is_refused_before_the_runs(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], option: str, value: str
) -> None:
    folder = tmp_path / "there"
    folder.mkdir()
    given = {"--runs": "1", option: value.format(folder=folder)}
    assert execute(["fusion", *(word for pair in given.items() for word in pair)]) == 2
    assert capsys.readouterr().out == ""


def test_dash_after_a_space_is_standard_output(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["fusion", "--runs", "1", "--json", "-"]) in (0, 1)
    assert json.loads(capsys.readouterr().out)["runs"] == 1


def test_all_bad_options_are_reported_at_once(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["fusion", "--runs", "0", "--seed", "-1", "--workers", "-1", "--json", "/no/such/f.json"]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert [line.split(":")[0] for line in lines] == ["--runs", "--seed", "--workers", "--json"]


def test_bound_does_not_move_with_the_filters_that_it_judges() -> None:
    settings = ("gnc.pkf.accelerometer_noise_mps2=3e-4", "gnc.akf.gyro_noise_degps=3e-6")
    shipped, other = (np.array(Study(of, "swapped", 0).bound().variance) for of in ((), settings))
    np.testing.assert_array_equal(other, shipped)
    worse = np.array(Study(("imu.accelerometer_noise_mps2=3e-4",), "swapped", 0).bound().variance)
    assert np.all(worse[:3] > 1.2 * shipped[:3])


def test_limit_of_the_ratio_is_that_of_the_scatter_of_the_runs(studies: Studies) -> None:
    """The mean square errors of sixty runs scatter as the degrees of freedom of the limit."""
    for reading in READINGS:
        results = studies.results[reading]
        assert len(results) == 60
        for freedom, axes in zip(Study((), reading, 0).degrees_of_freedom(), (slice(0, 3), slice(3, 6)), strict=True):
            squares = results["square_error"][:, axes]
            found = 2.0 * squares.mean() ** 2 / squares.var(axis=0, ddof=1).mean()
            assert found == pytest.approx(freedom, rel=0.5)
    limits = [largest_ratio(2.4, runs, 6, 0.999) for runs in (1, 100, 10_000)]
    assert limits[0] > limits[1] > limits[2] > 1.0
    assert studies.reported["swapped"]["attitude_ratio_limit"] == largest_ratio(
        Study((), "swapped", 0).degrees_of_freedom()[1], 60, 6, 0.999
    )
