"""One contract for all robots that stand for rails and turntable: drivers of installed packages, on their emulators.

In lock-step, with the rig file that each package ships.
"""

from __future__ import annotations

import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.bench.kinematics import pose_of_axes
from hil.config.load import load_rig
from hil.config.rig import BENCH_AXES
from hil.core.clock import Order
from hil.core.messages import Array
from hil.drivers.arm.device import make_arms
from hil.drivers.arm.model import ArmKinematics
from hil.drivers.base import AxisGroup
from hil.errors import BadInput, DeviceError, LinkLost
from hil.params import bench as bench_params
from hil.parts.emulation.lock_step import LockStepConductor
from hil.parts.emulation.shared_state import SharedAxisState
from hil.report.bench_error import encoders_at_truth

STEP_S = 0.02


def rig_of(point: EntryPoint) -> str:
    """Return the rig file in the package of a driver."""
    spec = find_spec(point.value.partition(".")[0])
    assert spec is not None
    assert spec.origin is not None
    make = point.name.partition(".")[2].partition("_")[0]
    return str(Path(spec.origin).parent / "rigs" / f"emulated-arm-{make}.toml")


def other_rigs() -> list[str]:
    """Return the rig files with several robots, or with one on a rail."""
    folders = {Path(rig).parent for rig in RIGS.values()}
    return sorted(str(rig) for folder in folders for rig in folder.glob("*.toml") if str(rig) not in RIGS.values())


RIGS = {p.name: rig_of(p) for p in sorted(entry_points(group="hil.drivers")) if p.name.startswith("arm.")}
robots = pytest.mark.parametrize("rig_file", RIGS.values(), ids=RIGS.keys())


class Bench:
    """The axes of a robot and its emulated controller, in bench time."""

    def __init__(self, clock: LockStepConductor, axes: dict[str, AxisGroup], robot: Any, port: int) -> None:
        self.clock, self.robot, self.port = clock, robot, port
        self.rails, self.turntable = axes["rails"], axes["turntable"]

    @property
    def now_s(self) -> float:
        return self.clock.now_s()

    def read(self) -> Array:
        parts = (self.rails.read(self.now_s), self.turntable.read(self.now_s))
        return np.concatenate([part.position for part in parts])

    def send(self, axes: Array, rate: Array) -> Array:
        rails = self.rails.send(axes[:3], rate[:3], self.now_s)
        return np.concatenate([rails, self.turntable.send(axes[3:], rate[3:], self.now_s)])

    def move(self, path: Array, duration_s: float, speed_up_s: float = 0.2) -> float:
        """Move along ``path`` (6,) with setpoints in each step; return the largest error on the way."""
        start, begin_s, worst = self.read(), self.now_s, 0.0
        while (t := self.now_s - begin_s) < duration_s:
            done, rate = profile(t + STEP_S, duration_s, speed_up_s)
            self.send(start + path * done, path * rate)
            self.clock.sleep(STEP_S)
            worst = max(worst, float(np.abs(self.read() - start - path * done).max()))
        return worst

    def stands(self, duration_s: float = 0.2) -> bool:
        """Return whether the robot stands still, by its true axes."""
        first = self.robot.axes
        self.clock.sleep(duration_s)
        return bool(np.abs(self.robot.axes - first).max() < 1e-6)


def profile(t: float, duration_s: float, speed_up_s: float) -> tuple[float, float]:
    """Return the part of a path at ``t`` and its rate, with constant acceleration at both ends."""
    top = 1.0 / (duration_s - speed_up_s)
    t = min(t, duration_s)
    if t < speed_up_s:
        return 0.5 * top * t * t / speed_up_s, top * t / speed_up_s
    if t > duration_s - speed_up_s:
        left = duration_s - t
        return 1.0 - 0.5 * top * left * left / speed_up_s, top * left / speed_up_s
    return top * (t - 0.5 * speed_up_s), top


