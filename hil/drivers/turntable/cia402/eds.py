"""What a CiA 402 drive offers by its data sheet, and what the driver uses of it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from hil.config.rig import Cia402
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.codec import Pdo
from hil.drivers.turntable.cia402.eds_file import Variable, read_data_sheet
from hil.errors import BadInput, Problem

SHIPPED: Final = Path(__file__).parent / "data" / "emulated-drive.eds"

ReadObject = Callable[[int, int], int | None]
"""Returns the value of an object, by index and sub-index; None if the drive does not have it."""

_BITS: Final = {
    (codec.HEARTBEAT_PRODUCER, 0): 16, (codec.GUARD_TIME, 0): 16, (codec.LIFE_TIME_FACTOR, 0): 8,
    (codec.HEARTBEAT_CONSUMER, 1): 32, (codec.SYNC_OBJECT, 0): 32, (codec.CYCLE_PERIOD, 0): 32,
    (codec.ABORT_CONNECTION_OPTION, 0): 16, (codec.ERROR_CODE, 0): 16, (codec.ERROR_REGISTER, 0): 8,
    (codec.CONTROLWORD, 0): 16, (codec.STATUSWORD, 0): 16, (codec.QUICK_STOP_OPTION, 0): 16,
    (codec.MODE, 0): 8, (codec.MODE_DISPLAY, 0): 8, (codec.POSITION_ACTUAL, 0): 32, (codec.VELOCITY_ACTUAL, 0): 32,
    (codec.TARGET_POSITION, 0): 32, (codec.VELOCITY_OFFSET, 0): 32, (codec.DIGITAL_INPUTS, 0): 32,
    (codec.INTERPOLATION_DATA, 1): 32, (codec.INTERPOLATION_SUBMODE, 0): 16, (codec.BUFFER, 6): 8,
    (codec.INTERPOLATION_PERIOD, 1): 8, (codec.INTERPOLATION_PERIOD, 2): 8,
    (codec.PROFILE_VELOCITY, 0): 32, (codec.PROFILE_ACCELERATION, 0): 32, (codec.PROFILE_DECELERATION, 0): 32,
    (codec.HOMING_METHOD, 0): 8, (codec.HOMING_SPEEDS, 1): 32, (codec.HOMING_SPEEDS, 2): 32,
    (codec.HOMING_ACCELERATION, 0): 32,
}  # fmt: skip
"""Size of the profile's objects that the driver uses; of PDO parameters and mappings see ``_bits``."""

_PROFILE: Final = ((codec.PROFILE_VELOCITY, 0), (codec.PROFILE_ACCELERATION, 0))
_STREAMS: Final = {
    codec.CYCLIC_SYNCHRONOUS_POSITION: (codec.TARGET_POSITION, 0),
    codec.INTERPOLATED_POSITION: (codec.INTERPOLATION_DATA, 1),
}
"""Modes that follow setpoints, in the order in which they are preferred, and the object of the setpoint."""
_FUNCTION: Final = 0x780  # bits of an identifier apart from the node id
_COMMANDS: Final = (codec.SETPOINT_PDO_PLAIN, codec.CONTROL_PDO, codec.COMMAND_PDO)
_INTERPOLATED_COMMANDS: Final = (codec.INTERPOLATION_PDO, codec.CONTROL_PDO, codec.INTERPOLATED_COMMAND_PDO)
_REPORTS: Final = (codec.FEEDBACK_PDO_PLAIN, codec.STATUS_PDO_PLAIN, codec.REPORT_PDO)
"""PDOs of each direction: two, and the one that replaces them."""


def _bits(index: int, subindex: int) -> int | None:
    if index in codec.PDO_PARAMETERS:
        return {1: 32, 2: 8, codec.PDO_EVENT_TIMER: 16}.get(subindex)
    if index in range(0x1600, 0x1800) or index in range(0x1A00, 0x1C00):
        return 32 if subindex else 8
    return _BITS.get((index, subindex))


