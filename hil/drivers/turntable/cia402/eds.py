"""Electronic data sheets (CiA 306) of CiA 402 drives, checked for the objects that the driver uses."""

from __future__ import annotations

import configparser
import io
import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import canopen
from canopen.objectdictionary import ODVariable, datatypes
from canopen.objectdictionary.eds import import_eds

from hil.config.rig import Cia402
from hil.core.files import MIB, read_text
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import Pdo
from hil.errors import BadInput, Problem

# canopen logs what it also raises; without a handler that would go to the terminal
logging.getLogger("canopen").addHandler(logging.NullHandler())

_BYTES_MAX: Final = 4 * MIB
SHIPPED: Final = Path(__file__).parent / "data" / "emulated-drive.eds"

_I8, _I16, _I32 = datatypes.INTEGER8, datatypes.INTEGER16, datatypes.INTEGER32
_U8, _U16, _U32 = datatypes.UNSIGNED8, datatypes.UNSIGNED16, datatypes.UNSIGNED32
_NAMES: Final = {
    _I8: "INTEGER8",
    _I16: "INTEGER16",
    _I32: "INTEGER32",
    _U8: "UNSIGNED8",
    _U16: "UNSIGNED16",
    _U32: "UNSIGNED32",
}
_WRITABLE: Final = ("rw", "wo", "rww", "rwr")
_OPTIONAL: Final = (codec.VELOCITY_OFFSET, codec.DIGITAL_INPUTS)


@dataclass(frozen=True)
class Need:
    """An object that the driver reads or writes: its type, and whether it is written."""

    index: int
    data_type: int
    written: bool = False
    subindex: int = 0


def _needs() -> list[Need]:
    needs = [
        Need(codec.DEVICE_TYPE, _U32),
        Need(codec.HEARTBEAT_PRODUCER, _U16, True),
        Need(codec.IDENTITY, _U32, subindex=1),
        Need(codec.ABORT_CONNECTION_OPTION, _I16, True),
        Need(codec.ERROR_CODE, _U16),
        Need(codec.CONTROLWORD, _U16, True),
        Need(codec.STATUSWORD, _U16),
        Need(codec.QUICK_STOP_OPTION, _I16, True),
        Need(codec.MODE, _I8, True),
        Need(codec.MODE_DISPLAY, _I8),
        Need(codec.POSITION_ACTUAL, _I32),
        Need(codec.VELOCITY_ACTUAL, _I32),
        Need(codec.TARGET_POSITION, _I32, True),
    ]
    for pdo in (codec.SETPOINT_PDO, codec.CONTROL_PDO, codec.FEEDBACK_PDO, codec.STATUS_PDO):
        needs += [Need(pdo.parameter, _U32, True, 1), Need(pdo.parameter, _U8, True, 2)]
        needs += [Need(pdo.mapping_index, _U8, True), Need(pdo.mapping_index, _U32, True, 1)]
    needs += [Need(pdo.parameter, _U16, True, codec.PDO_EVENT_TIMER) for pdo in (codec.SETPOINT_PDO, codec.STATUS_PDO)]
    return needs


def _homing_needs() -> list[Need]:
    return [
        Need(codec.HOMING_METHOD, _I8, True),
        Need(codec.HOMING_SPEEDS, _U32, True, 1),
        Need(codec.HOMING_SPEEDS, _U32, True, 2),
        Need(codec.HOMING_ACCELERATION, _U32, True),
    ]


_MAPPED: Final = (
    codec.CONTROLWORD,
    codec.STATUSWORD,
    codec.POSITION_ACTUAL,
    codec.VELOCITY_ACTUAL,
    codec.TARGET_POSITION,
)
_PROFILE: Final = (codec.PROFILE_VELOCITY, codec.PROFILE_ACCELERATION, codec.PROFILE_DECELERATION)


class Eds:
    """A data sheet that was read; ``variables`` by index and sub-index.

    homing: an axis needs homing. Raises BadInput with everything that the driver misses.
    """

    def __init__(self, path: Path, homing: bool = False) -> None:
        self.path = path
        self.variables = variables_of(read_eds(path))
        problems = [text for need in [*_needs(), *(_homing_needs() if homing else [])] if (text := self._fault(need))]
        for index in _MAPPED:
            variable = self._find(index)
            if variable is not None and not variable.pdo_mappable:
                problems.append(f"0x{index:04X}: PDOMapping=0: the driver must map it into a PDO, allowed: 1")
        if problems:
            raise BadInput([Problem(str(path), *text.split(": ", 1)) for text in problems])

    @classmethod
    def of(cls, config: Cia402, homing: bool = False) -> Eds:
        """Return the data sheet of a rig's drives. Raises BadInput with everything that the driver misses in it."""
        return cls(SHIPPED if config.eds_file is None else Path(config.eds_file), homing)

    @property
    def has_profiles(self) -> bool:
        """Whether the drive has what profile position mode needs."""
        return all(self._find(index) is not None for index in _PROFILE)

    def maps(self, pdo: Pdo) -> bool:
        """Return whether all that ``pdo`` holds can be mapped."""
        variables = [self._find(index) for index, _ in pdo.mapping]
        return all(variable is not None and variable.pdo_mappable for variable in variables)

    def _find(self, index: int, subindex: int = 0) -> Any:
        return self.variables.get((index, subindex))

    def _fault(self, need: Need) -> str:
        """Return the problem of one object, "" for none."""
        key = f"0x{need.index:04X}" + (f" sub {need.subindex}" if need.subindex else "")
        variable = self._find(need.index, need.subindex)
        if variable is None:
            return f"{key}: is missing: the driver needs it"
        if variable.data_type != need.data_type:
            actual = _NAMES.get(variable.data_type, f"0x{variable.data_type:04X}")
            return f"{key}: DataType is {actual}, allowed: {_NAMES[need.data_type]}"
        if need.written and variable.access_type not in _WRITABLE:
            return f"{key}: AccessType={variable.access_type}: the driver writes it, allowed: {', '.join(_WRITABLE)}"
        return ""


def read_eds(path: Path) -> canopen.ObjectDictionary:
    """Return the object dictionary of a data sheet. Raises BadInput."""
    text = read_text(path, _BYTES_MAX, "latin-1")  # encodings of vendors differ
    if "[DeviceInfo]" not in text:
        raise BadInput.single(str(path), "", "not an EDS file: section [DeviceInfo] is missing")
    try:
        dictionary: canopen.ObjectDictionary = import_eds(io.StringIO(text), None)
    except (configparser.Error, ValueError, KeyError, TypeError) as error:
        raise BadInput.single(str(path), "", f"not an EDS file: {error}") from error
    return dictionary


def variables_of(dictionary: canopen.ObjectDictionary) -> dict[tuple[int, int], ODVariable]:
    """Return the variables of an object dictionary by index and sub-index."""
    variables: dict[tuple[int, int], ODVariable] = {}
    for entry in dictionary.values():
        members = [entry] if isinstance(entry, ODVariable) else list(entry.values())
        variables |= {(variable.index, variable.subindex): variable for variable in members}
    return variables
