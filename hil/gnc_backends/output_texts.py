"""Texts of a GNC elsewhere and about it: its message, what its object has raised, what is wrong with its output."""

from __future__ import annotations

from typing import Final

import numpy as np

from hil.errors import DeviceError
from hil.gnc import backend_outputs

_AXES: Final = "xyz"
_VECTORS: Final = {
    backend_outputs.POSITION: ("r_CT_H", "r_CT_H_m"),
    backend_outputs.VELOCITY: ("v_CT_H", "v_CT_H_mps"),
    backend_outputs.RATE: ("w_CH_C", "w_CH_C_radps"),
    backend_outputs.BIAS: ("bias_mps2",),
}
"""Fields of NAVIGATION_OUTPUT and of GNC_OUTPUT."""


def printable(text: bytes) -> str:
    """Return a text of a GNC as one line of plain characters."""
    plain = text.split(b"\0")[0].decode("utf-8", "replace")
    return "".join(c if c.isprintable() else " " for c in plain).strip()


def whole_text(text: bytes, message: bytes) -> bytes:
    """Return ``message`` if the text of an output is the beginning of it, else that text."""
    shown = text.split(b"\0")[0]
    return message if shown and message.startswith(shown) else text


def step_failed(name: str, code: int, text: bytes) -> DeviceError:
    """Return the error of a step that returned ``code``, not 0. text: of its output."""
    return DeviceError(name, _with_text(f"its step returned {code}", text))


def reported_fault(name: str, text: bytes) -> DeviceError:
    """Return the fault that a GNC reports. text: of its output."""
    return DeviceError(name, printable(text) or "reports a fault")


def hold_reason(name: str, text: bytes) -> str:
    """Return why the bench is to hold if a GNC requests it. text: of its output."""
    return _with_text(f"{name} asks for it", text)


def _with_text(what: str, text: bytes) -> str:
    return f"{what}: {shown}" if (shown := printable(text)) else what


def fault_text(out: np.void, fault: int, index: int, n_thrusters: int, cycle: int) -> str:
    """Return what is wrong with an output of navigation, of control or of both.

    fault, index: of ``backend_outputs`` or ``whole_step.take_apart``. cycle: of the input.
    """
    names = out.dtype.names or ()
    match fault:
        case backend_outputs.CYCLE:
            return f"answers cycle {out['cycle']} to the input of cycle {cycle}"
        case backend_outputs.STATE:
            return f"state {out['state']}, allowed 0 to 3"
        case backend_outputs.VALID:
            name = "valid" if "valid" in names else "estimate"
            return f"{name} {out[name]}, allowed 0, 1"
        case backend_outputs.ATTITUDE:
            return f"estimated q_CH ({', '.join(f'{value:g}' for value in out['q_CH'])}) is not of length 1"
        case backend_outputs.SIGMA:
            return f"a standard deviation of component {index} is negative, allowed 0 and more, nan: not reported"
        case backend_outputs.PROTECTION_LEVEL:
            name = f"protection_level_m[{index}]" if index < 3 else "protection_level_rad"
            level = [*out["protection_level_m"], out["protection_level_rad"]][index]
            return f"{name} is {level:g}, allowed 0 and more, 0 or nan: not reported"
        case backend_outputs.HEALTH:
            return f"health {out['health']}, allowed 0 to {backend_outputs.HEALTH_MAX}"
        case backend_outputs.DIRECT:
            return f"direct {out['direct']}, allowed 0, 1"
        case backend_outputs.FORCE:
            return f"force demand along {_AXES[index]} is {out['force'][index]}, allowed -1, 0, 1"
        case backend_outputs.TORQUE:
            return f"torque demand about {_AXES[index]} is {out['torque'][index]}, allowed -1, 0, 1"
        case backend_outputs.THRUSTER if index >= n_thrusters:
            return f"opens thruster {index + 1} of {n_thrusters}"
        case backend_outputs.THRUSTER:
            return f"thruster {index + 1} is {out['on'][index]}, allowed 0, 1"
        case _:
            name = next(name for name in _VECTORS[fault] if name in names)
            return f"estimated {name}[{index}] is {out[name][index]}, allowed finite numbers"
