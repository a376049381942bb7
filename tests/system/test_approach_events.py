"""Events of the approach: readiness, and the docking decision at the order, at the end, after an abort."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.scenario import Scenario
from hil.core.messages import REFERENCE, SUPERVISION, new
from hil.gnc import approach_monitor, docking_go, guidance, step
from hil.gnc.step import APPROACH_PROGRESS, APPROACH_STATE
from hil.gnc_backends.approach_events import ApproachEventLog, go_limit_text, limit_text
from hil.params import gnc as gnc_params
from hil.session import build
from tests.support.run_settings import make_job


@pytest.fixture
def event_log() -> ApproachEventLog:
    """Return the event log of an approach of two phases, ready after 5 s."""
    return ApproachEventLog(("approach", "ready"), 5.0)


def texts(event_log: ApproachEventLog) -> list[str]:
    return [event.text for event in event_log.events]


def progress(**fields: float) -> np.void:
    """Return APPROACH_PROGRESS with these fields, the others zero."""
    record = np.zeros((), APPROACH_PROGRESS)
    for name, value in fields.items():
        record[name] = value
    return record[()]


@pytest.mark.parametrize(("t_s", "since_s", "go"), [(100.0, np.nan, 0), (14.9, 10.0, 0), (15.0, 10.0, 1)])
def test_docking_is_go_after_the_dwell_and_not_before(scheme_1: Scenario, t_s: float, since_s: float, go: int) -> None:
    params, state, supervision = gnc_params.gnc(scheme_1).approach, new(APPROACH_STATE), new(SUPERVISION)
    params.monitor.dwell_s, supervision.ready_since_s = 5.0, since_s
    guidance.start(params.guidance, state.guidance)
    step.guide(params, state, t_s, supervision, new(REFERENCE))
    assert state.progress.docking_go == go


def test_readiness_is_logged_when_it_begins_and_when_it_ends(event_log: ApproachEventLog) -> None:
    was = 0
    for t_s, ready in ((10.0, 0), (15.0, 1), (16.0, 1), (17.0, 0), (30.0, 1)):
        event_log.update(t_s, progress(ready=was), progress(ready=ready), new(SUPERVISION))
        was = ready
    assert [text.partition(":")[0] for text in texts(event_log)[1:]] == ["ready", "no longer ready", "ready"]


def test_readiness_is_logged_again_in_a_new_phase_and_its_end_is_not_after_an_abort(
    event_log: ApproachEventLog,
) -> None:
    event_log.update(10.0, progress(ready=1), progress(phase=1, ready=1), new(SUPERVISION))
    assert [text.partition(":")[0] for text in texts(event_log)[1:]] == ["phase ready begins", "ready"]
    event_log.update(11.0, progress(phase=1, ready=1), progress(phase=1, aborted=1), new(SUPERVISION))
    assert not any(text.startswith("no longer ready") for text in texts(event_log))


def test_decision_after_an_abort_is_no_go(event_log: ApproachEventLog) -> None:
    supervision = new(SUPERVISION)
    supervision.aborted, supervision.corridor_margin_m = 1, -0.02
    event_log.update(50.0, progress(), progress(aborted=1), supervision)
    event_log.update(60.0, progress(go=1, aborted=1), progress(aborted=1, ready_since_s=10.0), supervision)
    event_log.update(50.02, progress(aborted=1), progress(phase=2, aborted=1), supervision)
    assert texts(event_log).count("phase abort: brake begins") == 1
    assert "the corridor was left (corridor margin -0.020 m" in texts(event_log)[1]
    assert texts(event_log)[-1] == "docking: no-go, the approach was aborted"


def test_order_to_continue_is_answered_once() -> None:
    settings = ["initial.position_m=[0.4,0.0,0.0]", "initial.attitude_deg=[0.0,0.0,0.0]"]
    job = make_job(20.0, settings)
    with build.runner(job) as runner:
        gnc = runner.loop.gnc
        gnc.order_go()
        events = runner.run().events
    decisions = [(event.t_s, event.text) for event in events if event.text.startswith("docking")]
    assert [t_s for t_s, _ in decisions] == [0.0]
    what_is_missing = "level along the docking axis inf m"  # no second pose has confirmed the first
    assert decisions[0][1].startswith(f"docking: no-go, the ready state does not hold: {what_is_missing}")


def test_order_to_abort_is_executed_in_the_same_cycle() -> None:
    job = make_job(2.0)
    with build.runner(job) as runner:
        runner.loop.gnc.order_abort()
        outcome = runner.run()
    assert outcome.history["supervision"]["aborted"][0] == 3
    assert outcome.history["supervision"]["aborted"][-1] == 3


@pytest.mark.parametrize(
    ("go", "text"),
    [
        ({"lacks": docking_go.SUM, "axis": 7, "value": 27.0, "limit": 25.7}, "innovations of x - y sum up to 27.0"),
        ({"lacks": docking_go.HEALTH, "value": 2.0}, "vision is suspect"),
        ({"lacks": docking_go.HEALTH, "value": 64.0}, "the encoders contradict the estimate"),
        ({"lacks": docking_go.LEVEL, "value": np.inf, "limit": 0.03}, "with its level x without bound"),
        (
            {"lacks": docking_go.FIRING, "axis": 7, "value": 0.03, "limit": 0.02},
            "smallest firings give velocity y 0.03",
        ),
        ({"lacks": docking_go.HOLD, "axis": 1, "value": 0.03, "limit": 0.02}, "control holds with the level y 0.03"),
    ],
)
def test_withdrawal_names_its_cause(go: dict[str, float], text: str) -> None:
    state = new(APPROACH_STATE)
    for name, value in go.items():
        state.go[name] = value
    assert text in go_limit_text(state)


def test_vision_lost_to_a_clock_that_is_ahead_has_that_reason() -> None:
    state = new(APPROACH_STATE)
    assert "future" not in limit_text(approach_monitor.FIRST_HEALTH_CAUSE, state)
    state.reactions.from_future = 12
    assert "12 poses were stamped in the future" in limit_text(approach_monitor.FIRST_HEALTH_CAUSE, state)
