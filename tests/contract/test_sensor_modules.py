"""One contract over all sensor modules: Jacobian, noise, bits of all shells, faults, recording and replay."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.core.gnc_records import GncHealth
from hil.core.sensor_records import ACCEPTED, NOT_USED, SENSOR_ARRIVAL
from hil.parts.campaigns.case_runner import CaseRunner
from hil.recording import read
from hil.recording.replay import replay
from hil.sensors import check
from hil.sensors.registry import SHIPPED, sensor
from hil.session import build
from tests.support.rows import assert_same_bits
from tests.support.run_settings import faults_setting, make_job

pytestmark = pytest.mark.xdist_group("campaign")

PLUGIN = f"{Path(__file__).resolve().parents[2]}/examples/sensor_python/acme_bearing.py:BearingCamera"
KINDS = [*SHIPPED, PLUGIN]
NEAR = {"relative_gnss": ("sensors.s.range_min_m=0.1",)}
"""Settings with which a sensor measures in scheme 1."""
LATE = ("sensors.s.latency_s=0.13", "sensors.s.loss_probability=0.2")
END_S = 8.0
LATE_CYCLES = 20


class Rows(list[np.ndarray]):
    """Sink that keeps a copy of each row."""

    def put(self, row: np.ndarray) -> None:
        self.append(row.copy())


def settings(kind: str, *more: str) -> tuple[str, ...]:
    return (f"sensors.s.kind={json.dumps(kind)}", *NEAR.get(kind, ()), *more)


def fly(kind: str, *more: str, compiled: bool = True, seed: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of a short run of scheme 1, and those of its further sensor."""
    job = make_job(END_S, settings(kind, *more), seed=seed)
    with build.runner(build.Job(job.scenario, job.rig, seed, END_S, 1.0, compiled=compiled)) as runner:
        rows = Rows()
        assert runner.loop.sensors is not None
        runner.loop.sensors.sink = rows
        return runner.run().history, np.concatenate([np.zeros(0, SENSOR_ARRIVAL), *rows])


@pytest.mark.parametrize("kind", KINDS)
def test_jacobian_and_noise_are_as_stated(kind: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["sensors", "check", kind, "--seed", "5", "--json", "-"]) == 0
    assert json.loads(capsys.readouterr().out)["problems"] == []


def test_each_module_is_listed_and_another_Jacobian_than_stated_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["sensors", "list"]) == 0
    listed = capsys.readouterr().out
    assert all(kind in listed for kind in SHIPPED)
    file = tmp_path / "bearing.py"
    text = Path(PLUGIN.rpartition(":")[0]).read_text()
    file.write_text(text.replace("-1.0 - (s[1]", "-2.0 - (s[1]"))
    assert execute(["sensors", "check", f"{file}:BearingCamera"]) == 2
    assert "innovate: h of " in capsys.readouterr().err


@pytest.mark.parametrize("kind", KINDS)
def test_compiled_loop_cycle_in_python_and_campaign_have_the_same_bits(kind: str) -> None:
    compiled, samples = fly(kind, *LATE)
    python, again = fly(kind, *LATE, compiled=False)
    assert_same_bits(compiled, python)
    assert samples.tobytes() == again.tobytes()
    assert (samples["result"] == ACCEPTED).sum() > 3
    job = make_job(END_S, settings(kind, *LATE), seed=3)
    case = np.zeros_like(compiled)
    CaseRunner(job.scenario.value, job.rig.value, END_S).run(job.scenario.value, 3, case)
    assert_same_bits(compiled, case, without=("on_wire_s",))