class Eds:
    """A data sheet that was read; ``variables`` by index and sub-index. notes: what is illegible in it.

    homing: an axis needs homing. Raises BadInput with everything that the driver misses and has no substitute for.
    """

    def __init__(self, path: Path, homing: bool = False) -> None:
        self.path = path
        sheet = read_data_sheet(path)
        self.variables, self.notes = sheet.variables, sheet.notes
        interpolates = self.streams[:1] == [codec.INTERPOLATED_POSITION]
        self.commands = self._arranged(*_INTERPOLATED_COMMANDS if interpolates else _COMMANDS)
        """PDOs of setpoint and controlword; one for both if the drive cannot have two."""
        self.reports = self._arranged(*_REPORTS)
        """PDOs of position and statusword; one for both if the drive cannot have two."""
        if problems := [*self._problems(homing)]:
            raise BadInput([Problem(str(path), *text.split(": ", 1)) for text in problems])

    @classmethod
    def of(cls, config: Cia402, homing: bool = False) -> Eds:
        """Return the data sheet of a rig's drives. Raises BadInput with everything that the driver misses in it."""
        return cls(SHIPPED if config.eds_file is None else Path(config.eds_file), homing)

    def has(self, index: int, subindex: int = 0) -> bool:
        """Return whether the drive has an object that the driver can read."""
        variable = self.variables.get((index, subindex))
        return variable is not None and not self._type_problem(variable)

    def can_write(self, index: int, subindex: int = 0) -> bool:
        """Return whether the drive has an object that the driver can write."""
        return self.has(index, subindex) and self.variables[index, subindex].is_writable

    def maps(self, pdo: Pdo) -> bool:
        """Return whether all that ``pdo`` holds can be mapped."""
        return all(self._maps(index, subindex) for index, subindex, _ in pdo.mapping)

    def default(self, index: int, subindex: int = 0) -> int | None:
        """Return the default of an object, None if the drive does not have it, or the file gives none."""
        variable = self.variables.get((index, subindex))
        return None if variable is None else variable.number

    @property
    def has_profiles(self) -> bool:
        """Whether the drive has what profile position mode needs."""
        return all(self.can_write(*key) for key in (*_PROFILE, (codec.TARGET_POSITION, 0)))

    @property
    def streams(self) -> list[int]:
        """Modes in which the drive can follow setpoints, the preferred one first."""
        return [mode for mode in self.declared_streams(self.default(*codec.SUPPORTED_MODES)) if self._takes(mode)]

    def declared_streams(self, supported: int | None) -> list[int]:
        """Return the modes with setpoints in a value of 0x6502; all if there is none."""
        mode = self.variables.get((codec.MODE, 0))
        low, high = (None, None) if mode is None else (mode.low, mode.high)
        return [
            stream
            for stream in _STREAMS
            if (supported & 1 << stream - 1 if supported else low is None or high is None or low <= stream <= high)
        ]

    def _takes(self, mode: int) -> bool:
        return self._maps(*_STREAMS[mode]) and self.can_write(*_STREAMS[mode])

    def other_pdos(self) -> list[tuple[int, int]]:
        """Return the identifier entries of the PDOs that the driver does not use."""
        used = {pdo.parameter for pdo in (*self.commands, *self.reports)}
        indices = (index for index in self.variables if index[0] in codec.PDO_PARAMETERS and index[1] == 1)
        return [key for key in indices if key[0] not in used and self.can_write(*key)]

    def reaction(self, index: int, wanted: tuple[int, ...]) -> int | None:
        """Return the first of ``wanted`` that the drive takes as option code ``index``; None if it takes none."""
        if not self.can_write(index):
            return None
        low, high = self.variables[index, 0].low, self.variables[index, 0].high
        return next((each for each in wanted if low is None or high is None or low <= each <= high), None)

    def watchdogs(self) -> list[str]:
        """Return the means by which the drive can notice that the bench is silent."""
        means = []
        timed = codec.SETPOINT_PDO.parameter
        if self.commands[0].parameter == timed and self.can_write(timed, codec.PDO_EVENT_TIMER):
            means.append(codec.SETPOINT_TIME_OUT)
        if self.can_write(codec.HEARTBEAT_CONSUMER, 1):
            means.append(codec.HEARTBEAT_GUARD)
        elif self.can_write(codec.GUARD_TIME) and self.can_write(codec.LIFE_TIME_FACTOR):
            means.append(codec.LIFE_GUARD)
        return means

    def losses(self) -> list[str]:
        """Return a line per protection that the drive does not offer."""
        lines = []
        if not (means := self.watchdogs()):
            lines.append(
                "0x1400:05, 0x1016:01 and 0x100C are missing: no watchdog of the drive stops its axis when the bench "
                "falls silent, the safety chain alone does"
            )
        elif self.reaction(codec.ABORT_CONNECTION_OPTION, codec.ABORT_REACTIONS) is None:
            lines.append(
                f"0x6007 is missing or takes none of 3, 1, 2: what the drive does when its watchdog ({means[0]}) "
                "expires is set in the drive: try it with hil commission --proof-test"
            )
        if self.reaction(codec.QUICK_STOP_OPTION, codec.QUICK_STOP_REACTIONS) is None:
            lines.append(
                "0x605A is missing or takes neither 6 nor 5: whether the drive keeps its torque after a quick stop is "
                "set in the drive"
            )
        if not self.has(codec.MODE_DISPLAY):
            lines.append("0x6061 is missing: the drive does not confirm its mode of operation")
        return lines

    def _problems(self, homing: bool) -> list[str]:
        """Return the problems of objects without a substitute, ``KEY: text``."""
        if not self.streams:
            return [self._no_stream()]
        problems = [self._problem(codec.CONTROLWORD, 0, written=True, mapped=True)]
        problems += [self._problem(index, 0, mapped=True) for index in (codec.STATUSWORD, codec.POSITION_ACTUAL)]
        problems.append(self._problem(codec.MODE, 0, written=True))
        for pdo in (*self.commands, *self.reports):
            problems += self._pdo_problems(pdo)
        if homing:
            problems += [self._problem(*key, written=True) for key in codec.HOMING_OBJECTS]
        return [problem for problem in problems if problem]

    def _arranged(self, one: Pdo, other: Pdo, both: Pdo) -> tuple[Pdo, ...]:
        """Return ``one`` and ``other``; if they cannot be had, ``both`` as the first PDO that can hold it."""
        if not any(self._pdo_problems(one) + self._pdo_problems(other)):
            return one, other
        candidates = (codec.numbered(both, number) for number in range(codec.PDOS_OF_A_NODE))
        return next(((pdo,) for pdo in candidates if not any(self._pdo_problems(pdo))), (one, other))

    def _pdo_problems(self, pdo: Pdo) -> list[str]:
        """Return the problems of identifier, transmission type and mapping; what is fixed must be as the driver's."""
        problems = [self._problem(pdo.parameter, 1), self._problem(pdo.parameter, 2), self._mapping_problem(pdo)]
        identifier = self.variables.get((pdo.parameter, 1))
        if identifier is None or identifier.is_writable or (default := identifier.number) is None:
            return problems
        if default & codec.PDO_INVALID or default & _FUNCTION != pdo.identifier:
            problems.append(
                f"{identifier.section} AccessType: {identifier.access}, DefaultValue: 0x{default:X}: the driver needs "
                f"0x{pdo.identifier:X} and the node id there, or rw"
            )
        return problems

    def _mapping_problem(self, pdo: Pdo) -> str:
        if self.can_write(pdo.mapping_index, 0):
            first = self.variables.get((pdo.mapping_index, 1))  # entries that are not in use may be missing
            if first is None or first.is_writable:
                return ""
        if problem := self._problem(pdo.mapping_index, 0) or self._problem(pdo.mapping_index, 1):
            return problem
        for number, (index, subindex, bits) in enumerate(pdo.mapping, 1):
            if self.default(pdo.mapping_index, number) != index << 16 | subindex << 8 | bits:
                entry = self.variables.get((pdo.mapping_index, number)) or self.variables[pdo.mapping_index, 1]
                name = codec.object_name(index, subindex)
                return f"{entry.section} AccessType: {entry.access}: the driver maps {name} there, allowed: rw"
        return ""

    def _no_stream(self) -> str:
        supported = self.default(*codec.SUPPORTED_MODES)
        if supported and not self.declared_streams(supported):
            section = self.variables[codec.SUPPORTED_MODES].section
            return (
                f"{section} DefaultValue: 0x{supported:X} has neither bit 7, cyclic synchronous position, nor bit 6, "
                "interpolated position: the drive cannot follow setpoints of the bench"
            )
        wanted = self.declared_streams(supported) or list(_STREAMS)
        return self._problem(*_STREAMS[wanted[0]], written=True, mapped=True) or (
            f"{self.variables[codec.MODE, 0].section} LowLimit, HighLimit: exclude the modes 7 and 8: the drive cannot "
            "follow setpoints of the bench"
        )

    def _maps(self, index: int, subindex: int) -> bool:
        return self.has(index, subindex) and self.variables[index, subindex].is_mappable

    def _problem(self, index: int, subindex: int, written: bool = False, mapped: bool = False) -> str:
        """Return the problem of one object, "" for none."""
        variable = self.variables.get((index, subindex))
        if variable is None:
            return f"{codec.object_name(index, subindex)}: is missing: the driver needs it"
        if problem := self._type_problem(variable):
            return problem
        if written and not variable.is_writable:
            return f"{variable.section} AccessType: {variable.access}: the driver writes it, allowed: rw, wo, rww, rwr"
        if mapped and not variable.is_mappable:
            return f"{variable.section} PDOMapping: 0: the driver must map it into a PDO, allowed: 1"
        return ""

    def _type_problem(self, variable: Variable) -> str:
        bits = _bits(variable.index, variable.subindex)
        if variable.data_type is None or bits is None or variable.bits == bits:
            return ""
        return f"{variable.section} DataType: is {variable.type_name}, allowed: a whole number of {bits} bits"
