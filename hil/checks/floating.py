"""Check of a scenario on a rig whose vehicle floats."""

from __future__ import annotations

from hil.checks.combinations import problems_with
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import BUILTIN, Scenario
from hil.errors import Problem


def check_floating(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each setting that a floating vehicle, whose measured pose is the truth, does not have."""
    if rig.value.floating is None:
        return []
    value = scenario.value
    simulated = [family for family in ("imu", "axis") if any(fault.family == family for fault in value.faults)]
    wrong = {
        "chaser.plane": (f'"{value.chaser.plane}"', '"xz"') if value.chaser.plane != "xz" else None,
        "chaser.planar": ("false", "true: it floats in the x-z plane of H") if not value.chaser.planar else None,
        "truth.relative_motion": (f'"{value.truth.relative_motion}"', '"free": a level floor has no field')
        if value.truth.relative_motion != "free"
        else None,
        "gnc.navigation.backend": (f'"{BUILTIN}"', "one without an IMU: the measured pose is the only sensor")
        if value.gnc.fuses_imu
        else None,
        "bench.scaled_beyond_m": (f"{value.bench.scaled_beyond_m}", "none") if value.bench.scaled_beyond_m else None,
        "monitor.source": (f'"{value.monitor.source}"', '"none"') if value.monitor.source != "none" else None,
        "sensors": (", ".join(value.sensors), "none") if value.sensors else None,
        "faults": (f"of {', '.join(simulated)}", "those of vmu and thrusters") if simulated else None,
        **{f"{name}.fmu": (f'"{part.fmu}"', "none: the vehicle is no model") for name, part in value.models.items()},
    }
    return problems_with(f"the floating vehicle of rig {rig.value.name}", scenario, wrong)
