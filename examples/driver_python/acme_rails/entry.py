"""Registry entry, which ``hil`` reads before it imports the driver, and model of the table ``[rails.acme]``."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from hil.config.rig import Rails
from hil.config.tables.driver_registry import DriverEntry, WireKey
from hil.config.tables.model import ConfigModel


class AcmeSettings(ConfigModel):
    """Serial line of the controller, the model that it must report, and habits of the emulated one."""

    port: str | None = None
    baud: Annotated[int, Field(gt=0)] = 460_800
    model: str | None = None
    emulated_response_s: Annotated[float, Field(ge=0.0, le=0.04)] = 0.0


def _check(rails: Rails) -> None:
    for name, axis in zip(rails.axis_names, rails.axes, strict=True):
        if axis.encoder != "absolute":
            raise ValueError(f'{name}.encoder = "{axis.encoder}": ACME controllers have absolute encoders')


def _identity(rails: Rails) -> dict[str, str]:
    return {} if rails.settings.model is None else {"model": rails.settings.model}


ENTRY = DriverEntry(
    "rails",
    "acme",
    driver="acme_rails.driver:AcmeRails",
    emulator="acme_rails.emulator:AcmeEmulator",
    settings=AcmeSettings,
    wires=[WireKey("acme.port", "serial")],
    check=_check,
    identity=_identity,
    keeps_bench_time=lambda rails: True,
)
