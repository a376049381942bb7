"""Link to a robot that owns its cycle: each of its telegrams is answered with the pose that is due."""

from __future__ import annotations

from typing import ClassVar, Final, Generic

from hil.core.clock import BenchClock
from hil.drivers.arm.device import END
from hil.drivers.arm.model import FlangePose
from hil.errors import LinkTimeout
from hil_robot_arms.cycles import RobotCycles, State

_OPEN_S: Final = 5.0  # bench time until the controller follows


class CycleLink(Generic[State]):
    """PoseLink by ``cycles``, received on the UDP port of ``address``. A make says what its telegrams mean."""

    not_followed: ClassVar[str]
    """What a controller does that sends its cycles, but does not follow."""

    def __init__(
        self, cycles: RobotCycles[State], address: tuple[str, int | None], clock: BenchClock, name: str
    ) -> None:
        self._cycles, self._address, self._clock, self._name = cycles, address, clock, name
        self._ended = False
        self._pending: State | None = None

    def follows(self, state: State) -> bool:
        """Return whether the controller follows its answers; called from the second cycle on."""
        raise NotImplementedError

    def hold(self, state: State) -> None:
        """Answer so that the robot stands."""
        raise NotImplementedError

    def lead(self, state: State, target: FlangePose) -> None:
        """Answer so that the robot goes to ``target``."""
        raise NotImplementedError

    def check(self, state: State) -> None:
        """Raise DriveFault for a robot that has stopped."""
        raise NotImplementedError

    def flange(self, state: State) -> FlangePose:
        """Return where the robot is."""
        raise NotImplementedError

    def open(self) -> FlangePose:
        """Wait until the controller follows; the robot stands meanwhile. Raises DeviceError."""
        host, port = self._address
        assert port is not None
        self._ended, self._pending = False, None
        self._cycles.open(host, port)
        until_s, seen = self._clock.now_s() + _OPEN_S, 0
        while self._clock.now_s() < until_s:
            cycle = self._cycles.next(may_be_silent=True)
            if cycle is None:
                continue
            state, seen = cycle.state, seen + 1
            if seen > 1 and self.follows(state):
                self._pending = state
                return self.flange(state)
            self.hold(state)
        what = self.not_followed if seen else "no cycle"
        raise LinkTimeout(self._name, f"{what} within {_OPEN_S:g} s on udp port {port}")

    def exchange(self, target: FlangePose) -> FlangePose | None:
        """Answer the last cycle with ``target``; return the next one. Raises DeviceError, also for a stopped robot."""
        if self._pending is not None and not self._ended:
            self.lead(self._pending, target)
        self._pending = None
        cycle = self._cycles.next(may_be_silent=self._ended)
        if cycle is None:
            return None
        self._pending = cycle.state
        if not self._ended:
            self.check(cycle.state)
        return self.flange(cycle.state)

    def due_s(self) -> float:
        """Return the bench time of the last cycle, by the robot's clock."""
        return self._cycles.t_s

    def stop(self, category: int) -> None:
        """With END answer no more: the controller stops by itself after a silence."""
        self._ended = self._ended or category == END

    def close(self) -> None:
        """Close the port. Idempotent."""
        self._cycles.close()

    def counters(self) -> dict[str, int]:
        """Return the counts since ``open``."""
        return {**self._cycles.counts, "drift_ppm": round(1e6 * self._cycles.drift)}
