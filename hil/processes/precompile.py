"""Compiles the navigation filters into the kernel cache: the half of the work that a second core can do.

``python -m hil.processes.precompile`` is started beside the first run of a program that finds its cache empty.
"""

from __future__ import annotations

import numpy as np

from hil.config.load import load_scenario
from hil.core.messages import IMU, MAX_POSES, NAVIGATION, POSE, TRUTH, new
from hil.drivers.emulator_process import die_with_parent
from hil.gnc import navigation
from hil.gnc.fusion import MEMORY, STEP
from hil.params import gnc as gnc_params


def compile_navigation() -> None:
    """Call the kernels of navigation once, with the types that the loop calls them with."""
    params = gnc_params.navigation(load_scenario("scheme-1").value)
    state = new(navigation.NAVIGATION_STATE)
    poses = np.zeros(MAX_POSES, POSE).view(np.recarray)
    navigation.navigate(params, state, np.zeros(MEMORY, STEP), new(IMU), poses, 0, new(NAVIGATION))
    navigation.normalised_errors(state.fusion.filters, new(TRUTH), new(IMU), np.empty(2))


if __name__ == "__main__":
    die_with_parent()  # nobody waits for this work then
    compile_navigation()
