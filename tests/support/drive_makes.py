"""Makes of CiA 402 drives: habits in which real ones differ from an obliging one, and which a driver must bear."""

from __future__ import annotations

from typing import Any

PER_MINUTE, MILLI_PER_MINUTE = 0x00B44700, 0xFDB44700
CSP_AND_HOMING, INTERPOLATED_AND_HOMING = 0xA0, 0x60
MAKES: dict[str, dict[str, Any]] = {
    "obliging": {},
    "late modes": {"mode_lag_s": 0.02},
    "very late modes": {"mode_lag_s": 0.2},
    "modes when enabled": {"mode_only_enabled": True},
    "lingering bits": {"bits_lag_s": 0.2},
    "late states": {"state_lag_s": 0.1},
    "no mode display": {"missing": (0x6061,)},
    "general abort codes": {"missing": (0x603F, 0x606C), "missing_code": 0x08000000},
    "no heartbeat consumer": {"aborts": (0x1016,)},
    "no remote frames": {"no_remote_frames": True},
    "rev/min": {"velocity_unit": PER_MINUTE},
    "milli rev/min": {"velocity_unit": MILLI_PER_MINUTE},
    "no velocity": {"missing": (0x606C,)},
    "no heartbeat": {"missing": (0x1017,)},
    "no error code": {"missing": (0x603F,)},
    "interpolated position alone": {"supported_modes": INTERPOLATED_AND_HOMING},
    "setpoints alone": {"supported_modes": CSP_AND_HOMING},
    "kept errors": {"keeps_error": True},
    "slow to enable": {"enable_s": 4.0},
    "warnings in bursts": {"warnings_hz": 10.0},
    "fixed SYNC": {"aborts": (0x1005,)},
    "no setpoint time-out": {"missing": (0x605B,)},
    "foreign nodes": {"foreign_nodes": (20, 21)},
}
