"""Link to a KUKA controller: answers each of its cycles with a correction, and checks what it reports."""

from __future__ import annotations

import numpy as np

from hil.config.tables.arm import Arm
from hil.core.clock import BenchClock
from hil.core.messages import Array
from hil.drivers.arm.device import END
from hil.drivers.arm.model import FlangePose
from hil.errors import DriveFault, FaultKind, LinkTimeout
from hil_kuka_rsi import codec
from hil_kuka_rsi.codec import RobotState
from hil_kuka_rsi.entry import RsiSettings
from hil_robot_arms.cycles import Cycle, RobotCycles

_OPEN_S = 5.0  # bench time until the controller corrects


def _decode(data: bytes) -> Cycle[RobotState]:
    state = codec.decode_state(data)
    return Cycle(state.ipoc, 1e-3 * state.ipoc, state)


class RsiLink:
    """PoseLink of RSI; the port of ``[arm.kuka_rsi]``."""

    def __init__(self, arm: Arm, clock: BenchClock, name: str = "arm") -> None:
        settings: RsiSettings = arm.settings
        self._settings, self._clock, self._name = settings, clock, name
        self._cycles = RobotCycles(clock, _decode, settings.period_ms, settings.period_s, arm.timeout_s)
        self._ended = False
        self._pending: RobotState | None = None
        self._delayed = self._delayed_before = 0

    def open(self) -> FlangePose:
        """Wait until the controller corrects; its pose does not change by that. Raises DeviceError."""
        assert self._settings.port is not None
        self._ended, self._pending = False, None
        self._cycles.open(self._settings.host, self._settings.port)
        until_s, seen = self._clock.now_s() + _OPEN_S, 0
        while self._clock.now_s() < until_s:
            cycle = self._cycles.next(may_be_silent=True)
            if cycle is None:
                continue
            state, seen = cycle.state, seen + 1
            if state.status in (None, codec.RUNNING) and seen > 1:
                unit = np.zeros(6) if state.corrected is None else state.corrected
                self._start = codec.uncorrected(state.commanded, unit, self._settings.rotation)
                self._pending, self._delayed_before = state, state.delayed
                return self._flange(state)
            still = state.corrected if self._settings.mode == "absolute" else None
            self._send(state.ipoc, np.zeros(6) if still is None else still)
        what = "no cycle" if not seen else "its program does not correct (RSI_MOVECORR)"
        raise LinkTimeout(self._name, f"{what} within {_OPEN_S:g} s on udp port {self._settings.port}")

    def exchange(self, target: FlangePose) -> FlangePose | None:
        """Answer the last cycle with ``target``; return the next one. Raises DeviceError, also for a stopped robot."""
        if self._pending is not None and not self._ended:
            goal = codec.frame_of(target.position_m, target.axes)
            start = self._start if self._settings.mode == "absolute" else self._pending.commanded
            self._send(self._pending.ipoc, codec.correction_between(start, goal, self._settings.rotation))
        self._pending = None
        cycle = self._cycles.next(may_be_silent=self._ended)
        if cycle is None:
            return None
        self._pending, self._delayed = cycle.state, cycle.state.delayed
        if not self._ended:
            self._check(cycle.state)
        return self._flange(cycle.state)

    def due_s(self) -> float:
        """Return the bench time of the last cycle, by its IPOC."""
        return self._cycles.t_s

    def stop(self, category: int) -> None:
        """With END answer no more: the controller ends the correction after ``late_max`` cycles."""
        self._ended = self._ended or category == END

    def close(self) -> None:
        """Close the port. Idempotent."""
        self._cycles.close()

    def counters(self) -> dict[str, int]:
        """Return the counts of both ends: ``late`` are answers that the controller rejected as late."""
        late = max(0, self._delayed - self._delayed_before)
        return {**self._cycles.counts, "late": late, "drift_ppm": round(1e6 * self._cycles.drift)}

    def _check(self, state: RobotState) -> None:
        if state.status == codec.SAFETY_STOP:
            raise DriveFault(self._name, "safety stop of the controller", FaultKind.TORQUE_OFF)
        if state.status not in (None, codec.RUNNING):
            late = state.delayed - self._delayed_before
            raise DriveFault(self._name, f"the controller has ended the correction, {late} late answers")

    def _send(self, ipoc: int, correction: Array) -> None:
        self._cycles.answer(codec.encode_answer(ipoc, correction, self._settings.sen_type))

    def _flange(self, state: RobotState) -> FlangePose:
        joints = None if state.joints is None else np.radians(state.joints)
        return FlangePose(self._cycles.t_s, *codec.pose_of(state.actual), joints)
