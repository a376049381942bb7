"""Preflight of hardware requires a proof test of emergency stop, chain and brakes that is not due again."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from hil.checks.signed_record import DUE_DAYS_MAX, proof_gap, read_signed, signature_of, write_proof
from hil.config.load import load_rig
from hil.core.operator_keys import OperatorKey
from hil.preflight.run import proof_test_check
from tests.support.run_settings import HARDWARE_WIRES

ANN = OperatorKey("ann", "a1" * 32)
DAY_S = 86_400.0
NOW_S = 1.8e9


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    path = tmp_path / "lab.toml"
    path.write_text(f'extends = "emulated"\nname = "lab"\nkind = "hardware"\n{HARDWARE_WIRES}')
    return path


def test_bench_is_due_after_the_days_of_its_record(lab: Path) -> None:
    rig = load_rig(str(lab))
    check = proof_test_check(rig, NOW_S)
    assert check.passed is False
    assert check.value == "no record: lab.proof.json is missing"
    assert check.advice.startswith(f"hil commission {lab} --proof-test")
    assert write_proof(str(lab), NOW_S, 30, ["io: charge pump ..."], ANN) == lab.with_name("lab.proof.json")
    assert proof_test_check(rig, NOW_S + 29.9 * DAY_S).passed is True
    overdue = proof_test_check(rig, NOW_S + 30.1 * DAY_S)
    assert overdue.passed is False
    assert overdue.value == "overdue: 2027-01-15 by ann, due 2027-02-14"


def test_bench_whose_sign_off_is_waived_gets_a_note(lab: Path) -> None:
    assert proof_test_check(load_rig(str(lab), ["rig.sign_off.waived=true"]), NOW_S).passed is None


@pytest.mark.parametrize(
    ("change", "gap"),
    [
        ({"unix_time_s": NOW_S + DAY_S}, "not of the last year"),
        ({"unix_time_s": NOW_S - (DUE_DAYS_MAX + 1) * DAY_S, "due_unix_s": 1e10}, "not of the last year"),
        ({"due_unix_s": "never"}, "unreadable"),
        ({"due_unix_s": 1e300}, "unreadable"),
        ({"by": None}, "unreadable"),
    ],
)
def test_record_that_cannot_be_right_is_none(lab: Path, change: dict[str, Any], gap: str) -> None:
    path = write_proof(str(lab), NOW_S, 30, [], ANN)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    assert proof_gap(load_rig(str(lab)), NOW_S)[0] == gap


def test_record_is_sealed_with_its_due_date_and_results(lab: Path) -> None:
    path = write_proof(str(lab), time.time(), 30, ["io: holding brakes read as closed after 0.12 s"], ANN)
    for change in ({}, {"due_unix_s": 2e9}, {"tested": []}, {"more": 1}):
        signature, record = signature_of(read_signed(path) | change)
        assert bool(signature.problem(record, {ANN.id: ANN})) == bool(change)