@pytest.mark.parametrize("kind", KINDS)
def test_late_sample_is_fused_at_the_moment_of_its_measurement(kind: str, tmp_path: Path) -> None:
    """Once all samples have arrived, estimate and covariance are those of the same inputs without delay."""
    known_noise = "gnc.navigation.budget.vision_noise_scale_sigma=0.0"  # otherwise the factor of the noise is adapted
    overrides = dict(_pair(text) for text in settings(kind, "sensors.s.rate_hz=1.0", known_noise))
    hil.run("scheme-1", seed=4, duration_s=END_S, record=tmp_path, overrides=overrides)
    recorded = read.load(next(tmp_path.glob("*.mcap")))
    late = recorded.sensor_arrivals.copy()
    late["cycle"] += LATE_CYCLES
    late["sample"]["received_s"] += LATE_CYCLES * 0.02
    kept: list[tuple[np.ndarray, np.ndarray]] = []
    replay(replace(recorded, sensor_arrivals=late), recorded.scenario, keep=lambda *rows: kept.append(rows))
    ((at_once, found),) = kept
    k = round(7.8 / 0.02)  # the last sample was measured at 7 s
    assert (found["navigation"]["r_CT_H"][:k] != at_once["navigation"]["r_CT_H"][:k]).any()
    for name, atol in (("r_CT_H", 1e-12), ("q_CH", 1e-13), ("sigma_r_m", 1e-12)):
        np.testing.assert_allclose(found["navigation"][name][k], at_once["navigation"][name][k], rtol=0.0, atol=atol)


@pytest.mark.parametrize("kind", KINDS)
def test_mean_nis_is_one_and_the_estimate_is_consistent(kind: str) -> None:
    run = hil.run("scheme-1", seed=11, duration_s=150.0, overrides=dict(_pair(text) for text in settings(kind)))
    found = run.summary["sensors"]["s"]
    assert found["accepted"] > 50
    assert found["suspected"] == 0
    assert found["mean_nis"] == pytest.approx(1.0, abs=0.35)
    assert run.summary["decision"]["nees_ok"] is not False


def _pair(text: str) -> tuple[str, object]:
    key, _, value = text.partition("=")
    try:
        return key, json.loads(value)
    except ValueError:
        return key, value


@pytest.mark.parametrize(
    ("fault", "value"),
    [("no_sample", None), ("frozen", None), ("offset", 30.0), ("drift", 1.0), ("outlier", 0.5), ("noise_scale", 8.0)],
)
def test_each_kind_of_fault_has_its_effect_and_is_seen(fault: str, value: float | None) -> None:
    table = {"device": "sensor.s", "kind": fault, "at_s": 2.0} | ({} if value is None else {"value": value})
    healthy, samples = fly("range_finder")
    faulty, changed = fly("range_finder", faults_setting(table))
    before = healthy["t_s"] < 1.99
    assert_same_bits(healthy[before], faulty[before])
    if fault == "no_sample":
        assert len(changed) < len(samples) / 2
        return
    assert (changed["sample"]["value"] != samples["sample"]["value"]).any()
    late = changed["sample"]["t_s"] > 4.0
    if fault in ("offset", "drift", "noise_scale"):
        assert (changed["result"][late] != ACCEPTED).mean() > 0.5
        assert faulty["navigation"]["health"][-1] & 128
    error = np.abs(faulty["navigation"]["r_CT_H"] - faulty["truth"]["r_CT_H"])
    level = faulty["navigation"]["protection_level_m"]
    assert (error <= level).all()


def test_samples_are_recorded_exported_and_replayed(tmp_path: Path) -> None:
    run = hil.run(
        "scheme-1", seed=2, duration_s=6.0, record=tmp_path,
        overrides={"sensors.ranger.kind": "range_finder", "sensors.ranger.latency_s": 0.1},
    )  # fmt: skip
    (path,) = tmp_path.glob("*.mcap")
    recording = hil.open(path)
    assert recording.replay().identical
    for flown in (run, recording):
        ranger = flown.sensors["ranger"]
        assert len(ranger) == 60
        shown_m = np.interp(ranger.t_s, flown.t_s, np.linalg.norm(flown.truth.r_CT_H, axis=1))
        assert ranger.range_m - shown_m == pytest.approx(np.mean(ranger.range_m - shown_m), abs=6e-3)
        assert run.sensors["ranger"].records.tobytes() == ranger.records.tobytes()
    from hil.parts.export.table import export

    written = {file.name: rows for file, rows in export(path, "csv", tmp_path / "run.csv")}
    assert written["run-sensor-ranger.csv"] == 60
    header = (tmp_path / "run-sensor-ranger.csv").read_text().splitlines()[0]
    assert header == "t_s,received_s,cycle,result,nis,range_m,sigma_range_m,innovation_range_m"


