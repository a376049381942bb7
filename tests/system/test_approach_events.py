"""Events of the approach: readiness, and the docking decision at the order, at the end, after an abort."""

from __future__ import annotations

import numpy as np
import pytest

from hil.core.messages import SUPERVISION, new
from hil.gnc_backends.approach_events import ApproachEventLog
from hil.session import build
from tests.support.run_settings import make_job


@pytest.fixture
def diary() -> ApproachEventLog:
    """Return the diary of an approach of two phases, ready after 5 s."""
    return ApproachEventLog(("approach", "ready"), 5.0)


def texts(diary: ApproachEventLog) -> list[str]:
    return [event.text for event in diary.events]


def test_docking_is_go_after_the_dwell_and_not_before(diary: ApproachEventLog) -> None:
    assert not diary.docking_is_go(100.0, np.nan)
    assert not diary.docking_is_go(14.9, 10.0)
    assert diary.docking_is_go(15.0, 10.0)


def test_readiness_is_noted_when_it_comes_and_when_it_goes(diary: ApproachEventLog) -> None:
    for t_s, since_s in ((10.0, 10.0), (15.0, 10.0), (16.0, 10.0), (17.0, np.nan), (30.0, 18.0)):
        diary.look(t_s, since_s)
    assert [text.partition(":")[0] for text in texts(diary)[1:]] == ["ready", "no longer ready", "ready"]


def test_decision_after_an_abort_is_no_go(diary: ApproachEventLog) -> None:
    watch = new(SUPERVISION)
    watch.aborted, watch.corridor_margin_m = 1, -0.02
    diary.abort_began(50.0, watch)
    diary.decide(60.0, 10.0)
    assert "the corridor was left (corridor margin -0.020 m" in texts(diary)[1]
    assert texts(diary)[-1] == "docking: no-go, the approach was aborted"


def test_order_to_go_on_is_answered_once() -> None:
    settings = ["initial.position_m=[0.4,0.0,0.0]", "initial.attitude_deg=[0.0,0.0,0.0]"]
    job = make_job(20.0, settings)
    with build.runner(job) as runner:
        gnc = runner.loop.gnc
        gnc.order_go()
        events = runner.run().events
    decisions = [(event.t_s, event.text) for event in events if event.text.startswith("docking")]
    assert decisions == [(0.0, "docking: no-go, the ready state does not hold")]


def test_order_to_abort_is_obeyed_in_the_same_cycle() -> None:
    job = make_job(2.0)
    with build.runner(job) as runner:
        runner.loop.gnc.order_abort()
        outcome = runner.run()
    assert outcome.history["supervision"]["aborted"][0] == 3
    assert outcome.history["supervision"]["aborted"][-1] == 3
