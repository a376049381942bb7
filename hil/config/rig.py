"""Rig files: devices of the bench, their wires, limits and geometry."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Mapping
from itertools import pairwise
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, PrivateAttr, model_validator

from hil.config.tables.arm import Arm
from hil.config.tables.cameras import DriftCheckViews, MonitorCamera
from hil.config.tables.drive_habits import DriveHabits
from hil.config.tables.driver_registry import DeviceTable, Wire, WireKey, check_axes
from hil.config.tables.flight_computer import FlightComputer
from hil.config.tables.floating import Floating
from hil.config.tables.guard import BenchBody, GuardConfig, check_kinds
from hil.config.tables.host import (
    ClockConfig,
    ConsoleTable,
    GncLink,
    HostConfig,
    OnOverrun,
    RecordingTable,
    TelemetryTable,
)
from hil.config.tables.io import Io
from hil.config.tables.machine import MachineErrors
from hil.config.tables.mechanics import DriveMechanics, GimbalMechanics, RailMechanics
from hil.config.tables.model import ConfigModel, Delay, Matrix3, Name, NotNegative, Positive, Triple
from hil.config.tables.open_table import FileTable
from hil.config.tables.rail_map import RailMap
from hil.config.tables.sign_off import SignOff
from hil.config.tables.wires import CanBus, ImuWire, ModbusRtu
from hil.maths import elementary, linear

RAIL_NAMES = ("x", "y", "z")
GIMBAL_NAMES = ("roll", "pitch", "yaw")
LINEAR_NAMES = (*RAIL_NAMES, "u", "v", "w")  # of a group of up to six axes; further ones as in ISO 841
ROTARY_NAMES = (*GIMBAL_NAMES, "a", "b", "c")
FURTHER_AXES_MAX = 24  # largest number in a rig
BENCH_AXES = (*(f"rails.{name}" for name in RAIL_NAMES), *(f"turntable.{name}" for name in GIMBAL_NAMES))


NodeId = Annotated[int, Field(ge=1, le=127)]
LEAD_MAX_S = 0.2
EXCHANGES_MAX_HZ = 250.0
AVERAGING_MAX_S = 1.0
Lead = Annotated[float, Field(ge=-LEAD_MAX_S, le=LEAD_MAX_S)]  # s; negative for an axis that leads
MIDDLE_AXIS_MAX_DEG = 85.0  # largest angle of the middle axis of a rotary manipulator
Encoder = Literal["absolute", "incremental"]  # incremental: the axis must be homed after power-up
GimbalOrder = Literal["zyx", "zxy", "yzx", "yxz", "xyz", "xzy"]  # of three different axes
UNIT_AXES: Matrix3 = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_CATCHING_UP = 2.0  # speed of axes that reach a target in motion from rest, of its speed
_FIXED_LIMIT = 1.0  # m/s, m/s^2, deg/s, deg/s^2 of an axis without a drive, which never moves
Unsigned32 = Annotated[int, Field(ge=0, le=0xFFFF_FFFF)]


class BenchGeometry(ConfigModel):
    """Mounting of the bench (frames: docs/explanation/frames.md)."""

    lever_arm_m: Triple
    """In c: turntable's centre of rotation to the point that represents the chaser's reference point."""
    gimbal_order: GimbalOrder = "zyx"
    """Gimbals from outer to inner; "zyx" is yaw, pitch, roll."""
    rails_order: GimbalOrder = "xyz"
    """Rails from the floor up: the first carries the others."""
    geometry_file: str | None = None
    """Measured geometry, of `hil geometry fit`: compensated in all motion; unless set, the bench counts as ideal."""
    errors: MachineErrors = MachineErrors.model_construct()
    """How mock and emulated rigs are built wrong."""
    tolerance_m: NotNegative = 1e-3
    """Standard deviation of each parameter of the geometry that was not measured."""
    tolerance_deg: NotNegative = 0.05
    """The same for rotations."""
    thermal_sigma_m: NotNegative = 0.0
    """Drift of the bench since its geometry was measured, 1 sigma per axis."""
    thermal_sigma_deg: NotNegative = 0.0
    """The same for rotations."""
    camera_position_m: Triple = (0.6, 0.0, 0.0)
    """In c: chaser's reference point to the left camera."""
    camera_axes: Matrix3 = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))
    """Rows: axes of the left camera in c."""
    led_ring_position_m: Triple = (0.0, 0.0, 0.0)
    """In H: target's reference point to the centre of the LED ring."""
    axes_rate_hz: Positive | None = None
    """Setpoints per second, a multiple of the cycle's rate, interpolated between two cycles; unless set, one per
    cycle."""
    park_after_run: bool = False
    """Move all axes to `park_m` and `park_deg` at the end of a complete run."""
    led_ring_axes: Matrix3 = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))
    """Rows: axes of the LED ring in H."""
    lab_axes: Matrix3 = UNIT_AXES
    """Rows: axes of L in H, along which the rails run; by default L is parallel to H."""
    bodies: tuple[BenchBody, ...] = ()
    """`[[bench.bodies]]`: carriage, arm, cameras, ring and objects of the lab, at most 8 of each kind."""
    bodies_distance_m: Positive = 0.05
    """Least distance between a body that moves and one of the lab."""

    @model_validator(mode="after")
    def _bodies_can_meet(self) -> Self:
        check_kinds(self.bodies, "lab", "target")
        return self

    @model_validator(mode="after")
    def _axes_are_right_handed(self) -> Self:
        for name in ("camera_axes", "led_ring_axes", "lab_axes"):
            m = getattr(self, name)
            gram = [[linear.total(a * b for a, b in zip(p, q, strict=True)) for q in m] for p in m]
            identity = all(abs(gram[i][j] - (i == j)) < 1e-9 for i in range(3) for j in range(3))
            cross = (
                m[0][1] * m[1][2] - m[0][2] * m[1][1],
                m[0][2] * m[1][0] - m[0][0] * m[1][2],
                m[0][0] * m[1][1] - m[0][1] * m[1][0],
            )
            if not identity or linear.total(a * b for a, b in zip(cross, m[2], strict=True)) < 0.0:
                raise ValueError(f"{name} must be three right-handed unit axes at right angles")
        return self


class Servo(ConfigModel):
    """Dynamics of an axis of mock and emulator."""

    gain_per_s: Positive
    """Gain of the position loop."""
    lag_s: Positive
    """Time constant of the drive."""


class Brake(ConfigModel):
    """Holding brake: closed without current."""

    close_s: Annotated[float, Field(gt=0.0, le=1.0)]
    """Time from the command until the axis is held."""
    open_s: Annotated[float, Field(gt=0.0, le=1.0)] = 0.1
    """Time from the command until the axis is free."""


