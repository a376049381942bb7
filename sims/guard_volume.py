"""How near carriage and turntable come to the target when a GNC pushes, or an operator jogs, at random.

python sims/guard_volume.py            1,000 pushes and 200 jogs on the mock rig, in memory; exit code 1 if one fails
python sims/guard_volume.py 50 20      as many of each
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

import numpy as np

from hil.bench.kinematics import pose_of_axes
from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE, Array
from hil.core.operator_commands import Operator, OperatorCommand
from hil.drivers.axes import ServoAxes
from hil.drivers.mock_axes import MockAxes
from hil.gnc_backends.c_header import HEADER_FILE
from hil.maths import euler
from hil.models.bodies import clearance
from hil.params import bench as bench_params
from hil.parts.campaigns.case_runner import CaseRunner
from hil.session import build
from hil.session.build import Job

STILL: Final = np.zeros(3)
NO_TURN: Final = np.array([0.0, 0.0, 0.0, 1.0])
FAST_MPS: Final = 0.05
NEAR_M: Final = 0.1
ROUNDING_M: Final = 1e-6
STOPS: Final = ("along the docking axis", "range to the target", "distance of bodies", "distance of chaser and target")
_BRAKE_STEP_S: Final = 0.002
_REST: Final = 1e-4  # m/s, rad/s
_TO_JUDGE_M: Final = 1.2  # range from which on distances are computed
_FAR_M: Final = 10.0
_PUSHED_S: Final = 80.0
_JOGGED_S: Final = 40.0


@dataclass
class Nearest:
    """Of one run: least position along the docking axis, least distance of two bodies, m; fastest near one, m/s."""

    along_m: float = np.inf
    distance_m: float = np.inf
    near_mps: float = 0.0
    stop: str = ""


PUSH = """
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include "hil_gnc.h"

/* Pushes at random, along -x most of the time, each push for 2 to 20 s. */
typedef struct { uint64_t state; double until_s; int force[3]; } push;

