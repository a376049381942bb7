"""Table of all alarms: console, report, JSON and the page of alarms are made from it.

A new kind is one row here, raised by its ``alarm`` or ``trip``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import fields, replace
from fnmatch import fnmatchcase
from typing import Any, Final

from hil.core.alarms import LOW, MEDIUM, Alarm, AlarmKind, slug
from hil.errors import BenchError, DeviceError, DriveFault, LinkLost, LinkTimeout, ProtocolError, SafetyTrip

ALARMS: Final[dict[str, AlarmKind]] = {}
"""Code -> kind."""


def _row(quantity: str, device: str, hazard: str, allowed: str, **more: Any) -> AlarmKind:
    """Return the kind of a row; its code is its quantity unless it is given. Arguments of AlarmKind."""
    code = more.pop("code", slug(quantity.replace("{}", "").rstrip(", :").replace("'", "")))
    return ALARMS.setdefault(code, AlarmKind(quantity, device, allowed, hazard, code=code, **more))


_FIXED: Final = {"digits": (4, 3), "limit_digits": (4, 3)}
_AXIS_SPEED: Final = {"unit": "m/s", "digits": (3, 2), "limit_digits": (3, 2)}
_BRAKING: Final = "and the distance to brake from the closing rate after `guard.reaction_s`"
_AFTER_MOVE: Final = {"unit": "s", "limit": "{} after the move"}

# fmt: off
# people and safety chain
EMERGENCY_STOP = _row("emergency stop", "bench, io", "H-01",
                      "released and reset; an unreadable input counts as pressed")
INTERLOCK = _row("interlock {}", "io", "H-02", "closed")
SAFETY_CHAIN = _row("safety chain", "io", "H-02", "closed")
LOCAL_ENABLE = _row("local enabling input", "io", "H-03", "on, if `io.inputs.local_enable` is set; not in standby, "
                    "where commands to move are refused")
PUMP_TIMEOUT = _row("time-out of the charge pump", "io", "H-04", "the chain opens within `io.pump_timeout_s` of the "
                    "last pulse; opening of hardware, commissioning",
                    unit="s", value="chain closed {} after the last pulse")
HOLDING_BRAKES = _row("holding brakes", "io", "H-15", "read back as closed, and as open after their release, if "
                      "`io.inputs.brakes_closed` is set")

# devices and links
AGE_OF_FEEDBACK = _row("age of the feedback", "rails, turntable", "H-05", "their `timeout_s`",
                       unit="s", digits=(3, 3))
AGE_OF_SETPOINT = _row("age of the setpoint", "bench", "H-05", "`safety.command_age_max_s`", unit="s", digits=(3, 3))
TIMEOUT = _row("timeout", "a device", "H-05", "its `timeout_s`; of the vision unit while armed, in a run and in its "
               "holds: frames without a pose count; of a GNC in another process `gnc_link.timeout_cycles`, if "
               '`gnc_link.on_loss = "stop"`')
LINK = _row("link", "a device", "H-06", "connected")
PROTOCOL = _row("protocol", "a device", "H-06", "valid")
DRIVE_FAULT = _row("drive fault", "a device", "H-06", "none")
DEVICE = _row("device", "a device", "H-06", "no other error; outputs of the coupler are read back as written")
ERROR = _row("error", "bench", "H-06", "none")
LOST_PACKETS = _row("lost packets", "a device", "H-06", "leaky bucket: `lost_packets_max`, drained by one per "
                    "`lost_packets_window_s`", digits=(1, 1))
LOST_PERIODS = _row("lost periods", "loop", "H-16", "`host.overruns_max` lost periods within "
                    "`host.overruns_window_s`, if `host.on_overrun` requires it (default on hardware); from the first "
                    "motion on", digits=(0, 0))

# axes
HOMING = _row("homing", "an axis", "H-09", "no failure; within `safety.homing_timeout_s`; completed before a setpoint "
              "is sent", unit="s", digits=(1, 1), value="not done after {}")
LIMIT_SWITCH = _row("limit switch", "an axis", "H-07", "not active; a jog respects it by itself")
SETPOINT = _row("setpoint", "an axis", "H-07", "a finite number; homed axes")
RATE = _row("rate", "an axis", "H-07", "a finite number")
POSITION = _row("position", "an axis", "H-07", "the travel, widened by the allowed following error; before arming by "
                "1 mm, 0.06 deg", unit="m", digits=(4, 3))
FOLLOWING_ERROR = _row("following error", "an axis", "H-08", "`following_error_max_m` or `_deg` at rest, plus "
                       "`following_error_per_speed_s` times the commanded speed; of a target that moves those of "
                       "`rotary_manipulator`; not for a turntable that parks by its own profile",
                       unit="m", digits=(4, 3))
SPEED = _row("speed", "an axis", "H-08", "reported speed equal to the change of position, within "
             "`speed_mismatch_max_mps` or `_degps` and a tenth of the speed, for 0.1 s; not in homing",
             value="{} reported", limit="{} by its position", **_AXIS_SPEED)
SPEED_BEFORE_MOTION = _row("speed before motion", "an axis", "H-09", "0.01 m/s, 1 deg/s; waits at most 3 s for an axis "
                           "to be at rest for 0.1 s; before references are initialised", unit="m/s", digits=(4, 3))
SPEED_IN_A_STOP = _row("speed in a stop", "an axis", "H-14", "its braking ramp, for 0.1 s "
                       "([stops](../../explanation/stops.md))", limit="{} on its ramp", **_AXIS_SPEED)
START_POSE = _row("start pose", "bench", "H-09", "reached 3 s after the move", **_AFTER_MOVE)
PARK_POSITION = _row("park position", "bench", "H-09", "reached 3 s after the move", **_AFTER_MOVE)
STANDSTILL = _row("standstill", "bench", "H-09", "reached 3 s after a move; commissioning",
                  unit="s", limit="{} after a move")
DRY_RUN = _row("dry run", "an axis", "H-09", "start pose within the travel; commissioning")
PLACE = _row("place", "target, further axes", "H-19", "reached 3 s after the move", **_AFTER_MOVE)
COMMANDED_PLACE = _row("distance from commanded place", "target, further axes", "H-19", "`held_within_m` or `_deg`",
                       unit="m", digits=(4, 4))

# bench guard and guard volume
RANGE = _row("range to the target", "bench", "H-10", f"`keep_out.radius_m` of the scenario, {_BRAKING}; in a run, and "
             "by the encoders whenever axes are commanded", unit="m", by_guard=True, **_FIXED)
PLANE = _row("distance from the target along the docking axis", "bench", "H-10", "the same of the half-space at "
             "`keep_out.radius_m`", unit="m", by_guard=True, **_FIXED)
CHASER_AND_TARGET = _row("distance of chaser and target", "bench", "H-10", "`keep_out.distance_m` between two of "
                         "`keep_out.bodies`, and the distance to brake; in a run", unit="m", by_guard=True, **_FIXED)
BODIES = _row("distance of bodies", "bench", "H-11", "`bench.bodies_distance_m` between two of `bench.bodies`, and the "
              "distance to brake", unit="m", by_guard=True, **_FIXED)
MOVE_TO_VIEW = _row("move to view {}", "bench", "H-11", "clear of the guard volume; calibration drive")
DISTANCE_FROM_TRUTH = _row("distance from the truth", "bench", "H-12", "`guard.pose_error_max_m` at rest, plus "
                           "`guard.pose_error_per_speed_s` times the speed, for `guard.pose_error_cycles`; in a run",
                           unit="m", by_guard=True, **_FIXED)
ROTATION_FROM_TRUTH = _row("rotation from the truth", "bench", "H-12", "the same by `guard.pose_error_max_deg`",
                           unit="rad", by_guard=True, **_FIXED)
LIMITED_SETPOINTS = _row("limited setpoints", "bench", "H-12", "in a row for `guard.limited_max_s`; in a run",
                         digits=(0, 0), limit_digits=(0, 0), value="{} in a row", by_guard=True)
DISTANCE_FROM_DEMAND = _row("distance from the demand", "an axis", "H-08", "`guard.axis_error_max_m` or `_deg` at "
                            "rest, plus `guard.axis_error_per_speed_s` and the feedback's age times the demanded "
                            "speed, for `guard.axis_error_cycles`; in a run", unit="m", by_guard=True, **_FIXED)
ATTITUDE_AGAINST_ENCODERS = _row("pose against encoders, about {}", "vmu", "H-13", "`guard.vision_error_max_deg` plus "
                                 "`guard.vision_sigmas` reported standard deviations, for `guard.vision_frames_max` "
                                 "poses; in a run", unit="rad", code="attitude_against_encoders", by_guard=True,
                                 **_FIXED)
POSE_AGAINST_ENCODERS = _row("pose against encoders, {}", "vmu", "H-13", "the same by `guard.vision_error_max_m`",
                             unit="m", by_guard=True, **_FIXED)
DRIFT_CHECK = _row("drift check against {}:", "vmu", "H-13", "`vmu.drift_check`; before a run", code="drift_check")

# operator
OPERATORS_PAGE = _row("operator's page", "console", "H-17", "messages within `console.lease_s`; placing and running if "
                      '`console.on_loss = "stop"`', unit="s", digits=(1, 1), value="silent for {}",
                      limit="{} of silence while the bench moves")
CONSOLE_PROCESS = _row("console process", "console", "H-17", "the same of its process", unit="s",
                       limit="{} of silence while the bench moves")
HOLD = _row("hold", "bench", "H-17", "requested by the program in an unattended run")

# consistency monitors: conditions, which stop nothing by themselves
ACCEPTED_POSES = _row("accepted poses", "vmu", "H-18", "one within `gnc.integrity.lost_after_s`", unit="s",
                      value="none for {}", limit="one within {}", priority=MEDIUM)
INNOVATIONS = _row("innovations", "vmu, a sensor", "H-18", "fewer than `gnc.integrity.suspect_after` rejected in a "
                   "row, consistent with their covariance", limit="fewer than {} rejected in a row, consistent",
                   priority=MEDIUM)
READINGS = _row("readings", "imu", "H-18", "neither repeated nor unexplained by the thrusters", priority=MEDIUM)
THRUST = _row("thrust", "thrusters", "H-18", "as commanded", priority=MEDIUM)
COVARIANCE = _row("covariance", "navigation", "H-18", "positive definite", priority=MEDIUM)
ESTIMATE = _row("estimate against the encoders", "navigation", "H-18", "`guard.estimate_error_max_m` of the rig and "
                "the protection level", priority=MEDIUM)
NAVIGATION_POSE = _row("pose of the navigation", "docking monitor, another witness", "H-18", "the sigmas of both",
                       unit="m", digits=(4, 4), limit_digits=(4, 4), value="off by {}", priority=MEDIUM)
SAMPLES = _row("samples", "a sensor", "H-18", "one within 1 s", unit="s", digits=(1, 1), value="none for {}",
               limit="one within {}", priority=LOW)
MEAN_NIS = _row("mean NIS of {} over {} poses", "navigation", "H-18", "its band of 1e-6 on either side; normal again "
                "within that of 10 %", digits=(2, 2), limit_digits=(2, 2), priority=LOW, code="mean_nis")
SHADOW = _row("distance from the shadow filter", "navigation", "H-18", "`gnc.shadow.position_limit_m`, "
              "`attitude_limit_deg`", priority=LOW)
# fmt: on

_OF_ERRORS: Final[dict[type[DeviceError], tuple[AlarmKind, str]]] = {
    LinkLost: (LINK, "connected"),
    LinkTimeout: (TIMEOUT, "response in time"),
    ProtocolError: (PROTOCOL, "valid message"),
    DriveFault: (DRIVE_FAULT, "none"),
}


def alarm_from_error(error: BenchError, t_s: float) -> Alarm:
    """Return the alarm of a bench error; its text is the text of the error."""
    if isinstance(error, SafetyTrip):
        return replace(error.alarm, t_s=t_s)
    if isinstance(error, DeviceError):
        kind, limit = _OF_ERRORS.get(type(error), (DEVICE, "no error"))
        return replace(kind.alarm(t_s, error.device, error.what, limit), text=str(error))
    return replace(ERROR.alarm(t_s, "bench", str(error), "none"), text=str(error))


_FIELDS: Final = {field.name for field in fields(Alarm)}
_NUMBER: Final = re.compile(r"(-?[\d.]+(?:e[-+]\d+)?)(?![^ ])(?: (deg))?")


def alarm_of_json(entry: Mapping[str, Any]) -> Alarm:
    """Return the alarm of an ``entry`` of ``alarms``; one of an earlier version has its kind and numbers as texts."""
    alarm = Alarm(**{key: value for key, value in entry.items() if key in _FIELDS})
    for kind in ALARMS.values() if not alarm.code else ():
        if fnmatchcase(alarm.quantity, kind.quantity.replace("{}", "*")):
            return replace(
                alarm,
                code=kind.code,
                measured=_leading_number(alarm.value),
                allowed=_leading_number(alarm.limit),
                unit=kind.unit_of("deg" in alarm.value),
            )
    return alarm


def _leading_number(text: str) -> float | None:
    found = _NUMBER.match(text)
    if found is None:
        return None
    return math.radians(float(found[1])) if found[2] else float(found[1])
