"""The Python API: the same results as the command line, recordings, campaigns, and a bench under a procedure."""

from __future__ import annotations

import json
import re
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.api.jobs import IN_LOCK_STEP
from hil.cli.main import execute
from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from tests.support.run_settings import NEAR, typed

pytestmark = pytest.mark.xdist_group("api")

QUICK = {"gnc.control.deadband_m": 0.004, "vmu.latency_s": 0.1}


@pytest.fixture(scope="module")
def run() -> hil.Run:
    return hil.run("scheme-1", seed=3, duration_s=8.0, overrides=QUICK)


def test_run_is_that_of_the_command_line(run: hil.Run, capsys: pytest.CaptureFixture[str]) -> None:
    settings = typed(*(f"{key}={value}" for key, value in QUICK.items()))
    assert execute(["run", "scheme-1", "--seed", "3", "--duration", "8", *settings, "--json", "-"]) == 1
    printed = json.loads(capsys.readouterr().out)
    mine = json.loads(json.dumps(run.summary))
    for timed in ("timing", "latency"):
        printed.pop(timed), mine.pop(timed)
    assert mine == printed
    assert (run.accepted, run.passed, run.ready_time_s, run.stop) == (False, False, None, "completed")


def test_records_are_arrays_with_the_time_of_their_rows(run: hil.Run) -> None:
    n = 401
    assert run.truth.r_CT_H.shape == run.navigation.sigma_r_m.shape == (n, 3)
    assert run.command.on.shape[0] == run.t_s.shape[0] == len(run.feedback) == n
    np.testing.assert_array_equal(run.reference.t_s, run.t_s)
    assert 40 < len(run.pose) < 60
    assert np.allclose(np.diff(run.pose.t_s), 0.16)  # 6.25 Hz
    assert len(run.portions) == 0
    assert "r_CT_H" in dir(run.truth)
    assert run.cycles.fields[0] == "t_s"
    with pytest.raises(AttributeError, match="no field 'r'; this group has t_s, r_CT_H, "):
        run.truth.r  # noqa: B018
    assert run.events[0].source == "guidance"
    assert run.alarms == []


