"""A sensor as one module: settings, measurement, innovation, error terms and faults, declared in one class.

All else follows from the declaration: keys of the scenario and their checks, dispersions, faults, the mock, compiled
campaigns, fusion of late samples at their own time, gate, protection level, recording, export, replay and report.
A module is found by its ``kind``: one of this package, or an entry point of the group ``hil.sensors`` of another one
(``hil.sensors.registry``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal

from hil.config.tables.faults import TERMS
from hil.config.tables.sensors import SensorConfig
from hil.core.line_protocol import LineProtocol
from hil.core.public import public
from hil.core.sensor_records import COMPONENTS_MAX, SENSOR_ERRORS_MAX
from hil.core.settings import Setting, checked_settings

FAMILY: Final = "sensor"
"""Family of the faults of sensors (``hil.config.tables.faults``)."""
COMMON: Final = ("name", *SensorConfig.model_fields)
"""Keys that every sensor has (``hil.config.tables.sensors``)."""
FUSED_FAULTS: Final = {
    "no_sample": "no measurement: known at once; nothing is unseen",
    "frozen": "gate and CUSUM of the innovations once the chaser has moved by sigmas",
    "offset": "gate beyond its sigmas, below the CUSUM of the innovations: unseen up to what the level has",
    "drift": "CUSUM of the innovations: unseen up to what the level has",
    "outlier": "the gate",
    "noise_scale": "mean NIS",
    "sigma_scale": "mean NIS, if smaller; a larger one wastes information",
    "latency": "innovations in motion, if stamped with the arrival",
}
"""What the filters see of the faults of a sensor that they fuse."""


@public
@dataclass(frozen=True, slots=True)
class Component:
    """A component of a measurement: name of its column, which ends in the unit, its unit and what it means."""

    name: str
    unit: str
    doc: str = ""


@public
@dataclass(frozen=True, slots=True)
class SensorError:
    """An error of a sensor that is a state of the filters: by default added to ``component``.

    sigma: name of the setting with its standard deviation, in the unit of the component; 0 leaves it out. time_s: name
    of the setting with its correlation time: a first-order Gauss-Markov process; None: constant. Updates estimate it,
    so that the innovations of a sound sensor have no mean.
    """

    name: str
    component: int
    sigma: str
    time_s: str | None = None


class SensorModule:
    """Base class of a sensor module.

    kind: its name in a scenario. components: of a measurement, up to six; components one to three and four to six are
    fused one after the other and have independent noise. settings: numbers, keys of the scenario. errors: those of the
    sensor that are states of the filters. faults: kind of fault -> what a monitor sees of it and how large it can be
    unseen; kinds are those of the table of faults for sensors. sees: source of a modelled measurement: the bench by its
    axes, as a device on the bench sees it, or the truth, for what is not on the bench.
    """

    kind: ClassVar[str] = ""
    components: ClassVar[tuple[Component, ...]] = ()
    settings: ClassVar[tuple[Setting, ...]] = ()
    errors: ClassVar[tuple[SensorError, ...]] = ()
    faults: ClassVar[Mapping[str, str]] = {}
    sees: ClassVar[Literal["bench", "truth"]] = "bench"
    rate_hz: ClassVar[float] = 10.0
    """Measurements per second unless the scenario sets another rate."""
    wire: ClassVar[LineProtocol | None] = None
    """Lines of the sensor on a serial wire; None: it has none. ``innovate`` then gives the noise: no line has it."""

    @staticmethod
    def measure(settings: Any, truth: Any, out: Any) -> None:
        """Write ``out.sample.value`` from ``truth``; ``out.valid = 0`` if there is none. Compiled by numba.

        settings: the declared ones as attributes, as dispersed. truth: SENSOR_TRUTH. out: SENSOR_OUTPUT.
        """
        raise NotImplementedError

    @staticmethod
    def innovate(settings: Any, estimate: Any, out: Any) -> None:
        """Write ``out.value`` = measured - expected, ``out.h`` and ``out.noise``. Compiled by numba.

        settings: nominal ones. estimate: SENSOR_ESTIMATE. out: SENSOR_INNOVATION, whose ``sample`` is the measured one.
        """
        raise NotImplementedError


@dataclass(frozen=True)
class SensorKind:
    """A checked sensor module. distribution: the package that it comes from, "" for this one."""

    module: type[SensorModule]
    settings: tuple[Setting, ...]
    distribution: str = ""

    @property
    def kind(self) -> str:
        """Its name in a scenario."""
        return self.module.kind

    @property
    def components(self) -> tuple[Component, ...]:
        """Components of its measurements."""
        return self.module.components

    @property
    def summary(self) -> str:
        """First line of its documentation."""
        return (self.module.__doc__ or "").strip().partition("\n")[0]

    def values(self, given: Mapping[str, Any]) -> dict[str, float]:
        """Return the value of each setting in the order of the declaration: the given one, else its default."""
        return {setting.name: float(given.get(setting.name, setting.default)) for setting in self.settings}

    def as_json(self) -> dict[str, Any]:
        """Return the declaration for JSON: components, settings, errors, faults."""
        return {
            "summary": self.summary,
            "package": self.distribution or "hil",
            "components": [{"name": c.name, "unit": c.unit, "meaning": c.doc} for c in self.components],
            "settings": [
                {"name": s.name, "unit": s.unit, "default": s.default, "allowed": s.allowed, "meaning": s.doc}
                for s in self.settings
            ],
            "errors": list(self.error_columns()),
            "faults": dict(self.module.faults),
            "sees": self.module.sees,
            "wire": self.module.wire is not None,
            "rate_hz": self.module.rate_hz,
        }

    def error_columns(self) -> tuple[str, ...]:
        """Return the names of the error states, ``bias_range_m``."""
        return tuple(f"{error.name}_{self.components[error.component].name}" for error in self.module.errors)


def checked(module: Any, distribution: str = "") -> SensorKind:
    """Return ``module`` as a sensor. Raises ValueError with what its declaration lacks or contradicts."""
    if not (isinstance(module, type) and issubclass(module, SensorModule)):
        raise ValueError("is no subclass of hil.SensorModule")
    if not module.kind.isidentifier():
        raise ValueError(f"kind = {module.kind!r}: must be an identifier")
    settings = checked_settings(module.settings)
    names = {setting.name for setting in settings}
    if taken := sorted(names & set(COMMON)):
        raise ValueError(f"settings: {taken[0]} is a key of every sensor")
    _check_components(module)
    _check_errors(module, names)
    if not module.faults:
        raise ValueError("faults: a sensor without a fault hypothesis does not load: name each kind and what is seen")
    if unknown := sorted(set(module.faults) - set(TERMS[FAMILY])):
        raise ValueError(f"faults: {unknown[0]} is no kind of fault of sensors, which are {', '.join(TERMS[FAMILY])}")
    if empty := [kind for kind, text in module.faults.items() if not text.strip()]:
        raise ValueError(f"faults: {empty[0]} must state what a monitor sees of it, and how large it can be unseen")
    for name in ("measure", "innovate"):
        if getattr(module, name) is getattr(SensorModule, name):
            raise ValueError(f"{name} is missing: it must be a static method")
    if module.sees not in ("bench", "truth"):
        raise ValueError(f'sees = {module.sees!r}: must be "bench" or "truth"')
    return SensorKind(module, settings, distribution)


def _check_components(module: type[SensorModule]) -> None:
    components = tuple(module.components)
    if not 1 <= len(components) <= COMPONENTS_MAX or not all(isinstance(each, Component) for each in components):
        raise ValueError(f"components: must be 1 to {COMPONENTS_MAX} hil.Component")
    names = [component.name for component in components]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"components: {twice[0]} is declared twice")
    for component in components:
        if not component.name.isidentifier() or not component.unit:
            raise ValueError(f"components: {component.name!r} needs an identifier and a unit")
        suffix = component.unit.replace("/", "p").replace("^", "")
        if component.unit != "1" and not component.name.endswith(f"_{suffix}"):
            raise ValueError(f"components: {component.name} must end in its unit, _{suffix}")


def _check_errors(module: type[SensorModule], settings: set[str]) -> None:
    if len(module.errors) > SENSOR_ERRORS_MAX:
        raise ValueError(f"errors: {len(module.errors)} are declared, allowed {SENSOR_ERRORS_MAX}")
    for error in module.errors:
        if not 0 <= error.component < len(module.components):
            raise ValueError(f"errors: {error.name} is of component {error.component}, of {len(module.components)}")
        for name in (error.sigma, error.time_s):
            if name is not None and name not in settings:
                raise ValueError(f"errors: {error.name} needs the setting {name}, which is not declared")
