"""Compiled cycles of a session on the mock rig: blocks of ``run_cycles`` on the memory of the core.

The stages in Python work on the same memory, so that compiled cycles and cycles in Python can follow each other in any
order. Rows, frames and events of a block are handed over cycle by cycle, as if each had just happened. A cycle that the
compiled shell does not complete is run in Python, which raises its error.
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple, NoReturn

import numpy as np

from hil.core.messages import ARRIVAL, AXES_SAMPLE, IMU_SAMPLE, AxisFeedback, new
from hil.core.sensor_records import SAMPLES_PER_CYCLE, SENSOR_ARRIVAL
from hil.drivers.io.mock import MockIo
from hil.frmn.ring import NoTelemetry
from hil.gnc_backends.open_backends import CompiledGnc
from hil.loop.compiled import run_cycles
from hil.loop.compiled.run_stats import RUN_STATS
from hil.loop.cycle import Cycles, Loop
from hil.loop.rate_keeper import SimulatedRate, Tick
from hil.maths.random_streams import RandomRows
from hil.sensors.vision_unit import columns as vmu_columns

_BLOCK_S: Final = 20.0  # of the run's time: a few milliseconds, after which Ctrl-C and progress have their turn
_NO_ARRIVALS: Final = np.zeros(0, ARRIVAL).view(np.recarray)
_NO_AXES_SAMPLES: Final = np.zeros(0, AXES_SAMPLE)
_NO_SENSOR_ARRIVALS: Final = np.zeros(0, SENSOR_ARRIVAL).view(np.recarray)
_NO_IMU_SAMPLES: Final = np.zeros(0, IMU_SAMPLE)


class MockSources(NamedTuple):
    """What the compiled shell needs of the mocks beyond the core's memory.

    vision_noise, travel_draws: random numbers of the vision unit, one row per exposure. leds: (n, 3), m, in t.
    """

    io: MockIo | None
    vision_noise: RandomRows
    travel_draws: RandomRows
    leds: np.ndarray


class CompiledCycles:
    """Runs blocks of cycles of ``loop`` on mocks, in simulated time.

    python: runs the cycles that the compiled shell cannot run or complete. cycles: of the run.
    """

    def __init__(
        self, loop: Loop, rate: SimulatedRate, mocks: MockSources, gnc: CompiledGnc, python: Cycles, cycles: int
    ) -> None:
        self._loop = loop
        self._rate = rate
        self._mocks = mocks
        self._gnc = gnc
        self._python = python
        self._cycles = cycles
        self._params, self._state = loop.memory.params, loop.memory.state
        self._state.opened = self._params.reports = 1
        self._ticks, self._n_samples = int(self._params.ticks), len(loop.now.samples)
        self._axes_log, self._samples_log, self._sensor_log = _NO_AXES_SAMPLES, _NO_IMU_SAMPLES, _NO_SENSOR_ARRIVALS
        self._stats = new(RUN_STATS)
        self._arrivals = _NO_ARRIVALS
        self._last_arrivals: dict[int, int] = {}
        self._sent_arrivals = self._sent_axes = self._sent_samples = self._sent_sensors = self._begun = 0
        self._tick: Tick
        self._block = max(1, round(_BLOCK_S / float(self._params.step_s)))

    def advance(self, held_s: float) -> Tick:
        """Run a block of cycles, up to an event at most."""
        if held_s:  # cycles are no longer at multiples of the period
            return self._python.advance(held_s)
        loop, rate, state = self._loop, self._rate, self._state
        first = loop.done
        loop.make_room(first)
        end = min(first + self._block, loop.first + len(loop.history), self._cycles)
        self._begun = begun = self._tick_number()
        rate.seek(first * self._ticks)
        tick = rate.wait()
        if self._is_behind(tick.now_s):
            rate.seek(begun)
            return self._python.advance(held_s)
        self._load(first, end, tick)
        code = self._run(first, end)
        self._store(begun)
        last = int(state.cycle)
        self._hand_over(first, last, code)
        match code:
            case run_cycles.COMPLETED | run_cycles.EVENT:
                return self._tick
            case run_cycles.GNC_HOLDS:
                self._gnc.hold_as_asked()
                return self._tick
            case run_cycles.GNC_FAILED:
                self._fail_in_gnc(last)
            case run_cycles.NOT_FINITE:
                self._fail_in_setpoint(last)
        rate.seek(self._tick_number())
        return self._python.advance(held_s)

    def _tick_number(self) -> int:
        """Return the number of the next tick of the run."""
        done, tick = self._loop.done, self._loop.bench.tick
        return (done - 1) * self._ticks + tick if tick else done * self._ticks

    def _is_behind(self, now_s: float) -> bool:
        """Return whether more frames are due in the first cycle than in a period, as after a wait."""
        rate_hz, step_s = float(self._params.mock.vmu_rate_hz), float(self._params.step_s)
        return now_s * rate_hz - float(self._state.mock.transit.next_exposure) > rate_hz * step_s

    def _load(self, first: int, end: int, tick: Tick) -> None:
        """Prepare the state for the cycles ``first`` to ``end`` - 1."""
        loop, state = self._loop, self._state
        state.cycle, state.end, state.zero_s = first, end, tick.run_zero_s
        loop.run_zero.set(tick.run_zero_s)
        loop.safety_io.check(tick.now_s)
        state.mock.lines, state.mock.lines_changed_s = loop.now.command.on, loop.safety_io.thrusters_s
        state.vmu.logged = state.axes_logged = state.samples_logged = state.sensors_logged = 0

    def _run(self, first: int, end: int) -> int:
        """Run the cycles ``first`` to ``end`` - 1; return the code of ``run_cycles``."""
        loop, mocks, state, params = self._loop, self._mocks, self._state, self._params
        end_s = state.zero_s + end * params.step_s
        transit = state.mock.transit
        next_exposure = int(transit.next_exposure)
        exposures = max(0, math.ceil(end_s * params.mock.vmu_rate_hz) - next_exposure + 1)
        self._arrivals = _NO_ARRIVALS
        if loop.vision.frame_sink is not None:
            most = 2 * exposures + int(transit.in_transit) + int(state.vmu.delayed)
            self._arrivals = np.zeros(most, ARRIVAL).view(np.recarray)
        if loop.axes_sink is not None:
            self._axes_log = np.zeros((end - first) * self._ticks, AXES_SAMPLE)
        if loop.sensors is not None:
            self._sensor_log = np.zeros((end - first) * SAMPLES_PER_CYCLE, SENSOR_ARRIVAL).view(np.recarray)
        if loop.dss.sample_sink is not None:
            self._samples_log = np.zeros((end - first) * self._n_samples, IMU_SAMPLE)
        code: int = run_cycles.run_cycles(
            params,
            loop.dss.field,
            mocks.leds,
            loop.dss.noise.peek((end - first) * self._n_samples),
            mocks.vision_noise.peek(exposures),
            mocks.travel_draws.peek(exposures),
            state,
            loop.now.samples,
            self._gnc.memory,
            loop.memory.poses,
            loop.memory.frames,
            loop.memory.delayed,
            self._stats,
            loop.history[first - loop.first : end - loop.first],
            self._arrivals,
            self._axes_log,
            self._samples_log,
            self._sensor_log,
        )
        used_in = self._arrivals["cycle"][: state.vmu.logged]
        self._last_arrivals = {int(cycle): i + 1 for i, cycle in enumerate(used_in) if cycle >= 0}
        self._sent_arrivals = self._sent_axes = self._sent_samples = self._sent_sensors = 0
        loop.dss.noise.skip((int(state.cycle) - first + (code == run_cycles.NOT_FINITE)) * self._n_samples)
        for rows in (mocks.vision_noise, mocks.travel_draws):
            rows.skip(int(transit.next_exposure) - next_exposure)
        return code

    def _store(self, begun: int) -> None:
        """Pass lines, feedback and time of a block from tick ``begun`` on to the devices' stages."""
        loop, mocks, state = self._loop, self._mocks, self._state
        if mocks.io is not None:
            mocks.io.set_outputs(loop.safety_io.set_mirrored(), float(state.mock.lines_changed_s))
        bench, feedback, cycle = loop.bench, loop.now.feedback, int(state.cycle)
        last = ((cycle - 1) * self._ticks + bench.tick if bench.tick else cycle * self._ticks) - 1
        if last >= begun:
            bench.commanded_s = float(state.zero_s + last * self._params.tick_s)
            bench.feedback = (
                AxisFeedback(bench.commanded_s, feedback.rail_m.copy(), feedback.rail_mps.copy()),
                AxisFeedback(bench.commanded_s, feedback.gimbal_rad.copy(), feedback.gimbal_radps.copy()),
            )

    def _hand_over(self, first: int, end: int, code: int) -> None:
        """Send rows, frames and events of the cycles ``first`` to ``end`` - 1 to their sinks.

        code: of ``run_cycles``. The state is that of the last of these cycles unless a later one has failed.
        """
        loop = self._loop
        is_last = code in (run_cycles.COMPLETED, run_cycles.EVENT, run_cycles.GNC_HOLDS)
        rows = loop.history[first - loop.first : end - loop.first]
        has_poses = vmu_columns.has_pose(rows)
        due = has_poses.copy()
        is_sampled = loop.axes_sink is not None or loop.dss.sample_sink is not None or loop.sensors is not None
        if is_sampled or loop.vision.frame_sink is not None or not isinstance(loop.telemetry, NoTelemetry):
            due[:] = True
        due[-1:] = True
        health = rows["navigation"]["health"]
        due[1:] |= health[1:] != health[:-1]
        due[:1] = True
        nis_position, nis_attitude = rows["navigation"]["nis_position"], rows["navigation"]["nis_attitude"]
        for i in np.flatnonzero(due):
            k = first + int(i)
            self._begin(k)
            if has_poses[i]:
                self._gnc.add_innovations(k, float(nis_position[i]), float(nis_attitude[i]))
            if is_last and k == end - 1:
                self._gnc.log_step(float(rows["t_s"][i]), self._progress_before(), loop.now.supervision)
            self._send_sensors(k)
            loop.now.t_s[0] = rows["t_s"][i]
            loop.health_alarms.update(self._tick.now_s, int(health[i]))
            loop.telemetry.put(rows[i : i + 1])
            self._send_samples()
            self._send_axes(k * self._ticks + 1)
            loop.done = k + 1
        self._send_axes(end * self._ticks)

    def _send_axes(self, end: int) -> None:
        """Send the setpoints of the ticks before number ``end`` of the run that were not sent yet."""
        sink, log = self._loop.axes_sink, self._axes_log
        if sink is None:
            return
        for i in range(self._sent_axes, min(end - self._begun, int(self._state.axes_logged))):
            sink.put(log[i : i + 1])
            self._sent_axes = i + 1

    def _send_samples(self) -> None:
        """Send the IMU's samples of the next cycle of the block."""
        sink, log = self._loop.dss.sample_sink, self._samples_log
        if sink is None:
            return
        for _ in range(self._n_samples):
            sink.put(log[self._sent_samples : self._sent_samples + 1])
            self._sent_samples += 1

    def _send_sensors(self, cycle: int) -> None:
        """Send the samples of further sensors that arrived up to ``cycle``."""
        if self._loop.sensors is None:
            return
        log = self._sensor_log
        while self._sent_sensors < int(self._state.sensors_logged) and log[self._sent_sensors].cycle <= cycle:
            self._loop.sensors.put(log[self._sent_sensors : self._sent_sensors + 1])
            self._sent_sensors += 1

    def _begin(self, cycle: int) -> None:
        """Set the clock to ``cycle`` and send its frames."""
        self._send_axes(cycle * self._ticks)
        self._rate.seek(cycle * self._ticks)
        self._tick = self._rate.wait()
        self._loop.gnc.cycle = cycle
        sink = self._loop.vision.frame_sink
        if sink is None:
            return
        for i in range(self._sent_arrivals, self._last_arrivals.get(cycle, 0)):
            sink.put(self._arrivals[i : i + 1])
            self._sent_arrivals = i + 1

    def _progress_before(self) -> bytes:
        """Return APPROACH_PROGRESS at the start of the last cycle."""
        before: bytes = self._state.progress_before.tobytes()
        return before

    def _fail_in_gnc(self, cycle: int) -> NoReturn:
        """Hand over ``cycle``, in which the GNC has failed, up to there; raise the failure."""
        self._begin(cycle)
        t_s = cycle * float(self._params.step_s)
        self._gnc.fail(t_s, self._progress_before(), self._loop.now.supervision)

    def _fail_in_setpoint(self, cycle: int) -> NoReturn:
        """Hand over ``cycle``, whose setpoint is not finite, up to there; send it, which raises the error."""
        loop = self._loop
        self._hand_over(cycle, cycle + 1, run_cycles.COMPLETED)
        loop.done = cycle
        loop.bench.send(self._state.next, self._tick.now_s)
        raise AssertionError("a setpoint that is not finite is rejected")
