"""Camera's place error on ideal servos and on axes with the mechanics of a machine, at two rates of setpoints.

    python benchmarks/drive_mechanics.py [--duration 100]

The setpoints of a run of scheme 1 in memory are replayed to the emulated axes without wires, in simulated time: equal
calls give equal numbers. Columns: error of the left camera by the true axes and by the encoders, rms and largest.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np

from hil.bench.field_of_view import camera_errors
from hil.config.load import load_rig, load_scenario
from hil.core.clock import SimulatedClock, WallClock
from hil.core.messages import AXES_SAMPLE
from hil.loop.rate_keeper import SimulatedRate
from hil.params import bench as bench_params
from hil.parts.emulation.emulated_axes import EmulatedAxes
from hil.parts.emulation.shared_state import SharedAxisState
from hil.sensors.vision_unit import parameters as vmu_params
from hil.session.assembly import Job, axes_at_start
from hil.session.build import in_memory

EFFECTS = {
    "friction": ("friction_coulomb", "friction_breakaway", "friction_viscous"),
    "backlash": ("backlash",),
    "resonance": ("resonance",),
    "cogging": ("cogging",),
    "encoder": ("encoder_step",),
    "delay": ("loop_delay",),
}


class StoppedClock(WallClock):
    """A clock that stands at zero: time is handed in."""

    def now_s(self) -> float:
        return 0.0


class Setpoints:
    """Keeps each setpoint with its time."""

    def __init__(self) -> None:
        self.rows: list[np.ndarray] = []

    def put(self, row: np.ndarray) -> None:
        self.rows.append(row.copy())


def planned(rate_hz: float, duration_s: float) -> tuple[np.ndarray, np.ndarray, Job]:
    """Return rows of the run (n,) of CYCLE and its setpoints (m,) of AXES_SAMPLE."""
    settings = (f"rig.bench.axes_rate_hz={rate_hz:g}",)
    job = Job(load_scenario("scheme-1"), load_rig("mock", settings), 0, duration_s, 1.0, compiled=False)
    runner = in_memory(job, SimulatedRate(SimulatedClock(), job.tick_s))
    sink = Setpoints()
    runner.loop.axes_sink = sink
    rows = runner.run().history
    return rows, np.concatenate(sink.rows).astype(AXES_SAMPLE), job


def place_error(rows: np.ndarray, setpoints: np.ndarray, job: Job, rig_settings: tuple[str, ...]) -> np.ndarray:
    """Return the camera's error, mm: rms and largest by the true axes, rms and largest by the encoders."""
    machine = load_rig("emulated-machine", rig_settings).value
    at_start = axes_at_start(job.scenario.value, machine)
    board = SharedAxisState.create()
    devices = [
        EmulatedAxes(name, table, StoppedClock(), board)
        for name, table in zip(("rails", "turntable"), at_start, strict=True)
    ]
    places = np.empty((len(rows), 2, 2, 3))  # true and counted positions of both devices
    k = 0
    for row in setpoints:
        t_s = float(row["t_s"])
        for device in devices:
            device.advance(t_s)
        if k < len(rows) and t_s > rows["t_s"][k] - 1e-9:
            for i, device in enumerate(devices):
                places[k, 0, i], places[k, 1, i] = board.read(device.device, t_s)[0], device.position
            k += 1
        wanted = row["setpoint"]
        for device, position, rate in zip(devices, ("rail_m", "gimbal_rad"), ("rail_mps", "gimbal_radps"), strict=True):
            for axis in range(3):
                device.follow(axis, float(wanted[position][axis]), float(wanted[rate][axis]), t_s)
    board.close()
    found = []
    for shown in (0, 1):
        distance, angle = np.empty(k), np.empty(k)
        camera_errors(
            bench_params.bench(machine, job.scenario.value.step_s),
            vmu_params.mounting(machine),
            np.ascontiguousarray(places[:k, shown, 0]),
            np.ascontiguousarray(places[:k, shown, 1]),
            np.ascontiguousarray(rows["truth"]["r_CT_H"][:k]),
            np.ascontiguousarray(rows["truth"]["q_CH"][:k]),
            distance,
            angle,
        )
        settled = 1e3 * distance[50:]
        found += [float(np.sqrt(np.mean(settled**2))), float(settled.max())]
    return np.array(found)


def without(*effects: str) -> tuple[str, ...]:
    """Return the settings that switch ``effects`` off."""
    suffixes: dict[str, Any] = {
        "rails": {"friction_viscous": "n_per_mps", "backlash": "m", "encoder_step": "m"},
        "turntable": {"friction_viscous": "nm_per_degps", "backlash": "deg", "encoder_step": "deg"},
    }
    common = {"resonance": "hz", "loop_delay": "s"}
    force = {"rails": "n", "turntable": "nm"}
    return tuple(
        f"rig.{device}.mechanics.{key}_{(suffixes[device] | common).get(key, force[device])}=0.0"
        for device in ("rails", "turntable")
        for effect in effects
        for key in EFFECTS[effect]
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=100.0)
    duration_s = parser.parse_args().duration
    cases = {
        "ideal servos": tuple(f"rig.{device}.mechanics.enabled=false" for device in ("rails", "turntable")),
        "all effects": (),
        **{f"only {effect}": without(*(other for other in EFFECTS if other != effect)) for effect in EFFECTS},
    }
    print(f"{'axes':>8} {'mechanics':<16} {'true rms':>9} {'max':>7} {'encoder rms':>12} {'max':>7}  mm")
    for rate_hz in (50.0, 1000.0):
        rows, setpoints, job = planned(rate_hz, duration_s)
        for name, settings in cases.items():
            true_rms, true_max, shown_rms, shown_max = place_error(rows, setpoints, job, settings)
            print(f"{rate_hz:5.0f} Hz {name:<16} {true_rms:9.4f} {true_max:7.3f} {shown_rms:12.4f} {shown_max:7.3f}")


if __name__ == "__main__":
    main()
