"""Check of a scenario on a rig that has an IMU on a wire."""

from __future__ import annotations

from hil.checks.combinations import problems_with
from hil.config.load import Loaded, load_frame
from hil.config.rig import GIMBAL_NAMES, Rig
from hil.config.scenario import Scenario
from hil.errors import Problem


def check_wired_imu(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> list[Problem]:
    """Return a problem for each setting under which gyros on the table do not measure what the chaser's would."""
    value, bench = scenario.value, rig.value
    if bench.imu is None:
        return []
    fixed = [name for name in GIMBAL_NAMES if getattr(bench.turntable, name).is_fixed]
    faults = [fault.device for fault in value.faults if fault.family == "imu"]
    of_scenario = {
        "gnc.navigation.backend": ("one without an IMU", "one that fuses it") if not value.gnc.fuses_imu else None,
        "imu.rate_hz": (f"{value.imu.rate_hz:g}", "one sample per cycle") if value.imu_samples > 1 else None,
        "imu.fmu": (f'"{value.imu.fmu}"', "none") if value.imu.fmu is not None else None,
        "faults": ("of the virtual imu", "those of the emulated wire") if faults and bench.kind != "mock" else None,
    }
    of_rig = {
        "rig.imu.rate_hz": (f"{bench.imu.rate_hz:g}", f"from {1.0 / value.step_s:g}, one frame per cycle")
        if bench.imu.rate_hz * value.step_s < 1.0
        else None,
        "rig.turntable": (f"{', '.join(fixed)} fixed", "three driven gimbals, which turn it") if fixed else None,
        "rig.floating": ("a floating vehicle", "driven axes") if bench.floating is not None else None,
        "rig.target_manipulator": ("a target that is turned", "one that stands")
        if bench.target_axes is not None
        else None,
    }
    if bench.imu.can is not None and (sync := load_frame(bench.imu.frames).value.sync) is not None:
        expected, given = bench.imu.can.sync.hex(" "), bytes.fromhex(sync).hex(" ")
        of_rig["rig.imu.frames"] = (
            (f'sync "{given}"', f'"{expected}", imu.can.identifiers') if given != expected else None
        )
    part = f"the IMU on the table of rig {bench.name}"
    return [*problems_with(part, scenario, of_scenario), *problems_with(part, rig, of_rig)]
