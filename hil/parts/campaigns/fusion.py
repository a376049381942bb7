"""Fusion study (``hil fusion``): the bench paper's numerical simulation (IV.A) over many seeds, against the bound."""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, Final, Literal

import numpy as np
from scipy.stats import chi2

from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.core.messages import IMU, POSE, REFERENCE, TRUTH, Array, new
from hil.core.surroundings import prepare_worker_processes
from hil.errors import BadInput
from hil.gnc.estimation.fusion import FUSION_STATE
from hil.gnc.estimation.plane import filter_states
from hil.gnc.estimation.step_memory import new_memory
from hil.gnc.guidance import GUIDANCE_STATE
from hil.models.faults import SEED_BITS
from hil.params import dynamics as dynamics_params
from hil.params import gnc as gnc_params
from hil.params.sensors import constant_error_sigmas, sensor_sources, sensors_of
from hil.parts.campaigns import fusion_kernel
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.fusion_interval import AxisProblem, degrees_of_freedom, largest_ratio
from hil.sensors.measurement import SENSOR_STATE
from hil.sensors.registry import with_sensor_settings

Reading = Literal["swapped", "printed"]

VMU_SIGMA = {"swapped": (0.005, 0.033), "printed": (0.033, 0.005)}  # m, deg: Table I's rows, in either order
INITIAL_SIGMA = (0.1, 0.02, 5e-4, math.radians(3.0), math.radians(1e-5))
"""m, m/s, m/s^2, rad, rad/s: of position, velocity, bias, attitude and drift at the start."""

LARGEST_RATIO = 1.05
"""Greatest rmse over bound with which the filters count as optimal after many runs; with few its sampling error."""

TABLE_II_SD = ((0.0037, 0.0039, 0.0039), (0.0304, 0.0315, 0.0312))  # m, deg

_OF_THE_PAPER = (
    "gnc.ephemeris.rate_sigma_degps=[0,0,0]",
    "gnc.navigation.thrust.enabled=false",
    "gnc.navigation.budget.vision_bias_sigma_m=[0,0,0]",
    "gnc.navigation.budget.vision_misalignment_sigma_deg=0",
    "gnc.navigation.budget.vision_scale_sigma=0",
    "gnc.navigation.budget.vision_noise_scale_sigma=0",
)
"""The motion of the study is Hill's, the filters' only inputs are the IMU and poses."""
_SENSORS: Final = 1  # key of the random streams of further sensors
_ROTATION_TIME_S = 10.0  # the paper's attitude converges in about 10 s
_BAND = 0.999
_BATCH = 20
_COLOURS = ("#0072b2", "#d55e00", "#009e73")  # distinguishable for colour-blind readers


def study_params(scenario: Scenario, reading: Reading, vmu_rate_hz: float) -> np.record:
    """Return STUDY_PARAMS for ``scenario``'s line and attitude."""
    params = new(fusion_kernel.STUDY_PARAMS)
    params.cycles = round(fusion_kernel.SNAPSHOTS_S[-1] / scenario.step_s)
    params.frame_cycles = round(1.0 / (vmu_rate_hz * scenario.step_s))
    params.sigma_position = VMU_SIGMA[reading][0]
    params.sigma_angle = math.radians(VMU_SIGMA[reading][1])
    params.initial_rotation = gnc_params.initial_rotation_vector(scenario)
    params.rotation_time = _ROTATION_TIME_S
    params.initial_sigma = np.repeat(INITIAL_SIGMA, 3)
    return params


def _with_sizes_of_the_sensors(scenario: Scenario) -> Scenario:
    """Return ``scenario`` whose filters assume the IMU's true noise."""
    imu, gnc = scenario.imu, scenario.gnc
    akf = gnc.akf.model_copy(
        update={
            "gyro_noise_degps": imu.gyro_noise_degps,
            "gyro_drift_noise_degps2": imu.gyro_drift_noise_degps2,
        }
    )
    pkf = gnc.pkf.model_copy(
        update={
            "accelerometer_noise_mps2": imu.accelerometer_noise_mps2,
            "accelerometer_bias_noise_mps3": imu.accelerometer_bias_noise_mps3,
        }
    )
    return scenario.model_copy(update={"gnc": gnc.model_copy(update={"akf": akf, "pkf": pkf})})


