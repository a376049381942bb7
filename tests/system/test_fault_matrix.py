"""Each fault of the emulated devices, on real wires: detected, named, and the axes at rest."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

import pytest

from hil.api.jobs import IN_LOCK_STEP
from hil.core.modes import Mode
from hil.parts.wires.wired import WiredBench
from hil.session.build import check, wired_bench
from hil.session.warm_up import warm_up
from sims.fault_matrix import CONTINUES, TIGHT, Attendance, FaultCase, matrix, representatives, run_case
from tests.support.run_settings import PATIENT_RELAY, make_job

SETTINGS = (*TIGHT, *PATIENT_RELAY)


@contextmanager
def _opened(settings: Sequence[str]) -> Iterator[WiredBench]:
    job = make_job(60.0, settings, rig="emulated")
    check(job)
    warm_up(job)
    with wired_bench(job) as made:
        yield made


@pytest.fixture(scope="module")
def bench() -> Iterator[WiredBench]:
    with _opened((*TIGHT, *IN_LOCK_STEP)) as made:
        yield made


@pytest.fixture(scope="module")
def timed_bench() -> Iterator[WiredBench]:
    """Return a bench by the wall clock, which an operator at the console has."""
    with _opened(SETTINGS) as made:
        yield made


def _check(bench: WiredBench, case: FaultCase, by: Attendance = Attendance.SCRIPT) -> None:
    reaction = run_case(bench, case, by)
    assert reaction.as_expected, reaction
    if case.expected == CONTINUES:
        return
    # a dead coupler lets the relay open, and the drives may report first
    names = (case.device, "bench: emergency stop") if "estop" in case.line else (case.device,)
    torque = "safe torque off" if case.device == "io" else case.device
    assert any(name in reaction.alarm for name in (*names, torque)), reaction


@pytest.mark.parametrize("case", representatives(), ids=lambda case: case.name)
def test_fault_is_detected_and_named_and_the_axes_are_at_rest(bench: WiredBench, case: FaultCase) -> None:
    _check(bench, case)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", matrix((Mode.RUNNING, Mode.STANDBY, Mode.ARMED, Mode.HOLD)), ids=lambda case: case.name
)
def test_every_fault_in_every_mode_that_can_have_it(bench: WiredBench, case: FaultCase) -> None:
    _check(bench, case)


@pytest.mark.wires
@pytest.mark.slow
@pytest.mark.parametrize(
    "case", matrix((Mode.RUNNING, Mode.STANDBY, Mode.ARMED, Mode.HOLD)), ids=lambda case: case.name
)
def test_every_fault_in_every_mode_with_an_operator_at_the_console(timed_bench: WiredBench, case: FaultCase) -> None:
    _check(timed_bench, case, Attendance.CONSOLE)


@pytest.mark.slow
@pytest.mark.parametrize("case", matrix((Mode.RUNNING,)), ids=lambda case: case.name)
def test_every_fault_in_an_unattended_run(bench: WiredBench, case: FaultCase) -> None:
    _check(bench, case, Attendance.UNATTENDED)


def test_the_table_holds_every_fault_of_every_device_and_motion_faults_where_axes_move() -> None:
    cases = matrix((Mode.RUNNING, Mode.STANDBY))
    running = {(case.device, case.line.split()[1]) for case in cases if case.mode is Mode.RUNNING}
    standing = {(case.device, case.line.split()[1]) for case in cases if case.mode is Mode.STANDBY}
    wire = {"drop", "corrupt", "delay", "duplicate", "freeze", "link_down"}
    axis = {"stuck", "jump", "reversed", "drive_fault"}
    for device in ("rails", "turntable"):
        assert {kind for name, kind in running if name == device} == wire | axis
        assert {kind for name, kind in standing if name == device} == (wire | {"drive_fault"}) - {"freeze"}
    assert {kind for name, kind in running if name == "vmu"} == wire
    assert {kind for name, kind in running if name == "io"} == (wire | {"estop"}) - {"freeze"}
