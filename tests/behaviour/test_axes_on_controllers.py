"""Axes on controllers of their own, and further axes: configuration, emulated drives, a run in memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from pyarrow import parquet

import hil
from hil.config.load import load_rig
from hil.config.motion_digest import motion_digest
from hil.config.rig import ROTARY_NAMES, Rails, Rig
from hil.core.clock import SimulatedClock
from hil.core.messages import AxisFeedback, Homing
from hil.core.modes import Mode
from hil.drivers.mock_axes import MockAxes
from hil.drivers.split_axes import make_axes
from hil.errors import BadInput, DeviceError, LinkLost, SafetyTrip
from hil.loop.rate_keeper import SimulatedRate
from hil.loop.target_stage import AxesTogether, HeldAxes
from hil.parts.console.session_state import SessionState, bench_description
from hil.parts.console.status import StatusWriter
from hil.parts.emulation.shared_state import SharedAxisState
from hil.parts.export.ros2 import export_ros2
from hil.parts.export.table import export
from hil.recording.read import load
from hil.recording.session import recording
from hil.session import assembly
from hil.session.build import runner as make_runner
from tests.support.lock_step import in_lock_step, serving
from tests.support.run_settings import make_job

CONTROLLER = """
[[rails.controllers]]
axes = ["x"]
driver = "modbus_rtu"
"""
LAMP = """
[linear_axes.lamp]
driver = "{driver}"
servo = {{ gain_per_s = 30.0, lag_s = 0.006 }}
place_m = [0.4]
x = {{ travel_m = [0.0, 2.0], rate_max_mps = 1.0, acceleration_max_mps2 = 2.0, encoder = "incremental", home_m = 0.1 }}
"""
X = "x = {{ travel_m = [0.0, 2.0], rate_max_mps = 1.0, acceleration_max_mps2 = 2.0 }}\n".format()
SUN = """
[rotary_axes.sun]
driver = "mock"
servo = { gain_per_s = 30.0, lag_s = 0.006 }
place_deg = [3.0, 40.0]
roll = { travel_deg = [-10.0, 10.0], rate_max_degps = 30.0, acceleration_max_degps2 = 60.0 }
yaw = { travel_deg = [-90.0, 90.0], rate_max_degps = 30.0, acceleration_max_degps2 = 60.0 }
"""


ARM = """
[rotary_axes.arm]
driver = "mock"
servo = { gain_per_s = 30.0, lag_s = 0.006 }
place_deg = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
""" + "".join(
    f"{name} = {{ travel_deg = [-90.0, 90.0], rate_max_degps = 30.0, acceleration_max_degps2 = 60.0 }}\n"
    for name in ROTARY_NAMES
)


def rig_of(folder: Path, text: str, base: str = "emulated") -> Any:
    file = folder / "rig.toml"
    file.write_text(f'extends = "{base}"\nname = "own"\n{text}')
    return load_rig(str(file))


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (CONTROLLER.replace('"x"', '"w"'), r'controllers: axis "w", allowed: x, y, z'),
        (CONTROLLER + CONTROLLER, r"controllers: an axis is driven twice, allowed: each axis by one controller"),
        (
            CONTROLLER.replace('"x"', '"x", "y"') + CONTROLLER.replace('"x"', '"z"'),
            r"controllers: drive all axes, allowed: all but one, which driver drives",
        ),
        (
            '[[turntable.controllers]]\naxes = ["yaw"]\ndriver = "ascii"\n',
            r'ascii\.protocol "hil-ascii": drives roll, pitch, yaw, here yaw; allowed: a file for these$',
        ),
        (
            SUN.replace('"mock"', '"ascii"').replace("40.0]", "40.0, 0.0]") + SUN.splitlines()[-1].replace("yaw", "a"),
            r'sun: ascii\.protocol "hil-ascii": drives roll, pitch, yaw, here roll, yaw, a; allowed: a file for these$',
        ),
        (
            "".join(
                LAMP.format(driver="modbus").replace("lamp", f"lamp{i}").replace("[0.4]", "[0.4, 0.4, 0.4, 0.4, 0.4]")
                + "".join(X.replace("x =", f"{name} =") for name in "yzuv")
                for i in range(5)
            ),
            r"linear_axes, rotary_axes: 25 axes, at most 24 are allowed$",
        ),
        (CONTROLLER.replace("modbus_rtu", "mock"), r'rails\.controllers\.0\.driver = "mock" does not go with kind'),
        (LAMP.format(driver="modbus").replace("[0.4]", "[2.5]"), r"place_m: x 2\.5, allowed 0 to 2"),
        (LAMP.format(driver="modbus").replace("[0.4]", "[0.4, 0.5]"), r"place_m \[0\.4, 0\.5\]: one for each of x"),
        (LAMP.format(driver="modbus").replace(".lamp", ".io"), r"linear_axes\.io: the name of another device"),
        (LAMP.format(driver="modbus") + X.replace("x =", "q ="), r"linear_axes\.lamp\.q: .*unknown key"),
        (
            LAMP.format(driver="modbus_rtu").replace("[0.4]", "[0.4, 0.1]") + X.replace("x =", "u ="),
            r"rtu\.device_ids \[1, 2, 3\]: has none for u, allowed: one for each of x, y, z, u",
        ),
        (
            "turntable.cia402.node_ids = [1, 2]\n",
            r"node_ids \[1, 2\]: has none for yaw, allowed: one for each of roll, ",
        ),
        ("[rails.modbus.u]\nport = 502\n", r"rails\.modbus\.u: .*unknown key"),
    ],
)
def test_what_cannot_be_driven_is_one_line(tmp_path: Path, text: str, line: str) -> None:
    with pytest.raises(BadInput, match=line) as caught:
        rig_of(tmp_path, text)
    assert len(caught.value.problems) == 1, caught.value


def test_hardware_names_the_wire_of_each_controller_and_further_axis(tmp_path: Path) -> None:
    rig: Rig = rig_of(tmp_path, CONTROLLER + LAMP.format(driver="modbus")).value
    missing = rig.missing_wires()
    assert "rails.controllers.0.rtu.port" in missing
    assert "linear_axes.lamp.modbus.x.port" in missing
    assert "rails.modbus.x.port" not in missing
    assert "linear_axes.lamp.modbus.y.port" not in missing


def test_sign_off_covers_controllers_and_further_axes_and_stays_valid_without_any(tmp_path: Path) -> None:
    digests = [motion_digest(rig_of(tmp_path, text).value) for text in ("", CONTROLLER, LAMP.format(driver="modbus"))]
    assert len(set(digests)) == 3
    dumped = load_rig("emulated").value.model_dump(mode="json")
    assert {"linear_axes", "rotary_axes"} <= set(dumped)
    assert digests[0] == motion_digest(load_rig("emulated").value)


@contextmanager
def split_rails() -> Iterator[tuple[Any, Any, list[Any]]]:
    """Give clock, rails whose x is on a serial line, and the emulators of both controllers."""
    table = load_rig("emulated").value.rails
    controllers = {"controllers": [{"axes": ["x"], "driver": "modbus_rtu"}]}
    config = Rails.model_validate(table.model_dump(mode="json") | controllers, strict=False)
    with in_lock_step() as clock, closing(SharedAxisState.create()) as board, ExitStack() as served:
        emulators = [part.make_emulator(clock, board, name=name) for name, part in config.parts("rails").items()]
        addresses = [address for emulator in emulators for address in emulator.start().items()]
        for emulator in emulators:
            served.enter_context(serving(clock, emulator))
        with closing(make_axes(config.connected("rails", dict(addresses)), clock, "rails")) as rails:
            rails.open(clock.now_s())
            yield clock, (rails, board), emulators


def test_cameras_see_all_axes_of_a_group_on_two_controllers() -> None:
    with split_rails() as (clock, (rails, board), _):
        goal = rails.read(clock.now_s()).position + np.array([-0.02, 0.03, 0.01])
        for _ in range(150):
            rails.send(goal, np.zeros(3), clock.now_s())
            clock.sleep(0.02)
        assert rails.read(clock.now_s()).position == pytest.approx(goal, abs=1e-4)
        assert board.read("rails", clock.now_s())[0] == pytest.approx(goal, abs=1e-4)


@pytest.mark.parametrize("dead", [0, 1])
def test_silence_of_one_controller_stops_the_axes_of_the_other(dead: int) -> None:
    with split_rails() as (clock, (rails, _), emulators):
        start = rails.read(clock.now_s()).position
        error = None
        for k in range(150):
            if k == 10:
                emulators[dead].faults.on("drop", value=1.0)
            try:
                rails.read(clock.now_s())
                rails.send(start + 0.05 * 0.02 * k * np.array([-1.0, 1.0, 1.0]), np.zeros(3), clock.now_s())
            except DeviceError as caught:
                error = caught
                break
            clock.sleep(0.02)
        assert error is not None
        assert error.device.startswith("rails.x") == (dead == 1)
        clock.sleep(0.3)
        others = emulators[1 - dead]._rails._axes
        assert np.abs(others.rate).max() < 1e-3
        assert all(others._braking)


def bench_of(folder: Path, text: str, **overrides: Any) -> hil.Bench:
    return hil.Bench(rig_of(folder, text, "mock").value, "scheme-1", overrides={"duration_s": 0.4, **overrides})


def test_further_axes_are_jogged_by_name_within_their_travel_and_parked(tmp_path: Path) -> None:
    with bench_of(tmp_path, LAMP.format(driver="mock") + SUN) as bench:
        bench.home()
        rails_m = bench.feedback().rail_m.copy()
        bench.jog("lamp.x", 1, 1.0)  # at a tenth of 1 m/s, for 0.2 s more than the key
        assert bench.axis_feedback("lamp.x") == pytest.approx((0.1 + 0.12, 0.0), abs=0.02)
        bench.jog("lamp.x", -1, 4.0)
        assert bench.axis_feedback("lamp.x")[0] == pytest.approx(0.0, abs=1e-3)
        bench.jog("sun.roll", -1, 5.0)
        assert bench.axis_feedback("sun.roll")[0] == pytest.approx(np.radians(-10.0), abs=1e-3)
        assert bench.axis_feedback("sun.yaw") == (0.0, 0.0)
        assert bench.feedback().rail_m == pytest.approx(rails_m, abs=1e-6)
        with pytest.raises(BadInput, match=r"must be one of rails\.x, .*, lamp\.x, sun\.roll, sun\.yaw"):
            bench.axis_feedback("sun.pitch")
        bench.park()
        at = [bench.axis_feedback(name)[0] for name in ("lamp.x", "sun.roll", "sun.yaw")]
        assert at == pytest.approx([0.0, 0.0, 0.0], abs=1e-3)


def test_further_axis_that_is_not_homed_is_jogged_slowly_and_parks_not(tmp_path: Path) -> None:
    with bench_of(tmp_path, LAMP.format(driver="mock")) as bench:
        bench.jog("lamp.x", 1, 1.0)
        assert bench.axis_feedback("lamp.x")[0] == pytest.approx(0.02 * 1.2, abs=0.004)
        rails_m = bench.feedback().rail_m.copy()
        with pytest.raises(hil.errors.BenchError, match=r"lamp\.x: homing not done, allowed done before parking"):
            bench.park()
        assert bench.feedback().rail_m == pytest.approx(rails_m, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "axis", "words"),
    [
        (LAMP.format(driver="mock"), "lamp.x", r"lamp\.x: following error 0\.05\d m, allowed 0\.05"),
        (ARM, "arm.c", r"arm\.c: following error 2\.0\d\d deg, allowed 2\.0"),
    ],
)
def test_further_axis_that_does_not_follow_its_jog_stops_the_bench_by_its_name(
    tmp_path: Path, text: str, axis: str, words: str
) -> None:
    with bench_of(tmp_path, text) as bench:
        bench.home()
        runner = bench._operator.runner
        assert runner is not None
        (group,) = runner.loop.target.groups
        group.axes._axes.rate_max[-1] = 1e-3  # type: ignore[attr-defined]
        with pytest.raises(hil.errors.BenchError, match=words):
            bench.jog(axis, 1, 3.0)
        assert bench.mode is Mode.SAFE_STOP


def test_console_lists_further_axes_with_their_units_ages_and_states(tmp_path: Path) -> None:
    rig, scenario = rig_of(tmp_path, LAMP.format(driver="mock") + SUN, "mock"), make_job(0.4).scenario.value
    with make_runner(replace(make_job(0.4), rig=rig)) as runner, runner.axes_only() as sequencer:
        state, writer = SessionState(bench_description(rig.value, scenario), ""), StatusWriter(runner)
        sun = runner.loop.target.groups[1].axes
        assert isinstance(sun, MockAxes)
        sun.set_limit_switch(1, -1)
        sun.send(np.radians([2.0, -3.0]), np.zeros(2), runner.now_s())
        for _ in range(100):
            sequencer.tick()
        state.set_status(1, writer.fill(runner.now_s() + 0.1), 0.0)
        live = state.live(0.0)
    assert list(state.bench["axes"])[6:] == ["lamp.x", "sun.roll", "sun.yaw"]
    assert state.bench["axes"]["sun.yaw"] == [-90.0, 90.0]
    assert state.bench["units"] == {"rails": "m", "turntable": "deg", "lamp": "m", "sun": "deg"}
    assert live["homing"] == [2] * 6 + [0, 2, 2]
    assert live["limit"] == [0] * 8 + [-1]
    assert live["further_axes"]["lamp"] == {"m": [0.0], "mps": [0.0]}
    assert live["further_axes"]["sun"]["deg"] == pytest.approx([2.0, -3.0], abs=1e-3)
    assert live["ages_s"]["sun"] == pytest.approx(0.1)
    assert "target_deg" not in live


def test_further_axis_that_is_pushed_while_the_run_is_held_stops_the_bench(tmp_path: Path) -> None:
    with bench_of(tmp_path, LAMP.format(driver="mock"), duration_s=1.0) as bench:
        bench.home()
        bench.arm()
        bench.start(until=0.2)
        runner = bench._operator.runner
        assert runner is not None
        runner.loop.target.groups[0].axes._axes.record.encoder_offset[0] = 0.02  # type: ignore[attr-defined]
        assert bench.resume().stop.startswith("lamp.x: distance from commanded place 0.0200 m")
        assert list(runner.safety.modes.history).count(Mode.RUNNING) == 1  # it did not resume


def test_further_axis_that_sticks_or_reports_another_speed_stops_its_move(tmp_path: Path) -> None:
    class Reported(MockAxes):
        def read(self, now_s: float) -> AxisFeedback:
            found = super().read(now_s)
            return replace(found, rate=found.rate + 0.2)

    table = rig_of(tmp_path, LAMP.format(driver="mock").replace('encoder = "incremental", ', ""), "mock").value
    for axes, what in (
        (MockAxes("lamp", table.held_axes["lamp"]), r"lamp\.x: following error 0\.05\d m, allowed 0\.050 m"),
        (Reported("lamp", table.held_axes["lamp"]), r"lamp\.x: speed 0\.\d+ m/s reported, allowed 0\.\d+ m/s by its"),
    ):
        group, rate = HeldAxes(axes, table.held_axes["lamp"]), SimulatedRate(SimulatedClock(), 0.02)
        group.open(0.0)
        if type(axes) is MockAxes:
            axes._axes.rate_max[:] = 1e-3
        with pytest.raises(SafetyTrip, match=what):
            group.place(rate.wait, 0.02)


def test_further_axes_that_lose_packets_stop_the_bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Counting(MockAxes):
        lost = 0

        def lost_packets(self) -> int:
            return self.lost

    monkeypatch.setattr(assembly, "MockAxes", Counting)
    rig = rig_of(tmp_path, LAMP.format(driver="mock"), "mock")
    with make_runner(replace(make_job(0.4), rig=rig)) as runner, runner.axes_only() as sequencer:
        now_s = sequencer.tick().now_s
        sequencer.check_links(now_s)
        runner.loop.target.groups[0].axes.lost = 10  # type: ignore[attr-defined]
        with pytest.raises(SafetyTrip, match="lamp: lost packets"):
            sequencer.check_links(now_s)


def test_loss_of_a_further_axis_stops_a_bench_that_stands_by(tmp_path: Path) -> None:
    with bench_of(tmp_path, LAMP.format(driver="mock")) as bench:
        runner = bench._operator.runner
        assert runner is not None
        (group,) = runner.loop.target.groups
        group.axes.fail(LinkLost("lamp", "is gone"))  # type: ignore[attr-defined]
        with pytest.raises(hil.errors.BenchError, match="lamp: is gone"):
            bench.home()


def test_further_axes_are_homed_placed_held_and_reported(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, LAMP.format(driver="mock") + SUN, "mock")
    with make_runner(replace(make_job(0.4), rig=rig)) as runner:
        outcome = runner.run()
        lamp, sun = (group.axes for group in runner.loop.target.groups)
    assert lamp._axes.position == pytest.approx([0.4], abs=1e-3)
    assert lamp._homing == (Homing.DONE,)
    assert sun._axes.position == pytest.approx(np.radians([3.0, 40.0]), abs=1e-3)
    found = runner.meters["held_axes"]()
    assert set(found) == {"lamp", "sun"}
    assert 0.0 <= found["lamp"]["x_m"] < 0.005
    assert 0.0 <= found["sun"]["yaw_deg"] < 0.5
    assert outcome.stop == "completed"


def test_further_axes_are_recorded_in_each_cycle_and_exported_with_their_units(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, LAMP.format(driver="mock") + SUN, "mock")
    job = replace(make_job(0.4), rig=rig)
    with recording(job, "lamp", tmp_path, lambda _: None) as taken:
        with make_runner(job, sinks=taken.sinks) as runner:
            runner.run()
            lamp = runner.loop.target.groups[0].feedback
        taken.break_off("test")
    recorded = load(taken.path)
    rows = recorded.held_samples
    of_lamp, of_sun = (rows[rows["group"] == number] for number in (0, 1))
    np.testing.assert_array_equal(of_lamp["t_s"], recorded.cycles["t_s"])
    np.testing.assert_array_equal(of_sun["t_s"], recorded.cycles["t_s"])
    assert of_lamp["position"][-1, 0] == lamp.position[0]
    assert not of_lamp["position"][:, 1:].any()
    assert of_sun["position"][:, :2] == pytest.approx(np.tile(np.radians([3.0, 40.0]), (21, 1)), abs=1e-3)
    written = dict(export(taken.path, "parquet", tmp_path / "out.parquet"))
    assert written[tmp_path / "out-axes-lamp.parquet"] == 21
    table = parquet.read_table(tmp_path / "out-axes-sun.parquet")
    assert table.column_names[2:] == [
        f"{axis}_{name}" for axis in ("roll", "yaw") for name in ("setpoint_rad", "rad", "radps")
    ]
    assert table.schema.field("yaw_radps").metadata == {b"unit": b"rad/s"}
    assert table["yaw_setpoint_rad"].to_pylist() == [np.radians(40.0)] * 21
    assert table["yaw_rad"].to_pylist() == of_sun["position"][:, 1].tolist()
    counts = export_ros2(taken.path, tmp_path / "bag")
    assert (counts["/held_axes/lamp"], counts["/held_axes/sun"]) == (21, 21)
    with next((tmp_path / "bag").glob("*.mcap")).open("rb") as file:
        data = [m.data for _, _, m in make_reader(file).iter_messages(topics=["/held_axes/sun"])]
    assert all(of_sun["position"][i, 1].tobytes() in message for i, message in enumerate(data))


@pytest.mark.slow
def test_run_on_wires_homes_places_and_holds_all_axes(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, CONTROLLER + LAMP.format(driver="modbus") + '[host]\ntime = "lock_step"\n')
    with make_runner(replace(make_job(1.0), rig=rig)) as runner:
        outcome = runner.run()
        assert outcome.stop == "completed"
        assert runner.meters["held_axes"]()["lamp"]["x_m"] < 0.001
        error_m = outcome.history["feedback"]["rail_m"][1:] - outcome.history["setpoint"]["rail_m"][:-1]
        assert np.abs(error_m).max() < 0.002


def test_further_axis_that_leaves_its_place_trips_by_its_name() -> None:
    class Axes:
        axis_names = ("sun.roll", "sun.yaw")
        name = "sun"

        def read(self, now_s: float) -> Any:
            return type("Feedback", (), {"position": np.radians([3.0, 41.0])})

    file = load_rig("mock").value.model_dump(mode="json", exclude_none=True)
    gimbal = {"travel_deg": (-90.0, 90.0), "rate_max_degps": 10.0, "acceleration_max_degps2": 10.0}
    file["rotary_axes"] = {
        "sun": {"driver": "mock", "servo": {"gain_per_s": 30.0, "lag_s": 0.01}, "place_deg": (3.0, 40.0)}
        | {"roll": gimbal, "yaw": gimbal}
    }
    table = Rig.model_validate(file, strict=False).rotary_axes["sun"]
    together = AxesTogether([HeldAxes(Axes(), table)])  # type: ignore[arg-type]
    with pytest.raises(SafetyTrip, match=r"sun\.yaw: distance from commanded place 1\.0000 deg, allowed 0\.5 deg"):
        together.check(0.0)
