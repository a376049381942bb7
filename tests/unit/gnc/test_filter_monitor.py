"""Filter monitor: it reports inconsistent covariances, and stays quiet about consistent ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2

from hil.config.load import load_rig, load_scenario
from hil.core.alarms import LOW
from hil.core.messages import Event
from hil.gnc.estimation.filter_monitor import FilterMonitor, NisMonitor, nis_band
from hil.params import gnc as gnc_params
from hil.safety.alarms import AlarmLog
from hil.safety.condition_alarms import HealthAlarms
from hil.session import build
from tests.support.plain_filters import PLAIN
from tests.support.run_settings import make_job


def events_of(*settings: str, duration_s: float = 120.0, scheme: str = "scheme-1") -> list[Event]:
    """Return what the monitor reported in a run on the mock rig."""
    job = make_job(duration_s, settings, scenario=scheme)
    with build.runner(job) as runner:
        runner.run()
        watch = runner.loop.gnc.filter_monitor
        assert watch is not None
        return watch.events


def test_band_of_the_mean_is_that_of_chi_square() -> None:
    low, high = nis_band(50, 0.01)
    assert chi2.cdf(50 * low, 150) == pytest.approx(0.01)
    assert chi2.sf(50 * high, 150) == pytest.approx(0.01)


def test_consistent_innovations_raise_nothing(rng: np.random.Generator) -> None:
    monitor = NisMonitor("pkf", 64)
    assert [said for nis in rng.chisquare(3, 5000) if (said := monitor.add(float(nis)))] == []


@pytest.mark.parametrize(("scale", "words"), [(2.0, "larger"), (0.5, "smaller")])
def test_innovations_of_the_wrong_size_are_reported_once(rng: np.random.Generator, scale: float, words: str) -> None:
    monitor = NisMonitor("pkf", 64)
    said = [text for nis in scale * rng.chisquare(3, 1000) if (text := monitor.add(float(nis)))]
    assert len(said) == 1
    assert words in said[0]


def test_end_of_an_alarm_is_reported(rng: np.random.Generator) -> None:
    monitor = NisMonitor("pkf", 64)
    values = np.concatenate([3.0 * rng.chisquare(3, 200), rng.chisquare(3, 1000)])
    said = [text for nis in values if (text := monitor.add(float(nis)))]
    assert len(said) == 2
    assert "again" in said[1]


def test_check_of_the_innovations_is_a_condition_that_ends(rng: np.random.Generator) -> None:
    scenario = load_scenario("scheme-1", PLAIN).value
    watch = FilterMonitor(gnc_params.gnc(scenario).navigation, None)
    book = AlarmLog()
    alarms = HealthAlarms(book, scenario)
    alarms.watch(watch.conditions)
    scale = np.where(np.arange(1500) < 200, 3.0, 1.0)
    for cycle, nis in enumerate(scale * rng.chisquare(3, 1500)):
        watch.add_innovations(cycle, float(nis), math.nan)
        alarms.update(0.16 * cycle, 0)
        if cycle == 199:
            assert book.all()[0].active
            assert book.acknowledge(1, "ann") == 1
    fast, sensitive = book.all()
    assert (fast.device, fast.quantity, fast.priority) == ("navigation", "mean NIS of pkf over 64 poses", LOW)
    assert fast.text.endswith(f"allowed {watch._position[0].low:.2f} to {watch._position[0].high:.2f}")
    assert not fast.active
    assert not sensitive.active
    assert (fast.latched, sensitive.latched) == (False, True)  # one was acknowledged


@pytest.mark.parametrize("settings", [(), PLAIN])
def test_honest_run_has_no_alarm(settings: tuple[str, ...]) -> None:
    assert events_of(*settings) == []


@pytest.mark.parametrize(
    ("setting", "source", "words"),
    [
        ("vmu.reported_sigma_scale=0.7", "akf", "too small"),
        ("vmu.reported_sigma_scale=1.5", "pkf", "too large"),
        ("gnc.akf.gyro_noise_degps=1.0", "akf", "too large"),
    ],
)
def test_wrong_r_or_q_is_detected_and_reported(setting: str, source: str, words: str) -> None:
    told = [event.text for event in events_of(*PLAIN, setting) if event.source == source]
    assert any(words in text for text in told)


def test_wrong_q_of_the_accelerometer_is_seen() -> None:
    settings = ("gnc.pkf.accelerometer_noise_mps2=1e-6", "gnc.pkf.accelerometer_bias_noise_mps3=1e-8")
    assert any("too small" in event.text for event in events_of(*PLAIN, *settings, duration_s=250.0))


def test_shadow_agrees_with_the_compiled_filters_also_on_late_poses() -> None:
    settings = (*PLAIN, "gnc.shadow.enabled=true", "vmu.latency_jitter_s=0.3")
    rig = load_rig("mock", ("rig.vmu.timeout_s=1.0",))
    job = build.Job(load_scenario("scheme-1", settings), rig, 0, 20.0, 1.0)
    with build.runner(job) as runner:
        runner.run()
        watch = runner.loop.gnc.filter_monitor
    assert watch is not None
    assert watch.events == []
    assert 0.0 < watch.largest_divergence[0] < 0.006
    assert 0.0 < watch.largest_divergence[1] < 1e-4


def test_shadow_reports_when_the_filters_diverge() -> None:
    settings = (*PLAIN, "gnc.shadow.enabled=true", "gnc.shadow.position_limit_m=1e-5")
    told = events_of(*settings, duration_s=6.0)
    assert [event.source for event in told].count("shadow") >= 1
    assert "allowed 1e-05 m" in next(event.text for event in told if event.source == "shadow")
