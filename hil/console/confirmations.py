"""Orders that are asked back, and the question."""

from __future__ import annotations

from typing import Final

from hil.core.operator_commands import Order

HAZARDS: Final = {
    Order.HOME: "Home: axes without a place look for their switches. Is the bench clear of people?",
    Order.ARM: "Arm: all axes move to the start pose. Is the bench clear of people?",
    Order.START: "Start: the loop is closed, the bench moves by itself. Is the bench clear of people?",
    Order.RESUME: "Resume: the bench moves on from where it stands. Is the bench clear of people?",
    Order.ABORT: "Abort: the chaser brakes and retreats, and the bench with it. The run cannot go on after it.",
    Order.GO: "Go: the chaser leaves its waiting point and closes in.",
    Order.PARK: "Park: all axes move to the parking place, and the session ends. Is the bench clear of people?",
    Order.RESET: "Reset: the devices are opened anew and the drives get power. Is the cause gone, is the bench clear?",
}
