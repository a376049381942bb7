"""Random numbers with the same bits on every computer: PCG64's words, turned into numbers in a fixed order.

The words are integers, which numpy's generator makes alike everywhere; its normals call the C library. These are the
same numbers to 1e-13, by the same method.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Any, Final

import numpy as np

from hil.core.jit import kernel
from hil.maths import elementary

_LAYERS: Final = 256
_EDGE: Final = 3.6541528853610088  # where the tail begins
_AREA: Final = 0.00492867323397465  # area of each layer under exp(-x^2 / 2)
_UNIT: Final = 1.0 / 2**53
_FRACTION: Final = 1.0 / 2**52
_LAYER_BITS, _SIZE_BITS = np.uint64(0xFF), np.uint64(2**52 - 1)
_SIGN, _ONE, _EIGHT, _NINE, _ELEVEN = np.uint64(0x100), np.uint64(1), np.uint64(8), np.uint64(9), np.uint64(11)
_ZERO: Final = np.uint64(0)
_BLOCK: Final = 4096  # words that the processor's first cache holds


@cache
def _layers() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return of each layer the step of x per count, the counts that are surely inside, and exp(-x^2 / 2), (256,)."""
    x, height = np.zeros(_LAYERS), np.ones(_LAYERS)
    x[-1], height[-1] = _EDGE, elementary.exp(-0.5 * _EDGE * _EDGE)
    for i in range(_LAYERS - 2, 0, -1):
        height[i] = _AREA / x[i + 1] + height[i + 1]
        x[i] = math.sqrt(-2.0 * elementary.log(float(height[i])))
    base = _AREA / height[-1]
    step = np.array([base, *x[1:]])
    inside = np.array([math.floor(_EDGE / base / _FRACTION), 0, *np.floor(x[1:-1] / x[2:] / _FRACTION)])
    return step * _FRACTION, inside.astype(np.uint64), height


@kernel
def _uniform(word):
    """Return the number in [0, 1) of the upper 53 bits of ``word``."""
    return (word >> _ELEVEN) * _UNIT


@kernel
def _fill(words, at, out, first, step, inside, height):
    """Fill ``out`` (n,) from ``first`` on with the normals of ``words`` from ``at`` on; return how far both came.

    The ziggurat of Marsaglia and Tsang (2000). A normal for which the words do not suffice is not begun.
    """
    n, last = out.shape[0], words.shape[0]
    while first < n:
        start, done, x, negative = at, False, 0.0, False
        while not done:
            if at >= last:
                return start, first
            word = words[at]
            at += 1
            layer = np.int64(word & _LAYER_BITS)
            size = (word >> _NINE) & _SIZE_BITS
            x, negative = size * step[layer], (word & _SIGN) != _ZERO
            done = size < inside[layer]
            if not done and layer > 0:
                if at >= last:
                    return start, first
                between = height[layer] + (height[layer - 1] - height[layer]) * _uniform(words[at])
                done = between < elementary.exp(-0.5 * x * x)
                at += 1
            elif not done:
                negative = ((size >> _EIGHT) & _ONE) != _ZERO
                while not done:
                    if at + 1 >= last:
                        return start, first
                    beyond = -elementary.log1p(-_uniform(words[at])) / _EDGE
                    drop = -elementary.log1p(-_uniform(words[at + 1]))
                    done = drop + drop > beyond * beyond
                    x = _EDGE + beyond
                    at += 2
        out[first] = -x if negative else x
        first += 1
    return at, first


class Generator(np.random.Generator):
    """Generator whose normals are computed here; it takes the same words for them as numpy's."""

    def standard_normal(self, size: Any = None, dtype: Any = float, out: Any = None) -> Any:
        """Return standard normals of shape ``size``, or filled into ``out``; single precision is numpy's own."""
        if dtype not in (float, np.float64):
            return super().standard_normal(size, dtype=dtype, out=out)
        values = np.empty(() if size is None else size) if out is None else out
        flat = values.reshape(-1)
        rest, first = np.empty(0, np.uint64), 0
        while first < flat.size:  # each normal that is missing needs one more word at least
            words = self.bit_generator.random_raw(min(flat.size - first, _BLOCK))
            if rest.size:
                words = np.append(rest, words)
            at, first = _fill(words, 0, flat, first, *_layers())
            rest = words[at:]
        return values if out is not None or values.shape else float(values)
