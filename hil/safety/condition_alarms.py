"""Consistency monitors as alarms: each bit of the navigation's health, and the monitors of the filters."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Final

from hil.config.scenario import Scenario
from hil.core import alarm_table as table
from hil.core.alarms import LOW, MEDIUM, Alarm
from hil.core.gnc_records import GncHealth
from hil.core.observable import ObservableList
from hil.safety.alarms import AlarmLog

_INCONSISTENT: Final = "not those of their covariance"


class HealthAlarms:
    """Alarms of the navigation's health: raised with a bit, returned to normal when the bit is cleared.

    So are the checks of the filters, of the built-in GNC or of a GNC server, which are of low priority. Those to which
    the scenario's reactions are none in any phase are of low priority, the others of medium.
    disagreement: returns that of the docking monitor or another witness whose interlock is set, None without one.
    suspect: returns the device of a sensor that is excluded, "" without one.
    """

    def __init__(
        self,
        alarms: AlarmLog,
        scenario: Scenario,
        disagreement: Callable[[], Alarm | None] = lambda: None,
        suspect: Callable[[], str] = str,
    ) -> None:
        self._alarms = alarms
        self._disagreement = disagreement
        self._suspect = suspect
        self._witness, self._excluded = "monitor", "sensors"  # the last one that disagreed, and that was excluded
        self._health = 0
        self._checks: list[Alarm] = []
        lost_s, rejected = scenario.gnc.integrity.lost_after_s, scenario.gnc.integrity.suspect_after
        estimate_limit = "within rig.guard.estimate_error_max_m and its protection level"
        unexplained = "repeated, or explained by no thruster"
        self._of_bits = {
            GncHealth.VISION_LOST: table.ACCEPTED_POSES.alarm(0.0, "vmu", lost_s, lost_s),
            GncHealth.VISION_SUSPECT: table.INNOVATIONS.alarm(0.0, "vmu", f"rejected, or {_INCONSISTENT}", rejected),
            GncHealth.CAUSE_UNKNOWN: table.INNOVATIONS.alarm(0.0, "navigation", _INCONSISTENT, "consistent"),
            GncHealth.IMU_SUSPECT: table.READINGS.alarm(0.0, "imu", unexplained, "explained"),
            GncHealth.THRUSTER_FAULT: table.THRUST.alarm(0.0, "thrusters", "stuck open or dead", "as commanded"),
            GncHealth.COVARIANCE_INVALID: table.COVARIANCE.alarm(
                0.0, "navigation", "not positive definite", "positive definite"
            ),
            GncHealth.BENCH_DISAGREES: table.ESTIMATE.alarm(0.0, "navigation", "beyond its own bounds", estimate_limit),
        }
        reactions = scenario.gnc.reactions.conditions()
        self._priorities = {
            bit: LOW if set(row.model_dump().values()) == {"continue"} else MEDIUM
            for bit, row in zip((bit for bit in GncHealth if bit), reactions, strict=False)
        }

    def watch(self, conditions: ObservableList[Alarm]) -> None:
        """Raise the alarms of ``conditions`` with the next ``update``."""
        conditions.subscribe(self._checks.append)

    def update(self, bench_s: float, health: int) -> None:
        """Take the health of a cycle at ``bench_s`` of bench time."""
        if self._checks:
            for alarm in self._checks:
                self._take(alarm, bench_s)
            self._checks.clear()
        changed = health ^ self._health
        if not changed:
            return
        self._health = health
        for bit in GncHealth:
            if not bit or not changed & bit:
                continue
            self._take(replace(self._of(bit), priority=self._priorities[bit], active=bool(health & bit)), bench_s)

    def _take(self, alarm: Alarm, bench_s: float) -> None:
        """Raise ``alarm``, or return it to normal if it is not active."""
        if alarm.active:
            self._alarms.raise_condition(replace(alarm, t_s=bench_s))
        else:
            self._alarms.return_to_normal(alarm.device, alarm.quantity)

    def _of(self, bit: GncHealth) -> Alarm:
        """Return the alarm of ``bit``, at no time."""
        if bit is GncHealth.MONITOR_DISAGREES:
            texts = ("beyond both sigmas", "within both sigmas")
            alarm = self._disagreement() or table.NAVIGATION_POSE.alarm(0.0, self._witness, *texts)
            self._witness = alarm.device
            return alarm
        if bit is not GncHealth.SENSOR_SUSPECT:
            return self._of_bits[bit]
        self._excluded = self._suspect() or self._excluded
        return table.INNOVATIONS.alarm(0.0, self._excluded, _INCONSISTENT, "consistent")
