"""Comparison of rows of a run, bit by bit."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

OF_DIGITAL_LINES = ("on_wire_s",)
"""Field that a campaign leaves out: it has no digital lines."""


def assert_same_bits(one: np.ndarray, other: np.ndarray, without: Sequence[str] = (), name: str = "") -> None:
    """Compare every field of two arrays of records but those in ``without``, nan with nan; name one that differs."""
    for field in one.dtype.names or ():
        if one.dtype[field].names:
            assert_same_bits(one[field], other[field], without, f"{name}{field}.")
        elif field not in without:
            np.testing.assert_array_equal(one[field], other[field], err_msg=f"{name}{field}")
