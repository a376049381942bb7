"""Object dictionary and PDO mapping of one emulated CiA 402 drive; canopen's SDO server answers requests."""

from __future__ import annotations

import struct
from dataclasses import dataclass

from canopen.objectdictionary import ODVariable
from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.eds import SHIPPED, read_eds, variables_of

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
_ALLOWED = {
    (codec.ABORT_CONNECTION_OPTION, 0): (codec.ABORT_QUICK_STOPS,),
    (codec.QUICK_STOP_OPTION, 0): (codec.QUICK_STOP_STAYS,),
    (codec.MODE, 0): (codec.PROFILE_POSITION, codec.HOMING, codec.CYCLIC_SYNCHRONOUS_POSITION),
    **{(pdo.parameter, 2): (1, 255) for pdo in _PDOS},
}
"""Low bytes of values that may be written, of objects with few."""
_FORMATS = {16: "H", 32: "i"}  # formats of mappable objects, by bits


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
        self.object_dictionary = read_eds(SHIPPED)
        self.entries = {key: _object_of(variable) for key, variable in variables_of(self.object_dictionary).items()}
        self.entries[(codec.SETPOINT_PDO.parameter, codec.PDO_EVENT_TIMER)].value = watchdog_ms
        self._server = _SdoServer(self)
        self._operational = False
        self._written: int | None = None

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
            mapping = [self.value(pdo.mapping_index, subindex) & 0xFFFF_FFFF for subindex in places]
            layout = struct.Struct("<" + "".join(_FORMATS[entry & 0xFF] for entry in mapping))
            objects = tuple(self.entries[(entry >> 16, entry >> 8 & 0xFF)] for entry in mapping)
            pdos[identifier] = MappedPdo(identifier, self.value(pdo.parameter, 2), layout, objects)
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
        if entry.allowed and value & 0xFF not in entry.allowed:
            raise SdoAbortedError(_OUT_OF_RANGE)
        if index in _MAPPING_INDICES:
            self._check_mapping(index, subindex, value & 0xFFFF_FFFF)
        entry.value, self._written = value, index

    def _check_mapping(self, index: int, subindex: int, value: int) -> None:
        if self._operational or (subindex > 0 and self[index].value != 0):
            raise SdoAbortedError(_WRONG_STATE)
        if subindex > 0:
            entry = self.entries.get((value >> 16, value >> 8 & 0xFF))
            if entry is None or not entry.mappable or entry.size * 8 != value & 0xFF:
                raise SdoAbortedError(_NOT_MAPPABLE)

    def _find(self, index: int, subindex: int) -> Object:
        entry = self.entries.get((index, subindex))
        if entry is None:
            raise SdoAbortedError(_NO_SUCH_SUBINDEX if (index, 0) in self.entries else _NO_SUCH_OBJECT)
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


def _object_of(variable: ODVariable) -> Object:
    key = (variable.index, variable.subindex)
    if isinstance(variable.default, str):
        return Object(0, text=variable.default.encode("ascii"))
    return Object(
        len(variable) // 8, variable.default or 0, variable.writable, _ALLOWED.get(key, ()), variable.pdo_mappable
    )