class BenchAxis(ConfigModel):
    """Keys of a rail and of a gimbal alike. An axis with an incremental encoder must be homed after power-up.

    Travel, limits and positions are in metres or degrees, by the keys of the subclass. An axis that is fixed needs its
    position alone, key ``fixed``: it has no drive, and keys of a drive in the file do not count.
    """

    gravity_loaded: bool = False
    """The axis falls to the low end of its travel when it has neither torque nor a closed brake."""
    counterweight: bool = False
    """A counterweight holds a gravity-loaded axis."""
    brake: Brake | None = None
    """Holding brake; hardware rejects a gravity-loaded axis that has neither brake nor counterweight."""
    encoder: Encoder = "absolute"
    """"incremental": must be homed after power-up of its drive."""
    lead_s: Lead = 0.0
    """Time by which setpoints are advanced, measured by `hil identify`; negative for an axis that leads."""

    @classmethod
    def fixed_at(cls, position: float) -> dict[str, Any]:
        """Return the table of an axis that is fixed at ``position``, m or deg."""
        table: dict[str, Any] = {cls.key_of(stem): position for stem in ("fixed", "park", "home")}
        table |= {cls.key_of(stem): _FIXED_LIMIT for stem in ("rate_max", "acceleration_max")}
        return {**table, cls.key_of("travel"): [position, position]}

    @property
    def is_fixed(self) -> bool:
        """Whether the axis has no drive."""
        return self.in_file("fixed") is not None

    @property
    def falls(self) -> bool:
        """Whether gravity moves the axis when it has neither torque nor a closed brake."""
        return self.gravity_loaded and not self.counterweight

    @property
    def limits(self) -> tuple[float, float, float, float, float]:
        """Low and high end of the travel, highest rate, highest acceleration, park position, in SI units."""
        return *self.si("travel"), self.si("rate_max"), self.si("acceleration_max"), self.si("park")

    @property
    def averaging_s(self) -> float:
        """Time over which setpoints are averaged for the limit of their jerk, s; 0 without one."""
        jerk = self.in_file("jerk_max")
        return 0.0 if jerk is None else float(2.0 * self.in_file("acceleration_max") / jerk)

    @model_validator(mode="after")
    def _park_is_on_the_travel(self) -> Self:
        low, high = self.in_file("travel")
        if not (low < high or self.is_fixed):
            raise ValueError(f"{self.key_of('travel')} must rise from low to high")
        if not low <= self.in_file("park") <= high:
            raise ValueError(f"{self.key_of('park')} must lie within {self.key_of('travel')}")
        return self

    @model_validator(mode="after")
    def _jerk_delays_a_move_little(self) -> Self:
        """Require that a limit of the jerk delays the end of a move by at most ``AVERAGING_MAX_S``."""
        jerk, least = self.in_file("jerk_max"), 2.0 * self.in_file("acceleration_max") / AVERAGING_MAX_S
        if jerk is not None and jerk < least:
            key = self.key_of("jerk_max")
            raise ValueError(f"{key} {jerk:g}: allowed from {least:g}, twice the acceleration limit per second")
        return self


class RailAxis(BenchAxis):
    """One rail."""

    fixed_m: float | None = None
    """Position at which the axis is fixed, without a drive; then the other keys do not count."""
    travel_m: tuple[float, float]
    """Low and high end, inside the limit switches."""
    rate_max_mps: Positive
    """Speed limit."""
    acceleration_max_mps2: Positive
    """Acceleration limit."""
    jerk_max_mps3: Positive | None = None
    """Limit of the jerk of setpoints, at least twice the acceleration limit per second; unless set, off."""
    park_m: float = 0.0
    """Park position."""
    home_m: float = 0.0
    """Position of the home switch."""
    homing_rate_mps: Positive = 0.05
    """Speed of the search for it."""


class GimbalAxis(BenchAxis):
    """One axis of the turntable."""

    fixed_deg: float | None = None
    """Angle at which the axis is fixed, without a drive; then the other keys do not count."""
    travel_deg: tuple[float, float]
    """Low and high end, inside the limit switches."""
    rate_max_degps: Positive
    """Rate limit."""
    acceleration_max_degps2: Positive
    """Acceleration limit."""
    jerk_max_degps3: Positive | None = None
    """Limit of the jerk of setpoints, at least twice the acceleration limit per second; unless set, off."""
    park_deg: float = 0.0
    """Park position."""
    home_deg: float = 0.0
    """Position of the home switch."""
    homing_rate_degps: Positive = 5.0
    """Rate of the search for it."""


class ModbusAxis(ConfigModel):
    """Address of the drive of one rail."""

    host: str = "127.0.0.1"
    """Address of the drive, or of the gateway that several drives share."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """TCP port."""
    device_id: Annotated[int, Field(ge=1, le=247)] = 1
    """Modbus device id."""


class Modbus(ConfigModel):
    """Three drives on Modbus TCP."""

    x: ModbusAxis = ModbusAxis.model_construct()
    y: ModbusAxis = ModbusAxis.model_construct()
    z: ModbusAxis = ModbusAxis.model_construct()


class FurtherModbus(Modbus):
    """Drives of further axes on Modbus TCP."""

    u: ModbusAxis = ModbusAxis.model_construct()
    v: ModbusAxis = ModbusAxis.model_construct()
    w: ModbusAxis = ModbusAxis.model_construct()


class Cia402(CanBus):
    """CiA 402 drives on one CAN bus."""

    adapter_latency_s: Delay = 0.0
    """Time for which a serial adapter collects bytes."""
    node_ids: Annotated[tuple[NodeId, ...], Field(min_length=1, max_length=6)] = (1, 2, 3)
    """Node ids of roll, pitch, yaw, of further axes also of a, b, c; or of as many drives as there are."""
    counts_per_turn: Annotated[int, Field(gt=0, le=1_000_000_000)] = 10_000_000
    """Position units of the drive per revolution of the axis."""
    gear_ratio: Annotated[float, Field(gt=0.0, le=1e6)] = 1.0
    """Revolutions of the drive's shaft per revolution of the axis, by a gear outside the drive."""
    velocity_units_per_degps: Positive | None = None
    """Velocity units of the drive per deg/s of the axis; default: by object 0x60A9. With neither, rates are those of
    the positions, and nothing that needs the unit is sent."""
    bench_node_id: NodeId | None = None
    """Node id of the bench, of its heartbeat and SYNC; default: 128 less the smallest of `node_ids`."""
    enable_timeout_s: Annotated[float, Field(ge=0.5, le=25.0)] = 10.0
    """Longest time from reset to operation enabled, with the search for the commutation angle."""
    eds_file: str | None = None
    """EDS or DCF of the drives; default: the emulated drive's."""
    heartbeat_s: Annotated[float, Field(ge=0.01, le=60.0)] = 0.05
    """Heartbeat period of a drive."""
    homing_method: Annotated[int, Field(ge=-128, le=37)] = 24
    """Object 0x6098; 24: home switch, positive start."""
    vendor_id: Unsigned32 | None = None
    """Expected object 0x1018:1; any unless set."""
    product_code: Unsigned32 | None = None
    """Expected object 0x1018:2."""
    revision_min: Unsigned32 | None = None
    """Oldest accepted object 0x1018:3."""
    firmware: str | None = None
    """Expected object 0x100A."""
    emulated: DriveHabits = DriveHabits.model_construct()
    """Habits of the emulated drives."""

    @property
    def master_id(self) -> int:
        """Node id of the bench on this bus."""
        return 128 - min(self.node_ids) if self.bench_node_id is None else self.bench_node_id

    @model_validator(mode="after")
    def _nodes_differ(self) -> Self:
        if len(set(self.node_ids)) != len(self.node_ids):
            raise ValueError(f"node_ids {list(self.node_ids)} must differ from each other")
        if self.master_id in self.node_ids:
            raise ValueError(f"bench_node_id {self.master_id}: is one of node_ids, allowed: any other node id")
        return self


