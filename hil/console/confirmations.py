"""Operator commands that require confirmation, and the question asked."""

from __future__ import annotations

from typing import Final

from hil.core.operator_commands import OperatorCommand

CONFIRMATIONS: Final = {
    OperatorCommand.HOME: "Home: axes without a place look for their switches. Is the bench clear of people?",
    OperatorCommand.ARM: "Arm: all axes move to the start pose. Is the bench clear of people?",
    OperatorCommand.START: "Start: the loop is closed, the bench moves by itself. Is the bench clear of people?",
    OperatorCommand.RESUME: "Resume: the bench moves on from where it stands. Is the bench clear of people?",
    OperatorCommand.ABORT: "Abort: the chaser brakes and retreats with the bench. The run cannot go on after it.",
    OperatorCommand.GO: "Go: the chaser leaves its waiting point and closes in.",
    OperatorCommand.PARK: "Park: all axes move to the park position, the session ends. Is the bench clear of people?",
    OperatorCommand.RESET: "Reset: the devices open, the drives get power. Is the cause gone, is the bench clear?",
}
