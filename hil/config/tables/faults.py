"""Faults of devices, as data: the tables of all kinds, and the timetable ``[[faults]]`` of a scenario.

A fault is a term of a device's error model that acts for a time; an emulated device has faults of its wires as well.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import Annotated, Any, Final, Literal, Self

from pydantic import Field, ValidationInfo, field_validator, model_validator

from hil.config.tables.model import ConfigModel, NotNegative, Positive
from hil.errors import one_line
from hil.maths import linear

ALWAYS_S: Final = 1e9
"""End of a fault without ``until_s``."""

_SHOWN: Final = 60  # characters of a value in an error
Vector = Annotated[tuple[float, ...], Field(min_length=1, max_length=3)]
Sensor = Literal["gyro", "accelerometer"]


@dataclass(frozen=True)
class ErrorTerm:
    """A kind of fault of a kind of device.

    values: number of components of ``value``, 0 for none; default: of a value that may be omitted. unit, frame: of the
    value. low, high: range of each component; for a vector of its magnitude. effect: what the device does. of_axis: it
    hits one axis of an emulated device. once: it happens when it is switched on, and is over then.
    """

    effect: str
    values: int = 0
    unit: str = ""
    frame: str = ""
    low: float = 0.0
    high: float = 0.0
    default: float | None = None
    options: tuple[str, ...] = ()
    of_axis: bool = False
    once: bool = False

    @property
    def count(self) -> str:
        """Number of components and unit of the value, for errors."""
        return f"{'one number' if self.values == 1 else f'{self.values} numbers'}{self._in_unit}"

    @property
    def _in_unit(self) -> str:
        return f" in {self.unit}" if self.unit not in ("", "1", "share", "factor") else ""

    def problem(self, value: tuple[float, ...]) -> str:
        """Return what is wrong with ``value``, "" if it is allowed."""
        shown = f"{value[0]:g}" if len(value) == 1 else str(list(value))
        if len(value) != self.values:
            return f"value = {shown}: must be {self.count}"
        size = linear.length(value) if self.values == 3 else None
        sizes = value if size is None else (size,)
        if not all(self.low <= entry <= self.high for entry in sizes):
            of = "the magnitude" if size is not None else "each number" if self.values > 1 else "it"
            return f"value = {shown}: {of} must be {self.low:g} to {self.high:g}{self._in_unit}"
        return ""


FACTOR_MAX: Final = 1000.0

TERMS: Final[dict[str, dict[str, ErrorTerm]]] = {
    "vmu": {
        "no_pose": ErrorTerm("frames come without a pose"),
        "frozen": ErrorTerm("repeats its last pose and covariance, with fresh time stamps"),
        "offset": ErrorTerm("poses mean a chaser that is displaced", 3, "m", "H", 0.0, 100.0),
        "drift": ErrorTerm("the displacement grows from 0 at this rate", 3, "m/s", "H", 0.0, 10.0),
        "outlier": ErrorTerm("this fraction of the poses is displaced by `size_m` in a random direction", 1, "1", "",
                             1e-6, 1.0, options=("size_m",)),
        "noise_scale": ErrorTerm("the noise is this multiple of the reported one, which does not change", 1, "1", "",
                                 1.0, FACTOR_MAX),
        "sigma_scale": ErrorTerm("the reported standard deviations are multiplied by this factor", 1, "1", "",
                                 1.0 / FACTOR_MAX, FACTOR_MAX),
        "latency": ErrorTerm("poses come later by this time; `stamp` is their exposure, or their arrival", 1, "s", "",
                             0.0, 1.0, options=("stamp",)),
        "misidentified": ErrorTerm("LEDs are taken for those this many places further round the ring", 1, "1",
                                   "t", 1.0, 5.0, 1.0),
        "dimmed": ErrorTerm("the LEDs lose this fraction of their light: noise and reported noise grow, too dim LEDs "
                            "give no pose", 1, "1", "", 0.0, 1.0),
    },
    "imu": {
        "bias_step": ErrorTerm("the drift or bias changes by this value", 3, "deg/s or m/s^2", "c", 0.0, 100.0,
                               options=("sensor",)),
        "scale_factor": ErrorTerm("readings are multiplied by this factor", 1, "1", "", -FACTOR_MAX, FACTOR_MAX,
                                  options=("sensor",)),
        "dropout": ErrorTerm("all readings are zero"),
        "noise_scale": ErrorTerm("the noise of a reading is this multiple of its nominal one", 1, "1", "",
                                 1.0, FACTOR_MAX, options=("sensor",)),
        "stuck": ErrorTerm("readings repeat the last one", options=("sensor",)),
    },
    "thruster": {
        "stuck_open": ErrorTerm("the valve stays open"),
        "stuck_closed": ErrorTerm("the valve stays closed"),
        "leak": ErrorTerm("a closed valve gives this fraction of the thrust", 1, "1", "", 0.0, 1.0),
        "force_scale": ErrorTerm("the thrust is multiplied by this factor", 1, "1", "", 0.0, 10.0),
        "delay": ErrorTerm("the valve follows its command after this time", 1, "s", "", 0.0, 1.0),
        "minimum_on": ErrorTerm("a valve that opened stays open for this time", 1, "s", "", 0.0, 10.0),
    },
    "axis": {
        "stuck": ErrorTerm("the axis stands still, whatever its setpoint"),
        "slow": ErrorTerm("the largest rate is this fraction of its own", 1, "1", "", 0.0, 1.0),
        "offset": ErrorTerm("the encoder reads this much too high", 1, "m or deg", "", -100.0, 100.0),
        "oscillation": ErrorTerm("the axis moves about its setpoint: amplitude, frequency", 2, "m or deg, Hz", "",
                                 0.0, 100.0),
    },
    "monitor": {},
    "sensor": {
        "no_sample": ErrorTerm("measures nothing"),
        "frozen": ErrorTerm("repeats its last measurement, with fresh time stamps"),
        "offset": ErrorTerm("components one to three are displaced; fewer numbers: the first ones", 3,
                            "the component's unit", "", 0.0, 1e6),
        "drift": ErrorTerm("the displacement grows from 0 at this rate per second", 3, "the component's unit per s",
                           "", 0.0, 1e6),
        "outlier": ErrorTerm("this fraction of the measurements is displaced by 30 reported standard deviations", 1,
                             "1", "", 1e-6, 1.0),
        "noise_scale": ErrorTerm("the noise is this multiple of the reported one, which does not change", 1, "1", "",
                                 1.0, FACTOR_MAX),
        "sigma_scale": ErrorTerm("the reported standard deviations are multiplied by this factor", 1, "1", "",
                                 1.0 / FACTOR_MAX, FACTOR_MAX),
        "latency": ErrorTerm("measurements come later by this time; `stamp` is their moment, or their arrival", 1, "s",
                             "", 0.0, 1.0, options=("stamp",)),
    },
    "target": {
        "jump": ErrorTerm("the target is displaced", 3, "m", "H", 0.0, 10.0),
        "drift": ErrorTerm("the target moves at this velocity", 3, "m/s", "H", 0.0, 1.0),
        "plume": ErrorTerm("plumes push the target, a sphere of this radius", 1, "m", "", 0.0, 10.0),
    },
}  # fmt: skip
"""Kind of device -> kind of fault -> term: for models, injection, tests and the generated reference."""
_OF_LEDS: Final = ("misidentified", "dimmed")
TERMS["monitor"].update({kind: term for kind, term in TERMS["vmu"].items() if kind not in _OF_LEDS})
TERMS["monitor"] |= {kind: replace(TERMS["vmu"][kind], frame="c") for kind in ("offset", "drift")}

EMULATED: Final[dict[str, dict[str, ErrorTerm]]] = {
    "wire": {
        "drop": ErrorTerm("packets are lost", 1, "share", "", 0.0, 1.0, 1.0),
        "corrupt": ErrorTerm("bits of packets are flipped", 1, "share", "", 0.0, 1.0, 1.0),
        "delay": ErrorTerm("packets come late", 1, "s", "", 0.0, 10.0, 0.2),
        "duplicate": ErrorTerm("packets come twice", 1, "share", "", 0.0, 1.0, 1.0),
        "freeze": ErrorTerm("the device repeats its last values"),
        "link_down": ErrorTerm("the wire is dead"),
    },
    "drive": {
        "stuck": ErrorTerm("the axis does not move, whatever its setpoint", of_axis=True),
        "jump": ErrorTerm("the encoder jumps", 1, "m or deg", "", -100.0, 100.0, 0.1, of_axis=True, once=True),
        "reversed": ErrorTerm("the encoder counts the wrong way", of_axis=True),
        "mirrored": ErrorTerm("motor and encoder are both the wrong way round", of_axis=True),
        "scaled": ErrorTerm("the drive counts a multiple of the displacement", 1, "factor", "", 0.0, FACTOR_MAX, 1.0,
                            of_axis=True),
        "runaway": ErrorTerm("the drive ignores all commands and moves at a constant speed, 0 for its present one", 1,
                             "m/s or deg/s", "", 0.0, 100.0, 0.0, of_axis=True),
        "drive_fault": ErrorTerm("the drive reports a fault", 1, "code", "", 0.0, 65535.0, 0.0, of_axis=True,
                                 once=True),
    },
    "vmu": {"clock_jump": ErrorTerm("the unit's clock is off", 1, "s", "", 0.0, 1e6, 10.0)},
    "io": {
        "estop": ErrorTerm("the emergency stop is pressed"),
        "interlock": ErrorTerm("an interlock's contact is open", of_axis=True),
        "brakes_open": ErrorTerm("the holding brakes do not close, nor does their contact"),
        "pump_ignored": ErrorTerm("the relay does not monitor the charge pump"),
        "local_enable_off": ErrorTerm("the switch at the bench does not permit power and motion"),
        "busy": ErrorTerm("this fraction of the requests finds the coupler busy", 1, "share", "", 0.0, 1.0, 0.05),
        "odd_frames": ErrorTerm("this fraction of the responses is no Modbus", 1, "share", "", 0.0, 1.0, 0.02),
        "other_unit": ErrorTerm("responses have this unit id", 1, "1", "", 0.0, 255.0, 255.0),
    },
    "camera": {
        "drop": ErrorTerm("packets are lost", 1, "share", "", 0.0, 1.0, 1.0),
        "delay": ErrorTerm("images come late", 1, "s", "", 0.0, 10.0, 0.1),
        "freeze": ErrorTerm("the camera repeats its last image"),
        "dark": ErrorTerm("the lens is covered"),
        "link_down": ErrorTerm("the wire is dead"),
    },
}  # fmt: skip
"""Part of an emulated device -> kind of fault -> term: for the emulators and their control ports, and the reference."""


@dataclass(frozen=True)
class FaultResponse:
    """What the program does about a kind of fault, alone and at the sizes of its test.

    detected_by: as in ``injected`` of the JSON, None if not for sure. detection: the monitor, and how soon. test: that
    which shows it.
    """

    detected_by: Literal["navigation", "monitor", "guard", "device"] | None
    detection: str
    reaction: str
    test: str


_TEST: Final = "tests/system/test_faults.py::test_fault_is_detected_as_the_table_states"
_WITHIN: Final = "tests/system/test_faults.py::test_fault_that_is_not_detected_for_sure_stays_within_the_limits"


def _navigation(detection: str, reaction: str) -> FaultResponse:
    return FaultResponse("navigation", f"health: {detection}", reaction, _TEST)


def _excluded(detection: str) -> FaultResponse:
    return FaultResponse("navigation", f"health: {detection}", "the sensor is excluded", _TEST)


def _within(detection: str) -> FaultResponse:
    return FaultResponse(None, detection, "none while truth and estimate are within their limits", _WITHIN)


def _guard(detection: str) -> FaultResponse:
    return FaultResponse("guard", detection, "safe stop", _TEST)


def _both(detection: str) -> FaultResponse:
    return FaultResponse("navigation", f"health; bench guard: {detection}", "hold, later safe stop", _TEST)


def _interlock(detection: str) -> FaultResponse:
    text = f"interlock: two measurements beyond five sigmas of monitor and navigation, {detection}"
    return FaultResponse("monitor", text, "hold, later abort", _TEST)


RESPONSES: Final[dict[str, FaultResponse]] = {
    "vmu.no_pose": _navigation("vision lost; reaction once the protection level asks for it", "hold, later abort"),
    "vmu.sigma_scale": _within("suspect innovations, by their mean NIS, after 10 s to minutes"),
    "vmu.latency": _within("none with the stamp of the exposure; that of the arrival shifts innovations in motion"),
    "vmu.dimmed": _within("vision lost, if too dim at their range; none before, as the report allows for the noise"),
    "imu.bias_step": _navigation("IMU or vision suspect, by innovations and thrusters", "hold, later abort"),
    "imu.scale_factor": _within("suspect innovations once the chaser accelerates or turns"),
    "imu.dropout": _navigation("IMU suspect: readings that repeat", "commanded thrust replaces the IMU, no go"),
    "imu.noise_scale": _within("none: below the noise of the poses"),
    "imu.stuck": _navigation("IMU suspect: ten readings that repeat", "commanded thrust replaces the IMU, no go"),
    "thruster.stuck_open": _navigation("thruster fault, by the IMU", "abort"),
    "thruster.stuck_closed": _navigation("thruster fault, by the IMU, once it was commanded a few times", "abort"),
    "thruster.leak": _navigation(
        "thruster fault, by the IMU, from about a third of the thrust on; below, a disturbance", "abort"
    ),
    "thruster.force_scale": _within("thruster fault, by the IMU, from about half of the thrust on"),
    "thruster.delay": _within("none: control allows for it"),
    "thruster.minimum_on": _navigation("thruster fault, by the IMU, from about 0.5 s on", "abort"),
    "vmu.frozen": _both("pose against encoders, once the chaser has moved by five sigmas and for five poses more"),
    "vmu.offset": _both("pose against encoders, five poses if beyond five sigmas"),
    "vmu.drift": _both("pose against encoders, once beyond five sigmas; below that encoders against the estimate"),
    "vmu.outlier": _both("pose against encoders, if five in a row are beyond five sigmas"),
    "vmu.noise_scale": _both("pose against encoders, if five in a row are beyond five reported sigmas"),
    "vmu.misidentified": _both("pose against encoders, five poses"),
    "monitor.frozen": _interlock("once the chaser has moved that far"),
    "monitor.offset": _interlock("if larger"),
    "monitor.drift": _interlock("once larger"),
    "monitor.outlier": _interlock("if two in a row are outliers"),
    "monitor.no_pose": _within("none: the interlock stays as it is while nothing is measured"),
    "monitor.noise_scale": _within("interlock, if two measurements in a row are beyond five reported sigmas"),
    "monitor.sigma_scale": _within("none: a larger one only makes the interlock less strict"),
    "monitor.latency": _within("interlock in motion, if stamped with the arrival"),
    "axis.stuck": _guard("axis against the demand, 0.5 s from 2 mm/s or 0.1 deg/s on"),
    "axis.slow": _guard("axis against the demand, once slower than demanded"),
    "axis.offset": _guard("axis against the demand as the reading steps; later pose against encoders"),
    "axis.oscillation": _guard("axis against the demand, from amplitudes of 0.6 mm or 0.03 deg on"),
    "sensor.no_sample": _within("none: the others carry on, and the protection level grows by what it gave"),
    "sensor.frozen": _excluded("sensor suspect, by its innovations once the chaser has moved"),
    "sensor.offset": _excluded("sensor suspect, by rejections or the CUSUM of its innovations"),
    "sensor.drift": _excluded("sensor suspect, by the CUSUM of its innovations"),
    "sensor.outlier": _within("the gate rejects outliers; sensor suspect if they are many"),
    "sensor.noise_scale": _within("sensor suspect, by its mean NIS, if much larger than reported"),
    "sensor.sigma_scale": _within("sensor suspect, by its mean NIS, if much smaller than the noise"),
    "sensor.latency": _within(
        "none with the stamp of the measurement; that of the arrival shifts innovations in motion"
    ),
    "target.jump": _guard("axis against the demand, if farther than the axes move in three cycles"),
    "target.drift": _both("axis against the demand, if faster than the axes can follow"),
    "target.plume": _within("none: control allows for it as for stronger or weaker thrusters"),
}
"""Device and kind of fault -> response."""

AXES: Final = ("rails.x", "rails.y", "rails.z", "turntable.roll", "turntable.pitch", "turntable.yaw")


class TimedFault(ConfigModel):
    """A fault of a device, in the run's time."""

    at_s: NotNegative
    """Onset."""
    until_s: Positive | None = None
    """End; default: the end of the run."""
    device: str
    """`vmu`, `imu`, `thruster.1` and so on in the scenario's order, `rails.x`, `turntable.roll`, ..., `monitor`,
    `sensor.NAME`, `target`."""
    kind: str
    """Kind of fault: see [Faults](faults.md)."""
    value: float | Vector | None = None
    """Size, in unit and frame of the kind."""
    size_m: Annotated[float, Field(gt=0.0, le=100.0)] | None = None
    """Displacement of an outlier."""
    sensor: Sensor | None = None
    """Sensor of an IMU's fault; unless set, the gyro."""
    stamp: Literal["exposure", "arrival"] | None = None
    """Time stamp of poses that come late; unless set, the exposure."""

    @field_validator("value", mode="before")
    @classmethod
    def _value_is_of_the_kind(cls, value: Any, info: ValidationInfo) -> Any:
        """Name what the kind of fault takes, whatever type ``value`` has."""
        numbers = value if isinstance(value, list | tuple) else [value]
        if value is None or (1 <= len(numbers) <= 3 and all(_is_number(number) for number in numbers)):
            return tuple(map(float, value)) if isinstance(value, list) else value
        term = TERMS.get(_family_of(info.data.get("device", "")), {}).get(info.data.get("kind", ""))
        allowed = term.count if term is not None and term.values else "a number, or a list of 1 to 3 numbers"
        raise ValueError(f"{one_line(json.dumps(value, default=str), _SHOWN)}: must be {allowed}")

    @model_validator(mode="after")
    def _is_in_the_table(self) -> Self:
        kinds = TERMS.get(self.family)
        if kinds is None or self.number < 0:
            raise ValueError(f'device = "{self.device}": must be one of {", ".join(devices())}')
        if self.kind not in kinds:
            raise ValueError(f'kind = "{self.kind}": {self.device} has {", ".join(kinds)}')
        if self.until_s is not None and self.until_s <= self.at_s:
            raise ValueError(f"until_s = {self.until_s:g}: must be later than at_s = {self.at_s:g}")
        term = kinds[self.kind]
        for option in ("size_m", "sensor", "stamp"):
            if getattr(self, option) is not None and option not in term.options:
                raise ValueError(f'{option} does not go with kind = "{self.kind}"')
        if "size_m" in term.options and self.size_m is None:
            raise ValueError(f'kind = "{self.kind}" needs size_m')
        return self._checked_value(term)

    def _checked_value(self, term: ErrorTerm) -> Self:
        if self.value is None:
            if term.values and term.default is None:
                unit = f" in {term.unit}" if term.unit != "1" else ""
                raise ValueError(f'kind = "{self.kind}" needs value{unit}')
        elif not term.values:
            raise ValueError(f'value does not go with kind = "{self.kind}"')
        elif problem := term.problem(self.values):
            raise ValueError(problem)
        return self

    @property
    def family(self) -> str:
        """Kind of device: a key of TERMS, otherwise the device's name."""
        return _family_of(self.device)

    @property
    def member(self) -> str:
        """What follows the family in the name of the device: name of a sensor."""
        return self.device.partition(".")[2]

    @property
    def number(self) -> int:
        """Index of a thruster or an axis, from 0; -1 if it is no number."""
        if self.family == "axis":
            return AXES.index(self.device)
        if self.family != "thruster":
            return 0
        digits = self.member
        return int(digits) - 1 if digits.isascii() and digits.isdigit() and len(digits) < 4 else -1

    @property
    def values(self) -> tuple[float, ...]:
        """Components of the value, the default if it is omitted."""
        if self.value is None:
            default = TERMS[self.family][self.kind].default
            return () if default is None else (default,)
        numbers = self.value if isinstance(self.value, tuple) else (self.value,)
        if self.family == "sensor" and TERMS["sensor"][self.kind].values == 3:
            return (*numbers, 0.0, 0.0)[:3]
        return numbers

    @property
    def end_s(self) -> float:
        """End, in the run's time."""
        return ALWAYS_S if self.until_s is None else self.until_s


def _family_of(device: str) -> str:
    if device in AXES:
        return "axis"
    name, dot, _ = device.partition(".")
    return name if (dot != "") == (name in ("thruster", "sensor")) else device


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def devices() -> tuple[str, ...]:
    """Return the names of all devices that can have faults."""
    return ("vmu", "imu", "thruster.1, thruster.2 ...", *AXES, "monitor", "sensor.NAME", "target")
