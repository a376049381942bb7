"""Tracker of the mock rig in runs: rows, numbers, section, alarm and hold, and runs without one."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.config.load import load_rig, load_scenario
from hil.core.part import used_parts
from hil.drivers.mock_axes import MockAxes
from hil.errors import BadInput, SafetyTrip
from hil.loop.session_parts import SessionParts
from hil.parts.tracker.session import TrackerWatch
from hil.report.section import sections_of
from hil.session.build import Job, runner

TRACKER: dict[str, Any] = {
    "rig.tracker.driver": "mock", "rig.tracker.chaser.body": 1, "rig.tracker.target.body": 2,
}  # fmt: skip
KEYS = ("sigma_m", "sigma_deg", "off_m", "off_deg")


def test_run_has_rows_numbers_and_a_section_and_keeps_its_bits(tmp_path: Path) -> None:
    plain = hil.run("scheme-1", duration_s=20.0)
    run = hil.run("scheme-1", duration_s=20.0, overrides=TRACKER, record=tmp_path)
    assert run.history.tobytes() == plain.history.tobytes()  # it never reaches the GNC
    assert run.summary["withheld"] is None
    truth = run.summary["bench_truth"]
    assert all(len(truth[key]) == 3 and all(map(math.isfinite, truth[key])) for key in KEYS)
    assert all(abs(off) < 3.0 * sigma for off, sigma in zip(truth["off_m"], truth["sigma_m"], strict=True))
    assert truth["clock"]["latency_ms"] == pytest.approx(4.0, abs=3.0 * truth["clock"]["latency_sigma_ms"])
    assert truth["counts"]["ok"] > 900
    (section,) = [each for each in sections_of(run.summary) if each.title == "Tracker"]
    assert [row[0] for row in section.rows] == ["commanded", "encoders", "tracker"]
    others = [f"{n} {name}" for name, n in truth["counts"].items() if name != "ok"]
    assert f"rejected {', '.join(others) or 'none'}, longest" in section.notes[0]
    rows = hil.open(run.summary["recording"]["file"]).rows_of("tracker_samples")
    assert set(rows.body) == {0, 1}
    assert (rows.status == 0).all()
    assert np.abs(rows.off_m[rows.body == 0]).max() < 2e-3


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_clock_that_is_off_is_found_within_half_a_millisecond(capsys: pytest.CaptureFixture[str]) -> None:
    """pytest -m slow tests/unit/tracker/test_tracker_run.py"""
    overrides = {**TRACKER, "rig.tracker.reference.body": 3, "rig.tracker.latency_s": 0.005}
    for seed in range(1, 21):
        clock = hil.run("scheme-1", seed=seed, overrides=overrides, duration_s=180.0).summary["bench_truth"]["clock"]
        with capsys.disabled():
            sys.stdout.write(f"\nseed {seed}: {clock['latency_ms']:.3f} ms, sigma {clock['latency_sigma_ms']:.3f} ms")
        assert clock["latency_ms"] == pytest.approx(5.0, abs=0.5)


def test_run_whose_base_moves_is_held_and_has_no_verdict() -> None:
    fault = [{"kind": "moved", "at_s": 10.0, "value": [0.0, 0.003, 0.0]}]
    run = hil.run("scheme-1", duration_s=14.0, overrides={**TRACKER, "rig.tracker.faults": fault})
    alarm = next(each for each in run.summary["alarms"] if each["code"] == "bench_against_tracker")
    assert 10.0 < alarm["t_s"] < 12.0
    assert "rails.y or its base: +" in alarm["text"]
    assert 0.0025 < alarm["measured"] < 0.0035
    assert not run.summary["accepted"]
    assert run.summary["withheld"] == alarm["text"]
    assert run.summary["stop"].startswith("bench: hold (tracker: bench against tracker off by ")


def test_bench_that_is_built_wrong_is_found_although_its_encoders_agree() -> None:
    run = hil.run("scheme-1", duration_s=3.0, overrides={**TRACKER, "rig.bench.errors.seed": 5})
    assert "bench_against_tracker" in [each["code"] for each in run.summary["alarms"]]
    assert not run.summary["accepted"]


def test_tracker_that_sees_nothing_gives_no_verdict() -> None:
    fault = [{"kind": "no_pose", "at_s": 0.0}]
    run = hil.run("scheme-1", duration_s=5.0, overrides={**TRACKER, "rig.tracker.faults": fault})
    assert run.summary["withheld"] == "tracker: no sample could be compared"
    assert [each["code"] for each in run.summary["alarms"]] == ["samples"]


def standing(*settings: str, moved_m: float = 0.0) -> list[bool]:
    """Return what the comparison before the first motion returns in each cycle, of a bench that stands.

    moved_m: by which it is jogged after 20 cycles, within 1 s.
    """
    keys = [*(f"{key}={json.dumps(value)}" for key, value in TRACKER.items()), *settings]
    job = Job(load_scenario("scheme-1"), load_rig("mock", keys), 1, 1.0, 1.0)
    with runner(job) as opened:
        watch = TrackerWatch(job, SessionParts())
        watch.begin(opened)
        rails, turntable, feedback = opened.loop.bench.rails, opened.loop.bench.turntable, opened.loop.now.feedback
        assert isinstance(rails, MockAxes)
        assert isinstance(turntable, MockAxes)
        feedback.rail_m, feedback.gimbal_rad = rails.servo.position, turntable.servo.position
        done = [False]
        while not done[-1]:
            gap_s = 1.0 if moved_m and len(done) > 20 else 0.0
            if moved_m and len(done) == 21:
                rails.servo.position[0] += moved_m
                feedback.rail_m = rails.servo.position
            done.append(watch.check_standing(0.02 * (len(done) - 1) + gap_s, feedback))
        watch.close()
    return done[1:]


def test_comparison_before_motion_takes_half_a_second_of_samples_and_leaves_a_silent_tracker_to_the_run() -> None:
    assert 50 < len(standing()) < 70  # the target is measured first
    assert len(standing('rig.tracker.faults=[{kind = "no_pose", at_s = 0.0}]')) == 151


def test_comparison_begins_again_after_a_motion() -> None:
    assert len(standing(moved_m=0.2)) == 20 + len(standing())


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ("rig.bench.errors.reference_m=[0.0, 0.015, 0.0]", r"bench against tracker off by 0.01[45]\d m"),
        ("rig.bench.errors.reference_m=[0.0, 0.15, 0.0]", "bench against tracker off by more than its gate"),
    ],
)
def test_mounting_that_is_off_is_refused_before_motion(wrong: str, text: str) -> None:
    with pytest.raises(SafetyTrip, match=text):
        standing(wrong)


def test_run_without_the_table_does_not_use_the_part() -> None:
    scenario = hil.load_scenario("scheme-1")
    assert "tracker" not in [each.part.name for each in used_parts(scenario, load_rig("mock").value)]


@pytest.mark.parametrize(
    ("changed", "text"),
    [
        ({"rig.tracker.driver": "natnet"}, 'rig.tracker.driver: "natnet": on a rig of kind "mock" allowed are "mock"'),
        ({"rig.tracker.chaser.body": -1}, "rig.tracker.chaser.body: -1"),
        ({"rig.tracker.sigma": 1.0}, "rig.tracker.sigma: unknown key"),
    ],
)
def test_wrong_tables_are_refused_in_one_line(changed: dict[str, Any], text: str) -> None:
    with pytest.raises(BadInput) as refused:
        hil.run("scheme-1", duration_s=1.0, overrides=TRACKER | changed)
    (problem,) = refused.value.problems
    assert text in str(problem)
