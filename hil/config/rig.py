"""Rig files: devices of the bench, their wires, limits and geometry."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Field, model_validator

from hil.config.console import ConsoleTable
from hil.config.driver_registry import DeviceTable, Wire
from hil.config.flight_computer import FlightComputer
from hil.config.gnc_link import GncLink
from hil.config.host import HostConfig, OnOverrun
from hil.config.io import Io
from hil.config.model import ConfigModel, Matrix3, Name, NotNegative, Positive, Triple
from hil.config.rail_map import RailMap
from hil.config.rail_wires import ModbusRtu
from hil.config.recording import RecordingTable
from hil.config.sign_off import SignOff

RAIL_NAMES = ("x", "y", "z")
GIMBAL_NAMES = ("roll", "pitch", "yaw")
BENCH_AXES = (*(f"rails.{name}" for name in RAIL_NAMES), *(f"turntable.{name}" for name in GIMBAL_NAMES))


NodeId = Annotated[int, Field(ge=1, le=127)]
LEAD_MAX_S = 0.2
Lead = Annotated[float, Field(ge=-LEAD_MAX_S, le=LEAD_MAX_S)]  # s; negative for an axis that leads
Encoder = Literal["absolute", "incremental"]  # incremental: the axis must be homed after power-up
Unsigned32 = Annotated[int, Field(ge=0, le=0xFFFF_FFFF)]


class BenchGeometry(ConfigModel):
    """Mounting of the bench (frames: docs/explanation/frames.md)."""

    lever_arm_m: Triple  # in c: turntable's rotation centre to the chaser's reference point
    gimbal_order: Literal["zyx", "zxy", "yzx", "yxz", "xyz", "xzy"] = "zyx"  # outer to inner
    camera_position_m: Triple = (0.6, 0.0, 0.0)  # in c: chaser's reference point to the left camera
    camera_axes: Matrix3 = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))  # rows: v axes in c
    led_ring_position_m: Triple = (0.0, 0.0, 0.0)  # in H: target's reference point to the ring centre
    park_after_run: bool = False  # at the end of a run all axes go to their park_m and park_deg
    led_ring_axes: Matrix3 = ((0.0, -1.0, 0.0), (0.0, 0.0, 1.0), (-1.0, 0.0, 0.0))  # rows: t axes in H

    @model_validator(mode="after")
    def _axes_are_right_handed(self) -> Self:
        for name, m in (("camera_axes", self.camera_axes), ("led_ring_axes", self.led_ring_axes)):
            gram = [[sum(a * b for a, b in zip(p, q, strict=True)) for q in m] for p in m]
            identity = all(abs(gram[i][j] - (i == j)) < 1e-9 for i in range(3) for j in range(3))
            cross = (
                m[0][1] * m[1][2] - m[0][2] * m[1][1],
                m[0][2] * m[1][0] - m[0][0] * m[1][2],
                m[0][0] * m[1][1] - m[0][1] * m[1][0],
            )
            if not identity or sum(a * b for a, b in zip(cross, m[2], strict=True)) < 0.0:
                raise ValueError(f"{name} must be three right-handed unit axes at right angles")
        return self


class Servo(ConfigModel):
    """Dynamics of an axis of mock and emulator."""

    gain_per_s: Positive
    lag_s: Positive


class RailAxis(ConfigModel):
    """One rail. An axis with an incremental encoder must be homed after power-up."""

    travel_m: tuple[float, float]
    rate_max_mps: Positive
    acceleration_max_mps2: Positive
    park_m: float = 0.0
    encoder: Encoder = "absolute"
    home_m: float = 0.0  # position of the home switch
    homing_rate_mps: Positive = 0.05
    lead_s: Lead = 0.0  # lead of the setpoints; measured by hil identify

    @property
    def limits(self) -> tuple[float, float, float, float, float]:
        """Low and high end of the travel, highest rate, highest acceleration, park position."""
        return *self.travel_m, self.rate_max_mps, self.acceleration_max_mps2, self.park_m

    @property
    def home(self) -> float:
        return self.home_m

    @property
    def homing_rate(self) -> float:
        return self.homing_rate_mps

    @model_validator(mode="after")
    def _park_is_on_the_rail(self) -> Self:
        _check_travel("travel_m", self.travel_m, "park_m", self.park_m)
        return self


class GimbalAxis(ConfigModel):
    """One axis of the turntable. An axis with an incremental encoder must be homed after power-up."""

    travel_deg: tuple[float, float]
    rate_max_degps: Positive
    acceleration_max_degps2: Positive
    park_deg: float = 0.0
    encoder: Encoder = "absolute"
    home_deg: float = 0.0  # position of the home switch
    homing_rate_degps: Positive = 5.0
    lead_s: Lead = 0.0  # lead of the setpoints; measured by hil identify

    @property
    def limits(self) -> tuple[float, float, float, float, float]:
        """Low and high end of the travel, highest rate, highest acceleration, park position."""
        return *self.travel_deg, self.rate_max_degps, self.acceleration_max_degps2, self.park_deg

    @property
    def home(self) -> float:
        return self.home_deg

    @property
    def homing_rate(self) -> float:
        return self.homing_rate_degps

    @model_validator(mode="after")
    def _park_is_in_range(self) -> Self:
        _check_travel("travel_deg", self.travel_deg, "park_deg", self.park_deg)
        return self


def _check_travel(travel_key: str, travel: tuple[float, float], park_key: str, park: float) -> None:
    if not travel[0] < travel[1]:
        raise ValueError(f"{travel_key} must rise from low to high")
    if not travel[0] <= park <= travel[1]:
        raise ValueError(f"{park_key} must lie within {travel_key}")


class ModbusAxis(ConfigModel):
    """Address of the drive of one rail."""

    host: str = "127.0.0.1"
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    device_id: Annotated[int, Field(ge=1, le=247)] = 1


class Modbus(ConfigModel):
    """Three drives on Modbus TCP."""

    x: ModbusAxis = ModbusAxis()
    y: ModbusAxis = ModbusAxis()
    z: ModbusAxis = ModbusAxis()


class Cia402(ConfigModel):
    """Three CiA 402 drives on one CAN bus, roll, pitch, yaw."""

    interface: str = "serial"  # a python-can interface
    channel: str | None = None
    bitrate: Annotated[int, Field(gt=0)] = 1_000_000
    baud: Annotated[int, Field(gt=0)] = 1_000_000  # of a serial adapter
    node_ids: tuple[NodeId, NodeId, NodeId] = (1, 2, 3)
    counts_per_turn: Annotated[int, Field(gt=0, le=1_000_000_000)] = 10_000_000
    eds_file: str | None = None  # of the drives; the emulated drive's, shipped with the driver, when not given
    heartbeat_s: Annotated[float, Field(ge=0.01, le=60.0)] = 0.05  # heartbeat period of the drives
    homing_method: Annotated[int, Field(ge=-128, le=37)] = 24  # object 0x6098; 24: home switch, positive start
    vendor_id: Unsigned32 | None = None  # object 0x1018, what the drives must be; not given: any
    product_code: Unsigned32 | None = None
    revision_min: Unsigned32 | None = None
    firmware: str | None = None  # object 0x100A

    @model_validator(mode="after")
    def _nodes_differ(self) -> Self:
        if len(set(self.node_ids)) != len(self.node_ids):
            raise ValueError(f"node_ids {list(self.node_ids)} must differ from each other")
        return self


class SerialLine(ConfigModel):
    """A serial port."""

    port: str | None = None
    baud: Annotated[int, Field(gt=0)] = 460_800


class AsciiTurntableLine(SerialLine):
    """Serial port and command set of the turntable controller."""

    protocol: str = "hil-ascii"  # a shipped protocol file by its name, or the path of one
    identity: dict[Literal["model", "serial", "firmware"], str] = Field(default_factory=dict)  # expected identification


class AxisGroupTable(DeviceTable):
    """Table of three axes, each in a table of its own name."""

    axis_names: ClassVar[tuple[str, str, str]]
    si_per_unit: ClassVar[float]  # of positions in the file: 1 for m, rad per degree

    timeout_s: Positive = 0.4
    servo: Servo

    @property
    def axes(self) -> tuple[RailAxis | GimbalAxis, ...]:
        """The axes in the order of ``axis_names``."""
        return tuple(getattr(self, name) for name in self.axis_names)

    @property
    def encoder_sigma(self) -> float:
        """Noise of the emulated encoders, in the unit of the file."""
        raise NotImplementedError


class Rails(AxisGroupTable):
    """Three rails: x, y, z."""

    device: ClassVar = "rails"
    axis_names: ClassVar = RAIL_NAMES
    si_per_unit: ClassVar = 1.0

    following_error_max_m: Positive = 0.05  # at rest
    following_error_per_speed_s: NotNegative = 0.0  # m more for each m/s of commanded speed
    lost_packets_max: Positive = 5.0
    lost_packets_window_s: Positive = 1.0  # drain time of the leaky bucket per lost packet
    encoder_sigma_m: NotNegative = 0.0  # noise of the emulated encoders
    x: RailAxis
    y: RailAxis
    z: RailAxis
    modbus: Modbus | None = None
    rtu: ModbusRtu | None = None
    map: RailMap = RailMap()

    @property
    def encoder_sigma(self) -> float:
        return self.encoder_sigma_m


class TargetManipulator(Rails):
    """Manipulator of the target: three axes like the rails, placed before a run and held during it."""

    without_wires: ClassVar = ("mock", "none")

    place_m: Triple = (0.0, 0.0, 0.0)
    held_within_m: Positive = 0.005

    @model_validator(mode="after")
    def _the_place_can_be_reached(self) -> Self:
        for name, place in zip(RAIL_NAMES, self.place_m, strict=True):
            low, high = getattr(self, name).travel_m
            if not low <= place <= high:
                raise ValueError(f"place_m: {name} {place:g}, allowed {low:g} to {high:g}")
        return self


class Turntable(AxisGroupTable):
    """Three gimbals: roll, pitch, yaw."""

    device: ClassVar = "turntable"
    axis_names: ClassVar = GIMBAL_NAMES
    si_per_unit: ClassVar = math.pi / 180.0

    following_error_max_deg: Positive = 2.0  # at rest
    following_error_per_speed_s: NotNegative = 0.0  # deg more for each deg/s of commanded speed
    lost_packets_max: Positive = 5.0
    lost_packets_window_s: Positive = 1.0  # drain time of the leaky bucket per lost packet
    encoder_sigma_deg: NotNegative = 0.0  # noise of the emulated encoders
    roll: GimbalAxis
    pitch: GimbalAxis
    yaw: GimbalAxis
    cia402: Cia402 | None = None
    ascii: AsciiTurntableLine | None = None

    @property
    def encoder_sigma(self) -> float:
        return self.encoder_sigma_deg


class RigCamera(ConfigModel):
    """Both cameras of the vision unit."""

    focal_px: Positive = 1200.0
    width_px: Annotated[int, Field(gt=0)] = 1024
    height_px: Annotated[int, Field(gt=0)] = 1024
    baseline_m: Positive = 0.20  # from the left camera to the right one, along x_v


def _ring(radius_m: float, raised_m: float) -> tuple[Triple, ...]:
    """Return six LEDs evenly spaced on a circle in t, the first one raised towards the camera."""
    angles = [math.tau * k / 6 for k in range(6)]
    flat = [(radius_m * math.cos(angle), radius_m * math.sin(angle), 0.0) for angle in angles]
    return (radius_m, 0.0, -raised_m), *flat[1:]


class VmuIdentity(ConfigModel):
    """Expected identification of the unit; omitted keys are not checked."""

    vendor: str | None = None
    serial: str | None = None
    firmware: str | None = None  # "1.4"


class Vmu(DeviceTable):
    """Vision measurement unit."""

    device: ClassVar = "vmu"

    timeout_s: Positive = 0.4
    rate_hz: Positive = 6.25
    lost_packets_max: Positive = 10.0
    lost_packets_window_s: Positive | None = None  # default: two frame periods
    processing_s: NotNegative = 0.0  # from exposure to the first byte
    clock: Literal["shared", "own"] = "shared"  # time stamps are bench time, or of a clock in the unit
    camera: RigCamera = RigCamera()
    leds_m: Annotated[tuple[Triple, ...], Field(min_length=1)] = _ring(0.12, 0.06)  # in t
    geometry_file: str | None = None  # calibrated cameras and LEDs of the unit; default: camera and leds_m
    bench_sigma_m: NotNegative = 0.0  # error of bench and calibration added to the reported sigma, per axis
    bench_sigma_deg: NotNegative = 0.0
    identity: VmuIdentity = VmuIdentity()
    rs422: SerialLine | None = None


class Safety(ConfigModel):
    """Limits of the safety monitor, in addition to those of each device."""

    command_age_max_s: Positive = 0.5  # since the last setpoint, while axes are under command
    homing_timeout_s: Positive = 120.0  # for all axes together


class Rig(ConfigModel):
    """One bench."""

    name: Name
    kind: Literal["mock", "emulated", "hardware"]
    bench: BenchGeometry
    rails: Rails
    turntable: Turntable
    vmu: Vmu
    safety: Safety = Safety()
    host: HostConfig = HostConfig()
    console: ConsoleTable = ConsoleTable()
    recording: RecordingTable = RecordingTable()
    gnc_link: GncLink = GncLink()
    flight_computer: FlightComputer = FlightComputer()
    io: Io | None = None
    target_manipulator: TargetManipulator | None = None
    sign_off: SignOff | None = None

    @property
    def moved_target(self) -> TargetManipulator | None:
        """Manipulator of the target; None if the target is fixed."""
        target = self.target_manipulator
        return None if target is None or target.driver == "none" else target

    @property
    def has_io(self) -> bool:
        """Whether the bench has a coupler of digital lines."""
        return self.io is not None and self.io.driver != "none"

    @model_validator(mode="after")
    def _drivers_suit_the_kind(self) -> Self:
        for key, table in self.device_tables().items():
            if (table.driver == "mock") != (self.kind == "mock"):
                raise ValueError(f'{key}.driver = "{table.driver}" does not go with kind = "{self.kind}"')
        return self

    @property
    def on_overrun(self) -> OnOverrun:
        """Overrun policy: that of the file, else the default of the kind of rig."""
        return self.host.on_overrun or ("safe_stop" if self.kind == "hardware" else "log")

    @model_validator(mode="after")
    def _hardware_says_whether_it_has_io(self) -> Self:
        if self.kind == "hardware" and self.io is None:
            text = "[io] is missing: hardware needs emergency stop and safety relay on digital lines"
            raise ValueError(f'{text}; io.driver = "none" if the bench has none')
        return self

    def device_tables(self) -> dict[str, DeviceTable]:
        """Return the tables of the devices that the bench has, by their keys."""
        tables: dict[str, DeviceTable] = {"rails": self.rails, "turntable": self.turntable}
        if self.io is not None and self.has_io:
            tables["io"] = self.io
        tables["vmu"] = self.vmu
        if self.moved_target is not None:
            tables["target_manipulator"] = self.moved_target
        return tables

    def wires(self) -> list[Wire]:
        """Return the wires that the drivers open, also those without an address in the file."""
        found = [wire for key, table in self.device_tables().items() for wire in table.wires(key)]
        return found + self.flight_computer.wires()

    def missing_wires(self) -> list[str]:
        """Return the keys of devices' wires that the file does not name."""
        found = [wire for key, table in self.device_tables().items() for wire in table.wires(key)]
        return [wire.required_key for wire in found if wire.address is None]