class SerialLine(ConfigModel):
    """A serial port."""

    port: str | None = None
    """Serial port."""
    baud: Annotated[int, Field(gt=0)] = 460_800
    """Baud rate."""
    adapter_latency_s: Delay = 0.0
    """Time for which a USB adapter collects bytes: 0.016 for one of FTDI whose driver cannot be set to less."""


class AsciiTurntableLine(SerialLine):
    """Serial port, or address on Ethernet, and command set of the turntable controller."""

    port: str | None = None
    """Serial port, or `tcp://HOST:PORT`."""
    protocol: str = "hil-ascii"
    """Command set: `hil-ascii`, `acu`, `aerotech-ensemble` or the path of a protocol file."""
    identity: dict[Literal["model", "serial", "firmware"], str] = Field(default_factory=dict)
    """Expected model, serial and firmware of the controller; omitted ones are not checked."""


class VmuLine(SerialLine):
    """Serial port and frames of the vision unit."""

    frames: str = "hil"
    """Pose frames: `hil`, `euler-mm`, `text` or the path of a frame file."""


class VmuDatagrams(ConfigModel):
    """Datagrams of a vision unit, a camera or a tracker: where they are received, and their frames."""

    host: str = "127.0.0.1"
    """Address of this computer."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """UDP port."""
    frames: str = "hil"
    """Pose frames, binary or of text: `hil`, `euler-mm`, `text` or the path of a frame file."""


class SensorLine(ConfigModel):
    """Serial wire of a sensor of the scenario, `[sensors.NAME]`."""

    port: str | None = None
    """Path of the port, such as `/dev/ttyUSB0`."""
    baud: Annotated[int, Field(ge=50, le=4_000_000)] | None = None
    """Default: the value of the sensor's protocol."""


def _wires_of(keys: Iterable[WireKey], axes: Iterable[str]) -> list[WireKey]:
    """Return ``keys`` without keys of axes other than ``axes``."""
    others = {*LINEAR_NAMES, *ROTARY_NAMES} - set(axes)
    return [key for key in keys if key.name not in others]


class AxisController(DeviceTable):
    """Controller of some axes of a group, which drives them in place of the group's own driver."""

    axes: Annotated[tuple[str, ...], Field(min_length=1, max_length=2)]
    """Names of the axes that it drives."""

    @property
    def wire_keys(self) -> list[WireKey]:
        return _wires_of(super().wire_keys, self.axes)

    def check_driver(self) -> None:
        """Check nothing: the group checks what the driver gets, which includes its axes."""

    @property
    def changes(self) -> dict[str, Any]:
        """What the controller's driver finds in place of the group's keys."""
        own = {key: getattr(self, key) for key in self.model_fields_set - {"axes"}}
        return own | dict(self.__pydantic_extra__ or {})


class RailController(AxisController):
    """`[[rails.controllers]]`: axes of the rails on a controller of their own; further keys as in `[rails]`."""

    device: ClassVar = "rails"

    modbus: Modbus | None = None
    rtu: ModbusRtu | None = None
    map: RailMap = RailMap.model_construct()


class GimbalController(AxisController):
    """`[[turntable.controllers]]`: axes of the turntable on a controller of their own; further keys as there."""

    device: ClassVar = "turntable"

    cia402: Cia402 | None = None
    ascii: AsciiTurntableLine | None = None


