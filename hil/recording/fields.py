"""Unit, frame and meaning of each recorded field: what the schemas of a recording say (frames: docs/frames.md)."""

from __future__ import annotations

from typing import Final

Meaning = tuple[str, str, str]
"""Unit ("1" for a number without), frame ("" for none), what it is."""

_TRUTH: Final[dict[str, Meaning]] = {
    "t_s": ("s", "", "time of the truth"),
    "r_CT_H": ("m", "H", "chaser's reference point relative to the target's"),
    "v_CT_H": ("m/s", "H", "its velocity as seen in H"),
    "q_CH": ("1", "H to c", "attitude quaternion, scalar last"),
    "w_CI_C": ("rad/s", "c", "chaser against inertial space"),
    "r_T_I": ("m", "I", "target from the Moon's centre"),
    "v_T_I": ("m/s", "I", "target's velocity"),
    "q_HI": ("1", "I to H", "attitude of H, scalar last"),
    "w_HI_H": ("rad/s", "H", "H against inertial space"),
    "eta": ("m kg^1/2", "", "bending of the solar array"),
    "eta_rate": ("m kg^1/2/s", "", "its rate"),
    "mass_kg": ("kg", "", "mass of the chaser"),
    "open_s": ("s", "", "time for which each valve has been open, 0 closed"),
    "mean_rate_C": ("rad/s", "c", "mean of w_CI_C over the last step"),
    "mean_force_C": ("m/s^2", "c", "specific force, mean over the last step"),
    "thrust_fraction": ("1", "", "open part of the last step, by thruster"),
}

_IMU: Final[dict[str, Meaning]] = {
    "rate_C": ("rad/s", "c", "gyro"),
    "force_C": ("m/s^2", "c", "accelerometer"),
    "drift_C": ("rad/s", "c", "true drift of the gyro"),
    "bias_C": ("m/s^2", "c", "true bias of the accelerometer"),
}

_POSE: Final[dict[str, Meaning]] = {
    "z_TC_C": ("m", "c", "target's reference point seen from the chaser's"),
    "covariance_position": ("m^2", "c", "covariance of z_TC_C"),
    "q_CH": ("1", "H to c", "measured attitude, scalar last"),
    "covariance_attitude": ("rad^2", "c", "covariance of the small turn of c"),
    "t_s": ("s", "", "moment of exposure, time of the run"),
    "fresh": ("1", "", "how many poses came in this cycle; this is the newest"),
}

_NAVIGATION: Final[dict[str, Meaning]] = {
    "valid": ("1", "", "1 once a pose has come"),
    "r_CT_H": ("m", "H", "estimated position"),
    "v_CT_H": ("m/s", "H", "estimated velocity"),
    "q_CH": ("1", "H to c", "estimated attitude, scalar last"),
    "w_CH_C": ("rad/s", "c", "estimated rate of the chaser against H"),
    "sigma_r_m": ("m", "H", "standard deviation of the position"),
    "sigma_v_mps": ("m/s", "H", "standard deviation of the velocity"),
    "sigma_attitude_rad": ("rad", "c", "standard deviation of the attitude"),
    "nis_position": ("1", "", "normalised innovation squared, 3 components; nan without an update"),
    "nis_attitude": ("1", "", "normalised innovation squared, 3 components; nan without an update"),
}

_REFERENCE: Final[dict[str, Meaning]] = {
    "r_CT_H": ("m", "H", "reference position"),
    "v_CT_H": ("m/s", "H", "reference velocity"),
    "a_CT_H": ("m/s^2", "H", "reference acceleration"),
    "q_CH": ("1", "H to c", "reference attitude, scalar last"),
    "boost": ("1", "", "1 where force demands are to open the strong thruster sets"),
    "phase": ("1", "", "number of the phase; after the list: brake, retreat, hold of an abort"),
    "from_H": ("m", "H", "begin of the phase's line"),
    "to_H": ("m", "H", "its end"),
}

_SUPERVISION: Final[dict[str, Meaning]] = {
    "corridor_margin_m": ("m", "", "of the estimate, negative outside"),
    "closing_margin_mps": ("m/s", "", "allowed minus actual closing rate"),
    "broken_cycles": ("1", "", "cycles for which a limit has been broken on end"),
    "ready_since_s": ("s", "", "since then within Table III on the estimate; nan when it is not"),
    "aborted": ("1", "", "cause of the abort, 0 for none"),
    "aborted_at_s": ("s", "", "time of the run at which it was aborted"),
}

