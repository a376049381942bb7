"""A GNC as a Python object: what it is given, what it may return, and that each of its faults stops the bench."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import hil
from hil.api.jobs import job_of
from hil.api.runs import RunRequest, run_job
from hil.core.gnc_records import GNC_INPUT, GncState

N = 16  # thrusters of scheme 1


class Scripted:
    """Returns what ``answer`` makes of each input."""

    def __init__(self, answer: Any) -> None:
        self.answer = answer
        self.inputs: list[Any] = []
        self.calls: list[str] = []

    def reset(self) -> None:
        self.calls.append("reset")
        self.inputs.clear()

    def start(self, setup: Any) -> None:
        self.calls.append(f"start {int(setup.n_thrusters)}")

    def step(self, gnc_input: Any) -> Any:
        self.inputs.append(gnc_input)
        return self.answer(gnc_input)


class Minimal:
    """The least that can fly."""

    def step(self, _: Any) -> None:
        return None


def run(answer: Any, duration_s: float = 0.4) -> tuple[hil.Run, Scripted]:
    gnc = Scripted(answer)
    return stopped(gnc, duration_s), gnc


def stopped(gnc: Scripted, duration_s: float = 0.4) -> hil.Run:
    """Return the run of ``gnc`` as it ends on any bench; ``hil.run`` raises what the object has raised."""
    job = job_of("scheme-1", "mock", None, duration_s=duration_s, gnc=gnc)
    return run_job(RunRequest(job, "mock"))


def test_input_has_the_fields_of_the_c_header_and_may_be_kept() -> None:
    run_, gnc = run(lambda _: None)
    assert gnc.calls == ["reset", f"start {N}"]
    assert [int(data.cycle) for data in gnc.inputs] == list(range(21))
    assert all(hasattr(gnc.inputs[0], name) for name in GNC_INPUT.names)
    np.testing.assert_array_equal([data.t_s for data in gnc.inputs], run_.t_s)
    np.testing.assert_array_equal([data.rate_radps for data in gnc.inputs], run_.imu.rate_C)
    np.testing.assert_array_equal([data.reference_r_CT_H_m for data in gnc.inputs], run_.reference.r_CT_H)
    poses = [pose.t_s for data in gnc.inputs for pose in data.poses[: data.n_poses]]
    np.testing.assert_array_equal(poses, run_.pose.t_s)


def test_none_coasts() -> None:
    found = hil.run("scheme-1", duration_s=0.4, gnc=Minimal())
    assert found.stop == "completed"
    assert not found.command.on.any()
    assert not found.navigation.valid.any()
    assert found.summary["gnc"] == {"library": None, "sha256": None, "python": "Minimal"}


@pytest.mark.parametrize("answer", [[True] + [False] * (N - 1), np.arange(N) == 0, {"on": [1.0] + [0] * (N - 1)}])
def test_a_sequence_opens_thrusters(answer: Any) -> None:
    found, _ = run(lambda data: answer if data.cycle >= 10 else None)
    assert found.stop == "completed"
    assert found.command.on[:10].sum() == 0
    assert found.command.on[10:, 0].all()
    assert found.command.on[:, 1:].sum() == 0


def test_thrusters_close_when_they_are_no_longer_commanded() -> None:
    found, _ = run(lambda data: {"on": [1] * N, "text": "on"} if data.cycle == 10 else None)
    assert np.flatnonzero(found.command.on.any(axis=1)).tolist() == [10]


def test_demands_are_allocated_and_an_estimate_is_recorded() -> None:
    estimate = {"r_CT_H_m": [1, 2, 3], "v_CT_H_mps": [0, 0, 0], "q_CH": [0, 0, 0, 1], "w_CH_C_radps": (0, 0, 0)}
    found, _ = run(lambda data: {"force": [-1, 0, 0], "torque": np.array([0, 1, 0]), "text": "here", **estimate})
    assert (found.command.force == [-1, 0, 0]).all()
    assert (found.command.torque == [0, 1, 0]).all()
    assert found.command.on.any()
    assert (found.navigation.r_CT_H == [1.0, 2.0, 3.0]).all()
    assert [(event.source, event.text) for event in found.events if event.text == "here"] == [("gnc Scripted", "here")]


def raises(error: BaseException) -> Any:
    def step(_: Any) -> None:
        raise error

    return step


@pytest.mark.parametrize(
    ("answer", "text"),
    [
        (raises(ZeroDivisionError("division\nby zero")), "step raised ZeroDivisionError: division by zero"),
        (raises(ValueError()), "step raised ValueError"),
        (lambda _: [0] * (N - 1), f"thrusters: {N - 1} numbers, allowed {N} numbers"),
        (lambda _: 1, f"thrusters: one number, allowed {N} numbers"),
        (lambda _: "on", f"thrusters: 'on', allowed {N} numbers"),
        (lambda _: [0, float("nan")] + [0] * (N - 2), "thruster 2 is nan, allowed 0, 1"),
        (lambda _: [0.5] + [0] * (N - 1), "thruster 1 is 0.5, allowed 0, 1"),
        (lambda _: {"thrusters": [0] * N}, "step returned the field 'thrusters', allowed state, force, torque, on, "),
        (lambda _: {"force": [0, 2, 0]}, "force demand along y is 2, allowed -1, 0, 1"),
        (lambda _: {"force": [0.0, 0.5, 0.0]}, "force: [0.0, 0.5, 0.0], allowed integers"),
        (lambda _: {"torque": [1]}, "torque: 1 numbers, allowed 3 numbers"),
        (lambda _: {"r_CT_H_m": [0, 0, 0]}, "step returned an estimate without q_CH, v_CT_H_mps, w_CH_C_radps"),
        (lambda _: {"state": GncState.FAULT, "text": "lost"}, "lost"),
        (lambda _: {"state": 7}, "state 7, allowed 0 to 3"),
    ],
)
def test_each_fault_stops_the_bench_and_names_the_object(answer: Any, text: str) -> None:
    found, gnc = run(lambda data: answer(data) if data.cycle >= 5 else None)
    assert found.stop.startswith(f"gnc Scripted: {text}")
    assert not found.passed
    assert [alarm.device for alarm in found.alarms] == ["gnc Scripted"]
    assert len(gnc.inputs) == 6


def test_a_failure_at_the_start_stops_the_bench_before_the_run() -> None:
    gnc = Scripted(lambda _: None)
    gnc.start = raises(RuntimeError("no licence"))  # type: ignore[method-assign]
    found = stopped(gnc)
    assert found.stop.startswith("gnc Scripted: start raised RuntimeError: no licence (test_python_object.py, line ")
    assert len(found.t_s) == 0


def test_two_gncs_are_refused() -> None:
    with pytest.raises(hil.errors.BadInput, match=r"gnc: .*gnc.library: .*another GNC is given"):
        hil.run("scheme-1", overrides={"gnc.library": "own.so"}, gnc=Minimal())
