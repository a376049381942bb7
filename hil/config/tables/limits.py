"""Protective limits: for each key its recommended range, and the ranges that hardware and simulated rigs accept.

From this table come the checks of files and options, the waivers of weak limits, and the page of the reference.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Literal

from pydantic import BaseModel

Weakest = tuple[float, float, float]
"""Recommended, on hardware, and on simulated rigs."""
Kind = Literal["mock", "emulated", "hardware"]


@dataclass(frozen=True, slots=True)
class Limit:
    """Key of a rig or scenario that protects the bench or the verdict.

    key: a ``*`` in it stands for each axis, or each entry, of a table. A pair of numbers is judged by the larger size.
    protects: what it detects or prevents. recommended, hardware, simulated: its weakest recommended value, and the
    weakest ones accepted on hardware, and on mock and emulated rigs. weak_below: whether smaller values are weaker.
    """

    key: str
    protects: str
    recommended: float
    hardware: float
    simulated: float
    weak_below: bool = False

    def accepted(self, kind: Kind) -> float:
        """Return the weakest value accepted on a rig of ``kind``."""
        return self.hardware if kind == "hardware" else self.simulated

    def is_weaker(self, value: float, than: float) -> bool:
        """Return whether ``value`` protects less than the value ``than``."""
        return value < than if self.weak_below else value > than

    def range_text(self, weakest: float) -> str:
        """Return the range that ends at ``weakest``."""
        return f"{weakest:g} or {'more' if self.weak_below else 'less'}"


def _rails(device: str, names: str) -> tuple[Limit, ...]:
    error = (0.1, 0.5, 1e3)
    return _axes(device, names, "m", error, error, (50.0, 200.0, 1e6), (1.0, 2.5, 1e4))


def _gimbals(device: str, names: str) -> tuple[Limit, ...]:
    travel, rate = (400.0, 3600.0, 1e6), (100.0, 400.0, 1e5)
    return (
        *_axes(device, names, "deg", (5.0, 20.0, 1e3), (10.0, 45.0, 1e4), travel, rate),
        Limit(f"{device}.cia402.heartbeat_s", f"silent drives of {names}", 0.2, 1.0, 60.0),
    )


def _axes(
    device: str, names: str, unit: str, error: Weakest, speed: Weakest, travel: Weakest, rate: Weakest
) -> tuple[Limit, ...]:
    return (
        Limit(f"{device}.timeout_s", f"silence of {names}", 1.0, 2.0, 3600.0),
        Limit(f"{device}.following_error_max_{unit}", f"{names} that do not follow their setpoints", *error),
        Limit(f"{device}.following_error_per_speed_s", f"{names} that do not follow their setpoints", 0.2, 0.5, 1e3),
        Limit(f"{device}.speed_mismatch_max_{unit}ps", f"{names} with a wrong reported speed", *speed),
        Limit(f"{device}.*.travel_{unit}", f"{names} that run into their ends", *travel),
        Limit(f"{device}.*.rate_max_{unit}ps", f"{names} that are too fast to be stopped", *rate),
        Limit(f"{device}.*.acceleration_max_{unit}ps2", f"{names} that overload their drives", *_times(2.0, rate)),
        Limit(f"{device}.*.homing_rate_{unit}ps", f"{names} that run over their home switch", *_times(0.2, rate)),
        *_link(device, f"loose connectors of {names}", 0.2),
    )


def _times(factor: float, weakest: Weakest) -> Weakest:
    return factor * weakest[0], factor * weakest[1], factor * weakest[2]


def _link(device: str, protects: str, window_s: float) -> tuple[Limit, ...]:
    return (
        Limit(f"{device}.lost_packets_max", protects, 20.0, 100.0, 1e6),
        Limit(f"{device}.lost_packets_window_s", protects, window_s, 0.1 * window_s, 1e-3, True),
    )


RIG_LIMITS: Final = (
    Limit("host.overruns_max", "a bench that moves on late setpoints", 10, 100, 1e6),
    Limit("host.overruns_window_s", "a bench that moves on late setpoints", 0.5, 0.1, 1e-3, True),
    *_rails("rails", "rails"),
    *_gimbals("turntable", "gimbals"),
    *_rails("target_manipulator", "rails of the target"),
    *_gimbals("rotary_manipulator", "gimbals of the target"),
    Limit("turntable.controllers.*.cia402.heartbeat_s", "silent drives of gimbals", 0.2, 1.0, 60.0),
    *_rails("linear_axes.*", "further axes"),
    *_gimbals("rotary_axes.*", "further axes"),
    Limit("linear_axes.*.held_within_m", "a further body that leaves its place", 0.02, 0.1, 1e3),
    Limit("rotary_axes.*.held_within_deg", "a further body that leaves its place", 1.0, 5.0, 360.0),
    Limit("target_manipulator.held_within_m", "a target that leaves its place", 0.02, 0.1, 1e3),
    Limit("vmu.timeout_s", "a run without poses", 2.0, 10.0, 3600.0),
    *_link("vmu", "a vision unit that loses frames", 0.1),
    Limit("vmu.bench_sigma_m", "poses that differ from the encoders", 0.01, 0.05, 10.0),
    Limit("vmu.bench_sigma_deg", "poses that differ from the encoders", 0.5, 2.0, 90.0),
    Limit("floating.pose_lost_s", "thrusters that fire at a vehicle whose pose is not known", 1.0, 5.0, 3600.0),
    Limit("floating.start_error_max_m", "a run from another start than the plan's", 0.5, 2.0, 1e3),
    Limit("floating.start_error_max_deg", "a run from another start than the plan's", 20.0, 90.0, 180.0),
    Limit("imu.timeout_s", "gyros of the table that are silent", 0.2, 0.5, 3600.0),
    Limit("arm.timeout_s", "silence of the controller of a robot", 0.2, 0.5, 1.0),
    Limit("target_arm.timeout_s", "silence of the controller of the target's robot", 0.2, 0.5, 1.0),
    Limit("io.timeout_s", "silence of the coupler of the safety chain", 1.0, 2.0, 3600.0),
    Limit("io.pump_timeout_s", "torque of a controller that is dead or hangs", 0.2, 1.0, 60.0),
    Limit("io.torque_delay_s", "torque after the safety chain has opened", 0.5, 1.0, 3600.0),
    Limit("io.warning_s", "persons who do not expect the first motion", 1.0, 0.0, 0.0, True),
    Limit("safety.command_age_max_s", "axes that move without new setpoints", 0.5, 1.0, 3600.0),
    Limit("safety.homing_timeout_s", "an axis that misses its home switch", 600.0, 3600.0, 1e6),
    Limit("safety.jog_rate_fraction", "an operator who is too slow to stop a jog", 0.25, 0.5, 1.0),
    Limit("safety.parking_rate_fraction", "an operator who is too slow to stop the parking", 0.3, 0.5, 1.0),
    Limit("clock.ptp_max_offset_us", "poses of a wrong time", 1e3, 1e4, 1e9),
    Limit("gnc_link.coast_cycles", "thrusters that stay open without a GNC", 10, 50, 50),
    Limit("gnc_link.timeout_cycles", "a run without its GNC", 10, 100, 1e4),
    Limit("gnc_link.reconnect_timeout_s", "a hold without end", 600.0, 3600.0, 1e6),
    Limit("flight_computer.timeout_s", "thrusters that stay open on an old command", 0.5, 2.0, 3600.0),
    Limit("flight_computer.lost_s", "a run without its flight computer", 2.0, 10.0, 3600.0),
    Limit("monitor_camera.timeout_s", "a docking monitor without images", 2.0, 10.0, 3600.0),
    Limit("console.lease_s", "a bench that moves without its operator", 5.0, 5.0, 60.0),
    Limit("bench.bodies_distance_m", "collisions of carriage, arm and target", 0.02, 0.005, 1e-6, True),
    Limit("guard.reaction_s", "a chaser that enters the keep-out", 0.05, 0.02, 0.0, True),
    Limit("guard.pose_error_max_m", "a bench that does not show the truth", 0.02, 0.1, 1e3),
    Limit("guard.pose_error_max_deg", "a bench that does not show the truth", 1.0, 5.0, 1e3),
    Limit("guard.pose_error_per_speed_s", "a bench that does not show the truth", 0.5, 2.0, 1e3),
    Limit("guard.pose_error_cycles", "a bench that does not show the truth", 25, 250, 1e4),
    Limit("guard.limited_max_s", "a bench that cannot follow the truth", 2.0, 10.0, 3600.0),
    Limit("guard.axis_error_max_m", "a rail that sticks", 0.005, 0.05, 1e3),
    Limit("guard.axis_error_max_deg", "a gimbal that sticks", 0.2, 2.0, 1e3),
    Limit("guard.axis_error_per_speed_s", "an axis that sticks", 0.2, 1.0, 1e3),
    Limit("guard.axis_error_cycles", "an axis that sticks", 15, 150, 1e4),
    Limit("guard.vision_sigmas", "a vision unit that contradicts the encoders", 8.0, 20.0, 1e3),
    Limit("guard.vision_error_max_m", "a vision unit that contradicts the encoders", 0.01, 0.05, 1e3),
    Limit("guard.vision_error_max_deg", "a vision unit that contradicts the encoders", 0.5, 2.0, 1e3),
    Limit("guard.vision_frames_max", "a vision unit that contradicts the encoders", 20, 100, 1e4),
    Limit("guard.estimate_error_max_m", "an estimate that contradicts the encoders", 0.05, 0.2, 1e3),
    Limit("guard.estimate_error_max_deg", "an estimate that contradicts the encoders", 1.0, 5.0, 1e3),
    Limit("guard.calibration_m", "an estimate that contradicts the encoders", 0.005, 0.05, 1e3),
    Limit("guard.calibration_deg", "an estimate that contradicts the encoders", 0.1, 1.0, 1e3),
    Limit("guard.startup_s", "axes that do not catch up after the start", 5.0, 30.0, 3600.0),
)
"""Limits of a rig; a table that the rig does not have is skipped."""

_VISION_RANGE: Final = "gnc.integrity.vision_range_m"
SCENARIO_LIMITS: Final = (
    Limit("gnc.fmu_timeout_s", "an FMU that hangs", 1.0, 10.0, 60.0),
    Limit("gnc.shadow.position_limit_m", "filters that differ from independent ones", 0.1, 1.0, 1e3),
    Limit("gnc.shadow.attitude_limit_deg", "filters that differ from independent ones", 1.0, 10.0, 180.0),
    Limit("gnc.navigation.gate_sigma", "outliers in the estimate", 8.0, 20.0, 1e3),
    Limit("gnc.corridor.half_angle_deg", "a chaser far off its approach line", 15.0, 45.0, 90.0),
    Limit("gnc.corridor.minimum_radius_m", "a chaser far off its approach line", 0.5, 2.0, 1e3),
    Limit("gnc.corridor.closing_rate_mps", "a chaser that closes too fast", 0.1, 0.3, 1e3),
    Limit("gnc.corridor.closing_rate_slope_per_s", "a chaser that closes too fast", 1.0, 10.0, 1e3),
    Limit("gnc.corridor.closing_rate_max_mps", "a chaser that closes too fast", 0.3, 0.5, 1e3),
    Limit("gnc.corridor.confidence", "a violated corridor or closing rate", 5.0, 10.0, 1e3),
    Limit("gnc.corridor.persistence_s", "a violated corridor or closing rate", 1.0, 5.0, 3600.0),
    Limit("gnc.integrity.risk_probability", "protection levels below the error", 1e-5, 1e-3, 0.5),
    Limit("gnc.integrity.go_risk_probability", "a go outside the requirement", 1e-3, 1e-2, 0.5),
    Limit("gnc.integrity.cusum_limit_sigmas", "poses that drift", 72.0, 200.0, 1e6),
    Limit("gnc.integrity.go_alarm_interval_s", "a go with poses that drift", 3.6e5, 3.6e6, 1e8),
    Limit("gnc.integrity.mean_shift_sigmas", "poses that drift", 1.0, 5.0, 1e3),
    Limit("gnc.integrity.pose_sigma_max_m", "poses of no use", 2.0, 10.0, 1e3),
    Limit("gnc.integrity.pose_sigma_max_deg", "poses of no use", 45.0, 90.0, 180.0),
    Limit("gnc.integrity.pose_range_max_m", "poses of no use", 1e3, 1e4, 1e6),
    Limit(_VISION_RANGE, "an approach without poses", 5.0, 1.0, 1e-3, True),
    Limit("gnc.integrity.suspect_after", "poses that are rejected", 20, 100, 1e6),
    Limit("gnc.integrity.close_after", "poses that are rejected", 40, 200, 1e6),
    Limit("gnc.integrity.reopen_after", "wrong poses after a closed gate", 4, 2, 2, True),
    Limit("gnc.integrity.nis_window", "poses with sigmas that are too small", 128, 1000, 1e6),
    Limit("gnc.integrity.go_fraction", "a go at the edge of the requirement", 0.9, 1.0, 1.0),
    Limit("gnc.reactions.coast_fraction", "an approach without poses", 0.9, 1.0, 1.0),
    Limit("gnc.integrity.lost_after_s", "an approach without poses", 5.0, 30.0, 3600.0),
    Limit("gnc.integrity.thruster_open_s", "a thruster that is stuck open", 1.0, 5.0, 3600.0),
    Limit("gnc.integrity.acquisition_s", "levels that are not judged", 120.0, 600.0, 1e5),
    Limit("gnc.reactions.hold_max_s", "a hold without end on a suspect estimate", 300.0, 3600.0, 1e6),
    Limit("reachability.corridor_fraction", "a plan that the bench cannot follow", 0.1, 0.0, 0.0, True),
    Limit("reachability.attitude_margin_deg", "a plan that the bench cannot follow", 0.5, 0.0, 0.0, True),
    Limit("reachability.startup_lag_s", "axes that do not catch up with the start", 1.0, 5.0, 3600.0),
    Limit("monitor.interlock_sigmas", "a docking monitor that contradicts the estimate", 8.0, 20.0, 1e3),
    Limit("monitor.interlock_error_max_m", "a docking monitor that contradicts the estimate", 0.02, 0.1, 1e3),
    Limit("monitor.interlock_error_max_deg", "a docking monitor that contradicts the estimate", 0.5, 2.0, 180.0),
    Limit("monitor.interlock_frames", "a docking monitor that contradicts the estimate", 10, 50, 100),
    Limit("sensors.*.interlock_sigmas", "a witness that contradicts the estimate", 8.0, 20.0, 1e3),
    Limit("sensors.*.interlock_samples", "a witness that contradicts the estimate", 10, 50, 100),
    Limit("keep_out.radius_m", "contact of chaser and target", 0.05, 0.0, 0.0, True),
    Limit("keep_out.distance_m", "contact of the bodies of chaser and target", 0.02, 0.005, 1e-6, True),
    Limit("integrity.alert_axial_m", "an unnoticed error along the docking axis", 0.3, 1.0, 1e3),
    Limit("integrity.alert_axial_per_range_scale", "an unnoticed error along the docking axis", 0.2, 1.0, 1e3),
    Limit("integrity.alert_corridor_fraction", "an unnoticed error across the docking axis", 1.0, 2.0, 1e3),
    Limit("integrity.alert_attitude_deg", "an unnoticed error of attitude", 5.0, 20.0, 1e3),
    Limit("integrity.time_to_alert_s", "an error that is noticed late", 5.0, 30.0, 3600.0),
)
"""Limits of a scenario."""


def scenario_limits(has_vmu: bool) -> tuple[Limit, ...]:
    """Return SCENARIO_LIMITS; without a vision unit without that of its range: no poses are expected, at any range."""
    return tuple(each for each in SCENARIO_LIMITS if has_vmu or each.key != _VISION_RANGE)


def values(limits: tuple[Limit, ...], table: BaseModel) -> Iterator[tuple[str, Limit, float]]:
    """Yield the whole key of each of ``limits`` that ``table`` has, the limit, and its value."""
    for limit in limits:
        for key, value in _found(limit.key.split("."), table):
            yield key, limit, max(map(abs, value)) if isinstance(value, tuple) else float(value)


def _found(names: list[str], table: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the keys under ``table`` that match ``names``, and their values; what is not set is left out."""
    if table is None:
        return
    if not names:
        yield prefix.removeprefix("."), table
        return
    if isinstance(table, tuple):
        table = {str(number): each for number, each in enumerate(table)}
    elif isinstance(table, BaseModel):
        table = table.__dict__ | (table.__pydantic_extra__ or {})
    members = table if isinstance(table, dict) else {}
    for name in members if names[0] == "*" else names[:1]:
        yield from _found(names[1:], members.get(name), f"{prefix}.{name}")


def excess(limits: tuple[Limit, ...], table: BaseModel, kind: Kind) -> list[tuple[str, str]]:
    """Return the key of each limit that is weaker than a rig of ``kind`` accepts, and the text of the error."""
    return [
        (
            key,
            f"{value:g}: allowed on {kind} {limit.range_text(limit.accepted(kind))}, recommended "
            f"{limit.range_text(limit.recommended)}: it protects from {limit.protects}",
        )
        for key, limit, value in values(limits, table)
        if limit.is_weaker(value, limit.accepted(kind))
    ]
