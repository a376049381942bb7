"""Dynamics simulation with parts in FMUs: thrusters, motion of the chaser, IMU. What is not in an FMU is built in."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from hil.core.kernel_record import kernel_record
from hil.core.messages import MAX_THRUSTERS, Array
from hil.core.model_records import (
    IMU_INPUT_FIELDS,
    IMU_OUTPUT_FIELDS,
    IMU_SETUP_FIELDS,
    THRUSTERS_INPUT_FIELDS,
    THRUSTERS_OUTPUT_FIELDS,
    THRUSTERS_SETUP_FIELDS,
    TRUTH_INPUT_FIELDS,
    TRUTH_OUTPUT_FIELDS,
    TRUTH_SETUP_FIELDS,
)
from hil.dynamics import imu as imu_kernels
from hil.dynamics import truth as truth_kernels
from hil.dynamics.thrusters import wrench
from hil.errors import DeviceError
from hil.frmn.ring import Telemetry
from hil.loop import core
from hil.loop.bench_gyros import BenchGyros
from hil.loop.core_memory import CoreMemory
from hil.loop.stages import DssStage
from hil.maths import linear
from hil.maths.random_streams import NormalRows
from hil.parts.fmi.archive import FmuError
from hil.parts.fmi.plant_model import PlantModel, PlantRecords

RECORDS: Final = {
    "thrusters": PlantRecords(
        THRUSTERS_SETUP_FIELDS, THRUSTERS_INPUT_FIELDS, THRUSTERS_OUTPUT_FIELDS, ("thrust_fraction",)
    ),
    "truth": PlantRecords(
        TRUTH_SETUP_FIELDS,
        TRUTH_INPUT_FIELDS,
        TRUTH_OUTPUT_FIELDS,
        ("r_CT_H_m", "v_CT_H_mps", "q_CH", "w_CI_C_radps"),
    ),
    "imu": PlantRecords(IMU_SETUP_FIELDS, IMU_INPUT_FIELDS, IMU_OUTPUT_FIELDS, ("rate_radps", "force_mps2")),
}
"""Records of each part."""
_UNIT: Final = 1e-3  # tolerance of a quaternion's length


class PlantModels(NamedTuple):
    """Parts in FMUs, None for a built-in one."""

    thrusters: PlantModel | None = None
    truth: PlantModel | None = None
    imu: PlantModel | None = None


class ModelDssStage(DssStage):
    """Dynamics simulation of which ``models`` replace parts. Their failure is a DeviceError, which stops the bench."""

    def __init__(
        self,
        models: PlantModels,
        memory: CoreMemory,
        field: Array,
        imu_noise: NormalRows,
        sample_sink: Telemetry | None = None,
        gyros: BenchGyros | None = None,
    ) -> None:
        super().__init__(memory, field, imu_noise, sample_sink, gyros)
        self._models = models
        self._dss, self._imu_params = kernel_record(memory.params.dss), kernel_record(memory.params.imu)
        self._truth_memory, self._imu_memory = memory.view("truth_memory"), memory.view("imu_memory")
        self._now = memory.now
        # of the built-in motion with all valves open, each with its part of the force
        self._scaled = memory.params.dss.copy()
        self._scaled.thruster_errors.enabled = 0
        self._all_on = np.ones(MAX_THRUSTERS, np.int64)
        self._force, self._torque = np.empty(3), np.empty(3)

    def step(self, k: int) -> None:
        """Propagate the truth over cycle ``k``; see ``DssStage.step``."""
        truth, command, imu, samples = self._now.truth, self._now.command, self._now.imu, self._samples
        n = len(samples)
        sums = [np.zeros_like(field) for field in self._means(truth, imu)]
        for i, noise in enumerate(self.noise.next_rows(n)):
            w_before = truth.w_CI_C.copy()
            self._move(truth, w_before, command.on)
            self._sense(truth, w_before, noise, imu)
            samples[i] = imu
            for total, field in zip(sums, self._means(truth, imu), strict=True):
                total += field / n
        for total, field in zip(sums, self._means(truth, imu), strict=True):
            field[:] = total
        core.aim(self._params, self._state)
        self._send_samples(k)

    @staticmethod
    def _means(truth: np.record, imu: np.record) -> tuple[np.ndarray, ...]:
        """Return the fields that hold means over the cycle."""
        return imu.rate_C, imu.force_C, truth.mean_rate_C, truth.mean_force_C, truth.thrust_fraction

    def _move(self, truth: np.record, w_before: np.ndarray, on: np.ndarray) -> None:
        """Propagate ``truth`` by one step. w_before: (3,), rad/s, its inertial rate at the start."""
        t_s = float(truth.t_s)
        model = self._models.thrusters
        if model is None:
            truth_kernels.step(self._dss, self.field, self._truth_memory, truth, on)
        else:
            model.inputs.t_s, model.inputs.on = t_s, on
            fraction = self._step("thrusters", model).thrust_fraction[0]
            self._scaled.thruster_force = np.asarray(self._dss.thruster_force) * fraction
            truth_kernels.step(self._scaled, self.field, self._truth_memory, truth, self._all_on)
            truth.thrust_fraction = fraction
        if self._models.truth is not None:
            self._replace_motion(self._models.truth, truth, t_s, w_before)

    def _replace_motion(self, model: PlantModel, truth: np.record, t_s: float, w_before: np.ndarray) -> None:
        """Replace the motion of the chaser by that of the model; orbit of the target and frame H remain built in."""
        p = self._dss
        position, direction, force_n = p.thruster_position, p.thruster_direction, p.thruster_force
        wrench(truth.thrust_fraction, position, direction, force_n, p.n_thrusters, self._force, self._torque)
        inputs = model.inputs
        inputs.t_s, inputs.thrust_fraction = t_s, truth.thrust_fraction
        inputs.force_N, inputs.torque_Nm = self._force, self._torque
        out = self._step("truth", model)
        truth.r_CT_H, truth.v_CT_H, truth.w_CI_C = out.r_CT_H_m[0], out.v_CT_H_mps[0], out.w_CI_C_radps[0]
        length = linear.length(out.q_CH[0])
        if not abs(length - 1.0) < _UNIT:
            raise DeviceError("truth", f"{self._name(model)}: q_CH has length {length:g}, expected 1")
        truth.q_CH = out.q_CH[0] / length
        if "mass_kg" in model.given:
            truth.mass_kg = out.mass_kg[0]
        mean = 0.5 * (w_before + np.asarray(truth.w_CI_C, float))
        rate = out.mean_rate_C_radps[0] if "mean_rate_C_radps" in model.given else mean
        force = out.mean_force_C_mps2[0] if "mean_force_C_mps2" in model.given else self._force / truth.mass_kg
        truth.mean_rate_C, truth.mean_force_C = rate, force

    def _sense(self, truth: np.record, w_before: np.ndarray, noise: np.ndarray, imu: np.record) -> None:
        """Write the sample of the step that ended at ``truth``."""
        model = self._models.imu
        if model is None:
            imu_kernels.sample_with_errors(self._imu_params, truth, w_before, noise, self._imu_memory, imu)
            return
        inputs = model.inputs
        inputs.t_s = truth.t_s - self._dss.dt_s
        inputs.mean_rate_C_radps, inputs.mean_force_C_mps2 = truth.mean_rate_C, truth.mean_force_C
        inputs.w_CI_C_radps = truth.w_CI_C
        out = self._step("imu", model)
        imu.rate_C, imu.force_C = out.rate_radps[0], out.force_mps2[0]
        imu.drift_C, imu.bias_C = out.drift_C_radps[0], out.bias_C_mps2[0]

    def _step(self, part: str, model: PlantModel) -> np.recarray:
        try:
            return model.step()
        except FmuError as error:
            raise DeviceError(part, f"{self._name(model)}: {error}") from error

    @staticmethod
    def _name(model: PlantModel) -> str:
        return model.path.name
