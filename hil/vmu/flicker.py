"""Flicker of the LEDs: fed by pulses (PWM), they are bright in one image, or one row of it, and dark in the next."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from hil.core.messages import Array

_PAIRS: Final = 24
_STEP: Final = math.log(1.5)  # change of the light of all LEDs from one pair to the next
_STEPS: Final = 4  # up and down, which a hidden LED or a light that is switched off does not make
_MOVED_PX: Final = 80.0  # of the bright images' lights from one to the next: other scenes
_ROWS: Final = 5  # lights of an image, from which on their brightness shows a period
_IMAGES: Final = 6
_PERIODIC: Final = 0.8  # of the variance
_LIMITS_HZ: Final = (100.0, 20_000.0)


class Flicker:
    """Brightness of the lights of one camera in the last pairs. row_s: between the rows, 0 for a global shutter."""

    def __init__(self, row_s: float) -> None:
        self._row_s = abs(row_s)
        self._images: deque[np.ndarray] = deque(maxlen=_PAIRS)
        self._totals: deque[float] = deque(maxlen=_PAIRS)
        self._places: deque[Array] = deque(maxlen=_PAIRS)

    def add(self, spots: np.ndarray) -> None:
        """Add the lights (SPOT) of an image."""
        self._images.append(spots)
        total = float(spots["flux"].sum())
        self._totals.append(total)
        self._places.append(np.array([spots[axis] @ spots["flux"] for axis in "uv"]) / max(total, 1.0))

    def reason(self) -> str:
        """Return that the LEDs flicker, by how much, and what to do, "" if they do not."""
        totals = np.array(self._totals)
        largest = totals.max(initial=0.0)
        if largest == 0.0:
            return ""
        steps = np.diff(np.log(np.maximum(totals, 0.01 * largest)))
        steps = steps[np.abs(steps) > _STEP]
        moved = np.diff(np.array(self._places)[totals > 0.5 * largest], axis=0)
        is_elsewhere = np.hypot(*moved.T).sum() >= _MOVED_PX * len(moved)
        if is_elsewhere or np.count_nonzero(np.diff(np.sign(steps))) < _STEPS - 1:
            return ""
        hz = self._frequency_hz()
        about = f" of about {hz:.2g} Hz" if hz < 1e3 else f" of about {1e-3 * hz:.2g} kHz"
        part = 100.0 * totals.min() / largest
        return f"LEDs flicker, {part:.0f} to 100 %: PWM{about if hz else ''}? Use DC, or expose whole periods"

    def _frequency_hz(self) -> float:
        """Return the frequency with which the brightness changes along the rows, 0 if it is not known."""
        images = [each for each in self._images if len(each) >= _ROWS]
        if self._row_s == 0.0 or len(images) < _IMAGES:
            return 0.0
        tried = np.exp(np.arange(math.log(_LIMITS_HZ[0]), math.log(_LIMITS_HZ[1]), 0.005))
        parts = [_explained(each["v"] * self._row_s, each["flux"], tried) for each in images]
        explained = np.sum([part for part, _ in parts], axis=0) / sum(whole for _, whole in parts)
        best = int(explained.argmax())
        return float(tried[best]) if explained[best] > _PERIODIC else 0.0


def _explained(t_s: Array, flux: Array, tried_hz: Array) -> tuple[Array, float]:
    """Return the variance of ``flux`` that a wave of each frequency explains, of any phase, and the whole of it."""
    left = flux - flux.mean()
    waves = np.exp(2j * np.pi * tried_hz[:, None] * t_s)
    basis = np.stack([waves.real, waves.imag], axis=2)
    basis -= basis.mean(axis=1, keepdims=True)
    fits = np.linalg.pinv(basis) @ left
    return np.square(np.einsum("fnk,fk->fn", basis, fits)).sum(axis=1), float(left @ left)
