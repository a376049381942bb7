"""Backends of navigation and of control: what each declares, and an open one behind its address.

Kinds: a kernel (``kernel_backend``), a Python class or object (``python_backend``), a shared library
(``backend_library``). ``backend_registry`` finds the one that a scenario names.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final, NamedTuple, Protocol

import numpy as np

from hil.core.settings import Setting
from hil.errors import DeviceError, ProtocolError
from hil.gnc import backend_step
from hil.gnc_backends.external import printable, raised_text

PARTS: Final = ("navigation", "control")
"""Parts of the GNC that a backend replaces, in the order of the rows of GNC_PARAMS.settings."""
_AXES: Final = "xyz"
_VECTORS: Final = {
    backend_step.POSITION: "r_CT_H",
    backend_step.VELOCITY: "v_CT_H",
    backend_step.RATE: "w_CH_C",
    backend_step.BIAS: "bias_mps2",
}


class BackendInstance:
    """Base class of an open backend: in a campaign one per case.

    step_address: of ``int step(input, output, instance)``. address: third argument of the step, 0 once it is closed.
    block: memory that begins with the values of the settings; None if they are elsewhere. free: ends ``address``.
    """

    error: BaseException | None = None
    """What a Python object has raised in its step."""

    def __init__(
        self,
        step_address: int,
        address: int,
        block: np.ndarray | None = None,
        free: Callable[[int], object] = lambda _: None,
    ) -> None:
        self.step_address, self.address = step_address, address
        self._block, self._free = block, free

    def set_settings(self, values: np.ndarray) -> None:
        """Take over other values of the settings, (n,), between two cycles."""
        if self._block is not None:
            self._block.view(np.uint8)[: 8 * len(values)] = np.ascontiguousarray(values, float).view(np.uint8)

    def close(self) -> None:
        """End it; may be called more than once."""
        address, self.address = self.address, 0
        if address:
            self._free(address)


class Backend(Protocol):
    """A backend as loaded, from which instances are opened."""

    name: str
    settings: tuple[Setting, ...]

    def check(self, setup: np.record) -> None:
        """Raise BadInput if it cannot be flown with ``setup`` (GNC_SETUP)."""

    def open(self, setup: np.record, values: np.ndarray) -> BackendInstance:
        """Return a new instance. values: of the settings, (n,). Raises BadInput or DeviceError."""


class OwnBackends(NamedTuple):
    """Backends that the caller gives as Python objects: classes, instances or kernels; None for the scenario's."""

    navigation: object | None = None
    control: object | None = None


Backends = Mapping[str, Backend]
"""Backends that are not built in, by their part."""


def failure_of(name: str, backends: np.record, error: BaseException | None) -> DeviceError:
    """Return the error of the backend ``name`` that has failed. backends: BACKENDS. error: raised by its object."""
    if error is not None:
        failed = DeviceError(name, raised_text("step", error))
        failed.__cause__ = error
        return failed
    part = PARTS[int(backends["failed"]) - 1]
    output, fault, place = backends[f"{part}_output"], int(backends["fault"]), int(backends["place"])
    text = printable(bytes(backends[part]["text"]))
    if fault == backend_step.RETURNED:
        return DeviceError(name, f"its step returned {backends['code']}" + (f": {text}" if text else ""))
    if fault == backend_step.REPORTED:
        return DeviceError(name, text or "reports a fault")
    return ProtocolError(name, _fault_text(output, fault, place))


def _fault_text(out: np.void, fault: int, place: int) -> str:
    """Return what is wrong with an output. fault, place: of ``backend_step``."""
    match fault:
        case backend_step.STATE:
            return f"state {out['state']}, allowed 0 to 3"
        case backend_step.VALID:
            return f"valid {out['valid']}, allowed 0, 1"
        case backend_step.ATTITUDE:
            return f"estimated q_CH ({', '.join(f'{value:g}' for value in out['q_CH'])}) is not of length 1"
        case backend_step.SIGMA:
            return f"a standard deviation of component {place} is negative, allowed 0 and more, nan: not reported"
        case backend_step.PROTECTION_LEVEL:
            name = f"protection_level_m[{place}]" if place < 3 else "protection_level_rad"
            return f"{name} is negative, allowed 0 and more, 0 or nan: not reported"
        case backend_step.HEALTH:
            return f"health {out['health']}, allowed 0 to {backend_step.HEALTH_MAX}"
        case backend_step.DIRECT:
            return f"direct {out['direct']}, allowed 0, 1"
        case backend_step.FORCE:
            return f"force demand along {_AXES[place]} is {out['force'][place]}, allowed -1, 0, 1"
        case backend_step.TORQUE:
            return f"torque demand about {_AXES[place]} is {out['torque'][place]}, allowed -1, 0, 1"
        case backend_step.THRUSTER:
            return f"thruster {place + 1} is {out['on'][place]}, allowed 0, 1 of a thruster that exists"
        case _:
            name = _VECTORS[fault]
            return f"estimated {name}[{place}] is {out[name][place]}, allowed finite numbers"