def test_offset_that_a_budget_covers_is_estimated_and_one_that_it_does_not_is_within_the_level() -> None:
    of_ranger = {"sensors.r.kind": "range_finder", "sensors.r.bias_m": 0.005}
    covered = hil.run("scheme-1", seed=5, overrides={**of_ranger, "sensors.r.bias_sigma_m": 0.006})
    error = np.abs(covered.navigation.r_CT_H - covered.truth.r_CT_H)[-1]
    assert covered.accepted
    assert error[0] < 0.002
    alone = hil.run("scheme-1", seed=5, overrides=of_ranger)
    assert alone.summary["decision"]["beyond_level_cycles"] == 0
    assert not alone.summary["decision"]["error"]


def test_scenario_that_nothing_could_fly_names_key_and_reason() -> None:
    rig = load_rig("mock")
    for texts, key, reason in (
        (settings("lidr"), "sensors.s.kind", "did you mean lidar?"),
        (settings("lidar", "sensors.s.sigma=1.0"), "sensors.s.sigma", "did you mean sigma_range_m"),
        (settings("lidar", "sensors.s.sigma_range_m=-1.0"), "sensors.s.sigma_range_m", "must be 1e-05 to 10 m"),
        (settings("lidar", "sensors.s.rate_hz=200.0"), "sensors.s.rate_hz", "at most one measurement per cycle"),
        (settings("lidar", "sensors.s.latency_s=1.0", "gnc.navigation.memory_s=0.5"), "sensors.s.latency_s",
         "the filters remember"),
        (settings("lidar", "gnc.library=own.so"), "gnc.library", "no such file"),
        (settings("star_tracker", faults_setting({"device": "sensor.s", "kind": "outlier", "at_s": 1.0, "value": 0.1})),
         "faults[0]", "star_tracker has no_sample"),
    ):  # fmt: skip
        with pytest.raises(hil.errors.BadInput) as error:
            build.check(build.Job(load_scenario("scheme-1", texts), rig, 0, 1.0, 1.0))
        assert [problem.key for problem in error.value.problems] == [key]
        assert reason in error.value.problems[0].message


class OwnNavigation:
    """Navigation, or a whole GNC, that keeps the measurements that it receives."""

    def __init__(self) -> None:
        self.taken: list[tuple[int, float, float, float]] = []

    def step(self, given: Any) -> None:
        given = getattr(given, "measured", given)
        for each in given.measurements[: given.n_measurements]:
            self.taken.append((int(each.sensor), float(each.t_s), float(each.value[0]), float(each.covariance[0, 0])))


@pytest.mark.parametrize("part", ["navigation", "gnc"])
def test_navigation_of_the_users_own_receives_what_is_fused_and_no_witness(part: str) -> None:
    own = OwnNavigation()
    overrides = {
        "sensors.w.kind": "range_finder", "sensors.w.use": "witness", "sensors.s.kind": "range_finder",
        "sensors.s.latency_s": 0.1, "sensors.s.sigma_m": 0.002,
    }  # fmt: skip
    run = hil.run("scheme-1", seed=3, duration_s=2.0, overrides=overrides, **{part: own})  # type: ignore[arg-type]
    assert {number for number, *_ in own.taken} == {1}
    assert [t_s for _, t_s, *_ in own.taken] == pytest.approx(0.1 * np.arange(len(own.taken)), abs=1e-9)
    assert len(own.taken) == 20  # that of 2 s has not arrived
    _, _, distance, variance = own.taken[0]
    assert distance == pytest.approx(np.linalg.norm(run.truth.r_CT_H[0] + (0.3, 0.0, 0.0)), abs=0.05)
    assert variance == pytest.approx(0.002**2)


MODULE = """
import hil


class Height(hil.SensorModule):
    kind = "height"
    components = (hil.Component("height_m", "m", "z of the chaser in H"),)
    faults = {"no_sample": "nothing is unseen"}

    @staticmethod
    def measure(settings, truth, out):
        out.sample.value[0] = truth.r_CT_H[2]
        out.sample.covariance[0, 0] = VARIANCE

    @staticmethod
    def innovate(settings, estimate, out):
        out.value[0] = out.sample.value[0] - estimate.r_CT_H[2]
        out.h[0, 2] = 1.0
"""


