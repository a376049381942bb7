"""Records and values that pass between the stages of a cycle.

Each message is a flat numpy record, so that compiled kernels, recording and console read the same bytes. Its table
gives type, shape, unit, frame and meaning of each field (frames: ``docs/explanation/frames.md``); ``_H``, ``_c``,
``_v``, ``_t`` name the frame of a vector, ``q_CH`` takes components in H to components in c, quaternions have the
scalar last. Axis triples are x, y, z; angles by axis are theta1 (roll), theta2 (pitch), theta3 (yaw). Arrays of
thrusters have MAX_THRUSTERS places; unused ones stay zero. Recorded fields are appended, never renamed or reordered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from hil.core.fields import Field, leaf_fields, number, record_dtype, whole

Array = npt.NDArray[np.float64]

MAX_THRUSTERS = 24
MAX_PHASES = 16
MAX_POSES = 4  # that can arrive in one cycle
MAX_FAULTS = 8  # faults of one kind of device in a run
MAX_AIR_LAYERS = 32  # layers of an atmosphere
MAX_THIRD_BODIES = 4
MAX_MODES = 8  # modes of the solar array

TRUTH_FIELDS: Final = (
    number("t_s", "s", "time of the truth"),
    Field("r_CT_H", "f8", 3, "m", "H", "chaser's reference point relative to the target's"),
    Field("v_CT_H", "f8", 3, "m/s", "H", "its velocity as seen in H"),
    Field("q_CH", "f8", 4, "1", "H to c", "attitude quaternion, scalar last"),
    Field("w_CI_C", "f8", 3, "rad/s", "c", "chaser against inertial space"),
    Field("r_T_I", "f8", 3, "m", "I", "target from the centre of the central body"),
    Field("v_T_I", "f8", 3, "m/s", "I", "target's velocity"),
    Field("q_HI", "f8", 4, "1", "I to H", "attitude of H, scalar last"),
    Field("w_HI_H", "f8", 3, "rad/s", "H", "H against inertial space"),
    number("eta", "m kg^1/2", "bending of the solar array, its first mode"),
    number("eta_rate", "m kg^1/2/s", "its rate"),
    number("mass_kg", "kg", "mass of the chaser"),
    Field("open_s", "f8", MAX_THRUSTERS, "s", "", "time for which each valve has been open, 0 closed"),
    Field("mean_rate_C", "f8", 3, "rad/s", "c", "mean of w_CI_C over the last step: what a gyro integrates"),
    Field("mean_force_C", "f8", 3, "m/s^2", "c", "specific force, mean over the last step"),
    Field("thrust_fraction", "f8", MAX_THRUSTERS, "1", "", "open part of the last step, by thruster, 0 to 1"),
    number("sunlight", "1", "visible fraction of the Sun's disc; 1 without eclipses", 1.0),
)
TRUTH = record_dtype(TRUTH_FIELDS)

IMU_FIELDS: Final = (
    Field("rate_C", "f8", 3, "rad/s", "c", "gyro, U_g"),
    Field("force_C", "f8", 3, "m/s^2", "c", "accelerometer, U_a"),
    Field("drift_C", "f8", 3, "rad/s", "c", "true drift of the gyro, epsilon"),
    Field("bias_C", "f8", 3, "m/s^2", "c", "true bias of the accelerometer, d"),
)
IMU = record_dtype(IMU_FIELDS)

POSE_STATUS: Final = whole(
    "status", "status that the vision unit reported with the pose: 0 good, 2 a position whose attitude is a guess"
)
POSE_FIELDS: Final = (
    Field("z_TC_C", "f8", 3, "m", "c", "target's reference point seen from the chaser's"),
    Field("covariance_position", "f8", (3, 3), "m^2", "c", "covariance of z_TC_C"),
    Field("q_CH", "f8", 4, "1", "H to c", "measured attitude, scalar last"),
    Field("covariance_attitude", "f8", (3, 3), "rad^2", "c", "covariance of the small-angle rotation of c"),
    number("t_s", "s", "moment of exposure, time of the run"),
    whole("fresh", "number of poses that arrived in this cycle; this is the newest"),
    Field(
        "covariance_cross", "f8", (3, 3), "m rad", "c", "of the errors of z_TC_C (rows) and of the small-angle rotation"
    ),
    POSE_STATUS,
)
POSE = record_dtype(POSE_FIELDS)

NAVIGATION_FIELDS: Final = (
    whole("valid", "1 after the first pose"),
    Field("r_CT_H", "f8", 3, "m", "H", "estimated position"),
    Field("v_CT_H", "f8", 3, "m/s", "H", "estimated velocity"),
    Field("q_CH", "f8", 4, "1", "H to c", "estimated attitude, scalar last"),
    Field("w_CH_C", "f8", 3, "rad/s", "c", "estimated rate of the chaser against H"),
    Field("sigma_r_m", "f8", 3, "m", "H", "standard deviation of the position"),
    Field("sigma_v_mps", "f8", 3, "m/s", "H", "standard deviation of the velocity"),
    Field("sigma_attitude_rad", "f8", 3, "rad", "c", "standard deviation of the attitude"),
    number("nis_position", "1", "normalised innovation squared, 3 components; nan without an update"),
    number("nis_attitude", "1", "normalised innovation squared, 3 components; nan without an update"),
    Field("protection_level_m", "f8", 3, "m", "H", "bound on the position error, nan if not reported", math.nan),
    number("protection_level_rad", "rad", "bound on the attitude error, nan if not reported", math.nan),
    whole("health", "0 healthy; sum of the bits of hil_gnc_health"),
)
NAVIGATION = record_dtype(NAVIGATION_FIELDS)

REFERENCE_FIELDS: Final = (
    Field("r_CT_H", "f8", 3, "m", "H", "reference position"),
    Field("v_CT_H", "f8", 3, "m/s", "H", "reference velocity"),
    Field("a_CT_H", "f8", 3, "m/s^2", "H", "reference acceleration"),
    Field("q_CH", "f8", 4, "1", "H to c", "reference attitude, scalar last"),
    whole("boost", "1: force demands open the high-thrust sets"),
    whole("phase", "number of the phase; after the list: brake, retreat, hold of an abort"),
    Field("from_H", "f8", 3, "m", "H", "start of the phase's line"),
    Field("to_H", "f8", 3, "m", "H", "end of the phase's line"),
)
REFERENCE = record_dtype(REFERENCE_FIELDS)

SUPERVISION_FIELDS: Final = (
    number("corridor_margin_m", "m", "of the estimate, negative outside"),
    number("closing_margin_mps", "m/s", "allowed minus actual closing rate"),
    whole("broken_cycles", "consecutive cycles in which a limit is violated"),
    number("ready_since_s", "s", "start of the estimate's stay within Table III; nan outside"),
    whole("aborted", "cause of the abort, 0 for none"),
    number("aborted_at_s", "s", "time of the run at which the approach was aborted"),
    whole("reaction", "to the health: 0 continue, 1 coast, 2 hold, 3 retreat, 4 abort"),
    Field(
        "level", "f8", 3, "m, rad", "", "protection levels along the docking axis, across it, of the attitude", math.nan
    ),
    Field("alert_limit", "f8", 3, "m, rad", "", "alert limits of these levels, at the estimate", math.nan),
    whole(
        "level_term",
        "largest term of the level that is nearest its limit: 1 noise, 2 undetected fault of the poses, 3 its growth "
        "since the last pose, 4 reopened gate, 5 second sensor; 0 unknown",
    ),
    number("level_term_m", "m, rad", "that term", math.nan),
)
SUPERVISION = record_dtype(SUPERVISION_FIELDS)

COMMAND_FIELDS: Final = (
    Field("force", "i8", 3, "1", "c", "demand along each axis before allocation, -1, 0, 1"),
    Field("torque", "i8", 3, "1", "c", "demand about each axis before allocation, -1, 0, 1"),
    Field("on", "i8", MAX_THRUSTERS, "1", "", "thrusters, 0 or 1"),
    Field("cycles_left", "i8", 6, "1", "c", "of the burn under way, signed; force axes, then torque axes"),
    Field("until_decision", "i8", 6, "1", "", "cycles to the next decision of each axis"),
    Field(
        "owed", "f8", 6, "m/s, rad/s", "c", "pending delta-v: change of rate requested by the reference, not yet fired"
    ),
    whole("boost", "1: force demands open the high-thrust sets, as in the reference"),
)
COMMAND = record_dtype(COMMAND_FIELDS)

AXES_FIELDS: Final = (
    Field("rail_m", "f8", 3, "m", "L", "carriage along x, y, z"),
    Field("rail_mps", "f8", 3, "m/s", "L", "speed of the carriage"),
    Field("gimbal_rad", "f8", 3, "rad", "", "roll, pitch, yaw of the turntable"),
    Field("gimbal_radps", "f8", 3, "rad/s", "", "their rates"),
)
AXES = record_dtype(AXES_FIELDS)

CYCLE_FIELDS: Final = (
    number("t_s", "s", "time of the run"),
    Field("truth", TRUTH_FIELDS),
    Field("imu", IMU_FIELDS),
    Field("pose", POSE_FIELDS),
    Field("navigation", NAVIGATION_FIELDS),
    Field("reference", REFERENCE_FIELDS),
    Field("supervision", SUPERVISION_FIELDS),
    Field("command", COMMAND_FIELDS),
    Field("setpoint", AXES_FIELDS),
    Field("feedback", AXES_FIELDS),
    Field("sampled_s", "f8", 2, "s", "", "when the encoders of rails and turntable had these values, time of the run"),
    number("received_s", "s", "last byte of the newest pose's frame, time of the run"),
    number("commanded_s", "s", "when the thruster command was complete, time of the run"),
    number("on_wire_s", "s", "last change of the thrusters' digital lines, time of the run; nan without lines"),
    number("lateness_s", "s", "lateness of the cycle's wake-up, wall clock"),
    number("nees_position", "1", "normalised error squared of the position filter; nan without a pose"),
    number("nees_attitude", "1", "normalised error squared of the attitude filter; nan without a pose"),
    number(
        "monitor_bound_m",
        "m",
        "bound on the position error by the docking monitor's newest measurement, at its time; 0: none",
    ),
    number("monitor_bound_s", "s", "time of that measurement, time of the run"),
    Field(
        "bench_off",
        "f8",
        6,
        "m, rad",
        "H, c",
        "mean of estimate minus encoders: position, then rotation; nan before they were compared",
    ),
    Field(
        "bench_breach",
        "f8",
        3,
        "m, rad",
        "H, c",
        "component of estimate minus encoders that is nearest its limit: number from 0, size over 0.4 s, limit",
        math.nan,
    ),
)
CYCLE = record_dtype(CYCLE_FIELDS)
_OF_THRUSTERS: Final = {f.name.rpartition(".")[2] for f in leaf_fields(CYCLE_FIELDS) if f.shape == MAX_THRUSTERS}

IMU_SAMPLE_FIELDS: Final = (
    whole("cycle", "number of the cycle that uses it"),
    number("t_s", "s", "end of the sample, time of the run"),
    Field("imu", IMU_FIELDS),
)
IMU_SAMPLE = record_dtype(IMU_SAMPLE_FIELDS)
"""A sample of an IMU that is faster than the cycle."""

AXES_SAMPLE_FIELDS: Final = (
    number("t_s", "s", "time of the run at which the setpoint was sent"),
    Field("setpoint", AXES_FIELDS),
    Field("feedback", AXES_FIELDS),
    Field("sampled_s", "f8", 2, "s", "", "when the encoders of rails and turntable had these values, time of the run"),
    number("lateness_s", "s", "lateness of the wake-up, wall clock"),
)
AXES_SAMPLE = record_dtype(AXES_SAMPLE_FIELDS)
"""A setpoint of axes that are faster than the cycle, with the encoders read before it."""

VMU_FRAME_FIELDS: Final = (
    whole("counter", "frame number of the unit, wraps at 2^32"),
    number("t_s", "s", "exposure, bench time"),
    number("received_s", "s", "last byte, bench time"),
    Field("t_v", "f8", 3, "m", "v", "ring centre from the left camera"),
    Field("q_vt", "f8", 4, "1", "t to v", "attitude of the ring, scalar last"),
    Field(
        "covariance", "f8", (6, 6), "m^2, m rad, rad^2", "v", "of t_v and of the small-angle rotation e about v's axes"
    ),
    whole("leds_left", "bit n: LED n was used in the left image"),
    whole("leds_right", "bit n: LED n was used in the right image"),
    whole("status", "status that the vision unit reported: 0 good, 2 a position alone"),
)
VMU_FRAME = record_dtype(VMU_FRAME_FIELDS)
"""A frame of the vision unit; ``PoseFrame`` is its view in Python."""

ARRIVAL_FIELDS: Final = (
    whole("cycle", "number of the cycle that used it, -1 for none"),
    Field("frame", VMU_FRAME_FIELDS),
    Field("pose", POSE_FIELDS),
)
ARRIVAL = record_dtype(ARRIVAL_FIELDS)
"""A frame as the loop received it. cycle: -1 if no cycle used it (loop open, hold, too old, too many). pose: what
navigation received, chaser relative to target; zero if no cycle used it."""


def new(dtype: np.dtype) -> np.record:
    """Return one zeroed record of ``dtype`` that owns its memory."""
    record: np.record = np.zeros(1, dtype).view(np.recarray)[0]
    return record


def with_thrusters(records: np.ndarray, n: int) -> np.ndarray:
    """Return a view of ``records``, of CYCLE or a part of it, whose arrays of thrusters have ``n`` elements."""
    return records.view(_with_thrusters(records.dtype, n))


def _with_thrusters(dtype: np.dtype, n: int) -> np.dtype:
    if dtype.fields is None or dtype.names is None:
        return dtype
    formats: list[np.dtype] = [
        np.dtype((inner.base, (min(n, inner.shape[0]),)))
        if inner.shape and name.rpartition(".")[2] in _OF_THRUSTERS
        else _with_thrusters(inner, n)
        for name, (inner, *_) in dtype.fields.items()
    ]
    offsets = [offset for _, offset, *_ in dtype.fields.values()]
    names = list(dtype.names)
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": dtype.itemsize})


def imu_samples(row: np.ndarray, n: int) -> np.ndarray:
    """Return memory for the IMU's samples of a cycle, (n,) of IMU; for one it is ``imu`` of ``row``, (1,) of CYCLE."""
    return row["imu"].view(np.ndarray) if n == 1 else np.zeros(n, IMU)


