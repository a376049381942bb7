"""Hardware runs need a passed preflight of the last hour, for this rig and this period."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from hil.checks.signed_record import (
    MEASURED_S,
    VALID_S,
    check_preflight,
    read_signed,
    record_path,
    signature_of,
    write_record,
)
from hil.config.load import load_rig
from hil.core.operator_keys import OperatorKey
from tests.support.run_settings import HARDWARE_WIRES

STEP_S = 0.02
ANN = OperatorKey("ann", "a1" * 32)


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    path = tmp_path / "lab.toml"
    path.write_text(f'extends = "emulated"\nname = "lab"\nkind = "hardware"\n{HARDWARE_WIRES}')
    return path


def recorded(lab: Path, change: Callable[[dict[str, Any]], object] = lambda _: None) -> list[str]:
    """Write a good record, change it, and return the problems of a run."""
    rig = load_rig(str(lab))
    write_record(rig, 1.0 / STEP_S, MEASURED_S, True, ANN)
    record = json.loads(record_path(rig).read_text())
    change(record)
    record_path(rig).write_text(json.dumps(record))
    return [str(problem) for problem in check_preflight(rig, STEP_S)]


def test_a_run_of_hardware_needs_a_preflight_and_others_do_not(lab: Path) -> None:
    (problem,) = check_preflight(load_rig(str(lab)), STEP_S)
    path = lab.with_name("lab.preflight.json")
    assert str(problem) == f"{path}: preflight: is missing: run hil preflight --rig {lab} --devices"
    assert check_preflight(load_rig(str(lab), ["rig.sign_off.waived=true"]), STEP_S) == []
    for name in ("mock", "emulated", "emulated-rtu"):
        assert check_preflight(load_rig(name), STEP_S) == []


def test_a_good_preflight_permits_runs_for_an_hour(lab: Path) -> None:
    assert recorded(lab) == []
    rig = load_rig(str(lab))
    assert check_preflight(rig, STEP_S, time.time() + VALID_S - 60.0) == []
    (problem,) = check_preflight(rig, STEP_S, time.time() + VALID_S + 60.0)
    assert "is 61 min old, allowed 60 min" in str(problem)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        pytest.param({"passed": False}, "has failed", id="failed"),
        pytest.param({"measured_s": 5.0}, "measured the lateness for 5 s, required 60 s", id="short"),
        pytest.param({"digest": "sha256:0"}, "is of another configuration of this rig", id="other rig"),
        pytest.param({"rate_hz": 100.0}, "is for 100 Hz, the scenario has 50 Hz", id="other rate"),
        pytest.param({"unix_time_s": 1e12}, "min old", id="from the future"),
        pytest.param({"measured_s": "long"}, "cannot be read", id="no number"),
    ],
)
def test_another_record_is_refused_with_its_reason(lab: Path, change: dict[str, Any], text: str) -> None:
    (problem,) = recorded(lab, lambda record: record.update(change))
    assert text in problem


def test_a_damaged_record_is_refused(lab: Path) -> None:
    record_path(load_rig(str(lab))).write_text("{")
    (problem,) = check_preflight(load_rig(str(lab)), STEP_S)
    assert "cannot be read" in str(problem)


def test_record_names_the_key_of_the_operator_and_a_forged_one_is_found(lab: Path) -> None:
    path = lab.with_name("lab.preflight.json")
    assert recorded(lab) == []
    signature, record = signature_of(read_signed(path))
    assert (signature.by, signature.key, signature.problem(record, {ANN.id: ANN})) == ("ann", ANN.id, "")
    for change in ({"unix_time_s": time.time() + 1.0}, {"passed": 1}, {"by": "bob"}, {"seal": "0" * 64}):
        recorded(lab, lambda record, change=change: record.update(change))  # type: ignore[misc]
        signature, record = signature_of(read_signed(path))
        assert "the record or its signature was changed" in signature.problem(record, {ANN.id: ANN})
