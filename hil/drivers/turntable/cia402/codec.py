"""CiA 402 drives on CANopen: frames <-> numbers. No I/O, no clock.

Sources: CiA 301 (identifiers, SDO, NMT, EMCY, PDO parameters), CiA 402-2 / IEC 61800-7-201 (objects,
state machine, error codes). All numbers on the wire are little-endian.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from hil.core.messages import Homing
from hil.errors import FaultKind

NMT_ID: Final = 0x000
SYNC_ID: Final = 0x080
EMCY_ID: Final = 0x080  # these and the following + node id
TPDO1_ID: Final = 0x180
RPDO1_ID: Final = 0x200
TPDO2_ID: Final = 0x280
RPDO2_ID: Final = 0x300
SDO_REPLY_ID: Final = 0x580
SDO_REQUEST_ID: Final = 0x600
HEARTBEAT_ID: Final = 0x700

NMT_START: Final = 0x01
NMT_STOP: Final = 0x02
NMT_PRE_OPERATIONAL: Final = 0x80
NMT_RESET_NODE: Final = 0x81
NMT_RESET_COMMUNICATION: Final = 0x82

REMOTE: Final = 1 << 30
"""Flag of an identifier of this package: a remote frame, which has no data."""

DEVICE_TYPE: Final = 0x1000
ERROR_REGISTER: Final = 0x1001
DEVICE_PROFILE: Final = 402  # low half of the device type
ERROR_FIELD: Final = 0x1003  # 1: the newest error, its code in the low half
SYNC_OBJECT: Final = 0x1005  # identifier of SYNC
CYCLE_PERIOD: Final = 0x1006  # between two SYNC, us
GUARD_TIME: Final = 0x100C  # ms; times LIFE_TIME_FACTOR: the node expects a remote frame of its master
LIFE_TIME_FACTOR: Final = 0x100D
HEARTBEAT_CONSUMER: Final = 0x1016  # 1: node id << 16 | time, ms
FIRMWARE: Final = 0x100A
HEARTBEAT_PRODUCER: Final = 0x1017  # ms
IDENTITY: Final = 0x1018  # 1 vendor, 2 product, 3 revision
ABORT_CONNECTION_OPTION: Final = 0x6007
ABORT_QUICK_STOPS: Final = 3
ABORT_REACTIONS: Final = (ABORT_QUICK_STOPS, 1, 2)  # quick stop, fault, disable voltage
ERROR_CODE: Final = 0x603F
CONTROLWORD: Final = 0x6040
STATUSWORD: Final = 0x6041
QUICK_STOP_OPTION: Final = 0x605A
QUICK_STOP_STAYS: Final = 6  # slow down on the quick-stop ramp, stay in quick stop active
QUICK_STOP_REACTIONS: Final = (QUICK_STOP_STAYS, 5)  # 5: slow down on the ramp of the profile, stay
MODE: Final = 0x6060
MODE_DISPLAY: Final = 0x6061
PROFILE_POSITION: Final = 1
HOMING: Final = 6
INTERPOLATED_POSITION: Final = 7
CYCLIC_SYNCHRONOUS_POSITION: Final = 8
MODE_NAMES: Final = {
    PROFILE_POSITION: "profile position",
    HOMING: "homing",
    INTERPOLATED_POSITION: "interpolated position",
    CYCLIC_SYNCHRONOUS_POSITION: "cyclic synchronous position",
}
POSITION_ACTUAL: Final = 0x6064
FOLLOWING_ERROR_WINDOW: Final = 0x6065  # counts; UNLIMITED_WINDOW: no supervision
FOLLOWING_ERROR_TIME_OUT: Final = 0x6066  # ms
UNLIMITED_WINDOW: Final = 0xFFFF_FFFF
VELOCITY_ACTUAL: Final = 0x606C
MAX_TORQUE: Final = 0x6072  # per mille of the rated torque
TARGET_POSITION: Final = 0x607A
PROFILE_VELOCITY: Final = 0x6081
PROFILE_ACCELERATION: Final = 0x6083
PROFILE_DECELERATION: Final = 0x6084
HOMING_METHOD: Final = 0x6098
HOMING_SPEEDS: Final = 0x6099  # 1 towards the switch, 2 towards its edge
HOMING_ACCELERATION: Final = 0x609A
HOMING_OBJECTS: Final = ((HOMING_METHOD, 0), (HOMING_SPEEDS, 1), (HOMING_SPEEDS, 2))
ENCODER_RESOLUTION: Final = 0x608F  # 1 increments per 2 revolutions of the motor
GEAR_RATIO: Final = 0x6091  # 1 revolutions of the motor per 2 of the shaft
FEED_CONSTANT: Final = 0x6092  # 1 position units per 2 revolutions of the shaft
POSITION_FACTOR: Final = 0x6093  # 1 increments per 2 position units
POSITION_UNIT: Final = 0x60A8
VELOCITY_UNIT: Final = 0x60A9
VELOCITY_OFFSET: Final = 0x60B1
INTERPOLATION_SUBMODE: Final = 0x60C0  # 0: linear
INTERPOLATION_DATA: Final = 0x60C1
INTERPOLATION_PERIOD: Final = 0x60C2  # 1 value, 2 exponent of 10, s
BUFFER: Final = 0x60C4  # 6: 1 allows access to the buffer
DIGITAL_INPUTS: Final = 0x60FD
SUPPORTED_MODES: Final = (0x6502, 0)  # bit n - 1: mode n

RPDO_TIMEOUT: Final = 0x8250
GUARD_LOST: Final = 0x8130
TORQUE_OFF: Final = 0x5441
OVER_CURRENT: Final = 0x2310
FOLLOWING_ERROR: Final = 0x8611

BOOT_UP: Final = 0x00  # NMT states in a heartbeat
STOPPED: Final = 0x04
OPERATIONAL: Final = 0x05
PRE_OPERATIONAL: Final = 0x7F
TOGGLE: Final = 0x80  # alternates in the answers to life guarding

SHUTDOWN: Final = 0x06
SWITCH_ON: Final = 0x07
ENABLE_OPERATION: Final = 0x0F
DISABLE_VOLTAGE: Final = 0x00
QUICK_STOP: Final = 0x02
FAULT_RESET: Final = 0x80
START_HOMING: Final = 0x1F  # controlword bit 4 in homing mode, the drive being enabled
INTERPOLATE: Final = 0x1F  # controlword bit 4 in interpolated position mode
NEW_SETPOINT: Final = 0x3F  # bits 4 and 5 in profile position mode: move to the target at once

TARGET_REACHED: Final = 0x0400  # statusword
SETPOINT_TAKEN: Final = 0x1000  # in profile position mode
HOMING_ATTAINED: Final = 0x1000  # in homing mode
HOMING_ERROR: Final = 0x2000

LOW_LIMIT: Final = 0x1  # digital inputs
HIGH_LIMIT: Final = 0x2


class DriveState(Enum):
    """States of the drive's power machine: name, statusword mask, statusword value."""

    NOT_READY = ("not ready to switch on", 0x4F, 0x00)
    SWITCH_ON_DISABLED = ("switch on disabled", 0x4F, 0x40)
    READY = ("ready to switch on", 0x6F, 0x21)
    SWITCHED_ON = ("switched on", 0x6F, 0x23)
    ENABLED = ("operation enabled", 0x6F, 0x27)
    QUICK_STOP_ACTIVE = ("quick stop active", 0x6F, 0x07)
    FAULT_REACTION = ("fault reaction active", 0x4F, 0x0F)
    FAULT = ("fault", 0x4F, 0x08)

    def __init__(self, title: str, mask: int, bits: int) -> None:
        self.title = title
        self.mask = mask
        self.bits = bits


