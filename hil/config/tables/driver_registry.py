"""Registry of device drivers: the drivers that a rig file can select, and what each of them provides.

A driver is described by one ``DriverEntry``. Entries of this package are listed in ``_BUILT_IN``. Entries of other
packages are found by entry points of the group ``hil.drivers``, named ``DEVICE.DRIVER``:

    [project.entry-points."hil.drivers"]
    "rails.acme" = "acme_rails.entry:ENTRY"

An entry is imported when a rig file selects its driver, its driver and emulator when one is made.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from importlib.metadata import EntryPoint, entry_points
from typing import Any, ClassVar, Final, Literal, Self

from pydantic import BaseModel, field_validator, model_validator

from hil.config.tables.model import ConfigModel
from hil.config.tables.open_table import OpenTable, model_of_field
from hil.core.plug_ins import plug_in_error, raised_text
from hil.errors import INSTALLED, BadInput, HilError

Device = Literal["rails", "turntable", "vmu", "io", "arm"]
WireKind = Literal["serial", "tcp", "udp", "can", "camera", "other"]

GROUP: Final = "hil.drivers"
_PACKAGE: Final = "hil"
_BUILT_IN: Final = {
    "rails.modbus": "hil.drivers.rails.entry:TCP",
    "rails.modbus_rtu": "hil.drivers.rails.entry:RTU",
    "rails.arm": "hil.drivers.arm.entry:RAILS",
    "turntable.cia402": "hil.drivers.turntable.cia402.entry:ENTRY",
    "turntable.ascii": "hil.drivers.turntable.ascii.entry:ENTRY",
    "turntable.arm": "hil.drivers.arm.entry:TURNTABLE",
    "vmu.rs422": "hil.drivers.vmu.entry:ENTRY",
    "vmu.udp": "hil.drivers.vmu.entry:DATAGRAMS",
    "vmu.cameras": "hil.drivers.vmu.entry:CAMERAS",
    "io.modbus": "hil.drivers.io.entry:ENTRY",
}
_AXES_OF_A_DEVICE: Final = 3
_TCP: Final = "tcp://"  # a controller on Ethernet with a protocol of serial lines
_SERIAL_CAN: Final = ("serial", "slcan")  # interfaces of python-can that are serial ports


@dataclass(frozen=True, slots=True)
class Wire:
    """One wire of a rig. address: path, host:port or CAN channel; None if the rig file does not give it."""

    key: str
    kind: WireKind
    address: str | None

    @property
    def required_key(self) -> str:
        """The key that must be given for the driver to open this wire."""
        return f"{self.key}.port" if self.kind in ("tcp", "udp") else self.key


@dataclass(frozen=True, slots=True)
class WireKey:
    """Key of a device's table that holds the address of one wire, and what an emulator sets there.

    key: of a serial port, CAN channel or camera, for "tcp" and "udp" of the table with ``host`` and ``port``, with
    "udp" those of this computer on which datagrams are received. name: of the address that the emulator reports,
    ``DEVICE.NAME``, ``DEVICE`` if empty. emulated: further keys of the same table that are set for an emulator.
    """

    key: str
    kind: Literal["serial", "tcp", "udp", "can", "camera"]
    name: str = ""
    emulated: Mapping[str, Any] = field(default_factory=dict)

    def wire(self, table: ConfigModel) -> Wire:
        """Return the wire as ``table`` configures it."""
        *parents, last = self.key.split(".")
        if self.kind in ("tcp", "udp"):
            model = _inner(table, [key for key in (*parents, last) if key])
            port = getattr(model, "port", None)
            return Wire(self.key, self.kind, None if port is None else f"{getattr(model, 'host', '')}:{port}")
        model = _inner(table, parents)
        kind: WireKind = "camera" if self.kind == "camera" else "serial"
        if self.kind == "can":
            interface = getattr(model, "interface", "socketcan")
            kind = "can" if interface == "socketcan" else "serial" if interface in _SERIAL_CAN else "other"
        address = getattr(model, last, None)
        if self.kind == "serial" and str(address).startswith(_TCP):
            return Wire(self.key, "tcp", str(address).removeprefix(_TCP))
        return Wire(self.key, kind, address)

    def connected(self, table: Any, address: str) -> Any:
        """Return ``table`` with the address that the emulator reports."""
        *parents, last = self.key.split(".")
        if self.kind in ("tcp", "udp"):
            host, _, port = address.rpartition(":")
            path = [key for key in (*parents, last) if key]
            return _updated(table, path, {"host": host, "port": int(port), **self.emulated})
        return _updated(table, parents, {last: address, **self.emulated})


@dataclass(frozen=True)
class DriverEntry:
    """One driver of one device.

    driver, emulator: import paths, ``module:factory``. Factories of axis groups: ``driver(table, clock, name)`` and
    ``emulator(table, clock, shared_state, seed=, name=)``; docs/how-to/write-a-driver.md lists the other devices'.
    settings: model of the table ``[DEVICE.NAME]``, None if the device's table has the keys itself.
    wires: keys of the addresses that the driver opens.
    check: raises ValueError if the keys of the table contradict each other.
    check_files: returns a line per protection that the files named in the table leave out; raises BadInput for a file
    that the driver cannot use.
    identity: what the driver requires the device to report, by name; empty: any device is accepted.
    has_processes: whether the driver, of a vision unit, has processes of its own: the loop reads their memory, without
    the I/O process between.
    emulated_parts: parts of the device that are emulated in a process each; none: the device in one.
    setpoints_hz: most setpoints per second that the wire of an axis group carries, or frames that of a vision unit; inf
    if its speed does not matter.
    axes: numbers of axes that driver and emulator of an axis group serve, those of ``table.axis_names``.
    model: import path of the model of a robot, ``factory(table)``: ``RobotModel`` in ``hil.drivers.arm.model``.
    keeps_bench_time: whether driver and emulator wait by the clock that they are given, and count the bytes of their
    wires by it: required in lock-step.
    """

    device: Device
    name: str
    driver: str
    emulator: str | None = None
    settings: type[ConfigModel] | None = None
    wires: Sequence[WireKey] = ()
    check: Callable[[Any], None] = lambda table: None
    check_files: Callable[[Any], list[str]] = lambda table: []
    identity: Callable[[Any], Mapping[str, str]] = lambda table: {}
    has_processes: bool = False
    emulated_parts: Sequence[str] = ()
    setpoints_hz: Callable[[Any], float] = lambda table: math.inf
    axes: range = range(3, 4)
    model: str = ""
    keeps_bench_time: Callable[[Any], bool] = lambda table: False


@cache
def driver_entry(device: str, name: str) -> DriverEntry:
    """Return the entry of the driver ``name``; raise ValueError, one line, if there is no usable one."""
    key = f"{device}.{name}"
    if key in _BUILT_IN:
        entry: DriverEntry = _imported(_BUILT_IN[key])
        return entry
    points = [point for point in entry_points(group=GROUP) if point.name == key]
    if not points:
        raise ValueError(f'"{name}": unknown {device} driver, known: {_listed(device)}{INSTALLED}')
    if len(points) > 1:
        raise ValueError(f'"{name}": {device} driver of several packages: {", ".join(map(_package, points))}')
    (point,) = points
    what = f'"{name}": {device} driver of package {_package(point)}: {point.value}'
    try:
        loaded = point.load()
    except Exception as cause:
        raise ValueError(f"{what} cannot be imported: {type(cause).__name__}: {cause}") from cause
    if not isinstance(loaded, DriverEntry):
        raise ValueError(f"{what} is of type {type(loaded).__name__}, expected DriverEntry")
    if (loaded.device, loaded.name) != (device, name):
        raise ValueError(f"{what} is the entry of {loaded.device}.{loaded.name}, expected {key}")
    return loaded


def check_axes(key: str, device: str, name: str, axes: Sequence[str], all_names: Sequence[str]) -> None:
    """Raise ValueError, one line that begins with ``key``, if the driver ``name`` cannot drive ``axes``.

    all_names: of the axes that the device may have; a driver of three axes alone drives the first ones.
    """
    drivers = [other.partition(".")[2] for other in _BUILT_IN if other.startswith(f"{device}.")]
    drivers = [other for other in drivers if other != "arm"]  # which needs a robot
    allowed, n = driver_entry(device, name).axes, len(axes)
    if n in allowed and (len(allowed) > 1 or n < _AXES_OF_A_DEVICE or [*axes] == [*all_names[:n]]):
        return
    others = [other for other in drivers if n in (counts := driver_entry(device, other).axes) and len(counts) > 1]
    first = ", ".join(all_names[: allowed[0]]) if allowed[0] >= _AXES_OF_A_DEVICE else f"{allowed[0]}, any of them"
    drives = first if len(allowed) == 1 else f"{allowed[0]} to {allowed[-1]} axes"
    raise ValueError(f'{key} "{name}": drives {drives}, here {", ".join(axes)}; allowed: {", ".join(others)}')


def registered_drivers() -> dict[str, str]:
    """Return the package of each driver of wires, by the setting that selects it: ``rig.rails.driver=modbus``."""
    keys = [(key, _PACKAGE) for key in _BUILT_IN] + [(p.name, _package(p)) for p in entry_points(group=GROUP)]
    return {f"rig.{key.partition('.')[0]}.driver={key.partition('.')[2]}": package for key, package in keys}


def _listed(device: str) -> str:
    own = [key.removeprefix(f"{device}.") for key in _BUILT_IN if key.startswith(f"{device}.")]
    others = [
        f"{point.name.removeprefix(f'{device}.')} ({_package(point)})"
        for point in entry_points(group=GROUP)
        if point.name.startswith(f"{device}.") and point.name not in _BUILT_IN
    ]
    return ", ".join([", ".join(["mock", *own]) + f" ({_PACKAGE})", *sorted(others)])


def _package(point: EntryPoint) -> str:
    return f"{point.dist.name} {point.dist.version}" if point.dist else "unknown package"


def _imported(path: str) -> Any:
    module, _, name = path.partition(":")
    if not hasattr(imported := import_module(module), name):
        raise AttributeError(f"entry {path!r}: the module has no {name!r}")
    return getattr(imported, name)


def _made(device: str, path: str, *args: Any, **kwargs: Any) -> Any:
    """Return what the factory ``path`` makes. Raises DeviceError for what it raises, HilError as it is."""
    try:
        return _imported(path)(*args, **kwargs)
    except HilError:
        raise
    except (Exception, SystemExit) as error:
        raise plug_in_error(device, error) from error


class DeviceTable(OpenTable):
    """Table of a device in a rig file. ``driver`` selects the driver, whose own settings are in ``[DEVICE.DRIVER]``.

    The table of a driver of another package is validated by the model in that driver's entry.
    """

    device: ClassVar[Device]
    without_wires: ClassVar[tuple[str, ...]] = ("mock",)

    driver: str
    """Name of the driver, shipped or of an installed package."""

    @property
    def has_wires(self) -> bool:
        """Whether the device is reached by a driver, rather than simulated in memory or absent."""
        return self.driver not in self.without_wires

    @property
    def is_plug_in(self) -> bool:
        """Whether the device is reached by a driver of another package."""
        return self.has_wires and f"{self.device}.{self.driver}" not in _BUILT_IN

    @property
    def entry(self) -> DriverEntry:
        """The entry of the selected driver; ValueError for a device without one."""
        return driver_entry(self.device, self.driver)

    @property
    def settings(self) -> Any:
        """The table of the selected driver."""
        return getattr(self, self.driver)

    def make_driver(self, *args: Any, **kwargs: Any) -> Any:
        """Return the selected driver for this table; Raises BadInput if a wire has no address."""
        for wire in self.wires(self.device):
            if wire.address is None:
                raise BadInput.single("rig", wire.required_key, "is missing: the wire to the device")
        name = next((each for each in args if isinstance(each, str)), self.device)
        return _made(name, self.entry.driver, self, *args, **kwargs)

    def make_emulator(self, *args: Any, **kwargs: Any) -> Any:
        """Return the emulator of the selected driver for this table; imports it. Raises BadInput if there is none."""
        if self.entry.emulator is None:
            raise BadInput.single("rig", f"{self.device}.driver", f'"{self.driver}": this driver has no emulator')
        name = kwargs.get("name", self.device)
        return _made(f"{name} emulator", self.entry.emulator, self, *args, **kwargs)

    @property
    def wire_keys(self) -> list[WireKey]:
        """Keys of the wires that the selected driver opens."""
        return list(self.entry.wires)

    def check_driver(self) -> None:
        """Raise ValueError if the selected driver cannot work with this table."""
        if self.has_wires:
            try:
                self.entry.check(self)
            except (ValueError, HilError):
                raise
            except Exception as error:
                text = f'"{self.driver}": the check of its entry failed: {raised_text("", error)}'
                raise ValueError(text) from error

    def wires(self, prefix: str = "") -> list[Wire]:
        """Return the wires that the selected driver opens; prefix: key of this table."""
        wires = [key.wire(self) for key in self.wire_keys] if self.has_wires else []
        return [Wire(".".join(filter(None, (prefix, wire.key))), wire.kind, wire.address) for wire in wires]

    def connected(self, name: str, addresses: Mapping[str, str]) -> Self:
        """Return the table with the addresses that the emulator of the device ``name`` reports."""
        table = self
        for key in self.wire_keys:
            table = key.connected(table, addresses[".".join(filter(None, (name, key.name)))])
        return table

    @classmethod
    def added_model(cls, key: str) -> type[BaseModel] | None:
        """Return the model of the table of the registered driver ``key``; None for other keys."""
        try:
            return driver_entry(cls.device, key).settings
        except ValueError:
            return None

    @classmethod
    def driver_tables(cls) -> dict[str, type[BaseModel]]:
        """Return the models of the tables of all usable drivers of the device, by their names."""
        names = dict.fromkeys([*_BUILT_IN, *(point.name for point in entry_points(group=GROUP))])
        models = {}
        for device, _, name in (key.partition(".") for key in names):
            if device == cls.device and (model := cls.added_model(name)) is not None:
                models[name] = model
        return models

    @field_validator("driver")
    @classmethod
    def _driver_is_registered(cls, value: str) -> str:
        if value not in cls.without_wires:
            driver_entry(cls.device, value)
        return value

    @model_validator(mode="after")
    def _validate_driver(self) -> Self:
        tables = self.__pydantic_extra__
        assert tables is not None
        if self.has_wires and self.entry.settings is not None and self.driver not in tables:
            tables[self.driver] = self._validated(self.driver, {})
        self.check_driver()
        return self


def _inner(table: ConfigModel, path: Sequence[str]) -> object:
    value: object = table
    for key in path:
        value = getattr(value, key, None)
    return value


def _updated(table: Any, path: Sequence[str], values: Mapping[str, Any]) -> Any:
    """Return ``table`` with ``values`` in the table at ``path``, which is made if it is missing."""
    if not path:
        return table.model_copy(update=dict(values))
    key, *rest = path
    inner = getattr(table, key, None)
    if inner is None:
        model = table.model_of(key) if isinstance(table, DeviceTable) else model_of_field(type(table), key)
        assert model is not None
        inner = model()
    return table.model_copy(update={key: _updated(inner, rest, values)})
