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