class AxisGroupTable(DeviceTable):
    """Table of one to six axes, each in a table of its own name."""

    all_names: ClassVar[tuple[str, ...]]
    si_per_unit: ClassVar[float]  # unit of positions in the file: 1 for m, rad per degree

    _part: tuple[str, ...] = PrivateAttr(default=())

    timeout_s: Positive = 0.4
    """Longest silence of the device, and oldest accepted feedback."""
    servo: Servo
    """Dynamics of mock and emulated axes."""
    drive_following_error_s: NotNegative = 0.05
    """Emulated drives: time beyond their following error window after which they switch their torque off."""
    exchange_rate_max_hz: Annotated[float, Field(ge=10.0)] | None = None
    """Most exchanges with the drives per second, Hz; of faster setpoints the newest is sent. Unless set: one per
    setpoint, at most 250."""
    following_error_per_speed_s: NotNegative = 0.0
    """Increase of the allowed following error per commanded speed."""
    lost_packets_max: Positive = 5.0
    """Level of the leaky bucket of lost packets that trips."""
    lost_packets_window_s: Positive = 1.0
    """Time in which the bucket drains by one packet."""
    mechanics: DriveMechanics | None = None
    """Mechanics of the emulated axes; default: the ideal servo."""

    @property
    def exchanges_max_hz(self) -> float:
        """Most exchanges with the drives per second, Hz: of the file, else what drivers in Python sustain."""
        return EXCHANGES_MAX_HZ if self.exchange_rate_max_hz is None else self.exchange_rate_max_hz

    @property
    def axis_names(self) -> tuple[str, ...]:
        """Names of the table's axes; in a part, of the axes on its controller."""
        return tuple(name for name in self._part or self.all_names if getattr(self, name) is not None)

    @property
    def driven(self) -> tuple[str, ...]:
        """Those of ``axis_names`` that have a drive; the others are fixed."""
        return tuple(name for name in self.axis_names if not getattr(self, name).is_fixed)

    @property
    def axis_numbers(self) -> tuple[int, ...]:
        """Numbers, from 0, of ``axis_names`` among all that the table may have."""
        return tuple(self.all_names.index(name) for name in self.axis_names)

    def ids_of(self, ids: tuple[int, ...]) -> tuple[int, ...]:
        """Return the ids of ``axis_names``, of as many, or of one for each axis that the table may have."""
        return ids if len(ids) == len(self.axis_names) else tuple(ids[number] for number in self.axis_numbers)

    @property
    def axes(self) -> tuple[RailAxis | GimbalAxis, ...]:
        """The axes in the order of ``axis_names``."""
        return tuple(getattr(self, name) for name in self.axis_names)

    @property
    def own_controllers(self) -> tuple[AxisController, ...]:
        """Controllers of axes that the table's own driver does not drive."""
        return ()

    def parts(self, name: str) -> dict[str, AxisGroupTable]:
        """Return what each controller drives, by names: ``rails`` with the remaining axes, ``rails.x``, ``rails.y-z``.

        name: of the group. A group on one controller has one part, itself, without its fixed axes; none if all are
        fixed.
        """
        if not self.driven:
            return {}
        if not self.own_controllers:
            return {name: self if self.driven == self.axis_names else self._part_of(self.driven, {})}
        taken = [axis for controller in self.own_controllers for axis in controller.axes]
        rest = tuple(axis for axis in self.driven if axis not in taken)
        parts = {name: self._part_of(rest, {})}
        for controller in self.own_controllers:
            parts[part_name(name, controller)] = self._part_of(controller.axes, controller.changes)
        return parts

    def _part_of(self, axes: tuple[str, ...], changes: Mapping[str, Any]) -> AxisGroupTable:
        part = self.model_copy(update={"controllers": (), **changes})
        part._part = axes
        return part

    def connected(self, name: str, addresses: Mapping[str, str]) -> Self:
        """Return the table with the addresses that the emulators of the device ``name`` report."""
        table = super().connected(name, addresses)
        if not self.own_controllers or not self.driven:
            return table
        controllers = tuple(each.connected(part_name(name, each), addresses) for each in self.own_controllers)
        return table.model_copy(update={"controllers": controllers})

    @property
    def wire_keys(self) -> list[WireKey]:
        taken = [axis for controller in self.own_controllers for axis in controller.axes]
        return _wires_of(super().wire_keys, set(self.driven) - set(taken)) if self.driven else []

    def check_driver(self) -> None:
        """Raise ValueError for axes that are driven twice or by no driver, and if a driver cannot drive its axes."""
        given = [axis for controller in self.own_controllers for axis in controller.axes]
        if unknown := [axis for axis in given if axis not in self.driven]:
            raise ValueError(f'controllers: axis "{unknown[0]}", allowed: {", ".join(self.driven)}')
        if len(set(given)) != len(given):
            raise ValueError("controllers: an axis is driven twice, allowed: each axis by one controller")
        if given and set(given) >= set(self.driven):
            raise ValueError("controllers: drive all axes, allowed: all but one, which driver drives")
        for number, part in enumerate(self.parts("").values(), -1):
            if part.has_wires:
                key = "driver" if number < 0 else f"controllers.{number}.driver"
                check_axes(key, part.device, part.driver, part.axis_names, part.all_names)
                part.entry.check(part)

    @property
    def holding_brakes(self) -> list[Brake]:
        """Brakes of the gravity-loaded axes."""
        return [axis.brake for axis in self.axes if axis.falls and axis.brake is not None]

    @property
    def emulated_mechanics(self) -> DriveMechanics | None:
        """Mechanics of the emulated axes; None for ideal servos."""
        return self.mechanics if self.mechanics is not None and self.mechanics.enabled else None


def part_name(name: str, controller: AxisController) -> str:
    """Return the name of the part of the group ``name`` that is on ``controller``."""
    return f"{name}.{'-'.join(controller.axes)}"


def check_ids(key: str, ids: tuple[int, ...], table: AxisGroupTable) -> None:
    """Raise ValueError if ``ids`` lack one of the axes of ``table``: see ``AxisGroupTable.ids_of``."""
    last = table.axis_numbers[-1]
    if last >= len(ids) and len(ids) != len(table.axis_names):
        missing, own = table.all_names[last], ", ".join(table.axis_names)
        required = ", ".join(table.all_names[: last + 1])
        other = "" if own == required else f", or of {own}"
        raise ValueError(f"{key} {list(ids)}: has none for {missing}, allowed: one for each of {required}{other}")


class HeldAtPlace(AxisGroupTable):
    """Axes that are brought to their places, key ``place``, before the run is armed, and held there during it."""

    without_wires: ClassVar = ("mock", "none")

    @property
    def place(self) -> tuple[tuple[float, ...], float]:
        """Place of each axis and allowed distance from it, m or rad."""
        return self.si("place"), self.si("held_within")

    @model_validator(mode="after")
    def _the_place_can_be_reached(self) -> Self:
        key, places = self.key_of("place"), self.in_file("place")
        if not self.axis_names:
            raise ValueError(f"an axis is missing, allowed: {', '.join(self.all_names)}")
        if len(places) != len(self.axis_names):
            raise ValueError(f"{key} {list(places)}: one for each of {', '.join(self.axis_names)}")
        for name, axis, position in zip(self.axis_names, self.axes, places, strict=True):
            low, high = axis.in_file("travel")
            if not low <= position <= high:
                raise ValueError(f"{key}: {name} {position:g}, allowed {low:g} to {high:g}")
        return self


class LinearAxes(AxisGroupTable):
    """Axes that move along lines, with the keys of rails."""

    device: ClassVar = "rails"
    all_names: ClassVar[tuple[str, ...]] = RAIL_NAMES
    si_per_unit: ClassVar = 1.0

    following_error_max_m: Positive = 0.05
    """Largest following error at rest."""
    speed_mismatch_max_mps: Positive = 0.05
    """Largest difference of reported speed and change of position, in addition to a tenth of the speed."""
    drive_following_error_max_m: Positive = 0.1
    """Following error window of the emulated drives, by their own encoders."""
    encoder_sigma_m: NotNegative = 0.0
    """Noise of the emulated encoders."""
    mechanics: RailMechanics | None = None
    modbus: Modbus | None = None
    rtu: ModbusRtu | None = None
    map: RailMap = RailMap.model_construct()


def _absent_rail() -> RailAxis:
    return RailAxis.model_validate(RailAxis.fixed_at(0.0), strict=False)


def _absent_gimbal() -> GimbalAxis:
    return GimbalAxis.model_validate(GimbalAxis.fixed_at(0.0), strict=False)