class Homing(IntEnum):
    """State of an axis's position reference. An axis with an absolute encoder is always at DONE."""

    NEEDED = 0
    UNDER_WAY = 1
    DONE = 2
    FAILED = 3


AXES_MAX: Final = 6
"""Most axes of one device."""
HOMED: Final = (Homing.DONE, Homing.DONE, Homing.DONE)
"""Three axes with a valid position reference."""
NO_LIMIT: Final = (0, 0, 0)
"""Three axes of which none is on a limit switch."""


@dataclass(frozen=True, slots=True)
class AxisFeedback:
    """Feedback of the n axes of one device, one to six: the newest sample and its time.

    position: shape (n,), m or rad; rate: shape (n,), m/s or rad/s; t_s: bench time of the sample.
    homing: of each axis; only at DONE does its position refer to the bench. limit: limit switch that
    each axis is on, -1 the low one, 1 the high one, 0 none. Unless given: all axes are at DONE, and on no switch.
    """

    t_s: float
    position: Array
    rate: Array
    homing: tuple[Homing, ...] = HOMED
    limit: tuple[int, ...] = NO_LIMIT

    def __post_init__(self) -> None:
        """Give groups of other than three axes the defaults of their number of axes."""
        n = len(self.position)
        if n != len(HOMED) and (self.homing is HOMED or self.limit is NO_LIMIT):
            homing, limit = (Homing.DONE,) * n, (0,) * n
            object.__setattr__(self, "homing", homing if self.homing is HOMED else self.homing)
            object.__setattr__(self, "limit", limit if self.limit is NO_LIMIT else self.limit)