FAULT_STATES: Final = (DriveState.FAULT, DriveState.FAULT_REACTION)


def state_of(statusword: int) -> DriveState | None:
    """Return the state that a statusword shows, None for a pattern that the profile does not define."""
    for state in DriveState:
        if statusword & state.mask == state.bits:
            return state
    return None


TOWARDS_ENABLED: Final = {
    DriveState.SWITCH_ON_DISABLED: SHUTDOWN,
    DriveState.READY: SWITCH_ON,
    DriveState.SWITCHED_ON: ENABLE_OPERATION,
    DriveState.QUICK_STOP_ACTIVE: DISABLE_VOLTAGE,
}
"""Controlword that moves a drive one state towards operation enabled; in other states the driver waits."""


@dataclass(frozen=True, slots=True)
class Pdo:
    """One process data object as set-up writes it: parameter and mapping index, identifier, contents.

    transmission: 1 = with every SYNC, 255 = at once on change. mapping: (index, sub-index, bits) in their order.
    """

    parameter: int
    mapping_index: int
    identifier: int
    transmission: int
    mapping: tuple[tuple[int, int, int], ...]


def numbered(pdo: Pdo, number: int) -> Pdo:
    """Return ``pdo`` as number 0 to 3 of its direction."""
    step = number - (pdo.parameter & 0x1FF)
    identifier = pdo.identifier + 0x100 * step
    return replace(pdo, parameter=pdo.parameter + step, mapping_index=pdo.mapping_index + step, identifier=identifier)


