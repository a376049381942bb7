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
