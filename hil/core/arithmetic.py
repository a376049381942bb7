"""What the last bits of a run depend on besides configuration and seed, as a recording states it."""

from __future__ import annotations

import importlib.metadata
from collections.abc import Mapping
from typing import Final

from hil.core.program_digest import PACKAGES

FORMULAS: Final = 3
"""Version of the functions and orders of sums that determine a run.

1: the C library, BLAS and LAPACK; 2: fixed ones; 3: others in the truth's step, servo and update of the covariance.
"""
_KEY: Final = "formulas"


def formula_versions() -> dict[str, str]:
    """Return the versions of the formulas and of the packages that can matter, by the keys of a recording."""
    return {_KEY: str(FORMULAS), **{name: importlib.metadata.version(name) for name in PACKAGES}}


def why_bits_may_differ(run: Mapping[str, str]) -> str:
    """Return why a run with the header ``run`` may have other last bits here, in one line; "" if it has not.

    Headers of versions before 0.3 state no formulas, and not all packages.
    """
    here, recorded = formula_versions(), {_KEY: "1", **run}
    other = [
        f"{name} {recorded[name]} (here {here[name]})" for name in here if recorded.get(name, here[name]) != here[name]
    ]
    return f"last bits may differ from this program's: recorded with {', '.join(other)}" if other else ""