def with_fixed_axes(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``table`` of a rig file in which each axis with a position at which it is fixed has no other known key."""
    filled: dict[str, Any] = {}
    for key, value in table.items():
        filled[key] = with_fixed_axes(value) if isinstance(value, dict) else value
    for model in (RailAxis, GimbalAxis):
        at = filled.get(model.key_of("fixed"))
        if isinstance(at, int | float):
            unknown = {key: value for key, value in filled.items() if key not in model.model_fields}
            return unknown | model.fixed_at(at)
    return filled


class Rails(LinearAxes):
    """Rails x, y, z, each driven or fixed; one that the file does not have is fixed at 0."""

    without_wires: ClassVar = ("mock", "none")

    x: RailAxis = Field(default_factory=_absent_rail)
    y: RailAxis = Field(default_factory=_absent_rail)
    z: RailAxis = Field(default_factory=_absent_rail)
    controllers: tuple[RailController, ...] = ()
    """`[[rails.controllers]]`: axes on a controller of their own."""

    @property
    def own_controllers(self) -> tuple[AxisController, ...]:
        return self.controllers


class TargetManipulator(Rails, HeldAtPlace):
    """Rails of the target, along the axes of L: placed before a run and held during it, or driven in it."""

    place_m: Triple = (0.0, 0.0, 0.0)
    """Position of the target, reached before the run is armed, at half of the limits."""
    held_within_m: Positive = 0.005
    """Allowed deviation from it, per axis, while armed and running."""
    sharing: Literal["none", "travel", "path"] = "none"
    """What the target shows of the relative position in a run: "none", it is held at its place; "travel", along each
    axis the part by which both vehicles have the same fraction of their travel left; "path", its own path, and the
    chaser shows the rest."""
    path_s: Annotated[tuple[NotNegative, ...], Field(max_length=64)] = ()
    """Times of the run at the points of its path; before the first and after the last one it stands."""
    path_m: tuple[Triple, ...] = ()
    """Its positions at these times, straight lines between them."""

    @property
    def path_speed_mps(self) -> float:
        """Largest speed of the target on its path, while it catches up with it; 0 without one."""
        parts = zip(pairwise(self.path_s), pairwise(self.path_m), strict=True)
        speeds = [linear.length(b - a for a, b in zip(*ends, strict=True)) / (t_1 - t_0) for (t_0, t_1), ends in parts]
        return min(_CATCHING_UP * max(speeds, default=0.0), linear.length(axis.limits[2] for axis in self.axes))

    @model_validator(mode="after")
    def _a_rail_moves_the_target(self) -> Self:
        if self.sharing != "none" and not self.driven:
            raise ValueError(f'sharing "{self.sharing}": needs a driven rail, allowed "none"')
        return self

    @model_validator(mode="after")
    def _path_can_be_followed(self) -> Self:
        if (self.sharing == "path") != bool(self.path_s):
            raise ValueError(f'path_s: allowed with sharing = "path", and required there; sharing is "{self.sharing}"')
        if len(self.path_m) != len(self.path_s) or any(b <= a for a, b in pairwise(self.path_s)):
            raise ValueError("path_s: must rise, with a point of path_m for each")
        for number, (name, axis) in enumerate(zip(self.axis_names, self.axes, strict=True)):
            low, high, rate_max, *_ = axis.limits
            at = [point[number] for point in self.path_m]
            if out := [position for position in at if not low <= position <= high]:
                raise ValueError(f"path_m: {name} {out[0]:g}, allowed {low:g} to {high:g}")
            for (t_0, x_0), (t_1, x_1) in pairwise(zip(self.path_s, at, strict=True)):
                if abs(x_1 - x_0) > rate_max * (t_1 - t_0):
                    speed = abs(x_1 - x_0) / (t_1 - t_0)
                    raise ValueError(f"path_m: {name} at {speed:g} m/s from {t_0:g} s, allowed {rate_max:g}")
        return self


class RotaryAxes(AxisGroupTable):
    """Axes that rotate, with the keys of the turntable."""

    device: ClassVar = "turntable"
    all_names: ClassVar[tuple[str, ...]] = GIMBAL_NAMES
    si_per_unit: ClassVar = math.pi / 180.0

    following_error_max_deg: Positive = 2.0
    """Largest following error at rest."""
    speed_mismatch_max_degps: Positive = 5.0
    """Largest difference of reported rate and change of position, in addition to a tenth of the rate."""
    drive_following_error_max_deg: Positive = 5.0
    """Following error window of the emulated drives, by their own encoders (object 0x6065)."""
    encoder_sigma_deg: NotNegative = 0.0
    """Noise of the emulated encoders."""
    mechanics: GimbalMechanics | None = None
    cia402: Cia402 | None = None
    ascii: AsciiTurntableLine | None = None


class Turntable(RotaryAxes):
    """Gimbals roll, pitch, yaw, each driven or fixed; one that the file does not have is fixed at 0."""

    without_wires: ClassVar = ("mock", "none")

    roll: GimbalAxis = Field(default_factory=_absent_gimbal)
    pitch: GimbalAxis = Field(default_factory=_absent_gimbal)
    yaw: GimbalAxis = Field(default_factory=_absent_gimbal)
    controllers: tuple[GimbalController, ...] = ()
    """`[[turntable.controllers]]`: axes on a controller of their own."""

    @property
    def own_controllers(self) -> tuple[AxisController, ...]:
        return self.controllers


class HeldLinearAxes(LinearAxes, HeldAtPlace):
    """`[linear_axes.NAME]`: one to six axes, for example of a light source, that stand at their place during a run."""

    all_names: ClassVar = LINEAR_NAMES

    x: RailAxis | None = None
    y: RailAxis | None = None
    z: RailAxis | None = None
    u: RailAxis | None = None
    v: RailAxis | None = None
    w: RailAxis | None = None
    modbus: FurtherModbus | None = None
    place_m: tuple[float, ...]
    """Place of each axis that is given, in the order above, reached before the run is armed at half of the limits."""
    held_within_m: Positive = 0.005
    """Allowed distance from it while armed and running."""


class HeldRotaryAxes(RotaryAxes, HeldAtPlace):
    """`[rotary_axes.NAME]`: one to six axes that rotate a light source to its place and hold it during a run."""

    all_names: ClassVar = ROTARY_NAMES

    roll: GimbalAxis | None = None
    pitch: GimbalAxis | None = None
    yaw: GimbalAxis | None = None
    a: GimbalAxis | None = None
    b: GimbalAxis | None = None
    c: GimbalAxis | None = None
    place_deg: tuple[float, ...]
    """Place of each axis that is given, in the order above, reached before the run is armed."""
    held_within_deg: Positive = 0.5
    """Allowed distance from it while armed and running."""


class RotaryManipulator(Turntable):
    """Manipulator of the target: three gimbals that rotate it, which show the relative rotation as far as they can."""

    following_error_max_deg: Positive = 0.5
    """Largest following error at rest."""
    following_error_per_speed_s: NotNegative = 0.1
    """Its increase per commanded rate."""
    lever_arm_m: Triple = (0.0, 0.0, 0.0)
    """In H: centre of rotation to the target's reference point."""
    gimbal_order: GimbalOrder = "zyx"
    """Gimbals from outer to inner; "zyx" is yaw, pitch, roll."""

    @model_validator(mode="after")
    def _middle_axis_stays_off_the_pole(self) -> Self:
        name = {"x": "roll", "y": "pitch", "z": "yaw"}[self.gimbal_order[1]]
        low, high = getattr(self, name).travel_deg
        if max(-low, high) > MIDDLE_AXIS_MAX_DEG:
            raise ValueError(
                f"{name}.travel_deg [{low:g}, {high:g}]: the middle gimbal, allowed -{MIDDLE_AXIS_MAX_DEG:g} to "
                f"{MIDDLE_AXIS_MAX_DEG:g}: at 90 deg the other two rotate about the same axis"
            )
        for each in self.axis_names:
            low, high = getattr(self, each).travel_deg
            if not low <= 0.0 <= high:
                raise ValueError(f"{each}.travel_deg [{low:g}, {high:g}]: must contain 0, where H is parallel to L")
        return self


class RigCamera(ConfigModel):
    """Both cameras of the vision unit."""

    focal_px: Positive = 1200.0
    """Focal length."""
    width_px: Annotated[int, Field(gt=0)] = 1024
    """Image width."""
    height_px: Annotated[int, Field(gt=0)] = 1024
    """Image height."""
    baseline_m: Positive = 0.20
    """Left to right camera, along x_v."""


def _ring(radius_m: float, raised_m: float) -> tuple[Triple, ...]:
    """Return six LEDs evenly spaced on a circle in t, the first one raised towards the camera."""
    angles = [math.tau * k / 6 for k in range(6)]
    flat = [(radius_m * elementary.cos(angle), radius_m * elementary.sin(angle), 0.0) for angle in angles]
    return (radius_m, 0.0, -raised_m), *flat[1:]


class VmuIdentity(ConfigModel):
    """Expected identification of the unit; omitted keys are not checked."""

    vendor: str | None = None
    """Vendor."""
    serial: str | None = None
    """Serial number."""
    firmware: str | None = None
    """Firmware, such as "1.4"."""


class Vmu(DeviceTable):
    """Vision measurement unit."""

    device: ClassVar = "vmu"
    without_wires: ClassVar = ("mock", "none")

    timeout_s: Positive = 0.4
    """Longest time without a new frame."""
    rate_hz: Positive = 6.25
    """Frames per second."""
    lost_packets_max: Positive = 10.0
    """Level of the leaky bucket of lost frames that trips."""
    lost_packets_window_s: Positive | None = None
    """Time in which the bucket drains by one frame; unless set, two frame periods."""
    processing_s: NotNegative = 0.0
    """Emulated unit: from exposure to the first byte."""
    clock: Literal["shared", "own"] = "shared"
    """Clock of the unit's time stamps: bench time, or its own."""
    camera: RigCamera = RigCamera.model_construct()
    """Cameras of mock and emulated unit."""
    leds_m: Annotated[tuple[Triple, ...], Field(min_length=1)] = _ring(0.12, 0.06)
    """LEDs in t, of mock and emulated unit."""
    geometry_file: str | None = None
    """Calibrated cameras and LEDs of the unit; unless set, `camera` and `leds_m`."""
    estimator: str = "led_ring"
    """Software that determines the pose from images: `led_ring`, `apriltag`, `charuco`, or an installed package's."""
    estimator_settings: dict[str, Any] = Field(default_factory=dict)
    """Its settings."""
    covariance: Literal["whole", "noise"] = "whole"
    """Covariance of a pose that this host solves from images: the whole one, or only that of the noise, for a GNC whose
    error budget (`gnc.navigation.budget`) has the constant part."""
    bench_sigma_m: NotNegative = 0.0
    """Error of axes and calibration, 1 sigma per axis, added to the covariance of each pose."""
    bench_sigma_deg: NotNegative = 0.0
    """The same for the attitude."""
    identity: VmuIdentity = VmuIdentity.model_construct()
    """Expected identity of the unit."""
    drift_check: DriftCheckViews = DriftCheckViews.model_construct()
    rs422: VmuLine | None = None


class Safety(ConfigModel):
    """Limits of the safety monitor, in addition to each device's own limits."""

    command_age_max_s: Positive = 0.5
    """Longest time between setpoints; at most the time-out of the drives' watchdogs."""
    homing_timeout_s: Positive = 120.0
    """For all axes together."""
    parking_rate_fraction: Annotated[float, Field(gt=0.0, le=0.5)] = 0.25
    """Speed of parking, of each axis' limit."""
    jog_rate_fraction: Annotated[float, Field(gt=0.0, le=0.25)] = 0.1
    """Speed of a jog, of the axis' limit; at most 0.02 of it before the axis is homed."""


class Rig(FileTable):
    """One bench."""

    prefix: ClassVar = "rig."

    name: Name
    """Name in reports."""
    kind: Literal["mock", "emulated", "hardware"]
    """Mock: in memory, simulated time. Emulated: device emulators on real wires. Hardware: the devices of a lab."""
    bench: BenchGeometry
    rails: Rails
    turntable: Turntable
    vmu: Vmu
    safety: Safety = Safety.model_construct()
    guard: GuardConfig = GuardConfig.model_construct()
    host: HostConfig = HostConfig.model_construct()
    clock: ClockConfig = ClockConfig.model_construct()
    console: ConsoleTable = ConsoleTable.model_construct()
    recording: RecordingTable = RecordingTable.model_construct()
    telemetry: TelemetryTable = TelemetryTable.model_construct()
    gnc_link: GncLink = GncLink.model_construct()
    flight_computer: FlightComputer = FlightComputer.model_construct()
    imu: ImuWire | None = None
    monitor_camera: MonitorCamera = MonitorCamera.model_construct()
    io: Io | None = None
    arm: Arm | None = None
    """Robot that stands for rails and turntable, whose driver is then "arm"; on a mock rig its limits alone."""
    target_arm: Arm | None = None
    """Robot that stands for `[rotary_manipulator]` in the same way."""
    floating: Floating | None = None
    target_manipulator: TargetManipulator | None = None
    rotary_manipulator: RotaryManipulator | None = None
    linear_axes: dict[Name, HeldLinearAxes] = Field(default_factory=dict)
    """Further axes, by names: placed before a run and held during it."""
    rotary_axes: dict[Name, HeldRotaryAxes] = Field(default_factory=dict)
    """The same for axes that rotate."""
    sensors: dict[Name, SensorLine] = Field(default_factory=dict)
    """Wires of the scenario's sensors, by their names."""
    sign_off: SignOff | None = None

    @property
    def moved_target(self) -> TargetManipulator | None:
        """Rails of the target, held or driven in a run; None without any."""
        target = self.target_manipulator
        return None if target is None or target.driver == "none" else target

    @property
    def rotated_target(self) -> RotaryManipulator | None:
        """Rotary manipulator of the target; None without one."""
        target = self.rotary_manipulator
        return None if target is None or target.driver == "none" else target

    @property
    def shared_rails(self) -> TargetManipulator | None:
        """Rails that move the target in a run; None without any."""
        target = self.moved_target
        return None if target is None or target.sharing == "none" else target

    @property
    def moving_target(self) -> TargetManipulator | RotaryManipulator | None:
        """Axes that move the target in a run; None without any."""
        return self.rotated_target or self.shared_rails

    @property
    def undriven(self) -> list[str]:
        """Full names of those of ``BENCH_AXES`` that have no drive."""
        groups = {"rails": self.rails, "turntable": self.turntable}
        return [name for name in BENCH_AXES if name.partition(".")[2] not in groups[name.partition(".")[0]].driven]

    @property
    def hidden(self) -> list[str]:
        """Those of ``undriven`` along which the bench does not show the truth; a floating vehicle shows it itself."""
        return self.undriven if self.floating is None else []

    @property
    def is_reduced(self) -> bool:
        """Whether the bench cannot show every pose, or has L not parallel to H."""
        return bool(self.hidden) or self.bench.lab_axes != UNIT_AXES

    @property
    def target_axes(self) -> TargetManipulator | RotaryManipulator | None:
        """Axes that move the target, device ``target``; None without any."""
        return self.moved_target or self.rotated_target

    @property
    def held_axes(self) -> dict[str, HeldAtPlace]:
        """Further axes that are held at their places, by names."""
        return {name: table for name, table in (self.linear_axes | self.rotary_axes).items() if table.driver != "none"}

    @property
    def held_numbers(self) -> dict[str, int]:
        """Numbers of axes of the groups of further axes, by names."""
        return {name: len(table.axes) for name, table in self.held_axes.items()}

    @property
    def groups_at_places(self) -> dict[str, HeldAtPlace]:
        """All axes that are held at their places during a run: target axes, if the target stands, and further ones."""
        return ({} if self.moved_target is None else {"target": self.moved_target}) | self.held_axes

    @property
    def axis_groups(self) -> dict[str, AxisGroupTable]:
        """All axes of the bench, by the names of their devices."""
        target = {} if self.target_axes is None else {"target": self.target_axes}
        return {"rails": self.rails, "turntable": self.turntable, **target, **self.held_axes}

    @property
    def axis_names(self) -> list[str]:
        """Full names of all axes, as ``rails.x``: rails and turntable first, then target axes, then further ones."""
        return [f"{group}.{axis}" for group, table in self.axis_groups.items() for axis in table.axis_names]

    @model_validator(mode="after")
    def _further_axes_fit(self) -> Self:
        if (n := sum(self.held_numbers.values())) > FURTHER_AXES_MAX:
            raise ValueError(f"linear_axes, rotary_axes: {n} axes, at most {FURTHER_AXES_MAX} are allowed")
        return self

    @model_validator(mode="after")
    def _names_of_axes_differ(self) -> Self:
        taken = {"rails", "turntable", "target", "vmu", "io", "monitor", "sensor"}
        for key, names in (("linear_axes", set(self.linear_axes)), ("rotary_axes", set(self.rotary_axes))):
            for name in sorted(names):
                if name in taken or "." in name or "-" in name:
                    raise ValueError(f'{key}.{name}: the name of another device, or with "." or "-", allowed: others')
            taken |= names
        return self

    @property
    def has_vmu(self) -> bool:
        """Whether the bench has a vision unit; without one other sensors give the navigation what it needs."""
        return self.vmu.driver != "none"

    @property
    def has_io(self) -> bool:
        """Whether the bench has a coupler of digital lines."""
        return self.io is not None and self.io.driver != "none"

    @model_validator(mode="after")
    def _fixed_gimbal_is_off_the_pole(self) -> Self:
        name = {"x": "roll", "y": "pitch", "z": "yaw"}[self.bench.gimbal_order[1]]
        middle: GimbalAxis = getattr(self.turntable, name)
        if middle.is_fixed and abs(middle.park_deg) > MIDDLE_AXIS_MAX_DEG:
            raise ValueError(
                f"turntable.{name}.fixed_deg {middle.park_deg:g}: the middle gimbal of bench.gimbal_order, allowed "
                f"-{MIDDLE_AXIS_MAX_DEG:g} to {MIDDLE_AXIS_MAX_DEG:g}"
            )
        return self

    @model_validator(mode="after")
    def _nothing_drives_what_floats(self) -> Self:
        if self.floating is None:
            return self
        driven = [f"{key}.{name}" for key, table in self.axis_groups.items() for name in table.driven]
        wrong = {
            f"{', '.join(driven)} driven, allowed no axis": driven,
            "bench.axes_rate_hz, allowed none": self.bench.axes_rate_hz is not None,
            "bench.lab_axes, allowed those of H": self.bench.lab_axes != UNIT_AXES,
            "bench.errors or bench.geometry_file, allowed none: they are of axes": (
                self.bench.errors != MachineErrors() or self.bench.geometry_file is not None
            ),
            f'bench.gimbal_order "{self.bench.gimbal_order}", allowed "yxz", "yzx": y outside': (
                self.bench.gimbal_order[0] != "y"
            ),
            f'vmu.driver "{self.vmu.driver}", allowed one that measures the pose': not self.has_vmu,
            "no thruster lines, allowed io.thruster_lines of an io.driver": (
                self.io is None or not self.has_io or not self.io.thruster_lines
            ),
        }
        for text, is_wrong in wrong.items():
            if is_wrong:
                raise ValueError(f"floating: does not go with {text}")
        return self

    @model_validator(mode="after")
    def _one_thing_moves_the_target(self) -> Self:
        if self.moved_target is not None and self.rotated_target is not None:
            raise ValueError(
                "rotary_manipulator.driver: gimbals and rails of target_manipulator do not move the target together, "
                'allowed "none"; rails that stand in a run are linear_axes.NAME'
            )
        return self

    @property
    def robots(self) -> dict[str, Arm]:
        """Robots of the bench, by the names of their devices; on a mock rig their limits alone."""
        return {name: arm for name, arm in (("arm", self.arm), ("target_arm", self.target_arm)) if arm is not None}

    @property
    def robots_on_wires(self) -> dict[str, Arm]:
        """The same without those of a mock rig."""
        return {} if self.kind == "mock" else self.robots

    def robot_axes(self, name: str) -> dict[str, AxisGroupTable]:
        """Return the axes that the robot ``name`` stands for, by their groups, without those of other controllers."""
        groups = {key: each for key, each in self.axis_groups.items() if (key == "target") == (name == "target_arm")}
        parts = {key: groups[key].parts(key).get(key) for key in ("rails", "turntable", "target") if key in groups}
        return {key: part for key, part in parts.items() if part is not None}

    @model_validator(mode="after")
    def _robots_stand_for_all_of_a_group(self) -> Self:
        robots = {"rails": "arm", "turntable": "arm", "rotary_manipulator": "target_arm"}
        allowed = "mock" if self.kind == "mock" else "arm"
        tables = self.device_tables()
        for key, table in tables.items():
            name = robots.get(key)
            if table.driver == "arm" and name is None:
                raise ValueError(f'{key}.driver = "arm": allowed for {", ".join(robots)}')
            if table.driver == "arm" and name not in self.robots:
                raise ValueError(f'{key}.driver = "arm": needs the table [{name}] of the robot')
            if name in self.robots and table.driver != allowed:
                raise ValueError(f'{key}.driver = "{table.driver}": does not go with [{name}], allowed "{allowed}"')
        for name in self.robots:
            keys = [key for key, robot in robots.items() if robot == name]
            if not any(key in tables for key in keys):
                raise ValueError(f"{name}: needs driven axes of {' or '.join(keys)}")
        for key in ("turntable", "rotary_manipulator"):
            if robots[key] in self.robots and any(each.startswith(f"{key}.controllers") for each in tables):
                raise ValueError(f"{key}.controllers: do not go with [{robots[key]}], allowed none")
        return self

    @model_validator(mode="after")
    def _drivers_suit_the_kind(self) -> Self:
        for key, group in (("rails", self.rails), ("turntable", self.turntable)):
            if group.driver == "none" and group.driven:
                raise ValueError(f'{key}.driver = "none": drives no axis, allowed: fixed {", ".join(group.driven)}')
        for key, table in self.device_tables().items():
            if (table.driver == "mock") != (self.kind == "mock"):
                raise ValueError(f'{key}.driver = "{table.driver}" does not go with kind = "{self.kind}"')
        return self

    @property
    def on_overrun(self) -> OnOverrun:
        """Overrun policy: the file's, else the default of the kind of rig."""
        return self.host.on_overrun or ("safe_stop" if self.kind == "hardware" else "log")

    @model_validator(mode="after")
    def _hardware_says_whether_it_has_io(self) -> Self:
        if self.kind == "hardware" and self.io is None:
            text = "[io] is missing: hardware needs emergency stop and safety relay on digital lines"
            raise ValueError(f'{text}; io.driver = "none" if the bench has none')
        return self

    @model_validator(mode="after")
    def _gravity_loaded_axes_are_held(self) -> Self:
        """The brake of a gravity-loaded axis holds it before the relay removes the torque."""
        for key, table in self.device_tables().items():
            if not isinstance(table, AxisGroupTable):
                continue
            for name, axis in zip(table.axis_names, table.axes, strict=True):
                if not axis.falls:
                    continue
                if axis.brake is None and self.kind == "hardware":
                    raise ValueError(
                        f"{key}.{name}.gravity_loaded: needs brake or counterweight, without torque it falls"
                    )
                delay_s = self.io.torque_delay_s if self.io is not None and self.has_io else math.inf
                if axis.brake is not None and axis.brake.close_s > delay_s:
                    raise ValueError(
                        f"io.torque_delay_s {delay_s:g}: allowed from {key}.{name}.brake.close_s {axis.brake.close_s:g}"
                    )
        return self

    @model_validator(mode="after")
    def _wires_have_one_user(self) -> Self:
        """A serial port has one driver; groups of CiA 402 drives may share a bus, with node ids of their own.

        Emulators make the wires of other rigs.
        """
        if self.kind != "hardware":
            return self
        users: dict[str, str] = {}
        nodes: dict[tuple[object, ...], str] = {}
        for key, table in self.device_tables().items():
            can = getattr(table, "cia402", None) if table.driver == "cia402" else None
            for wire in table.wires(key):
                name = f"{wire.kind} {wire.address}"
                if wire.kind != "serial" or wire.address in (None, os.devnull):  # the null device connects nothing
                    continue
                if name in users:
                    raise ValueError(f"{wire.key}: {wire.address} is also {users[name]}, allowed: a port of its own")
                users[name] = wire.key
            if not isinstance(can, Cia402) or can.channel is None or not isinstance(table, AxisGroupTable):
                continue
            for node_id in (*table.ids_of(can.node_ids), can.master_id):
                bus = (can.interface, can.channel, node_id)
                if bus in nodes:
                    raise ValueError(
                        f"{key}.cia402: node id {node_id} on {can.channel} is also one of {nodes[bus]}, "
                        "allowed: others (node_ids, bench_node_id)"
                    )
                nodes[bus] = key
        return self

    @property
    def holding_brakes(self) -> list[Brake]:
        """Brakes of all gravity-loaded axes."""
        return [brake for table in self.axis_groups.values() for brake in table.holding_brakes]

    @property
    def brake_close_s(self) -> float:
        """Longest closing time of the holding brakes, s; 0 without one."""
        return max((brake.close_s for brake in self.holding_brakes), default=0.0)

    @property
    def brake_open_s(self) -> float:
        """Longest opening time of the holding brakes, s; 0 without one."""
        return max((brake.open_s for brake in self.holding_brakes), default=0.0)

    def ticks(self, step_s: float) -> int:
        """Return the number of setpoints per cycle of ``step_s``."""
        rate_hz = self.bench.axes_rate_hz
        return 1 if rate_hz is None else max(1, round(rate_hz * step_s))

    def telemetry_cycles(self, step_s: float) -> int:
        """Return the number of cycles of ``step_s`` per row of the telemetry."""
        rate_hz = self.telemetry.rate_hz
        return 1 if rate_hz is None else max(1, round(1.0 / (rate_hz * step_s)))

    def device_tables(self) -> dict[str, DeviceTable]:
        """Return the tables of the bench's devices by their keys; an axis group is given as its parts."""
        groups: dict[str, AxisGroupTable] = {"rails": self.rails, "turntable": self.turntable}
        if self.moved_target is not None:
            groups["target_manipulator"] = self.moved_target
        if self.rotated_target is not None:
            groups["rotary_manipulator"] = self.rotated_target
        for key in ("linear_axes", "rotary_axes"):
            groups |= {f"{key}.{name}": each for name, each in getattr(self, key).items() if each.driver != "none"}
        tables: dict[str, DeviceTable] = {}
        for key, group in groups.items():
            keys = [key, *(f"{key}.controllers.{number}" for number in range(len(group.own_controllers)))]
            tables |= zip(keys, group.parts(key).values(), strict=bool(group.driven))
        tables |= self.robots_on_wires
        if self.io is not None and self.has_io:
            tables["io"] = self.io
        return tables | ({"vmu": self.vmu} if self.has_vmu else {})

    def wires(self) -> list[Wire]:
        """Return the wires that the drivers open, also those without an address in the file."""
        lines = [Wire(f"sensors.{name}.port", "serial", line.port) for name, line in self.sensors.items()]
        return self._device_wires() + lines + self.flight_computer.wires()

    def missing_wires(self) -> list[str]:
        """Return the keys of devices' wires that the file does not name."""
        return [wire.required_key for wire in self._device_wires() if wire.address is None]

    def _device_wires(self) -> list[Wire]:
        wires = [wire for key, table in self.device_tables().items() for wire in table.wires(key)]
        return wires + ([self.imu.wire()] if self.imu is not None and self.kind != "mock" else [])
