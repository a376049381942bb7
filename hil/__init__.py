"""Hardware-in-the-loop bench controller for spacecraft rendezvous and docking.

    import hil

    run = hil.run("scheme-1", seed=7, overrides={"gnc.control.deadband_m": 0.004})
    run.accepted, run.ready_time_s, run.truth.r_CT_H

Each name below is imported from its module when it is first used.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if "numba" not in sys.modules:  # which would reset its configuration
    os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")  # functions with bits of their own

if TYPE_CHECKING:
    from hil import errors
    from hil.api.jobs import load_rig, load_scenario
    from hil.api.recordings import Recording, Replay
    from hil.api.recordings import open_recording as open
    from hil.api.results import RecordGroup, Run
    from hil.api.run_comparison import RunComparison
    from hil.api.runs import run
    from hil.config.rig import Rig
    from hil.config.scenario import Scenario
    from hil.core.build_info import VERSION
    from hil.core.line_protocol import LineProtocol
    from hil.core.settings import Setting
    from hil.gnc_backends.kernel_backend import kernel_backend
    from hil.parts.campaigns.api.bench import Bench
    from hil.parts.campaigns.api.campaign_results import (
        Campaign,
        Comparison,
        StudyResults,
        SweepResults,
        compare,
        open_campaign,
    )
    from hil.parts.campaigns.api.campaigns import campaign, rare_event, sobol_indices, sweep
    from hil.parts.campaigns.api.margins import margins
    from hil.parts.campaigns.api.requirements import RunRequirement
    from hil.parts.monitor.monitor import DockingMonitor
    from hil.sensors.module import Component, SensorError, SensorModule
    from hil.vmu.unit import VisionUnit

    __version__ = VERSION

__all__ = [
    "Bench",
    "Campaign",
    "Comparison",
    "Component",
    "DockingMonitor",
    "LineProtocol",
    "RecordGroup",
    "Recording",
    "Replay",
    "Rig",
    "Run",
    "RunComparison",
    "RunRequirement",
    "Scenario",
    "SensorError",
    "SensorModule",
    "Setting",
    "StudyResults",
    "SweepResults",
    "VisionUnit",
    "__version__",
    "campaign",
    "compare",
    "errors",
    "kernel_backend",
    "load_rig",
    "load_scenario",
    "margins",
    "open",
    "open_campaign",
    "rare_event",
    "run",
    "sobol_indices",
    "sweep",
]

_MODULES = {
    "Bench": "hil.parts.campaigns.api.bench",
    "Campaign": "hil.parts.campaigns.api.campaign_results",
    "Comparison": "hil.parts.campaigns.api.campaign_results",
    "Component": "hil.sensors.module",
    "DockingMonitor": "hil.parts.monitor.monitor",
    "LineProtocol": "hil.core.line_protocol",
    "RecordGroup": "hil.api.results",
    "Recording": "hil.api.recordings",
    "Replay": "hil.api.recordings",
    "Rig": "hil.config.rig",
    "Run": "hil.api.results",
    "RunComparison": "hil.api.run_comparison",
    "RunRequirement": "hil.parts.campaigns.api.requirements",
    "Scenario": "hil.config.scenario",
    "SensorError": "hil.sensors.module",
    "SensorModule": "hil.sensors.module",
    "Setting": "hil.core.settings",
    "StudyResults": "hil.parts.campaigns.api.campaign_results",
    "SweepResults": "hil.parts.campaigns.api.campaign_results",
    "VisionUnit": "hil.vmu.unit",
    "__version__": "hil.core.build_info:VERSION",
    "campaign": "hil.parts.campaigns.api.campaigns",
    "compare": "hil.parts.campaigns.api.campaign_results",
    "kernel_backend": "hil.gnc_backends.kernel_backend",
    "load_rig": "hil.api.jobs",
    "load_scenario": "hil.api.jobs",
    "margins": "hil.parts.campaigns.api.margins",
    "open": "hil.api.recordings:open_recording",
    "open_campaign": "hil.parts.campaigns.api.campaign_results",
    "rare_event": "hil.parts.campaigns.api.campaigns",
    "run": "hil.api.runs",
    "sobol_indices": "hil.parts.campaigns.api.campaigns",
    "sweep": "hil.parts.campaigns.api.campaigns",
}
"""Name -> module, and the name there if it is another one."""


def __getattr__(name: str) -> Any:
    """Return a public name from its module (PEP 562)."""
    if name == "errors":
        return import_module("hil.errors")
    if name not in _MODULES:
        from hil.errors import did_you_mean

        near = (
            did_you_mean(name, __all__).rstrip() or f"it has {', '.join(each for each in __all__ if each[0].islower())}"
        )
        raise AttributeError(f"module 'hil' has no attribute {name!r}: {near}")
    module, _, other = _MODULES[name].partition(":")
    value = globals()[name] = getattr(import_module(module), other or name)
    return value


def __dir__() -> list[str]:
    return sorted({*(name for name in globals() if name.startswith("__")), *__all__})
