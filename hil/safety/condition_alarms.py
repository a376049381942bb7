"""Consistency monitors as alarms: each bit of the navigation's health, and the monitors of the filters."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

from hil.config.scenario import Scenario
from hil.core.gnc_records import GncHealth
from hil.core.observable import ObservableList
from hil.gnc.estimation.filter_monitor import FilterCondition
from hil.safety.alarms import LOW, MEDIUM, Alarm, AlarmLog


class Disagreement(NamedTuple):
    """Disagreement of a witness with the navigation. component: what is off, by ``value``, SI in ``unit``."""

    device: str
    component: str
    unit: str
    value: float
    limit: float


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
        disagreement: Callable[[], Disagreement | None] = lambda: None,
        suspect: Callable[[], str] = str,
    ) -> None:
        self._alarms = alarms
        self._disagreement = disagreement
        self._suspect = suspect
        self._witness, self._excluded = "monitor", "sensors"  # the last one that disagreed, and that was excluded
        self._health = 0
        self._checks: list[FilterCondition] = []
        lost_s, rejected = scenario.gnc.integrity.lost_after_s, scenario.gnc.integrity.suspect_after
        self._texts = {
            GncHealth.VISION_LOST: ("vmu", "accepted poses", f"none for {lost_s:g} s", f"one within {lost_s:g} s"),
            GncHealth.VISION_SUSPECT: (
                "vmu",
                "innovations",
                "rejected, or not those of their covariance",
                f"fewer than {rejected} rejected in a row, consistent",
            ),
            GncHealth.IMU_SUSPECT: ("imu", "readings", "repeated, or explained by no thruster", "explained"),
            GncHealth.THRUSTER_FAULT: ("thrusters", "thrust", "stuck open or dead", "as commanded"),
            GncHealth.COVARIANCE_INVALID: ("navigation", "covariance", "not positive definite", "positive definite"),
            GncHealth.BENCH_DISAGREES: (
                "navigation",
                "estimate against the encoders",
                "beyond its own bounds",
                "within rig.guard.estimate_error_max_m and its protection level",
            ),
            GncHealth.SENSOR_SUSPECT: ("sensors", "innovations", "not those of their covariance", "consistent"),
        }
        reactions = scenario.gnc.reactions.conditions()
        self._priorities = {
            bit: LOW if set(row.model_dump().values()) == {"continue"} else MEDIUM
            for bit, row in zip((bit for bit in GncHealth if bit), reactions, strict=False)
        }

    def watch(self, conditions: ObservableList[FilterCondition]) -> None:
        """Raise the alarms of ``conditions`` with the next ``update``."""
        conditions.subscribe(self._checks.append)

    def update(self, bench_s: float, health: int) -> None:
        """Take the health of a cycle at ``bench_s`` of bench time."""
        if self._checks:
            self._take_checks(bench_s)
        changed = health ^ self._health
        if not changed:
            return
        self._health = health
        for bit in GncHealth:
            if not bit or not changed & bit:
                continue
            device, quantity, value, limit = self._of(bit)
            if health & bit:
                priority = self._priorities[bit]
                self._alarms.raise_condition(Alarm(bench_s, device, quantity, value, limit, priority=priority))
            else:
                self._alarms.return_to_normal(device, quantity)

    def _take_checks(self, bench_s: float) -> None:
        for check in self._checks:
            if check.active:
                alarm = Alarm(bench_s, "navigation", check.quantity, check.value, check.limit, priority=LOW)
                self._alarms.raise_condition(alarm)
            else:
                self._alarms.return_to_normal("navigation", check.quantity)
        self._checks.clear()

    def _of(self, bit: GncHealth) -> tuple[str, str, str, str]:
        """Return device, quantity, value and limit."""
        if bit is GncHealth.SENSOR_SUSPECT:
            self._excluded = self._suspect() or self._excluded
            return self._excluded, *self._texts[bit][1:]
        if bit is not GncHealth.MONITOR_DISAGREES:
            return self._texts[bit]
        value, limit = "beyond both sigmas", "within both sigmas"
        if (found := self._disagreement()) is not None:
            self._witness = found.device
            unit, scale = ("deg", math.degrees(1.0)) if found.unit == "rad" else (found.unit, 1.0)
            value = f"off by {scale * found.value:.4f} {unit} {found.component}"
            limit = f"{scale * found.limit:.4f} {unit}"
        return self._witness, "pose of the navigation", value, limit
