"""Products of vectors in plain loops."""

from __future__ import annotations

from hil.core.jit import kernel


@kernel
def cross_into(a, b, out):
    """Write a x b into ``out`` (3,), which is neither of them."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
