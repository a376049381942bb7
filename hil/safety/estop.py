"""Emergency stop: latched by level, released only by a new reset after the button is released."""

from __future__ import annotations


class EmergencyStop:
    """Latch of the emergency stop.

    The input is evaluated by level: one sample while the button is pressed latches. A reset acts only on its rising
    edge while the button is released; a reset held from before, or with an edge while pressed, has no effect.
    """

    def __init__(self) -> None:
        self.latched = False
        self.pressed = False
        self._reset_before = True  # a reset held at program start is no edge

    def update(self, pressed: bool | None, reset: bool = False) -> None:
        """Update with the levels of button and reset input; ``pressed`` None: unknown, which counts as pressed."""
        self.pressed = pressed is None or pressed
        if self.pressed:
            self.latched = True
        elif reset and not self._reset_before:
            self.latched = False
        self._reset_before = reset

    def reset(self) -> bool:
        """Reset on the operator's command, which counts as an edge; return whether the latch is released."""
        if not self.pressed:
            self.latched = False
        return not self.latched
