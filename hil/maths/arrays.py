"""Copying and filling in plain loops: numba's own slice assignment checks shapes at a high cost in compile time."""

from __future__ import annotations

from hil.core.jit import kernel


@kernel
def copy_into(target, source):
    """Write ``source`` (n,) into ``target`` (n,)."""
    for i in range(target.shape[0]):
        target[i] = source[i]


@kernel
def fill(target, value):
    """Write ``value`` into all of ``target`` (n,)."""
    for i in range(target.shape[0]):
        target[i] = value


@kernel
def fill_matrix(target, value):
    """Write ``value`` into all of ``target`` (m, n)."""
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            target[i, j] = value


@kernel
def copy_matrix(target, source):
    """Write ``source`` (m, n) into ``target`` (m, n)."""
    for i in range(target.shape[0]):
        for j in range(target.shape[1]):
            target[i, j] = source[i, j]


@kernel
def cross_into(a, b, out):
    """Write the cross product of ``a`` and ``b`` (3,) into ``out`` (3,), which is neither of them."""
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]