def test_run_shows_draws_reports_and_exports_itself(run: hil.Run, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    shown = run._repr_html_()
    assert "FAIL" in shown
    assert "data:image/svg+xml" in shown
    assert repr(run) == "<Run scheme-1 on mock, seed 3: not accepted, never ready, completed>"
    run.plot().savefig(tmp_path / "run.png")
    run.report(tmp_path / "run.html")
    page = (tmp_path / "run.html").read_text()
    assert "phase approach begins" in page
    assert run.summary["build"]["commit"] in page
    run.to_parquet(tmp_path / "run.parquet")
    table = pq.read_table(tmp_path / "run.parquet")
    np.testing.assert_array_equal(table.column("truth.r_CT_H[1]").to_numpy(), run.truth.r_CT_H[:, 1])
    assert table.schema.field("truth.r_CT_H[1]").metadata == {b"unit": b"m in H"}
    with pytest.raises(hil.errors.BadInput, match=r"run\.txt: must end in \.html"):
        run.report(tmp_path / "run.txt")


def test_recording_has_the_interface_of_a_run_and_is_replayed(tmp_path: Path) -> None:
    run = hil.run("scheme-1", duration_s=4.0, record=tmp_path)
    recording = hil.open(run.summary["recording"]["file"])
    np.testing.assert_array_equal(recording.truth.r_CT_H, run.truth.r_CT_H)
    assert recording.events == run.events
    assert recording.intact
    assert recording.passed is run.passed
    assert {name for name in dir(run) if name[0] != "_"} <= set(dir(recording))
    assert recording.replay().identical
    replay = recording.replay(overrides={"gnc.pkf.accelerometer_noise_mps2": 1e-3})
    assert {difference.field for difference in replay.differences} >= {"navigation.r_CT_H", "navigation.sigma_r_m"}
    assert not replay.identical
    recorded, navigation = replay.navigation["recorded"], run.summary["navigation"]
    assert recorded != replay.navigation["replayed"]
    assert recorded == {name: navigation[name] for name in recorded}
    assert (replay.run.navigation.sigma_r_m[-1] > run.navigation.sigma_r_m[-1]).all()
    with pytest.raises(hil.errors.BadInput, match=r"overrides: vmu\.latency_s=0\.2: cannot be changed in a replay"):
        recording.replay(overrides={"vmu.latency_s": 0.2})


def test_run_of_a_python_gnc_is_replayed_with_the_object(tmp_path: Path) -> None:
    class Fires:
        def __init__(self, from_s: float) -> None:
            self.from_s = from_s

        def step(self, data: Any) -> dict[str, Any]:
            return {"force": [int(data.t_s >= self.from_s), 0, 0]}

    run = hil.run("scheme-1", duration_s=2.0, gnc=Fires(1.0), record=tmp_path)
    recording = hil.open(run.summary["recording"]["file"])
    assert recording.replay(gnc=Fires(1.0)).identical
    differs = {difference.field: difference for difference in recording.replay(gnc=Fires(0.5)).differences}
    assert differs["command.force"].first_s == 0.5
    assert execute(["replay", str(recording.path)]) == 2
    with pytest.raises(hil.errors.BadInput, match="gnc: its GNC was the Python object Fires: give one"):
        recording.replay()


def test_campaign_has_cases_that_can_be_run_again(tmp_path: Path) -> None:
    campaign = hil.campaign("scheme-1", runs=3, duration_s=4.0, seed=5, workers=1, out=tmp_path / "results")
    assert campaign.pass_rate == {"passed": 0, "runs": 3, "rate": 0.0} | {
        key: pytest.approx(campaign.pass_rate[key]) for key in ("low", "high")
    }
    assert campaign.accepted_rate == campaign.pass_rate
    assert campaign.cases.column("case").to_pylist() == [0, 1, 2]
    again = campaign.run_case(1)
    assert again.summary["thrusters"]["propellant_kg"] == campaign.column("propellant_kg")[1]
    assert again.summary["case"] == 1
    campaign.figure().savefig(tmp_path / "campaign.png")
    assert "0 of 3 accepted" in campaign._repr_html_()
    assert hil.campaign("scheme-1", runs=3, duration_s=4.0, seed=5, workers=1).cases == campaign.cases
    with pytest.raises(hil.errors.BadInput, match="case: 3: must be 0 to 2"):
        campaign.run_case(3)
    with pytest.raises(hil.errors.BadInput, match="campaign: propellant: no such column: did you mean propellant_kg"):
        campaign.column("propellant")


def test_procedure_homes_jogs_arms_holds_resumes_and_ends() -> None:
    with hil.Bench("mock", "scheme-1", overrides={"duration_s": 6.0}) as bench:
        assert bench.mode is Mode.STANDBY
        bench.home()
        before_m = bench.feedback().rail_m[0]
        bench.jog("rails.x", -1, 0.5)
        assert bench.feedback().rail_m[0] < before_m
        bench.arm()
        bench.disarm()
        bench.arm()
        first = bench.start(until=2.0)
        assert bench.mode is Mode.HOLD
        assert (first.stop, first.t_s[-1]) == ("on hold", 2.0)
        second = bench.resume(until=3.0)
        np.testing.assert_array_equal(second.truth.r_CT_H[: len(first.t_s)], first.truth.r_CT_H)
        run = bench.resume()
        assert (run.stop, run.t_s[-1]) == ("completed", 6.0)
        assert [e.text.split(" after")[0] for e in run.events if e.source == "bench"] == [
            "hold: commanded by the operator",
            "resumed",
        ] * 2
    assert bench.mode is Mode.OFF
    assert bench.result is run
    with pytest.raises(hil.errors.BenchError, match="bench: cannot home, the session has ended: completed"):
        bench.home()


def test_another_thread_holds_a_run_and_stops_it() -> None:
    with hil.Bench("mock", "scheme-1", overrides={"duration_s": 600.0}) as bench:
        bench.arm()
        threading.Timer(0.05, bench.hold).start()
        first = bench.start()
        assert (first.stop, bench.mode) == ("on hold", Mode.HOLD)
        threading.Timer(0.05, bench.stop).start()
        run = bench.resume()
        assert run.stop == "stopped by the operator"
        assert first.t_s[-1] < run.t_s[-1] < 600.0


def test_procedure_waits_until_ready() -> None:
    near = dict(setting.split("=", 1) for setting in NEAR)
    position = json.loads(near["initial.position_m"])
    overrides = {"initial.position_m": position, "rig.rails.x.park_m": 0.6}
    with hil.Bench("mock", "scheme-1", overrides=overrides) as bench:
        bench.arm()
        run = bench.start(until="ready", timeout_s=150.0)
        (since_s,) = run.history["supervision"]["ready_since_s"][-1:]
        assert run.t_s[-1] == pytest.approx(since_s + hil.load_scenario("scheme-1").requirements.dwell_s, abs=1.0)
        assert run.ready_time_s <= run.t_s[-1]
        assert bench.mode is Mode.HOLD


def test_bench_that_leaves_its_block_stands_still_without_torque() -> None:
    bench = hil.Bench("mock", "scheme-1")

    def procedure() -> None:
        with bench:
            bench.arm()
            bench.start(until=1.0)
            raise RuntimeError("of the procedure")

    with pytest.raises(RuntimeError, match="of the procedure"):
        procedure()
    runner = bench._operator.runner
    assert runner is not None
    assert runner.safety.modes.mode is Mode.SAFE_STOP
    assert not bench._thread.is_alive()
    assert bench.result is not None
    assert bench.result.stop == "stopped by the operator"


def test_rejected_command_and_timeout_are_errors_and_the_bench_continues() -> None:
    with hil.Bench("mock", "scheme-1") as bench:
        with pytest.raises(hil.errors.BenchError, match="bench: cannot start in standby"):
            bench.start()
        bench.arm()
        with pytest.raises(hil.errors.BenchError, match="bench: start not done within 2 s"):
            bench.start(until="ready", timeout_s=2.0)
        assert bench.mode is Mode.HOLD
        with pytest.raises(hil.errors.BadInput, match="resume: until: 'soon': must be"):
            bench.resume(until="soon")  # type: ignore[arg-type]
        assert bench.resume(until=3.0).t_s[-1] == 3.0


def test_fault_ends_the_command_and_names_the_device() -> None:
    class Fails:
        def step(self, data: object) -> None:
            if data.t_s > 0.5:  # type: ignore[attr-defined]
                raise ValueError("lost")

    with hil.Bench("mock", "scheme-1", gnc=Fails()) as bench:
        bench.arm()
        run = bench.start()
        assert re.fullmatch(r"gnc Fails: step raised ValueError: lost \(test_python_api.py, line \d+\)", run.stop)
        assert run is bench.result


def test_procedure_injects_a_fault_and_reads_the_alarm() -> None:
    shifted = {"device": "rails.y", "kind": "offset", "at_s": 1.0, "value": 0.02}
    with hil.Bench("mock", "scheme-1", overrides={"faults": [shifted]}) as bench:
        bench.home()
        bench.arm()
        assert bench.alarms == []
        run = bench.start(until=5.0)
    (alarm,) = bench.alarms
    assert [alarm] == run.alarms
    assert (alarm.device, alarm.priority, alarm.text) == ("rails.y", "high", run.stop)
    assert run.summary["injected"][0]["detected_by"] in ("guard", "device")


def test_another_thread_stops_the_bench() -> None:
    class Stops:
        def __init__(self) -> None:
            self.cycles = 0

        def step(self, _: object) -> None:
            self.cycles += 1
            if self.cycles == 50:
                threading.Thread(target=bench._operator.submit, args=(OperatorCommand.STOP,)).start()

    with hil.Bench("mock", "scheme-1", gnc=Stops()) as bench:
        bench.arm()
        assert bench.start().stop == "stopped by the operator"


def test_procedure_on_emulated_wires() -> None:
    settings = {name: json.loads(value) for name, value in (text.split("=", 1) for text in (*NEAR, *IN_LOCK_STEP))}
    with hil.Bench("emulated", "scheme-1", overrides=settings) as bench:
        bench.home()
        bench.arm()
        run = bench.start(until=1.0, timeout_s=30.0)
        assert bench.mode is Mode.HOLD
        assert run.t_s[-1] >= 1.0
        assert np.abs(run.feedback.rail_m - run.setpoint.rail_m).max() < 0.05
    assert bench.result is not None
    assert bench.result.stop == "stopped by the operator"
