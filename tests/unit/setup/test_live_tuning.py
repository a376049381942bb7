"""Settings changed in flight: which may be, what becomes of them, and that a replay makes the same of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hil.config.gnc_override import with_other_gnc
from hil.config.live_tunable import live_ranges, range_of, value_of
from hil.config.load import load_rig, load_scenario
from hil.config.scenario import Scenario
from hil.core.operator_commands import Operator
from hil.errors import BadInput
from hil.loop.runner import Runner
from hil.loop.session_parts import SessionParts
from hil.params import gnc as gnc_params
from hil.parts.console.lease import RequestRejected
from hil.parts.console.tuner import Tuner, unit_of
from hil.recording.audit import Actor
from hil.recording.read import Recorded, load
from hil.recording.replay import replay
from hil.recording.session import recording
from hil.recording.sinks import EventRecorder
from hil.report.summary import summarise
from hil.session import build
from hil.session.live_tuning import packed, unpacked, with_setting
from tests.support.plain_filters import PLAIN

NOISE = "gnc.pkf.accelerometer_noise_mps2"
DEADBAND = "gnc.control.deadband_m"


def scheme(*settings: str, name: str = "scheme-1") -> build.Job:
    scenario = load_scenario(name, settings)
    return build.Job(scenario, load_rig("mock"), 3, 4.0, 1.0)


class Changes(Operator):
    """Changes one setting after each of some cycles."""

    def __init__(self, job: build.Job, changes: dict[int, str]) -> None:
        super().__init__()
        self._scenario = job.scenario.value
        self._changes = dict(changes)
        self.runner: Runner
        self.event_recorder: EventRecorder

    def poll(self, now_s: float) -> None:
        gnc = self.runner.loop.gnc
        if (text := self._changes.pop(gnc.cycle, None)) is not None:
            self._scenario = with_setting(self._scenario, text, "test").value
            self.event_recorder.setting(gnc.adjust(gnc_params.gnc(self._scenario)), Actor("ann"), text)


def fly(folder: Path, job: build.Job, changes: dict[int, str]) -> Recorded:
    """Return the recording of a run with ``changes``: cycle after which, what."""
    operator = Changes(job, changes)
    with recording(job, "mock", folder, lambda _: None) as taken:
        rate = build.SimulatedRate(build.SimulatedClock(), job.scenario.value.step_s)
        parts = SessionParts(operator, telemetry=taken.sinks["cycles"])
        taken.sinks.attach(parts)
        operator.runner = build.in_memory(job, rate, parts)
        assert taken.sinks.events is not None
        operator.event_recorder = taken.sinks.events
        outcome = operator.runner.run()
        summary, _ = summarise(outcome, job.scenario.value, job.rig.value, "mock", job.seed, 50.0)
        taken.finish(summary)
    return load(taken.path)


def first_difference(a: np.ndarray, b: np.ndarray, group: str) -> int:
    bits = [rows[group].tobytes() for rows in (a, b)]
    size = len(bits[0]) // len(a)
    return next(k for k in range(len(a)) if bits[0][k * size : (k + 1) * size] != bits[1][k * size : (k + 1) * size])


@pytest.mark.parametrize(
    ("filters", "others"), [((), ()), (PLAIN, ("gnc.shadow.enabled=true",))], ids=["compiled", "with their shadow"]
)
def test_change_in_flight_acts_from_its_cycle_on_and_the_replay_makes_it_again(
    filters: tuple[str, ...], others: tuple[str, ...], tmp_path: Path
) -> None:
    unchanged, job = fly(tmp_path / "unchanged", scheme(*filters), {}), scheme(*filters, *others)
    changes = {119: f"{NOISE}=0.0004", 150: f"{DEADBAND}=0.002", 169: f"{NOISE}=0.0002"}
    changed = fly(tmp_path / "changed", job, changes)
    assert first_difference(unchanged.cycles, changed.cycles, "navigation") == 120
    np.testing.assert_array_equal(unchanged.cycles[:120]["command"], changed.cycles[:120]["command"])
    assert [(n["cycle"], n["name"], n["message"]) for n in changed.log if n["kind"] == "setting"] == [
        (cycle + 1, "ann", text) for cycle, text in changes.items()
    ]
    assert not [note for note in changed.log if note["name"] == "shadow"]  # it took the new noise over as well
    found = replay(changed, changed.scenario)
    assert found.identical, found.differences[:3]


def test_replay_leaves_out_changes_of_what_it_has_otherwise(tmp_path: Path) -> None:
    changed = fly(tmp_path, scheme(), {119: f"{NOISE}=0.0004"})
    nearly = with_other_gnc(changed.scenario, "test", None, [f"{NOISE}=0.00011"]).value
    found = replay(changed, nearly)
    assert min(d.first_cycle for d in found.differences) < 10
    without = replay(dataclasses.replace(changed, log=[]), nearly)
    assert found.differences == without.differences


@pytest.mark.parametrize("key", live_ranges(Scenario))
def test_each_setting_that_is_sound_in_flight_acts_on_the_parameters_and_has_a_range(key: str) -> None:
    scenario = load_scenario("scheme-1").value
    before = value_of(scenario, key)
    limits = range_of(Scenario, key)
    assert 0.0 <= limits["low"] <= before <= limits["high"]
    changed = with_setting(scenario, f"{key}={1.25 * before + 0.04!r}", "test").value
    assert packed(gnc_params.gnc(changed)) != packed(gnc_params.gnc(scenario))


def test_records_come_back_from_their_text_bit_by_bit_and_nothing_else_does() -> None:
    records = gnc_params.gnc(load_scenario("scheme-1").value)
    assert packed(unpacked(packed(records))) == packed(records)
    for text in ("", "AAAA", "no text of ours!"):
        with pytest.raises(ValueError, match=r"bytes of parameters|base64|[Pp]adding|alphabet"):
            unpacked(text)


@pytest.mark.parametrize(
    ("adjustable", "words"),
    [
        (["gnc.control.deadband"], "did you mean gnc.control.deadband_m or "),
        (["chaser.mass_kg"], '"chaser.mass_kg": cannot be changed in flight: allowed: gnc.'),
        (["step_s"], '"step_s": cannot be changed in flight'),
        (["gnc.corridor.axis"], '"gnc.corridor.axis": cannot be changed in flight'),
        ([DEADBAND, DEADBAND], "is listed twice"),
    ],
)
def test_scenario_that_allows_what_cannot_be_is_refused_in_one_line(adjustable: list[str], words: str) -> None:
    with pytest.raises(BadInput) as refused:
        load_scenario("scheme-1", [f"console.adjustable={adjustable}"])
    (problem,) = refused.value.problems
    assert problem.key == "console.adjustable"
    assert words in problem.message


def test_page_is_offered_exactly_what_the_scenario_allows_with_value_unit_and_range() -> None:
    tuner = Tuner(scheme(f'console.adjustable=["{DEADBAND}", "gnc.corridor.half_angle_deg"]'))
    first, second = tuner.available()
    assert (first["key"], first["unit"], first["value"], first["range"]["words"]) == (
        DEADBAND,
        "m",
        0.0,
        "0 to 0.2",
    )
    assert (second["unit"], second["range"]["words"]) == ("\u00b0", "0.5 to 30")
    tuner.applied(tuner.change(DEADBAND, 0.0004))
    assert tuner.available()[0]["value"] == 0.0004


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("gnc.control.deadband_sigmas", -1, "gnc.control.deadband_sigmas: -1: during a run allowed 0 to 10"),
        (DEADBAND, 1, "gnc.control.deadband_m: 1: during a run allowed 0 to 0.2"),
        (DEADBAND, "0.1", "gnc.control.deadband_m: '0.1' is not a number"),
        (DEADBAND, True, "is not a number"),
        (DEADBAND, float("nan"), "is not a number"),
        (DEADBAND, None, "is not a number"),
        ("gnc.control.lead_s", 4.0, "'gnc.control.lead_s': not adjustable during a run of this scenario"),
        ("chaser.mass_kg", 1.0, "'chaser.mass_kg': not adjustable during a run of this scenario, allowed gnc."),
        (["x"], 1.0, "not adjustable during a run"),
        ("gnc.corridor.closing_rate_max_mps", 0.03, "0.03: must be below gnc.corridor.closing_rate_max_mps, 0.03"),
    ],
)
def test_invalid_change_is_rejected_with_its_reason(key: Any, value: Any, words: str) -> None:
    with pytest.raises((RequestRejected, BadInput)) as refused:
        Tuner(scheme()).change(key, value)
    assert words in str(refused.value)


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        (NOISE, "m/s\u00b2"),
        ("gnc.control.slew_rate_degps", "\u00b0/s"),
        ("gnc.navigation.gate_sigma", "\u03c3"),
        ("gnc.corridor.closing_rate_slope_per_s", "1/s"),
        ("gnc.control.lead_s", "s"),
        ("gnc.control.deadband_sigmas", ""),
    ],
)
def test_unit_of_a_setting_is_that_of_its_name(key: str, unit: str) -> None:
    assert unit_of(key) == unit
