"""Checks of what drivers return, before it reaches shared memory: an array of another shape would fill a record."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Final

import numpy as np

from hil.core.messages import AxisFeedback, IoInputs, PoseFrame
from hil.core.plug_ins import wrong_return

Method = Callable[..., Any]
_SHAPES: Final = {"t_v": (3,), "q_vt": (4,), "covariance": (6, 6)}


def checked_feedback(device: str, method: Method, feedback: object, n: int) -> AxisFeedback:
    """Return ``feedback``, which ``method`` has returned, if it is that of ``n`` axes. Raises PlugInError."""
    if not isinstance(feedback, AxisFeedback):
        raise wrong_return(device, method, f"{_shown(feedback)}, expected AxisFeedback")
    problem = _number_problem("t_s", feedback.t_s, ()) or next(
        filter(None, (_number_problem(name, getattr(feedback, name), (n,)) for name in ("position", "rate"))), ""
    )
    for name in ("homing", "limit"):
        if not problem and np.shape(getattr(feedback, name)) != (n,):
            problem = f"{name} {_shown(getattr(feedback, name))}, expected one for each of {n} axes"
    if problem:
        raise wrong_return(device, method, problem)
    return feedback


def checked_setpoint(device: str, method: Method, accepted: object, n: int) -> None:
    """Check that ``accepted``, which ``method`` has returned, is a setpoint of ``n`` axes. Raises PlugInError."""
    if problem := _number_problem("a setpoint", accepted, (n,)):
        raise wrong_return(device, method, problem)


def checked_frames(device: str, method: Method, frames: object) -> Iterable[PoseFrame]:
    """Return ``frames``, which ``method`` has returned, if they are poses. Raises PlugInError."""
    if not isinstance(frames, list | tuple):
        raise wrong_return(device, method, f"{_shown(frames)}, expected a list of PoseFrame")
    for frame in frames:
        if not isinstance(frame, PoseFrame):
            raise wrong_return(device, method, f"a list with {_shown(frame)}, expected PoseFrame")
        shapes = {"t_s": (), "received_s": (), **_SHAPES}
        problems = (_number_problem(name, getattr(frame, name), shape) for name, shape in shapes.items())
        if problem := next(filter(None, problems), ""):
            raise wrong_return(device, method, f"a PoseFrame with {problem}")
    return frames


def checked_inputs(device: str, method: Method, inputs: object) -> IoInputs:
    """Return ``inputs``, which ``method`` has returned, if they are those of digital lines. Raises PlugInError."""
    if not isinstance(inputs, IoInputs):
        raise wrong_return(device, method, f"{_shown(inputs)}, expected IoInputs")
    return inputs


def _number_problem(name: str, value: object, shape: tuple[int, ...]) -> str:
    """Return what keeps ``value`` from being finite numbers of ``shape``, "" if nothing does."""
    expected = f"expected {shape} finite numbers" if shape else "expected a finite number"
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        return f"{name} {_shown(value)}, {expected}"
    if array.shape != shape:
        return f"{name} of shape {array.shape}, {expected}"
    return "" if np.isfinite(array).all() else f"{name} {array.tolist()}, {expected}"


def _shown(value: object) -> str:
    return f"{value!r:.60}"