class IoInputs(NamedTuple):
    """Digital inputs: the newest sample and its time, s of bench time.

    estop_closed: the emergency stop is released. chain_closed: the safety relay enables torque.
    open_interlocks: names of the interlocks whose contacts are open. thrusters_s: when the coupler
    received the thrusters' lines as they are, s of bench time; NaN before the first change.
    brakes_closed: all holding brakes are closed; None: not read back. local_enable: the switch at the bench
    permits power and motion; None: the bench has none.
    """

    t_s: float
    estop_closed: bool
    chain_closed: bool
    open_interlocks: tuple[str, ...] = ()
    thrusters_s: float = math.nan
    brakes_closed: bool | None = None
    local_enable: bool | None = None


class IoOutputs(NamedTuple):
    """Demanded digital outputs. enable: asks the safety relay to close. thrusters: one byte per line, 0 or 1.

    brakes_released: lets go of the axes that have holding brakes. pump: the charge pump toggles; False only in a test
    of the safety relay's time-out. warning: signal before the first motion.
    """

    enable: bool
    thrusters: bytes
    brakes_released: bool = False
    pump: bool = True
    warning: bool = False


POSITION_ONLY: Final = 2
"""Status of a frame and of a pose whose attitude is a guess, with ``UNKNOWN_ATTITUDE_RAD`` about each axis."""
UNKNOWN_ATTITUDE_RAD: Final = 1.0


