"""Every fault of the emulated devices, on real wires: found, named, and the bench stands."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from hil.commission.fault_matrix import GOES_ON, TIGHT, FaultCase, matrix, rehearse, representatives
from hil.core.modes import Mode
from hil.session.build import WiredBench, check, warm_up, wired_bench
from tests.support.run_settings import UNHURRIED, make_job

pytestmark = pytest.mark.wires

SETTINGS = (*TIGHT, *UNHURRIED)


@pytest.fixture(scope="module")
def bench() -> Iterator[WiredBench]:
    job = make_job(60.0, SETTINGS, rig="emulated")
    check(job)
    warm_up(job)
    with wired_bench(job) as made:
        yield made


def _rehearse(bench: WiredBench, case: FaultCase) -> None:
    finding = rehearse(bench, case)
    assert finding.as_expected, finding
    if case.expected == GOES_ON:
        return
    # a dead coupler lets the relay open, and the drives may be the first to say so
    names = (case.device, "bench: emergency stop") if "estop" in case.line else (case.device,)
    torque = "safe torque off" if case.device == "io" else case.device
    assert any(name in finding.alarm for name in (*names, torque)), finding


@pytest.mark.parametrize("case", representatives(), ids=lambda case: case.name)
def test_a_fault_is_found_and_named_and_the_axes_stand(bench: WiredBench, case: FaultCase) -> None:
    _rehearse(bench, case)


@pytest.mark.slow
@pytest.mark.parametrize(
    "case", matrix((Mode.RUNNING, Mode.STANDBY, Mode.ARMED, Mode.HOLD)), ids=lambda case: case.name
)
def test_every_fault_in_every_mode_that_can_have_it(bench: WiredBench, case: FaultCase) -> None:
    _rehearse(bench, case)


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