@contextmanager
def opened(rig_file: str) -> Iterator[Bench]:
    clock, stop, board = LockStepConductor(STEP_S, 30.0), threading.Event(), SharedAxisState.create()
    rig = load_rig(rig_file).value
    assert rig.arm is not None
    controller = rig.arm.make_emulator(rig, clock, board)
    addresses = controller.start()
    rig = rig.model_copy(update={"arm": rig.arm.connected("arm", addresses)})
    served = clock.start_thread(lambda: controller.run(stop), "controller", Order.AXES)
    axes = make_arms(rig, clock)
    try:
        for group in axes.values():
            group.open(clock.now_s())
        yield Bench(clock, axes, controller.robot, int(addresses["arm"].rpartition(":")[2]))
    finally:
        for group in axes.values():
            group.close()
        stop.set()
        clock.join(served, 5.0)
        controller.close()
        board.close()
        clock.close()


PATH = np.array([-0.08, 0.04, 0.02, 0.03, -0.03, 0.05])


@robots
def test_robot_opens_where_it_stands_and_follows_setpoints(rig_file: str) -> None:
    with opened(rig_file) as bench:
        start = bench.read()
        assert bench.stands()
        assert bench.move(PATH, 1.0) < 0.01
        bench.clock.sleep(0.3)
        assert bench.read() == pytest.approx(start + PATH, abs=2e-4)


@robots
def test_stop_brakes_along_the_path_and_nothing_moves_after(rig_file: str) -> None:
    with opened(rig_file) as bench:
        start = bench.read()
        move_for(bench, PATH, 0.5)
        bench.rails.stop(bench.now_s)
        bench.clock.sleep(0.4)
        held = bench.robot.axes
        along = (held - start)[0] / PATH[0]
        assert held == pytest.approx(start + along * PATH, abs=5e-4)
        bench.send(start, np.zeros(6))
        assert bench.stands()
        bench.turntable.disable(bench.now_s)
        assert bench.stands()


def move_for(bench: Bench, rate: Array, duration_s: float) -> None:
    """Move at ``rate`` (6,), m/s and rad/s, for a time, and do not brake."""
    start, begin_s = bench.read(), bench.now_s
    while (t := bench.now_s - begin_s) < duration_s:
        done = 0.5 * t * t / 0.3 if t < 0.3 else t - 0.15
        bench.send(start + rate * done, rate * min(1.0, t / 0.3))
        bench.clock.sleep(STEP_S)


@robots
def test_setpoints_that_cease_let_the_robot_brake_within_its_limits(rig_file: str) -> None:
    with opened(rig_file) as bench:
        move_for(bench, PATH, 0.5)
        before, fastest = bench.robot.axes, 0.0
        for _ in range(25):
            bench.clock.sleep(STEP_S)
            fastest, before = max(fastest, np.abs(bench.robot.axes - before).max()), bench.robot.axes
        assert fastest < 1.1 * 0.08 * STEP_S
        assert bench.stands()
        assert np.isfinite(bench.read()).all()


@robots
def test_gap_in_the_setpoints_causes_no_jump(rig_file: str) -> None:
    with opened(rig_file) as bench:
        start, begin_s, given = bench.read(), bench.now_s, []
        while (t := bench.now_s - begin_s) < 0.9:
            done = 0.5 * t * t / 0.3 if t < 0.3 else t - 0.15
            if not 0.4 <= t < 0.48:
                bench.send(start + PATH * done, PATH * min(1.0, t / 0.3))
            for _ in range(5):
                bench.clock.sleep(STEP_S / 5.0)
                given.append(bench.robot.given)
        steps = np.diff(np.array(given[2:]), axis=0)
        assert np.abs(steps).max() < 1.5 * np.abs(PATH).max() * STEP_S / 5.0
        assert (steps * np.sign(PATH) > -1e-9).all()


FAULTS = {
    "drop 1.0": ("no cycle for 0.1", 0.25),
    "corrupt 1.0": ("(no cycle for 0.1|the controller has ended)", 0.25),
    "delay 0.5": ("no cycle for 0.1", 0.25),
    "link_down": ("no cycle for 0.1", 0.25),
    "freeze": ("repeats its last pose", 0.25),
    "drive_fault x": ("the controller has ended", 0.1),
}
"""Fault of the emulated controller -> begin of the error, and the time within which it is raised, s."""


@robots
@pytest.mark.parametrize(("fault", "text", "within_s"), [(k, *v) for k, v in FAULTS.items()], ids=FAULTS.keys())
def test_fault_names_the_robot_in_time_and_nothing_moves_after(
    rig_file: str, fault: str, text: str, within_s: float
) -> None:
    with opened(rig_file) as bench:
        move_for(bench, PATH, 0.5)
        assert bench.robot.faults.execute(f"on {fault}") == "ok"
        begin_s = bench.now_s
        with pytest.raises(DeviceError, match=f"^arm: {text}"):
            move_for(bench, PATH, 1.0)
        assert bench.now_s - begin_s <= within_s
        bench.rails.stop(bench.now_s)
        bench.clock.sleep(0.5)
        assert bench.stands()