@dataclass(frozen=True, slots=True)
class PoseFrame:
    """One pose of the vision unit, t to v: ``p_v = A(q_vt) p_t + t_v``; fields as in VMU_FRAME.

    covariance: shape (6, 6), of t_v and of the small-angle rotation e about v's axes, ``R_est = exp([e]x) R_true``.
    """

    counter: int
    t_s: float
    received_s: float
    t_v: Array
    q_vt: Array
    covariance: Array
    leds_left: int = 0
    leds_right: int = 0
    status: int = 0

    @classmethod
    def from_record(cls, record: np.void) -> Self:
        """Return the frame that ``record`` of VMU_FRAME holds; its arrays are copies."""
        return cls(*(record[name].copy() if field.shape else record[name].item() for name, field in _FRAME_PARTS))

    def write_to(self, record: np.ndarray) -> None:
        """Write the frame to ``record``, shape (1,) of VMU_FRAME."""
        record[0] = tuple(getattr(self, name) for name, _ in _FRAME_PARTS)


_FRAME_PARTS: Final = tuple((name, VMU_FRAME[name]) for name in VMU_FRAME.names or ())


@dataclass(frozen=True, slots=True)
class Event:
    """An entry of the event log: time of the run, source and text."""

    t_s: float
    source: str
    text: str


