"""Compilation of the navigation filters into the kernel cache, on a second core.

``python -m hil.processes.precompile`` is started by ``compile_kernels`` when the kernel cache is empty.
"""

from __future__ import annotations

import numpy as np

from hil.config.load import load_scenario
from hil.core.child_process import Parent
from hil.core.messages import IMU, MAX_POSES, NAVIGATION, POSE, TRUTH, new
from hil.gnc import navigation
from hil.gnc.fusion import MEMORY, STEP
from hil.params import gnc as gnc_params


def compile_navigation() -> None:
    """Call the kernels of navigation once, with the types of the loop's calls."""
    params = gnc_params.navigation(load_scenario("scheme-1").value)
    state = new(navigation.NAVIGATION_STATE)
    poses = np.zeros(MAX_POSES, POSE).view(np.recarray)
    navigation.navigate(params, state, np.zeros(MEMORY, STEP), new(IMU), poses, 0, new(NAVIGATION))
    navigation.normalised_errors(state.fusion.filters, new(TRUTH), new(IMU), np.empty(2))


def main() -> None:
    """Compile; the parent's end ends this process."""
    Parent()
    compile_navigation()


if __name__ == "__main__":
    main()