def _scenario(settings: tuple[str, ...]) -> Scenario:
    """Return scheme 2 with ``settings``. Raises BadInput, also for a sensor that the study cannot fuse."""
    scenario = with_sensor_settings(load_scenario("scheme-2", settings))
    problems = [
        scenario.problem(f"sensors.{name}", f"not available: hil fusion has no {what}")
        for name, (_, config, models) in sensors_of(scenario.value).items()
        for what, is_one in (("witnesses", config.use == "witness"), ("datagrams, only modelled sensors", not models))
        if is_one
    ]
    if problems:
        raise BadInput(problems)
    return scenario.value


class Study:
    """The parameters of one reading of Table I; each ``run`` is keyed by its number."""

    def __init__(self, settings: tuple[str, ...], reading: Reading, seed: int) -> None:
        circular = (*_OF_THE_PAPER, *settings)
        scenario = _scenario(circular)
        self.step_s, self.planar = scenario.step_s, scenario.chaser.planar
        self.vmu_rate_hz = load_rig("mock", settings).value.vmu.rate_hz
        self._study = study_params(scenario, reading, self.vmu_rate_hz)
        self._filters = gnc_params.navigation(scenario).fusion
        self._optimal = gnc_params.navigation(_with_sizes_of_the_sensors(scenario)).fusion
        self._filters.orbit.eccentricity = self._optimal.orbit.eccentricity = 0.0
        self._imu, self._imu_sizes = dynamics_params.imu(scenario), scenario.imu
        self._line = gnc_params.guidance(scenario)
        self._seed, self._start = seed, dynamics_params.initial_truth(scenario)
        self._sensors, self._error_sigmas = sensor_sources(scenario, 0), constant_error_sigmas(scenario)

    def run(self, number: int, result: np.record, trace: Array | None = None, noisy: bool = True) -> None:
        """Do run ``number``; write STUDY_RESULT. trace: (n, 12), filled for the first n cycles.

        noisy: if not, the covariance of the optimal filter is that of the result, whatever the filters assume.
        """
        filters = self._filters if noisy else self._optimal
        truth, sensors = new(TRUTH), self._sensors
        truth.r_T_I, truth.q_HI = self._start.r_T_I, self._start.q_HI
        random = np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(number, _SENSORS)))
        sensors.seed = int(random.integers(SEED_BITS)) if noisy else -1
        errors = self._error_sigmas * random.standard_normal(self._error_sigmas.shape) * noisy
        fusion_kernel.run_study(
            self._study,
            filters,
            self._imu,
            self._line,
            new(GUIDANCE_STATE),
            new(REFERENCE),
            truth,
            new(IMU),
            new(POSE),
            new(FUSION_STATE),
            new_memory(filters),
            sensors,
            new(SENSOR_STATE),
            errors,
            np.random.default_rng(np.random.SeedSequence(self._seed, spawn_key=(number,))),
            1 if noisy else 0,
            result,
            np.empty((0, 12)) if trace is None else trace,
        )

    def degrees_of_freedom(self) -> tuple[float, float]:
        """Return the degrees of freedom of a run's mean square error of an axis, in position and attitude."""
        imu, dt, study = self._imu_sizes, self.step_s, self._study
        r, v, bias, rotation, drift = INITIAL_SIGMA
        force = imu.accelerometer_noise_mps2 * np.array([0.5 * dt**2, dt, 0.0])
        walk = np.diag([0.0, 0.0, (dt * imu.accelerometer_bias_noise_mps3) ** 2])
        gyro = np.radians([imu.gyro_noise_degps, imu.gyro_drift_noise_degps2])
        problems = (
            AxisProblem(
                np.array([[1.0, dt, -0.5 * dt**2], [0.0, 1.0, -dt], [0.0, 0.0, 1.0]]),
                np.outer(force, force) + walk,
                np.diag([r, v, bias]) ** 2,
                float(study.sigma_position) ** 2,
            ),
            AxisProblem(
                np.array([[1.0, -dt], [0.0, 1.0]]),
                np.diag(dt * gyro) ** 2,
                np.diag([rotation, drift]) ** 2,
                float(study.sigma_angle) ** 2,
            ),
        )
        steps, poses = int(study.frame_cycles), int(study.cycles // study.frame_cycles)
        first = round(fusion_kernel.STEADY_STATE_AFTER_S / (steps * dt))
        position, attitude = (degrees_of_freedom(problem, steps, first, poses) for problem in problems)
        return position, attitude

    def bound(self) -> np.record:
        """Return STUDY_RESULT whose variance is that of the linear problem along the line."""
        result = new(fusion_kernel.STUDY_RESULT)
        self.run(0, result, noisy=False)
        return result


def run_batch(settings: tuple[str, ...], reading: Reading, seed: int, first: int, count: int) -> np.ndarray:
    """Return STUDY_RESULT of the runs ``first`` .. ``first + count``, (count,)."""
    study = Study(settings, reading, seed)
    results = np.zeros(count, fusion_kernel.STUDY_RESULT).view(np.recarray)
    for row in range(count):
        study.run(first + row, results[row])
    return results


def run_fusion(
    reading: Reading,
    runs: int,
    seed: int,
    settings: tuple[str, ...],
    workers: int,
    watch: Callable[[int], None],
) -> dict[str, Any]:
    """Do the study; return its numbers under the names of ``hil fusion --json``.

    watch: called with the number of completed runs.
    """
    study = Study(settings, reading, seed)
    bound = study.bound()
    batches = [(first, min(_BATCH, runs - first)) for first in range(0, runs, _BATCH)]
    parts: list[np.ndarray] = []
    if workers == 1 or len(batches) == 1:
        for first, count in batches:
            parts.append(run_batch(settings, reading, seed, first, count))
            watch(first + count)
    else:
        prepare_worker_processes()
        with ProcessPoolExecutor(workers, mp_context=get_context("forkserver")) as pool:
            waiting = [pool.submit(run_batch, settings, reading, seed, first, count) for first, count in batches]
            done = 0
            for future in waiting:
                parts.append(future.result())
                done += len(parts[-1])
                watch(done)
    return _summary(reading, seed, np.concatenate(parts), bound, study)


def _summary(reading: Reading, seed: int, results: np.ndarray, bound: np.record, study: Study) -> dict[str, Any]:
    n = len(results)
    updates = n * round((fusion_kernel.SNAPSHOTS_S[-1] - fusion_kernel.SNAPSHOTS_S[0]) * study.vmu_rate_hz)
    rmse = np.sqrt(results["square_error"].mean(axis=0))
    limit = np.sqrt(np.array(bound.variance))
    ratio = np.divide(rmse, limit, out=np.ones(6), where=limit > 0.0)  # what a plane holds is known
    position, attitude = study.degrees_of_freedom()
    of_position, of_attitude = filter_states(study.planar)
    return {
        "vmu_noise": reading,
        "runs": n,
        "seed": seed,
        "position_rmse_m": _list(rmse[:3]),
        "position_bound_m": _list(limit[:3]),
        "position_ratio": _list(ratio[:3]),
        "position_ratio_limit": max(LARGEST_RATIO, largest_ratio(position, n, 6, _BAND)),
        "position_max_m": _list(results["largest_error"].max(axis=0)[:3]),
        "attitude_rmse_deg": _list(np.degrees(rmse[3:])),
        "attitude_bound_deg": _list(np.degrees(limit[3:])),
        "attitude_ratio": _list(ratio[3:]),
        "attitude_ratio_limit": max(LARGEST_RATIO, largest_ratio(attitude, n, 6, _BAND)),
        "attitude_max_deg": _list(np.degrees(results["largest_error"].max(axis=0)[3:])),
        "nees_pkf": _band(results["nees_pkf"][:, -1], of_position),
        "nees_akf": _band(results["nees_akf"][:, -1], of_attitude),
        "nees_at_s": {
            f"{t_s:g}": {
                "pkf": _band(results["nees_pkf"][:, i], of_position),
                "akf": _band(results["nees_akf"][:, i], of_attitude),
            }
            for i, t_s in enumerate(fusion_kernel.SNAPSHOTS_S)
        },
        "nis_pkf": _nis(results["nis_pkf"], updates),
        "nis_akf": _nis(results["nis_akf"], updates),
        "rejected": int(results["rejected"].sum()),
    }


def _band(values: Array, degrees_of_freedom: int) -> dict[str, float]:
    """Return the mean over the runs with the chi-square band of that mean."""
    n = len(values)
    tail = 0.5 * (1.0 - _BAND)
    low, high = (float(chi2.ppf(p, n * degrees_of_freedom)) / n for p in (tail, 1.0 - tail))
    return {"mean": float(values.mean()), "low": low, "high": high}


def _nis(values: Array, updates: int) -> dict[str, float]:
    """Return the mean of three-component NIS over all ``updates`` of all runs; values: the mean of each run."""
    tail = 0.5 * (1.0 - _BAND)
    low, high = (float(chi2.ppf(p, 3 * updates)) / updates for p in (tail, 1.0 - tail))
    return {"mean": float(values.mean()), "low": low, "high": high}


def _list(values: Array) -> list[float]:
    return [float(value) for value in values]


def draw(reading: Reading, seed: int, settings: tuple[str, ...], path: str) -> None:
    """Draw run 0 of the study of ``seed`` into ``path``."""
    import matplotlib as mpl

    mpl.use("Agg")
    from matplotlib import pyplot as plt

    study = Study(settings, reading, seed)
    trace = np.zeros((round(fusion_kernel.SNAPSHOTS_S[-1] / study.step_s), 12))
    study.run(0, new(fusion_kernel.STUDY_RESULT), trace)
    t_s = (1 + np.arange(len(trace))) * study.step_s
    figure, axes = plt.subplots(3, 2, figsize=(11, 7), sharex=True, constrained_layout=True)
    for column, (title, unit, scale) in enumerate((("position", "mm", 1e3), ("attitude", "deg", 180.0 / np.pi))):
        late = t_s >= 20.0
        for i in range(3):
            plot = axes[i, column]
            error, sigma = trace[:, 3 * column + i] * scale, trace[:, 6 + 3 * column + i] * scale
            plot.fill_between(t_s, -3.0 * sigma, 3.0 * sigma, color="0.9", linewidth=0)
            plot.plot(t_s, error, color=_COLOURS[i], linewidth=0.8)
            limit = 3.5 * sigma[late].max()
            plot.set_ylim(-limit, limit)
            plot.set_ylabel(f"{'xyz'[i]}, {unit}" if column == 0 else f"theta{i + 1}, {unit}")
        axes[0, column].set_title(f"{title} error and 3 sigma, vision noise as {reading}", loc="left", fontsize=10)
        axes[2, column].set_xlabel("time, s")
    figure.savefig(path, dpi=110)
    plt.close(figure)


def compile_kernels() -> None:
    """Call the kernels of the study and of a campaign's case once."""
    Study((), "swapped", 0).bound()
    scenario, rig = load_scenario("scheme-1").value, load_rig("mock").value
    CaseRunner(scenario, rig, 10 * scenario.step_s).run(scenario, 0)
