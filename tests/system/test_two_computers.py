"""A run with bench and GNC apart is the run of one process; and what the link measures."""

from __future__ import annotations

import pytest
from far_gnc import gnc_thread, split_bench

from hil import build
from hil.config.load import load_rig, load_scenario


def in_one_process(scenario: str, duration_s: float, settings: tuple[str, ...] = (), seed: int = 0) -> build.Job:
    return build.Job(load_scenario(scenario, settings), load_rig("mock", settings), seed, duration_s, 1.0)


@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2", "scheme-3"])
def test_lock_step_gives_the_trajectory_of_one_process_bit_by_bit(scheme: str) -> None:
    with build.runner(in_one_process(scheme, 20.0), lambda *_: None, lambda _: None) as runner:
        alone = runner.run()
    with split_bench(scheme, 20.0) as bench, gnc_thread(scheme, bench.link.address) as gnc:
        apart = bench.fly()
    assert apart.faults == []
    assert apart.history.tobytes() == alone.history.tobytes()
    assert apart.events == alone.events
    account = bench.account()
    assert (account["answers"], account["delay_cycles"], account["lost"]) == (1001, 0.0, 0)
    assert gnc.flight.steps == 1001
