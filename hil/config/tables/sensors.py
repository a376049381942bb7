"""Sensors that a scenario adds to vision unit, IMU and docking monitor: tables ``[[sensors]]``, by their name.

The keys beyond those of every sensor are declared by its module, which checks them (``hil.sensors.registry``).
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from hil.config.tables.model import ConfigModel, Delay, Positive, Probability
from hil.errors import BadInput


def device_of(name: str) -> str:
    """Return the name of the sensor ``name`` in alarms, faults and errors."""
    return f"sensor.{name}"


class SensorConfig(ConfigModel):
    """A sensor other than vision unit, IMU and docking monitor; its module declares further keys.

    The keys are listed in [Sensors](sensors.md).
    """

    model_config = ConfigDict(extra="allow")

    kind: Annotated[str, Field(min_length=1)]
    """Kind of sensor: a shipped module, or an entry point of the group `hil.sensors` in a package."""
    enabled: bool = True
    """Whether its measurements are used; false: they are made and recorded alone."""
    use: Literal["fusion", "witness"] = "fusion"
    """"fusion": the filters use its measurements; "witness": they are compared with the navigation, whose error they
    bound, and a disagreement is an alarm, to which `gnc.reactions` reacts."""
    interlock_sigmas: Positive = 5.0
    """Of a witness: standard deviations of both by which they may differ, in addition to its constant errors."""
    interlock_samples: Annotated[int, Field(ge=1, le=100)] = 2
    """Of a witness: consecutive samples that set the interlock, and release it."""
    rate_hz: Positive | None = None
    """Measurements per second, at most one per cycle; unless set, the module's."""
    latency_s: Delay = 0.0
    """From the measurement to its arrival in the loop."""
    loss_probability: Probability = 0.0
    """Of a measurement that never arrives."""
    source: Literal["model", "udp"] = "model"
    """"model": modelled, or, unless the rig is a mock, on the serial wire that its kind has; "udp": datagrams from a
    program of your own, in memory modelled, in lock-step emulated. See [Sensors](../../how-to/add-a-sensor.md)."""
    port: Annotated[int, Field(ge=1, le=65535)] | None = None
    """UDP port of this computer on which datagrams arrive, for `source = "udp"`."""
    host: str = "127.0.0.1"
    """Address of this computer on which they are received."""
    frames: str | None = None
    """Frame file of datagrams that are poses, binary or of text, as those of a vision unit: `t` is H, `v` the chaser's
    axes c, and `position` that of the tracked point in H; unless set, they are JSON."""
    stamp: Literal["capture", "receipt"] | None = None
    """What the time of a datagram means: the moment of the measurement on the bench's clock, or nothing, and
    `latency_s` before its receipt is taken. It must be given for `source = "udp"`; "receipt" for a serial wire of
    hardware, whose lines have no time."""

    @model_validator(mode="after")
    def _source_is_complete(self) -> Self:
        if self.source == "model":
            if self.frames is not None:
                raise ValueError('frames: of datagrams, source = "udp"')
            return self
        if self.frames is not None and self.kind != "pose":
            raise ValueError(f'frames: of poses, kind = "pose", here "{self.kind}"')
        if self.port is None:
            raise ValueError('source = "udp" needs port: on which datagrams are received')
        if self.stamp is None:
            raise ValueError('source = "udp" needs stamp: "capture" or "receipt", what the time of a datagram means')
        return self

    @property
    def settings(self) -> dict[str, Any]:
        """Keys that the module declares."""
        return dict(self.model_extra or {})


def by_name(tables: Any, source: str) -> Any:
    """Return the tables ``[[sensors]]`` of a file as one table by name. Raises BadInput for two of one name."""
    if not isinstance(tables, list):
        return tables
    named: dict[str, Any] = {}
    for number, table in enumerate(tables, start=1):
        name = table.get("name") if isinstance(table, dict) else None
        if not (isinstance(name, str) and name.isidentifier()):
            text = f"{number}: needs a name of letters, digits and _, as the key of its columns"
            raise BadInput.single(source, "sensors", text)
        if name in named:
            raise BadInput.single(source, "sensors", f'name = "{name}": two sensors have it')
        named[name] = {key: value for key, value in table.items() if key != "name"}
    return named