_COMMAND: Final[dict[str, Meaning]] = {
    "force": ("1", "c", "demand along each axis, -1, 0, 1"),
    "torque": ("1", "c", "demand about each axis, -1, 0, 1"),
    "on": ("1", "", "thrusters, 0 or 1"),
    "cycles_left": ("1", "c", "of the burn under way, signed; force axes, then torque axes"),
    "until_decision": ("1", "", "cycles to the next decision of each axis"),
    "owed": ("m/s, rad/s", "c", "change of rate that the reference asked for and was not fired yet"),
    "boost": ("1", "", "1: force demands open the strong sets"),
}

_AXES: Final[dict[str, Meaning]] = {
    "rail_m": ("m", "L", "carriage along x, y, z"),
    "rail_mps": ("m/s", "L", "speed of the carriage"),
    "gimbal_rad": ("rad", "", "roll, pitch, yaw of the turntable"),
    "gimbal_radps": ("rad/s", "", "their rates"),
}

_FRAME: Final[dict[str, Meaning]] = {
    "counter": ("1", "", "frame number of the unit"),
    "t_s": ("s", "", "exposure, bench time"),
    "received_s": ("s", "", "last byte, bench time"),
    "t_v": ("m", "v", "ring centre from the left camera"),
    "q_vt": ("1", "t to v", "attitude of the ring, scalar last"),
    "covariance": ("m^2, m rad, rad^2", "v", "of t_v and of the small turn about v's axes"),
    "leds_left": ("1", "", "bit n: LED n was used in the left picture"),
    "leds_right": ("1", "", "bit n: LED n was used in the right picture"),
}


_QUANTITIES: Final[dict[str, Meaning]] = {
    "d1_m": ("m", "", "camera in the target's frame C, along y1; nan where not observable, as all that follows"),
    "d2_m": ("m", "", "the same along y2"),
    "d3_m": ("m", "", "the same along y3"),
    "phi1_rad": ("rad", "", "active pitch"),
    "phi2_rad": ("rad", "", "active yaw"),
    "phi3_rad": ("rad", "", "active roll"),
    "range_m": ("m", "", "range"),
    "range_rate_mps": ("m/s", "", "its rate"),
    "pitch_passive_rad": ("rad", "", "passive pitch"),
    "yaw_passive_rad": ("rad", "", "passive yaw"),
    "los_right_rad": ("rad", "", "target's disc to the right of the optical axis"),
    "los_up_rad": ("rad", "", "target's disc above the optical axis"),
}

_PORTION: Final[dict[str, Meaning]] = {
    "frames": ("1", "", "how many frames were used"),
    "status": ("1", "", "near, far, no_target or rejected_<why>"),
    **_QUANTITIES,
}


def _all() -> dict[str, Meaning]:
    groups = {
        "truth": _TRUTH,
        "imu": _IMU,
        "pose": _POSE,
        "navigation": _NAVIGATION,
        "reference": _REFERENCE,
        "supervision": _SUPERVISION,
        "command": _COMMAND,
        "setpoint": _AXES,
        "feedback": _AXES,
        "frame": _FRAME,
    }
    plain: dict[str, Meaning] = {
        "t_s": ("s", "", "time of the run"),
        "sampled_s": ("s", "", "when the encoders of rails and turntable had these values, time of the run"),
        "received_s": ("s", "", "last byte of the pose's frame, time of the run"),
        "commanded_s": ("s", "", "when the thrusters' command was there, time of the run"),
        "on_wire_s": ("s", "", "when the thrusters' digital lines last changed, time of the run; nan without lines"),
        "lateness_s": ("s", "", "how late the cycle woke up, on the wall"),
        "nees_position": ("1", "", "normalised error squared of the position filter, 9 states; nan without a pose"),
        "nees_attitude": ("1", "", "normalised error squared of the attitude filter, 6 states; nan without a pose"),
        "cycle": ("1", "", "number of the cycle that used it, -1 for none"),
    }
    plain |= _PORTION | {
        f"sigma_{name}": (unit, "", f"its standard deviation: {name}") for name, (unit, _, _) in _QUANTITIES.items()
    }
    return plain | {f"{name}.{field}": meaning for name, group in groups.items() for field, meaning in group.items()}


FIELDS: Final = _all()
"""Dotted name of a field of CYCLE or ARRIVAL -> its meaning."""
