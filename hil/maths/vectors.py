"""Products of vectors in plain loops."""

from __future__ import annotations

import numpy as np

from hil.maths.jit import kernel


@kernel
def cross(a, b):
    """Return a x b, shape (3,)."""
    out = np.empty(3)
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
    return out