@robots
def test_repeated_telegrams_change_nothing_and_are_counted(rig_file: str) -> None:
    with opened(rig_file) as bench:
        start = bench.read()
        bench.robot.faults.execute("on duplicate 1.0")
        bench.move(PATH, 1.0)
        bench.clock.sleep(0.3)
        assert bench.read() == pytest.approx(start + PATH, abs=2e-4)
        counts = bench.rails.counters()  # type: ignore[attr-defined]
        assert counts["duplicates"] > 0.9 * counts["exchanges"]
        assert counts["protocol_errors"] == counts["lost"] == 0


@robots
def test_some_lost_telegrams_are_counted_and_bridged(rig_file: str) -> None:
    with opened(rig_file) as bench:
        start = bench.read()
        bench.robot.faults.execute("on drop 0.1")
        bench.move(PATH, 1.0)
        bench.clock.sleep(0.3)
        assert bench.read() == pytest.approx(start + PATH, abs=2e-4)
        assert 10 < bench.rails.counters()["lost"] < 80  # type: ignore[attr-defined]


@robots
def test_robot_whose_pose_stands_for_a_few_cycles_of_a_fast_motion_is_not_frozen(rig_file: str) -> None:
    """Answers that come late leave it where it is: of 0.15 m/s two such cycles are 1 mm."""
    with opened(rig_file) as bench:
        start, begin_s = bench.read(), bench.now_s
        for step in range(round(1.0 / STEP_S)):
            for at_s, switch in ((0.45, "on"), (0.49, "off")):
                if step == round(at_s / STEP_S):
                    bench.robot.faults.execute(f"{switch} freeze")
            done, rate = profile(bench.now_s - begin_s + STEP_S, 1.0, 0.45)
            bench.send(start + PATH * done, PATH * rate)
            bench.clock.sleep(STEP_S)
            bench.read()
        bench.clock.sleep(0.3)
        assert bench.read() == pytest.approx(start + PATH, abs=2e-4)


@robots
def test_limit_of_the_robot_is_named_and_it_stands_before(rig_file: str) -> None:
    with opened(rig_file) as bench:
        kinematics = ArmKinematics(load_rig(rig_file).value)
        with pytest.raises(DeviceError, match=r"^arm: .*allowed"):
            bench.move(np.array([0.0, -1.5, 0.0, 0.0, 0.0, 0.0]), 5.0, 1.0)  # over its own base
        bench.rails.stop(bench.now_s)
        bench.clock.sleep(1.0)
        kinematics.target(bench.robot.axes, 0.0, None)
        assert bench.stands()


@robots
def test_port_has_one_user_and_one_sender(rig_file: str) -> None:
    with opened(rig_file) as bench:
        rig = load_rig(rig_file).value
        assert rig.arm is not None
        arm = rig.arm.connected("arm", {"arm": f"127.0.0.1:{bench.port}"})
        second = make_arms(rig.model_copy(update={"arm": arm}), bench.clock)["rails"]
        with pytest.raises(LinkLost, match=f"^arm: cannot open udp 127.0.0.1:{bench.port}: "):
            second.open(bench.now_s)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
            for _ in range(50):
                stranger.sendto(b"<Rob><IPOC>1</IPOC></Rob>", ("127.0.0.1", bench.port))
        start = bench.read()
        bench.move(PATH, 1.0)
        bench.clock.sleep(0.3)
        assert bench.read() == pytest.approx(start + PATH, abs=2e-4)
        assert bench.rails.counters()["protocol_errors"] == 0  # type: ignore[attr-defined]


@pytest.mark.parametrize("rig_file", [*RIGS.values(), *other_rigs()], ids=lambda path: Path(path).stem)
def test_loop_is_closed_on_the_emulated_robots(rig_file: str) -> None:
    run = hil.run("scheme-1", rig=rig_file, duration_s=0.5, overrides={"rig.host.time": "lock_step"})
    assert run.summary["stop"] == "completed"
    assert max(run.summary["bench"]["rail_error_max_m"]) < 0.005


