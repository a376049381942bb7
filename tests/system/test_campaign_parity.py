"""The compiled loop against the cycle: the same bits, the same faults, the same verdict."""

from __future__ import annotations

import numpy as np
import pytest

from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE
from hil.loop.outcome import Outcome
from hil.loop.runner import COMPLETED
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.campaigns.dispersions import Design, case_seed
from hil.parts.campaigns.outcome import row_of
from hil.report.summary import summarise
from hil.session import build
from tests.support.rows import OF_DIGITAL_LINES, assert_same_bits
from tests.support.run_settings import ALL_ERRORS

pytestmark = pytest.mark.xdist_group("campaign")

CLOSE = ("initial.position_m=[0.55, 0.01, -0.01]", "initial.attitude_deg=[0.3, 0.2, -0.2]")
LATE = (
    "vmu.latency_s=0.07",
    "vmu.latency_jitter_s=0.3",
    "vmu.duplicate_probability=0.2",
    "vmu.loss_probability=0.1",
    "rig.vmu.timeout_s=2.0",
)


def both(
    scheme: str, settings: tuple[str, ...], duration_s: float, case: int | None = None
) -> tuple[Outcome, build.Job, np.ndarray, np.record, str]:
    """Return the outcome of a run on the mock rig, its job, and history, stats and stop of the compiled one."""
    scenario, rig = load_scenario(scheme, settings), load_rig("mock", settings)
    truth, told, seed = scenario.value, scenario.value, 3
    if case is not None:
        design = Design(scenario, 11)
        truth, told = design.apply(design.values(case))
        seed = case_seed(11, case)
    job = build.Job(scenario, rig, seed, duration_s, 1.0, truth, compiled=False)
    with build.runner(job) as runner:
        outcome = runner.run()
    flight = CaseRunner(told, rig.value, duration_s)
    flight.run(truth, seed + 1)  # what was flown before leaves no trace
    history = np.zeros(flight.cycles, CYCLE)
    stats, stop = flight.run(truth, seed, history)
    return outcome, job, history, stats, stop


@pytest.mark.parametrize(
    ("scheme", "settings"),
    [
        ("scheme-1", ()),
        ("scheme-2", LATE),
        ("scheme-3", ()),
        ("scheme-2", (*ALL_ERRORS, "rig.guard.enabled=false")),
    ],
    ids=[
        "scheme-1",
        "scheme-2 with late, lost and repeated poses",
        "scheme-3",
        "all terms of the error models",
    ],
)
def test_compiled_loop_has_the_bits_of_the_cycle(scheme: str, settings: tuple[str, ...]) -> None:
    outcome, _, history, stats, stop = both(scheme, settings, 20.0)
    assert outcome.stop == stop == COMPLETED
    assert stats.cycles == len(history) == len(outcome.history)
    assert_same_bits(outcome.history, history, OF_DIGITAL_LINES)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2", "scheme-3"])
def test_compiled_loop_has_the_bits_of_the_cycle_to_the_end(scheme: str) -> None:
    outcome, _, history, _, stop = both(scheme, (), 400.0)
    assert outcome.stop == stop == COMPLETED
    assert_same_bits(outcome.history, history, OF_DIGITAL_LINES)


def test_abort_and_retreat_have_the_same_bits() -> None:
    outcome, _, history, stats, _ = both("scheme-1", ("gnc.abort.at_s=8.0",), 20.0)
    assert_same_bits(outcome.history, history, OF_DIGITAL_LINES)
    assert stats.integrity.limits.aborted == history["supervision"]["aborted"][-1] != 0


def test_dispersed_case_has_the_bits_of_the_cycle() -> None:
    wrong_bench = "dispersions.bench.errors.squareness_deg={kind='normal', sigma=0.05}"
    outcome, _, history, _, _ = both("scheme-2", (wrong_bench,), 10.0, case=5)
    assert_same_bits(outcome.history, history, OF_DIGITAL_LINES)


@pytest.mark.parametrize(
    "settings",
    [
        ("rig.rails.following_error_max_m=0.00002",),
        ('faults=[{device = "vmu", kind = "offset", at_s = 5.0, value = [0.3, 0.0, 0.0]}]',),
    ],
    ids=["following error", "pose beside the encoders"],
)
def test_fault_ends_both_at_the_same_cycle_with_the_same_words(settings: tuple[str, ...]) -> None:
    outcome, _, history, stats, stop = both("scheme-1", settings, 20.0)
    assert outcome.stop == stop != COMPLETED
    assert stats.cycles == len(outcome.history) < len(history)
    assert_same_bits(outcome.history, history[: stats.cycles], OF_DIGITAL_LINES)


def test_row_of_a_case_holds_the_numbers_of_the_report() -> None:
    outcome, job, _, stats, stop = both("scheme-1", CLOSE, 60.0)
    scenario = job.scenario.value
    summary, _ = summarise(outcome, scenario, job.rig.value, "mock", job.seed, 50.0)
    row = row_of(stats, stop, scenario, job.truth)
    assert summary["ready_time_s"] is not None
    for name in ("accepted", "passed", "passed_all_parts", "stop", "ready_time_s", "held_since_s"):
        assert row[name] == summary[name], name
    thrusters, security = summary["thrusters"], summary["verdict"]["security"]
    assert row["firings"] == sum(thrusters["thruster_firings"])
    assert row["propellant_kg"] == thrusters["propellant_kg"]
    assert row["thruster_on_time_s"] == pytest.approx(sum(thrusters["thruster_on_time_s"]), rel=1e-12)
    assert row["corridor_margin_m"] == security["corridor_margin_m"]
    assert row["closing_margin_mps"] == security["closing_margin_mps"]
    assert row["nearest_m"] == pytest.approx(security["nearest_m"], rel=1e-15)
    energy = summary["verdict"]["energy"]
    assert row["propellant_share"] == pytest.approx(energy["propellant_kg"] / energy["least_propellant_kg"], rel=1e-12)
    # judged at exposures alone, so never smaller than over all cycles
    assert 0.0 <= row["view_margin_px"] - summary["verdict"]["field_of_view"]["margin_px"] < 5.0
    for i, axis in enumerate("xyz"):
        for name in ("position_m", "velocity_mps", "attitude_deg", "rate_degps"):
            assert row[f"{name}_{axis}"] == pytest.approx(summary["ready_phase"][name][i], rel=1e-9)
        for name in ("position_rmse_m", "velocity_rmse_mps", "attitude_rmse_deg"):
            assert row[f"{name}_{axis}"] == pytest.approx(summary["navigation"][name][i], rel=1e-6)
        assert row[f"force_on_time_s_{axis}"] == pytest.approx(thrusters["force_on_time_s"][i])
        assert row[f"torque_on_time_s_{axis}"] == pytest.approx(thrusters["torque_on_time_s"][i])
