"""Replay: bit-identical when nothing was changed; otherwise what differs, and from which cycle on."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.gnc_override import with_other_gnc
from hil.core.modes import Mode
from hil.core.operator_commands import Operator, OperatorCommand
from hil.errors import BadInput
from hil.recording.read import Recorded, load
from hil.recording.replay import replay
from hil.recording.session import recording
from hil.report.summary import summarise
from hil.session import build
from tests.support.plain_filters import PLAIN
from tests.support.run_settings import make_job


def record(folder: Path, scenario: str, duration_s: float, *settings: str) -> Recorded:
    """Return a recorded run on the mock rig."""
    job = make_job(duration_s, settings, scenario=scenario, seed=1)
    with recording(job, "mock", folder, lambda _: None) as taken:
        with build.runner(job, sinks=taken.sinks) as runner:
            outcome = runner.run()
        taken.finish(summarise(outcome, job.scenario.value, job.rig.value, "mock", 1, 50.0)[0])
    recorded = load(taken.path)
    assert recorded.cycles.tobytes() == outcome.history.tobytes()
    return recorded


@pytest.mark.parametrize(
    ("scheme", "duration_s"),
    [
        pytest.param(f"scheme-{n}", s, marks=pytest.mark.slow if s > 100.0 else ())
        for s in (6.0, 400.0)
        for n in (1, 2, 3)
    ],
)
def test_an_unchanged_replay_is_bit_identical(tmp_path: Path, scheme: str, duration_s: float) -> None:
    recorded = record(tmp_path, scheme, duration_s)
    found = replay(recorded, recorded.scenario)
    assert found.identical, (found.ended, found.differences, found.new_events)
    assert found.cycles == round(duration_s * 50) + 1


def test_late_double_and_lost_poses_are_replayed_as_they_came(recorded_run: Path) -> None:
    recorded = load(recorded_run)
    used = recorded.arrivals[recorded.arrivals["cycle"] >= 0]
    assert np.bincount(used["cycle"]).max() > 1  # several in one cycle
    assert replay(recorded, recorded.scenario).identical


def test_orders_are_given_again_in_their_cycles(tmp_path: Path) -> None:
    recorded = record(tmp_path, "scheme-1", 6.0, "gnc.abort.at_s=2.0", *PLAIN, "gnc.shadow.enabled=true")
    assert any("abort" in note["message"] for note in recorded.log)
    assert replay(recorded, recorded.scenario).identical


def test_samples_of_a_fast_imu_are_replayed(tmp_path: Path) -> None:
    recorded = record(tmp_path, "scheme-1", 6.0, "imu.rate_hz=200.0", "rig.bench.axes_rate_hz=250.0")
    assert len(recorded.imu_samples) == 4 * len(recorded.cycles)
    assert len(recorded.axes_samples) == 5 * (len(recorded.cycles) - 1) + 1
    assert replay(recorded, recorded.scenario).identical
    recorded.imu_samples["imu"]["rate_C"][500] += 1e-6
    assert replay(recorded, recorded.scenario).differences[0].first_cycle == 126
    recorded.imu_samples["cycle"][900:] += 1
    assert "of which 0 are in the recording" in replay(recorded, recorded.scenario).ended


def record_operated(folder: Path, operator: Operator, watch: Callable[[Mode, float], None]) -> Recorded:
    """Return 4 s of scheme-1, recorded, with an operator who gives orders at given progress of the run."""
    job = make_job(4.0, seed=1)
    with recording(job, "mock", folder, lambda _: None) as taken:
        with build.runner(job, watch, lambda _: None, operator, taken.sinks) as runner:
            assert runner.run().stop == "completed"
        taken.break_off("test")
    return load(taken.path)


def test_an_abort_by_the_operator_is_replayed(tmp_path: Path) -> None:
    operator = Operator()
    recorded = record_operated(
        tmp_path, operator, lambda _, share: operator.submit(OperatorCommand.ABORT) if 0.4 < share < 0.6 else None
    )
    assert [(n["cycle"], n["message"]) for n in recorded.log if n["kind"] == "order"] == [(101, "abort")]
    assert recorded.cycles["supervision"]["aborted"][-1] != 0
    assert replay(recorded, recorded.scenario).identical


def test_a_hold_is_replayed_without_the_frames_that_came_in_it(tmp_path: Path) -> None:
    operator = Operator()

    def watch(mode: Mode, share: float) -> None:
        if mode is Mode.RUNNING and 0.4 < share < 0.6:
            operator.submit(OperatorCommand.HOLD)
        elif mode is Mode.HOLD:
            operator.submit(OperatorCommand.RESUME)

    recorded = record_operated(tmp_path, operator, watch)
    assert [n["message"] for n in recorded.log if n["kind"] == "mode"][-4:] == [
        "running",
        "hold",
        "running",
        "standby",
    ]
    assert (recorded.arrivals["cycle"][1:] == -1).any()
    assert len(recorded.cycles) == 201
    assert replay(recorded, recorded.scenario).identical


def test_a_changed_q_shows_from_the_first_prediction_on(recorded_run: Path) -> None:
    recorded = load(recorded_run)
    first = int(np.argmax(recorded.cycles["navigation"]["valid"] == 1))  # the filters start with this pose
    scenario = with_other_gnc(
        recorded.scenario, str(recorded_run), None, ["gnc.pkf.accelerometer_noise_mps2=0.01"]
    ).value
    found = {d.field: d for d in replay(recorded, scenario).differences}
    assert found["navigation.sigma_v_mps"].first_cycle == found["navigation.sigma_r_m"].first_cycle
    assert first <= found["navigation.sigma_v_mps"].first_cycle
    assert found["navigation.sigma_v_mps"].first_cycle == _first_prediction(recorded)
    assert "navigation.q_CH" not in found  # the attitude filter was left alone
    assert found["navigation.r_CT_H"].first_cycle > found["navigation.sigma_r_m"].first_cycle
    largest = found["navigation.r_CT_H"]
    assert largest.largest is not None
    assert largest.first_s == pytest.approx(largest.first_cycle * 0.02)


def _first_prediction(recorded: Recorded) -> int:
    """Return the first cycle in which the sigma of the velocity is not that of the start any more."""
    sigma = recorded.cycles["navigation"]["sigma_v_mps"][:, 0]
    started = recorded.cycles["navigation"]["valid"] == 1
    return int(np.argmax(started & (sigma != recorded.scenario.gnc.pkf.initial_velocity_sigma_mps)))


def test_a_single_changed_bit_is_found(recorded_run: Path) -> None:
    recorded = load(recorded_run)
    recorded.cycles["reference"]["v_CT_H"].view(np.int64)[123, 1] ^= 1
    [difference] = replay(recorded, recorded.scenario).differences
    assert (difference.field, difference.cycles, difference.first_cycle) == ("reference.v_CT_H", 1, 123)


def test_a_gap_ends_the_replay_and_is_named(recorded_run: Path) -> None:
    recorded = load(recorded_run)
    keep = np.arange(len(recorded.cycles)) != 200
    found = replay(Recorded(**{**vars(recorded), "cycles": recorded.cycles[keep]}), recorded.scenario)
    assert found.ended.startswith("cycles 200 to 200 are not in the recording")
    assert found.cycles == 200
    assert not found.differences


def test_the_command_prints_and_returns_what_it_found(
    recorded_run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert execute(["replay", str(recorded_run)]) == 0
    assert "identical, bit by bit" in capsys.readouterr().out
    other = tmp_path / "other.toml"
    for text in ("[gnc.pkf]\naccelerometer_noise_mps2 = 0.01\n", "[pkf]\naccelerometer_noise_mps2 = 0.01\n"):
        other.write_text(text)
        out = tmp_path / "out.json"
        assert execute(["replay", str(recorded_run), "--gnc", str(other), "--json", str(out)]) == 0
        found = json.loads(out.read_text())
        assert not found["identical"]
        assert found["differences"][0]["field"] == "navigation.r_CT_H"
        assert found["navigation"]["replayed"]["nees_pkf"] < found["navigation"]["recorded"]["nees_pkf"]
        assert "differs from cycle" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("[chaser]\nmass_kg = 9.0\n", ("chaser", "cannot be changed in a replay", "gnc")),
        ("[gnc.pkf]\naccelerometer_noise = 1.0\n", ("gnc.pkf.accelerometer_noise", "accelerometer_noise_mps2")),
        ("[gnc.pkf]\naccelerometer_noise_mps2 = -1.0\n", ("accelerometer_noise_mps2", "greater than 0")),
        ("what is this\n", ("not TOML",)),
    ],
)
def test_other_settings_that_make_no_sense_are_refused(
    recorded_run: Path, tmp_path: Path, content: str, words: tuple[str, ...]
) -> None:
    path = tmp_path / "other.toml"
    path.write_text(content)
    with pytest.raises(BadInput) as caught:
        with_other_gnc(load(recorded_run).scenario, str(recorded_run), str(path), ())
    assert all(word in str(caught.value) for word in (str(path), *words))


def test_a_setting_of_the_flight_itself_is_refused(recorded_run: Path) -> None:
    with pytest.raises(BadInput, match=r"step_s=0\.1.*cannot be changed in a replay"):
        with_other_gnc(load(recorded_run).scenario, str(recorded_run), None, ["step_s=0.1"])