LOCK_STEP = {"rig.host.time": "lock_step"}
COMPENSATED = dict.fromkeys((f"rig.{axis}.lead_s" for axis in BENCH_AXES), -0.0107)
"""Leads of the emulated rails and turntable, by hil identify."""


class RecordedCommands:
    """GNC that repeats the thruster commands of a run."""

    def __init__(self, on: Array) -> None:
        self._on = iter(on)

    def step(self, _: object) -> Array:
        return next(self._on)


def shown(run: hil.Run) -> tuple[Array, Array, Array]:
    """Return times (n,), s, positions (n, 3), m, and attitudes (n, 4) that the axes show, by their encoders."""
    rows, rail_m, gimbal_rad = encoders_at_truth(run.history)
    bench, r, q = bench_params.bench(run.rig, run.scenario.step_s), np.empty((len(rows), 3)), np.empty((len(rows), 4))
    for k in range(len(rows)):
        pose_of_axes(bench, rail_m[k], gimbal_rad[k], r[k], q[k])
    return rows["t_s"], r, q


@pytest.mark.slow
@robots
def test_robot_and_rails_show_the_same_of_the_same_commands(rig_file: str) -> None:
    """pytest -m slow tests/contract/test_pose_device.py

    In closed loop the truths of two benches differ: the first firing that differs by a cycle separates their limit
    cycles. With the commands of one run on both they are the same, and what the benches show of them is compared.
    """
    rails = hil.run("scheme-1", rig="emulated", overrides=LOCK_STEP | COMPENSATED)
    robot = hil.run("scheme-1", rig=rig_file, overrides=LOCK_STEP, gnc=RecordedCommands(rails.command.on))
    np.testing.assert_array_equal(robot.truth.r_CT_H, rails.truth.r_CT_H)
    np.testing.assert_array_equal(robot.truth.q_CH, rails.truth.q_CH)
    (t_s, r, q), (robot_s, robot_r, robot_q) = shown(rails), shown(robot)
    _, own, of_robot = np.intersect1d(t_s, robot_s, return_indices=True)
    assert len(own) > 0.99 * len(t_s)
    assert np.linalg.norm(r[own] - robot_r[of_robot], axis=1).max() < 1e-4
    turned = np.abs(np.sum(q[own] * robot_q[of_robot], axis=1)).clip(max=1.0)
    assert np.degrees(2.0 * np.arccos(turned)).max() < 0.01


@pytest.mark.slow
@robots
def test_robot_shows_the_truth_and_its_verdict_is_that_of_rails(rig_file: str) -> None:
    """pytest -m slow tests/contract/test_pose_device.py"""
    rails, robot = (hil.run("scheme-1", rig=rig, overrides=LOCK_STEP).summary for rig in ("emulated", rig_file))
    assert robot["passed"] == rails["passed"] is True
    assert abs(robot["ready_time_s"] - rails["ready_time_s"]) < 0.2
    assert robot["bench"]["true_pose_error_mm"]["max"] < 0.1
    assert robot["bench"]["true_pose_error_deg"]["max"] < 0.01


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("lag_ms", [12.0, 20.0, 40.0])
def test_lag_of_a_robot_is_compensated_or_refused_by_its_cost(lag_ms: float) -> None:
    """pytest -m slow tests/contract/test_pose_device.py"""
    of_robot = {"rig.arm.abb_egm.emulated_lag_s": 1e-3 * lag_ms, "rig.arm.lag_s": 1e-3 * lag_ms + 0.003}
    leads = [dict.fromkeys((f"rig.{axis}.lead_s" for axis in BENCH_AXES), s) for s in (0.0, of_robot["rig.arm.lag_s"])]
    with pytest.raises(BadInput, match=r"rails\.x\.lead_s: 0: leaves .* ms of arm\.lag_s"):
        hil.run("scheme-1", rig=RIGS["arm.abb_egm"], overrides=LOCK_STEP | of_robot | leads[0])
    run = hil.run("scheme-1", rig=RIGS["arm.abb_egm"], overrides=LOCK_STEP | of_robot | leads[1])
    assert run.summary["passed"]
    assert run.summary["bench"]["true_pose_error_mm"]["max"] < 0.1
    assert run.summary["bench"]["true_pose_error_deg"]["max"] < 0.01
