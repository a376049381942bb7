"""Table of all alarms: console, report, JSON and the page of alarms are made from it.

A new kind is one row here, raised by its ``alarm`` or ``trip``.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from hil.core.alarms import LOW, MEDIUM, Alarm, AlarmKind
from hil.errors import BenchError, DeviceError, DriveFault, LinkLost, LinkTimeout, ProtocolError, SafetyTrip

_M: Final[dict[str, Any]] = {"unit": "m", "digits": (4, 3)}
_MPS: Final[dict[str, Any]] = {"unit": "m/s", "digits": (3, 2), "limit_digits": (3, 2)}
_S: Final[dict[str, Any]] = {"unit": "s", "digits": (3, 3)}
_GUARD: Final[dict[str, Any]] = _M | {"limit_digits": (4, 3), "by_guard": True}
_GUARD_RAD: Final = _GUARD | {"unit": "rad"}
_COUNT: Final[dict[str, Any]] = {"unit": "", "digits": (0, 0), "limit_digits": (0, 0)}
_NIS: Final[dict[str, Any]] = {"digits": (2, 2), "limit_digits": (2, 2)}
_POSE: Final[dict[str, Any]] = {"unit": "m", "digits": (4, 4), "limit_digits": (4, 4)}
_FEWER: Final = "fewer than {} rejected in a row, consistent"
_SILENCE: Final = "{} of silence while the bench moves"

# fmt: off
# people and safety chain
EMERGENCY_STOP = AlarmKind("emergency stop", "bench, io", "H-01")
INTERLOCK = AlarmKind("interlock {}", "io", "H-02")
SAFETY_CHAIN = AlarmKind("safety chain", "io", "H-02")
LOCAL_ENABLE = AlarmKind("local enabling input", "io", "H-03")
PUMP_TIMEOUT = AlarmKind("time-out of the charge pump", "io", "H-04", "s", "chain closed {} after the last pulse")
HOLDING_BRAKES = AlarmKind("holding brakes", "io", "H-15")
# devices and links
AGE_OF_FEEDBACK = AlarmKind("age of the feedback", "rails, turntable", "H-05", **_S)
AGE_OF_SETPOINT = AlarmKind("age of the setpoint", "bench", "H-05", **_S)
TIMEOUT = AlarmKind("timeout", "a device", "H-05")
LINK = AlarmKind("link", "a device", "H-06")
PROTOCOL = AlarmKind("protocol", "a device", "H-06")
DRIVE_FAULT = AlarmKind("drive fault", "a device", "H-06")
DEVICE = AlarmKind("device", "a device", "H-06")
ERROR = AlarmKind("error", "bench", "H-06")
MEASURED_POSE = AlarmKind("measured pose", "vmu", "H-13", "s", "none for {}", "one within {}", (3, 3))
LOST_PACKETS = AlarmKind("lost packets", "a device", "H-06", digits=(1, 1))
LOST_PERIODS = AlarmKind("lost periods", "loop", "H-16", digits=(0, 0))
# axes
HOMING = AlarmKind("homing", "an axis", "H-09", "s", "not done after {}", digits=(1, 1))
LIMIT_SWITCH = AlarmKind("limit switch", "an axis", "H-07")
SETPOINT = AlarmKind("setpoint", "an axis", "H-07")
RATE = AlarmKind("rate", "an axis", "H-07")
POSITION = AlarmKind("position", "an axis", "H-07", **_M)
FOLLOWING_ERROR = AlarmKind("following error", "an axis", "H-08", **_M)
SPEED = AlarmKind("speed", "an axis", "H-08", value="{} reported", limit="{} by its position", **_MPS)
SPEED_BEFORE_MOTION = AlarmKind("speed before motion", "an axis", "H-09", "m/s", digits=(4, 3))
SPEED_IN_A_STOP = AlarmKind("speed in a stop", "an axis", "H-14", limit="{} on its ramp", **_MPS)
START_POSE = AlarmKind("start pose", "bench", "H-09", "s", limit="{} after the move")
PARK_POSITION = AlarmKind("park position", "bench", "H-09", "s", limit="{} after the move")
STANDSTILL = AlarmKind("standstill", "bench", "H-09", "s", limit="{} after a move")
DRY_RUN = AlarmKind("dry run", "an axis", "H-09")
PLACE = AlarmKind("place", "target, further axes", "H-19", "s", limit="{} after the move")
COMMANDED_PLACE = AlarmKind("distance from commanded place", "target, further axes", "H-19", "m", digits=(4, 4))
# bench guard and guard volume
RANGE = AlarmKind("range to the target", "bench", "H-10", **_GUARD)
PLANE = AlarmKind("distance from the target along the docking axis", "bench", "H-10", **_GUARD)
CHASER_AND_TARGET = AlarmKind("distance of chaser and target", "bench", "H-10", **_GUARD)
BODIES = AlarmKind("distance of bodies", "bench", "H-11", **_GUARD)
MOVE_TO_VIEW = AlarmKind("move to view {}", "bench", "H-11")
DISTANCE_FROM_TRUTH = AlarmKind("distance from the truth", "bench", "H-12", **_GUARD)
ROTATION_FROM_TRUTH = AlarmKind("rotation from the truth", "bench", "H-12", **_GUARD_RAD)
LIMITED_SETPOINTS = AlarmKind("limited setpoints", "bench", "H-12", value="{} in a row", **_GUARD | _COUNT)
DISTANCE_FROM_DEMAND = AlarmKind("distance from the demand", "an axis", "H-08", **_GUARD)
POSE_AGAINST_ENCODERS = AlarmKind("pose against encoders, {}", "vmu", "H-13", code="pose_against_encoders", **_GUARD)
ATTITUDE_AGAINST_ENCODERS = AlarmKind("pose against encoders, about {}", "vmu", "H-13",
                                      code="attitude_against_encoders", **_GUARD_RAD)
BENCH_AGAINST_TRACKER = AlarmKind("bench against tracker", "tracker", "H-30", value="off by {}", priority=MEDIUM,
                                  **_POSE)
DRIFT_CHECK = AlarmKind("drift check against {}:", "vmu", "H-13", code="drift_check")
# operator
OPERATORS_PAGE = AlarmKind("operator's page", "console", "H-17", "s", "silent for {}", _SILENCE, (1, 1))
CONSOLE_PROCESS = AlarmKind("console process", "console", "H-17", "s", limit=_SILENCE)
HOLD = AlarmKind("hold", "bench", "H-17")
# consistency monitors: conditions, which stop nothing by themselves
ACCEPTED_POSES = AlarmKind("accepted poses", "vmu", "H-18", "s", "none for {}", "one within {}", priority=MEDIUM)
INNOVATIONS = AlarmKind("innovations", "vmu, a sensor, navigation", "H-18", limit=_FEWER, priority=MEDIUM)
READINGS = AlarmKind("readings", "imu", "H-18", priority=MEDIUM)
THRUST = AlarmKind("thrust", "thrusters", "H-18", priority=MEDIUM)
COVARIANCE = AlarmKind("covariance", "navigation", "H-18", priority=MEDIUM)
ESTIMATE = AlarmKind("estimate against the encoders", "navigation", "H-18", priority=MEDIUM)
NAVIGATION_POSE = AlarmKind("pose of the navigation", "a witness", "H-18", value="off by {}", priority=MEDIUM, **_POSE)
SAMPLES = AlarmKind("samples", "a sensor", "H-18", "s", "none for {}", "one within {}", (1, 1), priority=LOW)
MEAN_NIS = AlarmKind("mean NIS of {} over {} poses", "navigation", "H-18", priority=LOW, code="mean_nis", **_NIS)
SHADOW = AlarmKind("distance from the shadow filter", "navigation", "H-18", priority=LOW)
# fmt: on

ALARMS: Final = {kind.code: kind for kind in tuple(globals().values()) if isinstance(kind, AlarmKind)}
"""Code -> kind."""
_OF_ERRORS: Final[dict[type[DeviceError], tuple[AlarmKind, str]]] = {
    LinkLost: (LINK, "connected"),
    LinkTimeout: (TIMEOUT, "response in time"),
    ProtocolError: (PROTOCOL, "valid message"),
    DriveFault: (DRIVE_FAULT, "none"),
}


def alarm_from_error(error: BenchError, t_s: float) -> Alarm:
    """Return the alarm of a bench error; its text is the text of the error."""
    if isinstance(error, SafetyTrip):
        alarm: Alarm = error.alarm
        return replace(alarm, t_s=t_s)
    if isinstance(error, DeviceError):
        kind, limit = _OF_ERRORS.get(type(error), (DEVICE, "no error"))
        return replace(kind.alarm(t_s, error.device, error.what, limit), text=str(error))
    return replace(ERROR.alarm(t_s, "bench", str(error), "none"), text=str(error))
