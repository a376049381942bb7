"""Objects of one CiA 402 drive by SDO, and the mapping of its PDOs.

canopen's SDO client does the transfers, pumped from the bus in the calling thread: no notifier thread, so an error of
the bus is raised here. Blocks; each reply is waited for at most REPLY_WALL_S.
"""

from __future__ import annotations

from collections.abc import Callable

import canopen
from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from hil.core.clock import BenchClock
from hil.drivers.can_port import CanPort
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import Pdo
from hil.drivers.turntable.cia402.eds import Eds
from hil.errors import LinkTimeout, ProtocolError

REPLY_WALL_S = 0.3
_SDO_BYTES = 8
_INVALID_VALUE = 0x06090030
_WITHOUT_RTR = 0xFFFF_FFFF & ~codec.PDO_NO_RTR
_ABSENT = (0x06020000, 0x06090011)  # no such object, no such sub-index

_OTHER_REMEDY = "check its state and data sheet with the tool of its maker"
_REMEDIES = {
    codec.INTERPOLATION_PERIOD: "run the scenario at a rate whose period the drive takes",
    codec.QUICK_STOP_OPTION: "set 6, or 5, with the tool of its maker: the axis must keep its torque after a stop",
    codec.ABORT_CONNECTION_OPTION: "set 3, quick stop, with the tool of its maker",
    codec.HEARTBEAT_CONSUMER: "without a watchdog of the drive only the safety chain stops it",
    codec.MODE: "the mode must be one of 0x6502",
}
"""What to do if the drive refuses a setting, by object."""

Handler = Callable[[int, bytes], None]


class PortNetwork(canopen.Network):
    """Network of canopen's clients on a ``CanPort``."""

    def __init__(self, port: CanPort) -> None:
        super().__init__()
        self._port = port

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        self._port.send((can_id, bytes(data)))


class _PumpedClient(SdoClient):
    """canopen's SDO client that reads the bus itself while it waits."""

    RESPONSE_TIMEOUT = 0.0

    def __init__(
        self, port: CanPort, network: canopen.Network, node_id: int, others: Handler, clock: BenchClock
    ) -> None:
        super().__init__(codec.SDO_REQUEST_ID + node_id, codec.SDO_REPLY_ID + node_id, ObjectDictionary())
        self.network = network
        self._port = port
        self._others = others
        self._clock = clock
        network.subscribe(self.tx_cobid, self.on_response)

    def read_response(self) -> bytes:
        end_s = self._clock.host_s() + REPLY_WALL_S
        while self.responses.empty() and (left_s := end_s - self._clock.host_s()) > 0.0:
            frame = self._port.receive(left_s)
            if frame is not None and frame[0] == self.tx_cobid and len(frame[1]) == _SDO_BYTES:
                self.on_response(frame[0], bytearray(frame[1]), 0.0)
            elif frame is not None:
                self._others(*frame)
        return super().read_response()  # type: ignore[no-any-return]


