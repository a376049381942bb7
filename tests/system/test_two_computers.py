"""A run with bench and GNC apart is the run of one process; and what the link measures."""

from __future__ import annotations

import numpy as np
import pytest

from hil.cli.main import execute
from hil.errors import DeviceError, LinkTimeout
from hil.session import build
from tests.support.plain_filters import PLAIN
from tests.support.run_settings import make_job
from tests.support.split_bench import gnc_thread, split_bench
from tests.support.udp_relay import Relay


def in_one_process(scenario: str, duration_s: float, settings: tuple[str, ...] = (), seed: int = 0) -> build.Job:
    return make_job(duration_s, settings, scenario=scenario, seed=seed)


def transmitted(history: np.ndarray) -> bytes:
    """Return the rows without the terms of the protection level, which stay where the GNC runs."""
    rows = history.copy()
    rows["supervision"]["level_term"], rows["supervision"]["level_term_m"] = 0, 0.0
    return rows.tobytes()


@pytest.mark.parametrize(
    ("scheme", "duration_s"),
    [
        ("scheme-1", 4.0),
        ("scheme-2", 4.0),
        ("scheme-3", 4.0),
        *(pytest.param(f"scheme-{n}", 400.0, marks=pytest.mark.slow) for n in (1, 2, 3)),
    ],
)
def test_lock_step_gives_the_trajectory_of_one_process_bit_by_bit(scheme: str, duration_s: float) -> None:
    with build.runner(in_one_process(scheme, duration_s)) as runner:
        alone = runner.run()
    with split_bench(scheme, duration_s) as bench, gnc_thread(scheme, bench.link.address) as gnc:
        apart = bench.fly()
    cycles = round(duration_s / 0.02) + 1
    assert apart.faults == []
    assert transmitted(apart.history) == transmitted(alone.history)
    assert apart.events == alone.events
    account = bench.account()
    assert (account["answers"], account["delay_cycles"], account["lost"]) == (cycles, 0.0, 0)
    assert gnc.stats.steps == cycles


LATE = ("vmu.latency_s=0.1", "vmu.latency_jitter_s=0.25", "vmu.duplicate_probability=0.2", "vmu.loss_probability=0.1")
"""Poses that come late, out of order and several in a cycle."""
FAST_IMU = ("imu.rate_hz=200.0",)
"""Four samples of the IMU per cycle."""
ABORT = ("gnc.abort.at_s=2.0",)
"""The plan changes on the bench's side, and control boosts on the other."""


@pytest.mark.parametrize("settings", [LATE, ABORT, FAST_IMU, FAST_IMU + LATE])
def test_lock_step_gives_the_same_also_with_late_poses_and_in_an_abort(settings: tuple[str, ...]) -> None:
    with build.runner(in_one_process("scheme-1", 4.0, settings, seed=3)) as runner:
        alone = runner.run()
    with split_bench("scheme-1", 4.0, settings, seed=3) as bench, gnc_thread("scheme-1", bench.link.address, settings):
        apart = bench.fly()
    assert transmitted(apart.history) == transmitted(alone.history)
    assert apart.events == alone.events


def test_answer_from_before_an_abort_is_not_taken_for_the_one_after_it() -> None:
    """A slow network makes the bench ask twice, so that each answer comes twice, too."""
    settings = ("gnc.abort.at_s=1.4",)
    with build.runner(in_one_process("scheme-1", 1.6, settings)) as runner:
        alone = runner.run()
    with (
        split_bench("scheme-1", 1.6, settings) as bench,
        Relay(bench.link.address, delay_s=0.035) as relay,
        gnc_thread("scheme-1", relay.address, settings),
    ):
        apart = bench.fly()
    assert bench.account()["resent"] > 60
    assert alone.history["command"]["boost"][-1] == 1
    assert transmitted(apart.history) == transmitted(alone.history)


def test_shadow_filter_that_diverges_is_reported_where_the_gnc_runs() -> None:
    settings = (*PLAIN, "gnc.shadow.enabled=true", "gnc.shadow.position_limit_m=1e-5")
    with split_bench("scheme-1", 4.0) as bench, gnc_thread("scheme-1", bench.link.address, settings) as gnc:
        assert bench.fly().faults == []
    told = [text for text in gnc.stats.as_json(gnc.link)["filters"] if "shadow: diverges from the filters" in text]
    assert told
    assert told[0].endswith("allowed 1e-05 m and 0.05 deg")


def test_gnc_of_another_chaser_is_refused_with_a_message() -> None:
    heavier = ("chaser.mass_kg=1200.0",)
    with (
        split_bench("scheme-1", 1.0) as bench,
        gnc_thread("scheme-1", bench.link.address, heavier, patience_s=0.5),
        pytest.raises(DeviceError, match=r"gnc: setup differs in mass_kg \(1000\.0 there, 1200\.0 here\)"),
    ):
        bench.fly()


def test_bench_without_a_reply_reports_where_it_waited() -> None:
    with (
        split_bench("scheme-1", 1.0) as bench,
        pytest.raises(LinkTimeout, match=r"gnc: none has answered 127\.0\.0\.1:\d+ within 0\.1 s"),
    ):
        bench.gnc.connect(0.1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["dss", "scheme-1", "--listen", "127.0.0.1:1", "--gnc", "127.0.0.1:2"], "give this or --listen, not both"),
        (["dss", "scheme-1", "--listen", "nonsense:port"], "--listen: nonsense:port: must be HOST:PORT"),
        (["dss", "scheme-1", "--lock-step", "--speed", "2"], "in lock-step a mock rig does not run in real time"),
        (["dss", "scheme-1", "--wait", "0"], "--wait: 0: must be a time above 0 s"),
        (["dss", "scheme-1", "--set", "rig.gnc_link.coast_cycles=9"], "coast_cycles = 9: must not exceed"),
        (["dss", "scheme-1", "--set", "rig.gnc_link.on_loss=explode"], "rig.gnc_link.on_loss"),
        (
            ["gnc", "scheme-1", "--set", "imu.rate_hz=2000"],
            "imu.rate_hz: 2000: a GNC on another computer gets at most 1200",
        ),
        (["gnc", "scheme-1", "--dss", "127.0.0.1:0"], "--dss: 127.0.0.1:0: must name a port"),
        (["gnc", "scheme-1", "--listen", "192.0.2.1:5000"], "192.0.2.1:5000: cannot listen there"),
        (["gnc", "scheme-1", "--dss", "127.0.0.1:9", "--json", "/no/such/folder/x.json"], "folder does not exist"),
    ],
)
def test_bad_option_is_refused_in_a_line(capsys: pytest.CaptureFixture[str], arguments: list[str], said: str) -> None:
    assert execute(arguments) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 1
    assert said in lines[0]
