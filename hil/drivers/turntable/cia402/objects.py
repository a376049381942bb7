"""Object dictionary, PDO mapping and SDO server of one emulated CiA 402 drive."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from hil.drivers.turntable.cia402 import codec as codec

_SDO = struct.Struct("<BHB4s")
_ABORT = struct.Struct("<BHBI")
_NO_SUCH_OBJECT = 0x06020000
_NO_SUCH_SUBINDEX = 0x06090011
_READ_ONLY = 0x06010002
_WRONG_LENGTH = 0x06070010
_OUT_OF_RANGE = 0x06090030
_NOT_MAPPABLE = 0x06040041
_WRONG_STATE = 0x08000022
_UNKNOWN_COMMAND = 0x05040001

_PDOS = (codec.SETPOINT_PDO, codec.CONTROL_PDO, codec.FEEDBACK_PDO, codec.STATUS_PDO)
_MAPPING_INDICES = tuple(pdo.mapping_index for pdo in _PDOS)
_MODES = (codec.PROFILE_POSITION, codec.HOMING, codec.CYCLIC_SYNCHRONOUS_POSITION)
_FORMATS = {16: "H", 32: "i"}  # of mappable objects, by bits


class _Refused(Exception):
    """An SDO abort with its code."""

    def __init__(self, code: int) -> None:
        self.code = code


@dataclass(slots=True)
class Object:
    """One entry: ``size`` in bytes; ``allowed`` low bytes of values that may be written, empty: all.

    text: of a string, which has no value.
    """

    size: int
    value: int = 0
    writable: bool = False
    allowed: tuple[int, ...] = ()
    mappable: bool = False
    text: bytes = b""


@dataclass(frozen=True, slots=True)
class MappedPdo:
    """A PDO whose mapping is fixed for as long as the node is operational."""

    identifier: int
    transmission: int
    layout: struct.Struct
    objects: tuple[Object, ...]

    def pack(self) -> bytes:
        return self.layout.pack(*(entry.value for entry in self.objects))

    def unpack(self, data: bytes) -> None:
        for entry, value in zip(self.objects, self.layout.unpack_from(data), strict=True):
            entry.value = value


class ObjectDictionary:
    """Objects of the drive and their access by SDO. Item access is to sub-index 0."""

    def __init__(self, watchdog_ms: int) -> None:
        self.entries = _drive_objects() | _pdo_objects(watchdog_ms)
        self._string = b""  # rest of a segmented upload

    def __getitem__(self, index: int) -> Object:
        return self.entries[(index, 0)]

    def remove(self, index: int) -> None:
        """Make this a drive without object ``index``."""
        del self.entries[(index, 0)]

    def value(self, index: int, subindex: int = 0) -> int:
        """Return an object's value, 0 for one that this drive does not have."""
        entry = self.entries.get((index, subindex))
        return entry.value if entry else 0

    def map_pdos(self) -> dict[int, MappedPdo]:
        """Return the PDOs that are valid now, by identifier."""
        pdos = {}
        for pdo in _PDOS:
            identifier = self.value(pdo.parameter, 1) & 0xFFFF_FFFF
            if identifier & codec.PDO_INVALID:
                continue
            places = range(1, self.value(pdo.mapping_index) + 1)
            mapping = [self.value(pdo.mapping_index, place) & 0xFFFF_FFFF for place in places]
            layout = struct.Struct("<" + "".join(_FORMATS[entry & 0xFF] for entry in mapping))
            objects = tuple(self.entries[(entry >> 16, entry >> 8 & 0xFF)] for entry in mapping)
            pdos[identifier] = MappedPdo(identifier, self.value(pdo.parameter, 2), layout, objects)
        return pdos

    def serve(self, request: bytes, operational: bool) -> tuple[bytes, int | None]:
        """Answer one expedited SDO request; return the reply and the index that was written, if any."""
        command, index, subindex, data = _SDO.unpack(request)
        try:
            if command & 0xE0 == 0x40:
                return self._upload(index, subindex), None
            if command & 0xE0 == 0x60:
                return self._next_segment(command & 0x10), None
            if command & 0xE2 != 0x22:
                raise _Refused(_UNKNOWN_COMMAND)
            size = 4 - (command >> 2 & 3) if command & 1 else 4
            return self._download(index, subindex, data[:size], operational), index
        except _Refused as refused:
            return _ABORT.pack(0x80, index, subindex, refused.code), None

    def _upload(self, index: int, subindex: int) -> bytes:
        entry = self._find(index, subindex)
        if entry.text:
            self._string = entry.text
            return _SDO.pack(0x41, index, subindex, len(entry.text).to_bytes(4, "little"))
        data = (entry.value & (1 << 8 * entry.size) - 1).to_bytes(entry.size, "little")
        return _SDO.pack(0x43 | (4 - entry.size) << 2, index, subindex, data)

    def _next_segment(self, toggle: int) -> bytes:
        segment, self._string = self._string[:7], self._string[7:]
        if not segment:
            raise _Refused(_UNKNOWN_COMMAND)
        return bytes((toggle | (7 - len(segment)) << 1 | (not self._string),)) + segment.ljust(7, b"\0")

    def _download(self, index: int, subindex: int, data: bytes, operational: bool) -> bytes:
        entry = self._find(index, subindex)
        value = int.from_bytes(data, "little", signed=True)
        if not entry.writable:
            raise _Refused(_READ_ONLY)
        if len(data) != entry.size:
            raise _Refused(_WRONG_LENGTH)
        if entry.allowed and value & 0xFF not in entry.allowed:
            raise _Refused(_OUT_OF_RANGE)
        if index in _MAPPING_INDICES:
            self._check_mapping(index, subindex, value & 0xFFFF_FFFF, operational)
        entry.value = value
        return _SDO.pack(0x60, index, subindex, bytes(4))

    def _check_mapping(self, index: int, place: int, value: int, operational: bool) -> None:
        if operational or (place > 0 and self[index].value != 0):
            raise _Refused(_WRONG_STATE)
        if place > 0:
            entry = self.entries.get((value >> 16, value >> 8 & 0xFF))
            if entry is None or not entry.mappable or entry.size * 8 != value & 0xFF:
                raise _Refused(_NOT_MAPPABLE)

    def _find(self, index: int, subindex: int) -> Object:
        entry = self.entries.get((index, subindex))
        if entry is None:
            raise _Refused(_NO_SUCH_SUBINDEX if (index, 0) in self.entries else _NO_SUCH_OBJECT)
        return entry


