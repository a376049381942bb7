"""Input of a GNC in datagrams: the first fields as ``gnc.input``, what is measured in mailboxes before it.

A bench sends these to a GNC that wants them, in cycles that have some: ``imu.samples``, ``gnc.poses`` and
``gnc.measurements``. Each has the number of the cycle whose input follows.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from typing import Final

import numpy as np

from hil.core.gnc_records import GNC_INPUT, GNC_INPUT_3, GNC_POSE, GncMode
from hil.frmn.mailboxes import GNC_MEASUREMENTS, GNC_POSES, IMU_SAMPLES, IMU_SAMPLES_MAX, MEASUREMENTS_MAX

MEASURED: Final = ("imu.samples", "gnc.poses", "gnc.measurements")
"""Mailboxes of what is measured."""


def mailboxes_of(given: np.record, wants: Collection[str]) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the mailboxes of ``given`` (GNC_INPUT) in the order of sending; ``wants``: those that the GNC receives.

    Samples are sent of an IMU that is faster than the cycle; the input has the only one of others.
    """
    cycle, measured = given.cycle, given.measured
    if given.mode == GncMode.RUNNING:
        if "imu.samples" in wants and 1 < (n := int(measured.n_samples)) <= IMU_SAMPLES_MAX:
            samples = np.zeros(1, IMU_SAMPLES)
            samples["cycle"], samples["n"] = cycle, n
            samples["rate_C"][0, :n] = measured.samples["rate_radps"][:n]
            samples["force_C"][0, :n] = measured.samples["force_mps2"][:n]
            yield "imu.samples", samples
        if "gnc.poses" in wants and measured.n_poses:
            poses = np.zeros(1, GNC_POSES)
            poses["cycle"], poses["n"], poses["poses"] = cycle, measured.n_poses, measured.poses
            yield "gnc.poses", poses
        if "gnc.measurements" in wants:
            for first in range(0, int(measured.n_measurements), MEASUREMENTS_MAX):
                measurements = np.zeros(1, GNC_MEASUREMENTS)
                measurements["cycle"], measurements["first"], measurements["n"] = cycle, first, measured.n_measurements
                some = measured.measurements[first : min(first + MEASUREMENTS_MAX, int(measured.n_measurements))]
                measurements["measurements"][0, : len(some)] = some
                yield "gnc.measurements", measurements
    yield "gnc.input", np.frombuffer(np.asarray(given).tobytes()[: GNC_INPUT_3.itemsize], GNC_INPUT_3)


class InputReceiver:
    """Assembles ``input`` (GNC_INPUT) from its mailboxes.

    Of samples and poses that were lost, or that the bench does not send, the input has their mean and the whole poses.
    """

    def __init__(self) -> None:
        self._block = np.zeros(1, GNC_INPUT)
        self.input: np.record = self._block.view(np.recarray)[0]
        self._bytes = self._block.view(np.uint8).data
        self._newest: dict[str, list[np.ndarray]] = {name: [] for name in MEASURED}

    def add(self, name: str, record: np.ndarray) -> None:
        """Keep ``record`` (1,) of the mailbox ``name``, one of MEASURED, for the input that follows."""
        kept = self._newest[name]
        if kept and kept[0]["cycle"] != record["cycle"]:
            kept.clear()
        kept.append(record)

    def take(self, record: np.ndarray) -> None:
        """Write ``input`` from ``record`` (1,) of ``gnc.input`` and what has come before it."""
        self._bytes[: GNC_INPUT_3.itemsize] = record.view(np.uint8).data
        given, measured = self.input, self.input.measured
        measured.n_samples = int(given.mode == GncMode.RUNNING and given.cycle > 0)
        measured.samples[0]["rate_radps"], measured.samples[0]["force_mps2"] = given.rate_radps, given.force_mps2
        for samples in self._of_input("imu.samples"):
            n = measured.n_samples = min(max(int(samples["n"]), 0), IMU_SAMPLES_MAX)
            measured.samples["rate_radps"][:n] = samples["rate_C"][:n]
            measured.samples["force_mps2"][:n] = samples["force_C"][:n]
        measured.n_measurements = 0
        measured.n_poses = min(max(int(given.n_poses), 0), len(given.poses))
        for name in GNC_POSE.names or ():
            measured.poses[name] = given.poses[name]
        measured.poses["status"], measured.poses["covariance_cross_m_rad"] = 0, 0.0
        for poses in self._of_input("gnc.poses"):
            measured.n_poses = min(max(int(poses["n"]), 0), len(given.poses))
            measured.poses = poses["poses"]
        seen = {int(part["first"]): part for part in self._of_input("gnc.measurements")}
        for first, part in sorted(seen.items()):
            start, n = int(measured.n_measurements), min(int(part["n"]) - first, MEASUREMENTS_MAX)
            n = max(0, min(n, len(measured.measurements) - start))
            measured.measurements[start : start + n] = part["measurements"][:n]
            measured.n_measurements = start + n

    def _of_input(self, name: str) -> Iterator[np.void]:
        """Yield the records of the mailbox ``name`` that belong to the present input."""
        for record in self._newest[name]:
            if record["cycle"][0] == self.input.cycle and self.input.mode == GncMode.RUNNING:
                yield record[0]
