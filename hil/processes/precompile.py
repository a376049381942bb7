"""Compiler of the GNC's kernels into the kernel cache: the half of the work that a second core can do.

``python -m hil.processes.precompile`` runs in parallel with the first start of a program with an empty cache.
"""

from __future__ import annotations

import numpy as np

from hil.config.load import load_scenario
from hil.core.child_process import Parent
from hil.core.messages import IMU, MAX_POSES, POSE, TRUTH, new
from hil.gnc import navigation
from hil.loop.cycle import CycleData
from hil.setup.assembly import make_gnc


class _NoPoses:
    poses: np.ndarray = np.zeros(MAX_POSES, POSE).view(np.recarray)
    arrived = 0


def compile_gnc() -> None:
    """Call the kernels of the GNC once, with the types that the loop calls them with."""
    gnc = make_gnc(load_scenario("scheme-1").value)
    gnc.step(0.0, CycleData(), _NoPoses())
    navigation.normalised_errors(gnc.state.navigation.fusion.filters, new(TRUTH), new(IMU), np.empty(2))


def main() -> None:
    """Compile; the parent's end ends this process."""
    Parent()
    compile_gnc()


if __name__ == "__main__":
    main()
