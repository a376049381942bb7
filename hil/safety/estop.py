"""The emergency stop: latched, by level; let go only by a new reset with the cause gone."""

from __future__ import annotations


class EmergencyStop:
    """Whether the emergency stop holds the bench.

    It is the level of the input that counts: whoever looks only once while the button is in has seen
    it. A reset counts on its rising edge alone, and only while the button is out; a reset that was
    held from before, or whose edge came while the button was in, does nothing.
    """

    def __init__(self) -> None:
        self.latched = False
        self.pressed = False
        self._reset_before = True  # a reset that is held when the program starts is no edge

    def update(self, pressed: bool | None, reset: bool = False) -> None:
        """Take the levels of button and reset input; ``pressed`` None: unknown, which counts as pressed."""
        self.pressed = pressed is None or pressed
        if self.pressed:
            self.latched = True
        elif reset and not self._reset_before:
            self.latched = False
        self._reset_before = reset

    def reset(self) -> bool:
        """Take one request of the operator, which is an edge in itself; return whether the stop let go."""
        if not self.pressed:
            self.latched = False
        return not self.latched