def _drive_objects() -> dict[tuple[int, int], Object]:
    return {
        (codec.DEVICE_TYPE, 0): Object(4, 0x0002_0192),  # servo drive, profile 402
        (codec.ERROR_REGISTER, 0): Object(1),
        (codec.FIRMWARE, 0): Object(0, text=b"emulated drive 1.0"),
        (codec.HEARTBEAT_PRODUCER, 0): Object(2, 0, True),
        (codec.IDENTITY, 0): Object(1, 4),
        (codec.IDENTITY, 1): Object(4, 0x0000_0B0B),  # vendor, product, revision, serial number
        (codec.IDENTITY, 2): Object(4, 0x0001_0402),
        (codec.IDENTITY, 3): Object(4, 0x0001_0000),
        (codec.IDENTITY, 4): Object(4, 1),
        (codec.ABORT_CONNECTION_OPTION, 0): Object(2, 1, True, (codec.ABORT_QUICK_STOPS,)),
        (codec.ERROR_CODE, 0): Object(2, mappable=True),
        (codec.CONTROLWORD, 0): Object(2, 0, True, mappable=True),
        (codec.STATUSWORD, 0): Object(2, mappable=True),
        (codec.QUICK_STOP_OPTION, 0): Object(2, 2, True, (codec.QUICK_STOP_STAYS,)),
        (codec.MODE, 0): Object(1, 0, True, _MODES),
        (codec.MODE_DISPLAY, 0): Object(1),
        (codec.POSITION_ACTUAL, 0): Object(4, mappable=True),
        (codec.FOLLOWING_ERROR_WINDOW, 0): Object(4, codec.UNLIMITED_WINDOW, True),
        (codec.FOLLOWING_ERROR_TIME_OUT, 0): Object(2, 0, True),
        (codec.VELOCITY_ACTUAL, 0): Object(4, mappable=True),
        (codec.TARGET_POSITION, 0): Object(4, 0, True, mappable=True),
        (codec.PROFILE_VELOCITY, 0): Object(4, 0, True),
        (codec.PROFILE_ACCELERATION, 0): Object(4, 0, True),
        (codec.PROFILE_DECELERATION, 0): Object(4, 0, True),
        (codec.HOMING_METHOD, 0): Object(1, 0, True),
        (codec.HOMING_SPEEDS, 0): Object(1, 2),
        (codec.HOMING_SPEEDS, 1): Object(4, 0, True),
        (codec.HOMING_SPEEDS, 2): Object(4, 0, True),
        (codec.HOMING_ACCELERATION, 0): Object(4, 0, True),
        (codec.VELOCITY_OFFSET, 0): Object(4, 0, True, mappable=True),
        (codec.DIGITAL_INPUTS, 0): Object(4, mappable=True),
    }


def _pdo_objects(watchdog_ms: int) -> dict[tuple[int, int], Object]:
    objects = {}
    for pdo in _PDOS:
        objects[(pdo.parameter, 0)] = Object(1, 5)
        objects[(pdo.parameter, 1)] = Object(4, codec.PDO_INVALID, True)
        objects[(pdo.parameter, 2)] = Object(1, 255, True, (1, 255))
        timer_ms = watchdog_ms if pdo is codec.SETPOINT_PDO else 0
        objects[(pdo.parameter, codec.PDO_EVENT_TIMER)] = Object(2, timer_ms, True)
        for place in range(9):
            objects[(pdo.mapping_index, place)] = Object(1 if place == 0 else 4, 0, True)
    return objects
