"""Kernels of the worker processes: the process that forks them imports this module, which loads the kernels once."""

from __future__ import annotations

from contextlib import suppress

from hil.config.load import load_rig, load_scenario
from hil.parts.campaigns.batch import Spec, run_batch

with suppress(Exception):  # each worker meets the same, and reports it
    run_batch(Spec.of(load_scenario("scheme-1").value, load_rig("mock").value, 0, 0.1), 0, 1)