static double uniform(push *p)
{
    p->state = p->state * 6364136223846793005ULL + 1442695040888963407ULL;
    return (double)(p->state >> 11) / 9007199254740992.0;
}
int hil_gnc_protocol(void) { return HIL_GNC_PROTOCOL; }
void *hil_gnc_open(const hil_gnc_setup *setup, char *reason)
{
    push *p = calloc(1, sizeof *p);
    (void)setup; (void)reason;
    p->state = strtoull(getenv("HIL_PUSH_SEED"), NULL, 10) * 0x9E3779B97F4A7C15ULL + 1;
    p->until_s = -1.0;
    return p;
}
int hil_gnc_step(void *gnc, const hil_gnc_input *input, hil_gnc_output *output)
{
    push *p = gnc;
    if (input->t_s > p->until_s) {
        for (int i = 0; i < 3; i++) {
            double u = uniform(p);
            p->force[i] = i == 0 ? (u < 0.7 ? -1 : u < 0.8 ? 0 : 1) : (u < 0.4 ? -1 : u < 0.6 ? 0 : 1);
        }
        p->until_s = input->t_s + 2.0 + 18.0 * uniform(p);
    }
    for (int i = 0; i < 3; i++)
        output->force[i] = p->force[i];
    return 0;
}
void hil_gnc_close(void *gnc) { free(gnc); }
"""
"""GNC as a C library."""


class RandomJogs(Operator):
    """Operator who jogs random axes for random times, and stops the session at its end."""

    def __init__(self, draws: np.random.Generator) -> None:
        super().__init__(plan=(OperatorCommand.HOME,), attended=True)
        self._draws, self._key_until_s, self._end_s = draws, -1.0, np.nan
        self._key = ("rails.x", -1)

    def poll(self, now_s: float) -> None:
        """Hold the key of the present jog; begin the next one."""
        if np.isnan(self._end_s):
            self._end_s = now_s + _JOGGED_S
        if now_s > self._end_s:
            self.submit(OperatorCommand.STOP)
            return
        if now_s > self._key_until_s:
            axis = self._draws.choice(["rails.x", "rails.x", "rails.y", "rails.z", "turntable.yaw", "turntable.pitch"])
            direction = -1 if axis == "rails.x" and self._draws.random() < 0.8 else int(self._draws.choice([-1, 1]))
            self._key, self._key_until_s = (str(axis), direction), now_s + self._draws.uniform(2.0, 25.0)
        self.jog(*self._key)


@contextmanager
def _rows(rails: MockAxes, turntable: MockAxes) -> Iterator[list[Array]]:
    """Yield a list that receives positions and rates of the rails, and angles of the gimbals, whenever they move."""
    rows: list[Array] = []
    for axes in (rails, turntable):

        def move(now_s: float, axes: MockAxes = axes, original: Any = axes._move) -> None:
            original(now_s)
            rows.append(np.concatenate([rails.servo.position, rails.servo.rate, turntable.servo.position]))

        axes._move = move  # type: ignore[method-assign]
    yield rows


def judge(job: Job, rows: list[Array], stop: str) -> Nearest:
    """Return how near the axes came in ``rows``."""
    rig, scenario = job.rig.value, job.scenario.value
    guard, bench = bench_params.axis_guard(rig, scenario), bench_params.bench(rig, scenario.step_s)
    found, nearest, r, q = np.empty(4), Nearest(stop=stop), np.empty(3), np.empty(4)
    for row in rows:
        rail, rate, gimbal = row[:3], row[3:6], row[6:]
        pose_of_axes(bench, rail, gimbal, r, q)
        nearest.along_m = min(nearest.along_m, float(r @ guard.zone.axis))
        if rail[0] > _TO_JUDGE_M:
            continue
        turned = euler.to_quaternion(gimbal, guard.order)
        least = min(
            float(clearance(bodies, rail, attitude, STILL, 0.0, guard.lab, 0.0, 1.0, 1.0, _FAR_M, found))
            for bodies, attitude in ((guard.carriage, NO_TURN), (guard.turntable, turned))
        )
        nearest.distance_m = min(nearest.distance_m, least)
        if least <= NEAR_M:
            nearest.near_mps = max(nearest.near_mps, float(np.linalg.norm(rate)))
    return nearest


def _run(job: Job, operator: Operator | None) -> Nearest:
    with build.runner(job, operator=operator) as runner:
        rails, turntable = runner.loop.bench.rails, runner.loop.bench.turntable
        assert isinstance(rails, MockAxes)
        assert isinstance(turntable, MockAxes)
        with _rows(rails, turntable) as rows:
            outcome = runner.run()
        return judge(job, rows, outcome.stop)


class Pushes:
    """Runs under the GNC of ``PUSH`` in the compiled loop, and the stop after each. folder: for its files."""

    def __init__(self, folder: Path, *settings: str) -> None:
        (folder / "push.c").write_text(PUSH, encoding="ascii")
        command = ["cc", "-std=c11", "-O1", "-fPIC", "-shared", f"-I{HEADER_FILE.parent}", "push.c", "-o", "push.so"]
        subprocess.run(command, cwd=folder, check=True)
        strong = ("chaser.thrusters.force_n=12", "vmu.errors.needs_view=false", "initial.attitude_deg=[0,0,0]")
        chosen = (f"gnc.library={folder / 'push.so'}", *strong, *settings)
        self._job = Job(load_scenario("scheme-1", chosen), load_rig("mock", chosen), 0, _PUSHED_S, 1.0)
        self._runner = CaseRunner(self._job.scenario.value, self._job.rig.value, _PUSHED_S)
        self._rows = np.zeros(self._runner.cycles, CYCLE)

    def __call__(self, seed: int) -> Nearest:
        """Return how near the bench comes from a random start."""
        draws = np.random.default_rng(seed)
        position = (draws.uniform(0.7, 2.5), *draws.uniform(-0.6, 0.6, 2))
        scenario = self._job.scenario.value
        start = scenario.initial.model_copy(update={"position_m": position})
        os.environ["HIL_PUSH_SEED"] = str(seed)
        stats, stop = self._runner.run(scenario.model_copy(update={"initial": start}), seed, self._rows)
        flown = self._rows[: int(stats.cycles)]["feedback"]
        rows = [np.concatenate([row["rail_m"], row["rail_mps"], row["gimbal_rad"]]) for row in flown]
        return judge(self._job, rows + self._braked(), stop)

    def _braked(self) -> list[Array]:
        """Return the axes while they brake to rest from where the run has ended."""
        mock, rig, rows = self._runner._state.mock, self._job.rig.value, []
        axes = [ServoAxes(rig.rails), ServoAxes(rig.turntable)]
        for each, servo in zip(axes, (mock.rails, mock.turntable), strict=True):
            np.asarray(each.record)[...] = servo
        rails, turntable = axes
        while max(np.abs(rails.rate).max(), np.abs(turntable.rate).max()) > _REST:
            for each in axes:
                each.hold()
                each.step(_BRAKE_STEP_S)
            rows.append(np.concatenate([rails.position, rails.rate, turntable.position]))
        return rows


def jog(seed: int, *settings: str) -> Nearest:
    """Return how near the bench comes under an operator who jogs at random."""
    draws = np.random.default_rng(seed)
    x, y, z = draws.uniform(0.6, 1.5), *draws.uniform(-1.2, 1.2, 2)
    chosen = (f"initial.position_m=[{x:.3f}, {y:.3f}, {z:.3f}]", *settings)  # where the axes of a mock stand
    job = Job(load_scenario("scheme-1", chosen), load_rig("mock", chosen), seed, 10.0, 1.0, compiled=False)
    return _run(job, RandomJogs(draws))


def is_clear(nearest: Nearest, plane_m: float = 0.25) -> bool:
    """Return whether the bench stayed before the plane, clear of bodies, and slow near them."""
    return bool(nearest.along_m >= plane_m - ROUNDING_M and nearest.distance_m > 0.0 and nearest.near_mps <= FAST_MPS)


def main() -> int:
    """Run all cases and print the nearest ones."""
    counts = [int(word) for word in sys.argv[1:3]] or [1000, 200]
    failed = 0
    with TemporaryDirectory() as folder:
        for name, case, count in zip(("pushes", "jogs"), (Pushes(Path(folder)), jog), counts, strict=True):
            results = [case(seed) for seed in range(count)]
            failed += (bad := sum(not is_clear(result) for result in results))
            stopped = sum(any(words in result.stop for words in STOPS) for result in results)
            print(
                f"{count} {name}: {bad} not clear, {stopped} stopped by the guard volume; least position "
                f"{min(result.along_m for result in results):.4f} m, least distance of bodies "
                f"{min(result.distance_m for result in results):.4f} m, fastest within {NEAR_M:g} m of a body "
                f"{max(result.near_mps for result in results):.3f} m/s",
                flush=True,
            )
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
