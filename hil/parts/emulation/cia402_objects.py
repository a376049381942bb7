"""Object dictionary of one emulated CiA 402 drive, from a data sheet; canopen's SDO server answers requests."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import canopen
from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from hil.config.rig import Cia402
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.eds import SHIPPED
from hil.drivers.turntable.cia402.eds_file import MAPPED_MAX, Variable, read_data_sheet
from hil.drivers.turntable.cia402.units import velocity_per_radps

_NO_SUCH_OBJECT = 0x06020000
_NO_SUCH_SUBINDEX = 0x06090011
_READ_ONLY = 0x06010002
_WRONG_LENGTH = 0x06070010
_OUT_OF_RANGE = 0x06090030
_NOT_MAPPABLE = 0x06040041
_WRONG_STATE = 0x08000022
_REFUSED = 0x08000000
_UNKNOWN_COMMAND = 0x05040001

_PDOS = [
    codec.numbered(pdo, number)
    for pdo in (codec.SETPOINT_PDO, codec.FEEDBACK_PDO)
    for number in range(codec.PDOS_OF_A_NODE)
]
_MAPPINGS = frozenset((*range(0x1600, 0x1800), *range(0x1A00, 0x1C00)))
_FORMATS = {8: "b", 16: "H", 32: "i"}  # formats of mappable objects, by bits
_TRANSMISSIONS = (*range(241), 254, 255)
_OLD_ERROR = 0x7305
_PROFILE_AREA = 0x2000
_SERVO_DRIVE = 0x0002_0192  # device type
_INCREMENTS, _INCREMENTS_PER_S = 0x00B50000, 0x00B50300
_BITS = 32  # of an object whose size the data sheet does not give


@dataclass(slots=True)
class Object:
    """One entry: ``size`` in bytes; ``low`` and ``high`` of values that may be written, None: all.

    text: of a string, which has no value.
    """

    size: int
    value: int = 0
    writable: bool = False
    low: int | None = None
    high: int | None = None
    mappable: bool = False
    text: bytes = b""


@dataclass(frozen=True, slots=True)
class MappedPdo:
    """A PDO whose mapping is fixed for as long as the node is operational."""

    identifier: int
    transmission: int
    layout: struct.Struct
    objects: tuple[Object, ...]
    indices: frozenset[int]
    is_sent: bool

    def pack(self) -> bytes:
        return self.layout.pack(*(entry.value for entry in self.objects))

    def unpack(self, data: bytes) -> None:
        for entry, value in zip(self.objects, self.layout.unpack_from(data), strict=True):
            entry.value = value


class ObjectDictionary:
    """Objects of the drive ``node_id`` and their access by SDO. Item access is to sub-index 0.

    The drive is set up for the rig: scales that can be written are those of ``config``, as are its habits.
    """

    def __init__(self, config: Cia402, node_id: int, watchdog_ms: int) -> None:
        variables = read_data_sheet(SHIPPED if config.eds_file is None else Path(config.eds_file)).variables
        self.habits = config.emulated
        self.entries = {
            key: _object_of(variable, node_id)
            for key, variable in variables.items()
            if key[0] not in self.habits.missing
        }
        for index in [index for (index, sub), entry in self.entries.items() if not sub and entry.writable]:
            for sub in range(1, (MAPPED_MAX if index in _MAPPINGS else 0) + 1):
                self.entries.setdefault((index, sub), Object(4, writable=True))
        self._set_up(config, watchdog_ms, variables)
        self.object_dictionary = canopen.ObjectDictionary()  # of canopen's server, which asks for the data alone
        self._server = _SdoServer(self)
        self._operational = False
        self._written: int | None = None

    def _set_up(self, config: Cia402, watchdog_ms: int, variables: dict[tuple[int, int], Variable]) -> None:
        self._set(codec.SETPOINT_PDO.parameter, codec.PDO_EVENT_TIMER, watchdog_ms)
        if not self.value(codec.DEVICE_TYPE):
            self.entries[codec.DEVICE_TYPE, 0] = Object(4, _SERVO_DRIVE)
        self._scale(config)
        unit = self.value(codec.VELOCITY_UNIT) if self.habits.velocity_unit is None else self.habits.velocity_unit
        self.velocity = velocity_per_radps(config, unit if _is_of_an_angle(unit) else _INCREMENTS_PER_S)
        if not self.habits.declares_velocity:
            self.entries.pop((codec.VELOCITY_UNIT, 0), None)
        elif self.habits.velocity_unit is not None:
            self.entries.setdefault((codec.VELOCITY_UNIT, 0), Object(4)).value = unit
        if self.habits.supported_modes is not None:
            self.entries.setdefault(codec.SUPPORTED_MODES, Object(4)).value = self.habits.supported_modes
        elif self.value(*codec.SUPPORTED_MODES) == 0:
            objects = {1: (codec.PROFILE_VELOCITY, 0), 6: (codec.HOMING_METHOD, 0), 7: (codec.INTERPOLATION_DATA, 1)}
            modes = [mode for mode, key in objects.items() if key in self.entries]
            target = variables.get((codec.TARGET_POSITION, 0))
            modes += [codec.CYCLIC_SYNCHRONOUS_POSITION] if target is not None and target.is_mappable else []
            self._set(*codec.SUPPORTED_MODES, sum(1 << mode - 1 for mode in modes))
        if self.habits.keeps_error:
            self._set(codec.ERROR_CODE, 0, _OLD_ERROR)

    def _scale(self, config: Cia402) -> None:
        """Set the scales that can be written to those of the rig file."""
        turn = Fraction(config.counts_per_turn) / Fraction(config.gear_ratio).limit_denominator(1000)
        if self._can_write(codec.POSITION_UNIT, 0):
            self._set(codec.POSITION_UNIT, 0, _INCREMENTS)
        if self.value(codec.FEED_CONSTANT, 1) > 1 and self._can_write(codec.FEED_CONSTANT, 1):
            self._set_ratio(codec.FEED_CONSTANT, turn)
        if self._can_write(codec.POSITION_FACTOR, 1):
            self._set_ratio(codec.POSITION_FACTOR, Fraction(1))
        gear = Fraction(1)
        if self._can_write(codec.ENCODER_RESOLUTION, 1):
            scale = Fraction(self.habits.declared_scale).limit_denominator(1000)
            self._set_ratio(codec.ENCODER_RESOLUTION, turn * scale)
        elif encoder := self.value(codec.ENCODER_RESOLUTION, 1):
            gear = turn / encoder
        if self._can_write(codec.GEAR_RATIO, 1):
            self._set_ratio(codec.GEAR_RATIO, gear)

    def _can_write(self, index: int, subindex: int) -> bool:
        entry = self.entries.get((index, subindex))
        return entry is not None and entry.writable

    def _set(self, index: int, subindex: int, value: int) -> None:
        if (entry := self.entries.get((index, subindex))) is not None:
            entry.value = value

    def _set_ratio(self, index: int, ratio: Fraction) -> None:
        self._set(index, 1, ratio.numerator)
        self._set(index, 2, ratio.denominator)

    def __getitem__(self, index: int) -> Object:
        return self.entries[(index, 0)]

    def remove(self, index: int) -> None:
        """Make this a drive without object ``index``."""
        del self.entries[(index, 0)]

    def value(self, index: int, subindex: int = 0) -> int:
        """Return an object's value, 0 for one that this drive does not have."""
        entry = self.entries.get((index, subindex))
        return entry.value if entry else 0

    def put(self, index: int, value: int, subindex: int = 0) -> None:
        """Set an object's value, if this drive has it."""
        self._set(index, subindex, value)

    def map_pdos(self) -> dict[int, MappedPdo]:
        """Return the PDOs that are valid now, by identifier."""
        pdos = {}
        for pdo in _PDOS:
            identifier = self.value(pdo.parameter, 1) & 0xFFFF_FFFF
            if identifier & codec.PDO_INVALID or (pdo.parameter, 1) not in self.entries:
                continue
            places = range(1, self.value(pdo.mapping_index) + 1)
            mapping = [self.value(pdo.mapping_index, subindex) & 0xFFFF_FFFF for subindex in places]
            keys = [(entry >> 16, entry >> 8 & 0xFF) for entry in mapping]
            if any(entry & 0xFF not in _FORMATS for entry in mapping) or not self.entries.keys() >= set(keys):
                continue  # it does not concern motion
            layout = struct.Struct("<" + "".join(_FORMATS[entry & 0xFF] for entry in mapping))
            objects = tuple(self.entries[key] for key in keys)
            indices = frozenset(index for index, _ in keys)
            transmission, is_sent = self.value(pdo.parameter, 2) & 0xFF, pdo.parameter >= codec.FEEDBACK_PDO.parameter
            pdos[identifier & 0x7FF] = MappedPdo(identifier & 0x7FF, transmission, layout, objects, indices, is_sent)
        return pdos

    def serve(self, request: bytes, operational: bool) -> tuple[bytes, int | None]:
        """Answer one SDO request; return the reply and the index that was written, if any."""
        self._operational, self._written = operational, None
        self._server.on_request(0, request, 0.0)
        return self._server.reply, self._written

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:
        """Return the content of an object (called by canopen)."""
        entry = self._find(index, subindex)
        return entry.text or (entry.value & (1 << 8 * entry.size) - 1).to_bytes(entry.size, "little")

    def set_data(self, index: int, subindex: int, data: bytes, check_writable: bool = False) -> None:
        """Write an object (called by canopen). Raises SdoAbortedError."""
        entry = self._find(index, subindex)
        value = int.from_bytes(data, "little", signed=True)
        if not entry.writable:
            raise SdoAbortedError(_READ_ONLY)
        if len(data) != entry.size:
            raise SdoAbortedError(_WRONG_LENGTH)
        if index in self.habits.aborts:
            raise SdoAbortedError(_REFUSED)
        if not self._allows(index, subindex, value, entry):
            raise SdoAbortedError(_OUT_OF_RANGE)
        if index in _MAPPINGS:
            self._check_mapping(index, subindex, value & 0xFFFF_FFFF)
        entry.value, self._written = value, index

    def _allows(self, index: int, subindex: int, value: int, entry: Object) -> bool:
        unsigned = value & (1 << 8 * entry.size) - 1
        if index in codec.PDO_PARAMETERS and subindex == 1:
            needs_bit = self.habits.no_remote_frames and index >= codec.FEEDBACK_PDO.parameter
            return not needs_bit or bool(unsigned & codec.PDO_NO_RTR)
        if index in codec.PDO_PARAMETERS and subindex == 2:
            return unsigned in _TRANSMISSIONS
        if index == codec.MODE and (supported := self.value(*codec.SUPPORTED_MODES)):
            return value > 0 and bool(supported >> value - 1 & 1)
        if entry.low is None or entry.high is None or index < _PROFILE_AREA:  # of CiA 301's objects it is no choice
            return True
        return entry.low <= (value if entry.low < 0 else unsigned) <= entry.high

    def _check_mapping(self, index: int, subindex: int, value: int) -> None:
        if self._operational or (subindex > 0 and self[index].value != 0):
            raise SdoAbortedError(_WRONG_STATE)
        if subindex > 0:
            entry = self.entries.get((value >> 16, value >> 8 & 0xFF))
            if value >> 16 in self.habits.missing:
                raise SdoAbortedError(self.habits.missing_code)
            if entry is None or not entry.mappable or entry.size * 8 != value & 0xFF:
                raise SdoAbortedError(_NOT_MAPPABLE)

    def _find(self, index: int, subindex: int) -> Object:
        entry = self.entries.get((index, subindex))
        if entry is None:
            missing = self.habits.missing_code if index in self.habits.missing else _NO_SUCH_OBJECT
            raise SdoAbortedError(_NO_SUCH_SUBINDEX if (index, 0) in self.entries else missing)
        return entry


class _SdoServer(SdoServer):
    """canopen's SDO server, whose reply is kept."""

    def __init__(self, objects: ObjectDictionary) -> None:
        super().__init__(codec.SDO_REQUEST_ID, codec.SDO_REPLY_ID, objects)
        self._index = self._subindex = 0
        self.reply = b""

    def send_response(self, response: bytes) -> None:
        self.reply = bytes(response)

    def block_upload(self, data: bytes) -> None:
        _, self._index, self._subindex = struct.unpack_from("<BHB", data)
        raise SdoAbortedError(_UNKNOWN_COMMAND)


def _is_of_an_angle(unit: int) -> bool:
    return unit >> 16 & 0xFF in (0x10, 0x41, 0x42, 0x43, 0xB4, 0xB5)


def _object_of(variable: Variable, node_id: int) -> Object:
    if isinstance(variable.default, str):
        return Object(0, text=variable.default.encode("latin-1", "replace") or b"\0")
    value = (variable.number or 0) + node_id * variable.is_relative
    size = (variable.bits or _BITS) // 8
    return Object(size, value, variable.is_writable, variable.low, variable.high, variable.is_mappable)
