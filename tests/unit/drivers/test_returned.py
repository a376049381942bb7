"""What drivers return is checked before it reaches shared memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hil.core.messages import AxisFeedback, Homing, IoInputs, PoseFrame
from hil.drivers.returned import checked_feedback, checked_frames, checked_inputs, checked_setpoint
from hil.errors import PlugInError

FEEDBACK = AxisFeedback(1.0, np.zeros(3), np.zeros(3))
FRAME = PoseFrame(1, 1.0, 1.0, np.array([0.0, 0.0, 2.0]), np.array([0.0, 0.0, 0.0, 1.0]), np.eye(6))


class Driver:
    def read(self) -> None: ...


@pytest.mark.parametrize(
    ("feedback", "text"),
    [
        (None, "Driver.read returned None, expected AxisFeedback"),
        (replace(FEEDBACK, position=np.zeros(1)), r"position of shape \(1,\), expected \(3,\) finite numbers"),
        (replace(FEEDBACK, rate=[0.0, None, 0.0]), r"rate \[0.0, nan, 0.0\]"),
        (replace(FEEDBACK, position=np.array([0.0, np.nan, 0.0])), "position .*nan"),
        (replace(FEEDBACK, t_s=None), "t_s nan, expected a finite number"),
        (replace(FEEDBACK, homing=(Homing.DONE,)), "homing .*, expected one for each of 3 axes"),
    ],
)
def test_feedback_of_another_shape_is_refused(feedback: AxisFeedback, text: str) -> None:
    with pytest.raises(PlugInError, match=text) as caught:
        checked_feedback("rails", Driver().read, feedback, 3)
    assert "(test_returned.py, line " in str(caught.value)


@pytest.mark.parametrize(
    ("frames", "text"),
    [
        (None, "None, expected a list of PoseFrame"),
        ([None], "a list with None, expected PoseFrame"),
        ([replace(FRAME, t_v=np.zeros(2))], r"t_v of shape \(2,\)"),
        ([replace(FRAME, covariance=np.zeros(6))], r"covariance of shape \(6,\)"),
        ([replace(FRAME, q_vt=np.full(4, np.inf))], "q_vt .*inf"),
    ],
)
def test_frames_of_another_shape_are_refused(frames: object, text: str) -> None:
    with pytest.raises(PlugInError, match=text):
        checked_frames("vmu", Driver().read, frames)


def test_sound_returns_pass() -> None:
    assert checked_feedback("rails", Driver().read, FEEDBACK, 3) is FEEDBACK
    assert checked_frames("vmu", Driver().read, [FRAME]) == [FRAME]
    inputs = IoInputs(0.0, True, True)
    assert checked_inputs("io", Driver().read, inputs) is inputs
    with pytest.raises(PlugInError, match=r"io: Driver\.read returned True, expected IoInputs"):
        checked_inputs("io", Driver().read, True)


@pytest.mark.parametrize("accepted", [None, "sent", np.zeros(2), [0.0, 0.0, np.nan]])
def test_setpoint_that_is_none_is_not_accepted(accepted: object) -> None:
    with pytest.raises(PlugInError, match=r"rails: Driver\.read returned a setpoint .*expected \(3,\) finite numbers"):
        checked_setpoint("rails", Driver().read, accepted, 3)
    checked_setpoint("rails", Driver().read, np.zeros(3), 3)