class DriveObjects:
    """Objects of one drive on the bus. Errors name ``axis``: LinkTimeout, ProtocolError.

    others: handler of received frames that are not SDO responses of this drive. clock: of the time-outs.
    """

    def __init__(
        self,
        port: CanPort,
        network: canopen.Network,
        node_id: int,
        axis: str,
        eds: Eds,
        others: Handler,
        clock: BenchClock,
    ) -> None:
        self.axis = axis
        self.node_id = node_id
        self._eds = eds
        self._clock = clock
        self._sdo = _PumpedClient(port, network, node_id, others, clock)

    def text(self, index: int) -> str:
        data = self._transfer(index, 0, lambda: self._sdo.upload(index, 0)) or b""
        return data.rstrip(b"\0 ").decode("ascii", "replace")

    def read(self, index: int, subindex: int = 0) -> int | None:
        """Return a whole number of any size; None if the data sheet does not have it, or the drive does not."""
        if (index, subindex) not in self._eds.variables:
            return None
        try:
            data = self._transfer(index, subindex, lambda: self._sdo.upload(index, subindex)) or b""
        except ProtocolError as error:
            if _abort_code(error) is None:
                raise
            return None
        return int.from_bytes(data[:4], "little", signed=True)

    def get(self, index: int, size: int, subindex: int = 0) -> int:
        """Read one whole number of ``size`` bytes, signed."""
        data = self._transfer(index, subindex, lambda: self._sdo.upload(index, subindex))
        if data is None or len(data) < size:
            name = codec.object_name(index, subindex)
            raise ProtocolError(self.axis, f"object {name} is shorter than {size} bytes")
        return int.from_bytes(data[:size], "little", signed=True)

    def put(self, index: int, value: int, size: int, subindex: int = 0) -> None:
        """Write one whole number of ``size`` bytes."""
        data = (value & (1 << 8 * size) - 1).to_bytes(size, "little")
        self._transfer(index, subindex, lambda: self._sdo.download(index, subindex, data), value)

    def set(self, index: int, value: int, size: int, subindex: int = 0) -> None:
        """Write a setting unless the drive has it already, and read it back. Raises ProtocolError if it differs."""
        mask = (1 << 8 * size) - 1
        present = self.read(index, subindex)
        if present is not None and present & mask == value & mask:
            return
        self.put(index, value, size, subindex)
        if (actual := self.get(index, size, subindex)) & mask != value & mask:
            name = codec.object_name(index, subindex)
            raise ProtocolError(self.axis, f"object {name} is {actual} after {value} was written")

    def map_either(self, full: Pdo, plain: Pdo, skip_full: bool = False) -> bool:
        """Map ``full``, or ``plain`` if the EDS lacks one of its objects or the drive refuses it; return which."""
        if self._eds.maps(full) and not skip_full:
            try:
                self.map(full)
            except ProtocolError as error:
                if _abort_code(error) is None:
                    raise
            else:
                return True
        self.map(plain)
        return False

    def map(self, pdo: Pdo) -> None:
        """Write one PDO in the order that CiA 301 asks for: invalid, no entries, entries, count, valid.

        The bit that forbids remote frames stays as the drive has it; a drive that has none of them insists on it.
        """
        is_movable = self._eds.can_write(pdo.parameter, 1)
        identifier = self._invalidated(pdo) if is_movable else 0
        if not is_movable and (given := self.get(pdo.parameter, 4, 1)) & _WITHOUT_RTR != pdo.identifier + self.node_id:
            name = codec.object_name(pdo.parameter, 1)
            raise ProtocolError(self.axis, f"object {name} is 0x{given & 0xFFFF_FFFF:X}: the driver cannot change it")
        if self._eds.can_write(pdo.parameter, 2) or pdo.parameter >= codec.FEEDBACK_PDO.parameter:
            self.set(pdo.parameter, pdo.transmission, 1, subindex=2)  # a fixed one of a setpoint: it acts at once
        mapping = [index << 16 | subindex << 8 | bits for index, subindex, bits in pdo.mapping]
        if not self._has_mapping(pdo.mapping_index, mapping):
            self.put(pdo.mapping_index, 0, 1)
            for each, entry in enumerate(mapping, start=1):
                self.put(pdo.mapping_index, entry, 4, subindex=each)
            self.put(pdo.mapping_index, len(mapping), 1)
        if is_movable:
            self.put(pdo.parameter, identifier, 4, subindex=1)

    def _invalidated(self, pdo: Pdo) -> int:
        """Make a PDO invalid; return the identifier that makes it valid."""
        kept = (self.read(pdo.parameter, 1) or 0) & codec.PDO_NO_RTR
        identifier = pdo.identifier + self.node_id | kept
        try:
            self.put(pdo.parameter, identifier | codec.PDO_INVALID, 4, subindex=1)
        except ProtocolError as error:
            if _abort_code(error) != _INVALID_VALUE or kept or pdo.parameter < codec.FEEDBACK_PDO.parameter:
                raise
            identifier |= codec.PDO_NO_RTR
            self.put(pdo.parameter, identifier | codec.PDO_INVALID, 4, subindex=1)
        return identifier

    def _has_mapping(self, index: int, mapping: list[int]) -> bool:
        present = [self.read(index, each) for each in range(len(mapping) + 1)]
        return [each is not None and each & 0xFFFF_FFFF for each in present] == [len(mapping), *mapping]

    def _transfer(
        self, index: int, subindex: int, transfer: Callable[[], bytes | None], value: int | None = None
    ) -> bytes | None:
        name = codec.object_name(index, subindex)
        for tries_left in (1, 0):
            try:
                return transfer()
            except SdoAbortedError as error:
                what = name if value is None else f"{name} = {value}"
                text = f"refuses object {what}: {error}: {_REMEDIES.get(index, _OTHER_REMEDY)}"
                if error.code in _ABSENT:
                    text = (
                        f"object {name} of the data sheet does not exist in the drive: enter its own as cia402.eds_file"
                    )
                raise ProtocolError(self.axis, text) from error
            except SdoCommunicationError as error:
                if tries_left:
                    continue  # a frame was lost or damaged
                what = f"node {self.node_id} does not answer for object {name} within {REPLY_WALL_S:g} s"
                raise LinkTimeout(self.axis, what) from error
        raise AssertionError("unreachable")


def _abort_code(error: ProtocolError) -> int | None:
    """Return the code with which the drive has refused an object; None for another error."""
    return error.__cause__.code if isinstance(error.__cause__, SdoAbortedError) else None