_POSITION, _VELOCITY = (POSITION_ACTUAL, 0, 32), (VELOCITY_ACTUAL, 0, 32)
SETPOINT_PDO: Final = Pdo(0x1400, 0x1600, RPDO1_ID, 1, ((TARGET_POSITION, 0, 32), (VELOCITY_OFFSET, 0, 32)))
SETPOINT_PDO_PLAIN: Final = replace(SETPOINT_PDO, mapping=((TARGET_POSITION, 0, 32),))
INTERPOLATION_PDO: Final = replace(SETPOINT_PDO, mapping=((INTERPOLATION_DATA, 1, 32),))
CONTROL_PDO: Final = Pdo(0x1401, 0x1601, RPDO2_ID, 255, ((CONTROLWORD, 0, 16),))
FEEDBACK_PDO: Final = Pdo(0x1800, 0x1A00, TPDO1_ID, 1, (_POSITION, _VELOCITY))
FEEDBACK_PDO_PLAIN: Final = replace(FEEDBACK_PDO, mapping=(_POSITION,))
STATUS_PDO: Final = Pdo(0x1801, 0x1A01, TPDO2_ID, 255, ((STATUSWORD, 0, 16), (DIGITAL_INPUTS, 0, 32)))
STATUS_PDO_PLAIN: Final = replace(STATUS_PDO, mapping=((STATUSWORD, 0, 16),))
COMMAND_PDO: Final = replace(CONTROL_PDO, mapping=(*CONTROL_PDO.mapping, (TARGET_POSITION, 0, 32)))
INTERPOLATED_COMMAND_PDO: Final = replace(CONTROL_PDO, mapping=(*CONTROL_PDO.mapping, *INTERPOLATION_PDO.mapping))
REPORT_PDO: Final = replace(STATUS_PDO, transmission=1, mapping=(*STATUS_PDO_PLAIN.mapping, _POSITION))
"""PDOs of a drive that has no two of them to map: control and setpoint in one, statusword and position in one."""
PDOS_OF_A_NODE: Final = 4  # in each direction, with identifiers of the predefined connection set
PDO_PARAMETERS: Final = frozenset((*range(0x1400, 0x1600), *range(0x1800, 0x1A00)))

PDO_EVENT_TIMER: Final = 5  # sub-index, ms: a TPDO is sent, an RPDO is due at least this often
PDO_INVALID: Final = 1 << 31  # bit of the identifier entry: this PDO does not exist
PDO_NO_RTR: Final = 1 << 30  # of a TPDO: it is not sent on request

SETPOINT_TIME_OUT: Final = "setpoint time-out, 0x1400:05"
HEARTBEAT_GUARD: Final = "heartbeat of the bench, 0x1016:01"
LIFE_GUARD: Final = "life guarding, 0x100C and 0x100D"
GUARDS_PER_LIFE: Final = 5

_SETPOINT = struct.Struct("<ii")
_SETPOINT_PLAIN = struct.Struct("<i")
_FEEDBACK = struct.Struct("<ii")
_WORD = struct.Struct("<H")
_STATUS = struct.Struct("<HI")
_EMCY = struct.Struct("<HB5s")