SUN = """
import hil
from hil.maths import quat, stack


class SunSensor(hil.SensorModule):
    kind = "sun"
    components = tuple(hil.Component(f"sun_{axis}", "1", "direction of the Sun in c") for axis in "xyz")
    settings = (hil.Setting("sigma", 1e-3, "1", 1e-7, 1.0, "noise of each component"),)
    faults = {"no_sample": "nothing is unseen"}

    @staticmethod
    def measure(settings, truth, out):
        sun = stack.vector(3)
        sun[0], sun[1], sun[2] = 0.6, 0.8, 0.0  # in I
        quat.transform_into(truth.q_HI, sun, sun)
        quat.transform_into(truth.q_CH, sun, sun)
        for i in range(3):
            out.sample.value[i] = sun[i] + settings.sigma * truth.normal[i]
            out.sample.covariance[i, i] = settings.sigma**2

    @staticmethod
    def innovate(settings, estimate, out):
        sun = stack.vector(3)
        sun[0], sun[1], sun[2] = 0.6, 0.8, 0.0
        quat.transform_into(estimate.q_HI, sun, sun)
        quat.transform_into(estimate.q_CH, sun, sun)
        for i in range(3):
            out.value[i] = out.sample.value[i] - sun[i]
            j, k = (i + 1) % 3, (i + 2) % 3
            out.h[i, 6 + k], out.h[i, 6 + j] = sun[j], -sun[k]  # -theta x sun
"""


def test_module_of_a_direction_in_inertial_space_has_the_attitude_of_the_hill_frame(tmp_path: Path) -> None:
    path = tmp_path / "sun.py"
    path.write_text(SUN)
    kind = f"{path}:SunSensor"
    assert check.problems(sensor(kind), seed=5) == []
    for eccentricity in (0.0, 0.02):
        overrides = {"sensors.s.kind": kind, "orbit.eccentricity": eccentricity}
        run = hil.run("scheme-1", seed=4, duration_s=100.0, overrides=overrides)
        found = run.summary["sensors"]["s"]
        assert found["accepted"] > 500
        assert found["mean_nis"] == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("variance", ["-1e-6", "0.0", "float('nan')"])
def test_sample_whose_covariance_is_none_is_rejected_and_the_filters_stay_sound(tmp_path: Path, variance: str) -> None:
    path = tmp_path / "height.py"
    path.write_text(MODULE.replace("VARIANCE", variance))
    run = hil.run("scheme-1", seed=3, duration_s=2.0, overrides={"sensors.s.kind": f"{path}:Height"})
    found = run.summary["sensors"]["s"]
    assert found["accepted"] == 0
    assert found["rejected"] + found["excluded"] > 15
    assert not (run.navigation.health & GncHealth.COVARIANCE_INVALID).any()
    assert np.isfinite(run.navigation.r_CT_H[5:]).all()


@pytest.mark.parametrize("kind", KINDS)
def test_as_a_witness_it_leaves_the_estimate_alone_and_accuses_it_of_what_it_sees(kind: str) -> None:
    """An offset of the witness stands for one of the estimate; the reaction is a hold."""
    witness = 'sensors.s.use="witness"'
    alone, none = fly(kind, witness, "sensors.s.enabled=false")
    sound, samples = fly(kind, witness)
    assert not (sound["navigation"]["health"] & GncHealth.MONITOR_DISAGREES).any()
    assert (none["result"] == NOT_USED).all()
    assert set(samples["result"]) <= {NOT_USED, ACCEPTED}
    np.testing.assert_array_equal(alone["navigation"]["r_CT_H"], sound["navigation"]["r_CT_H"])
    offset = {"device": "sensor.s", "kind": "offset", "at_s": 4.0, "value": 50.0 if kind == "relative_gnss" else 0.5}
    off, _ = fly(kind, witness, faults_setting(offset))
    python, _ = fly(kind, witness, faults_setting(offset), compiled=False)
    assert_same_bits(off, python)
    accused = (off["navigation"]["health"] & GncHealth.MONITOR_DISAGREES) != 0
    assert not accused[off["t_s"] < 4.0].any()
    assert accused[-1]