GIMBALS_FIELDS: Final = (
    Field("angle_rad", "f8", 3, "rad", "", "roll, pitch, yaw of the rotary manipulator"),
    Field("rate_radps", "f8", 3, "rad/s", "", "their rates"),
)

MANIPULATOR_SAMPLE_FIELDS: Final = (
    number("t_s", "s", "time of the run, that of the cycle's row"),
    Field("setpoint", GIMBALS_FIELDS),
    Field("feedback", GIMBALS_FIELDS),
    number("sampled_s", "s", "when the encoders had these values, time of the run"),
    Field("chaser_setpoint", AXES_FIELDS),
    Field("chaser_feedback", AXES_FIELDS),
)
MANIPULATOR_SAMPLE: Final = record_dtype(MANIPULATOR_SAMPLE_FIELDS)
"""Last setpoints and newest encoder values of all nine axes in a cycle; chaser: rails and turntable, in the lab.

In a cycle's record the axes of a rig whose target is rotated are relative to the target."""


HELD_SAMPLE_FIELDS: Final = (
    number("t_s", "s", "time of the run, that of the cycle's row"),
    whole("group", "number of the group in `held_axes.json`, from 0"),
    Field("setpoint", "f8", AXES_MAX, "SI", "", "of its axes, m or rad; of axes that it lacks zero"),
    Field("position", "f8", AXES_MAX, "SI", "", "by the encoders, m or rad"),
    Field("rate", "f8", AXES_MAX, "SI", "", "by the encoders, m/s or rad/s"),
    number("sampled_s", "s", "when the encoders had these values, time of the run"),
)
HELD_SAMPLE: Final = record_dtype(HELD_SAMPLE_FIELDS)
"""Places and newest encoder values of one group in a cycle."""