def encode_setpoint(target: int, velocity_offset: int) -> bytes:
    """Return the data of SETPOINT_PDO: in the drive's units of position and velocity."""
    return _SETPOINT.pack(target, velocity_offset)


def encode_plain_setpoint(target: int) -> bytes:
    """Return the data of SETPOINT_PDO_PLAIN and INTERPOLATION_PDO: in the drive's unit of position."""
    return _SETPOINT_PLAIN.pack(target)


def object_name(index: int, subindex: int = 0) -> str:
    """Return ``0x6040``, ``0x1400:05``."""
    return f"0x{index:04X}" + (f":{subindex:02X}" if subindex else "")


def decode_feedback(data: bytes, has_velocity: bool = True) -> tuple[int, int | None]:
    """Return position and velocity in the drive's units of FEEDBACK_PDO; FEEDBACK_PDO_PLAIN has no velocity, None.

    Raises ValueError on a wrong length.
    """
    if not has_velocity:
        return _unpack(_SETPOINT_PLAIN, data)[0], None
    position, velocity = _unpack(_FEEDBACK, data)
    return position, velocity


def encode_control(controlword: int) -> bytes:
    """Return the data of CONTROL_PDO."""
    return _WORD.pack(controlword)


def decode_status(data: bytes) -> tuple[int, int]:
    """Return statusword and digital inputs of STATUS_PDO; STATUS_PDO_PLAIN has no inputs, 0. Raises ValueError."""
    if len(data) == _WORD.size:
        return int(_unpack(_WORD, data)[0]), 0
    statusword, inputs = _unpack(_STATUS, data)
    return statusword, inputs


def homing_of(statusword: int) -> Homing:
    """Return the homing state in the statusword of a drive in homing mode that was commanded to start."""
    if statusword & HOMING_ERROR:
        return Homing.FAILED
    both = HOMING_ATTAINED | TARGET_REACHED
    return Homing.DONE if statusword & both == both else Homing.UNDER_WAY


def limit_of(inputs: int) -> int:
    """Return the active limit switch of the digital inputs: -1 low, 1 high, 0 none."""
    return int(bool(inputs & HIGH_LIMIT)) - int(bool(inputs & LOW_LIMIT))


def encode_emergency(error_code: int, error_register: int) -> bytes:
    """Return the data of an EMCY frame; code 0: no error any more."""
    return _EMCY.pack(error_code, error_register, bytes(5))


def decode_emergency(data: bytes) -> int:
    """Return the error code of an EMCY frame. Raises ValueError on a wrong length."""
    return int(_unpack(_EMCY, data)[0])


def _unpack(layout: struct.Struct, data: bytes) -> tuple[int, ...]:
    if len(data) != layout.size:
        raise ValueError(f"{len(data)} bytes instead of {layout.size}: {data.hex(' ')}")
    return layout.unpack(data)


FAULT_NAMES: Final = {
    OVER_CURRENT: "continuous over-current",
    0x2320: "short circuit",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "device over-temperature",
    0x4310: "drive over-temperature",
    0x5113: "logic supply too low",
    TORQUE_OFF: "safe torque off",
    0x6010: "software watchdog",
    0x6320: "parameter error",
    0x7121: "motor blocked",
    0x7305: "encoder fault",
    0x7500: "communication error",
    0x8120: "CAN error passive",
    GUARD_LOST: "heartbeat or guarding lost",
    0x8140: "recovered from bus off",
    RPDO_TIMEOUT: "setpoint time-out",
    FOLLOWING_ERROR: "following error",
    0x8612: "reference limit",
}


def fault_kind(code: int) -> FaultKind:
    """Return the kind of an error code."""
    return FaultKind.TORQUE_OFF if code == TORQUE_OFF else FaultKind.OTHER


def fault_text(code: int) -> str:
    """Return code and name of an error code (object 0x603F or EMCY)."""
    name = FAULT_NAMES.get(code) or FAULT_NAMES.get(code & 0xFF00) or "not in the profile's table"
    return f"fault 0x{code:04X} ({name})"


def power_of_ten(exponent: int) -> float:
    """Return 10^exponent, rounded correctly: ``**`` of the C library is not."""
    return float(f"1e{exponent}")
