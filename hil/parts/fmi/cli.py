"""``hil fmu-export``: the plant of the bench as an FMU."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from hil.cli.options import Integer, OptionalSeconds, Seed, Settings, one_of
from hil.cli.output import notices

Version = Annotated[Integer, one_of((2, 3))]


def fmu_export(
    scenario: str,
    /,
    *,
    out: Annotated[str, Parameter(alias="-o")],
    fmi: Version = 2,
    rig: str = "mock",
    seed: Seed = 0,
    duration: OptionalSeconds = None,
    settings: Settings = (),
) -> int:
    """Write truth, sensors, thrusters and mock axes of one run as an FMU for co-simulation.

    Needs a C compiler: cc, or the one that CC names. The FMU's outputs are the inputs of a GNC, its inputs the
    outputs of a GNC, under the names of hil_gnc.h.

    Parameters
    ----------
    scenario
        scheme-1, scheme-2, scheme-3, or the path of a scenario file.
    out
        File of the FMU.
    fmi
        Version of FMI, 2 or 3.
    rig
        mock, emulated, or the path of a rig file: it gives ranges and rates of axes and vision unit.
    seed
        Seed of all random numbers, as for hil run.
    duration
        Length of the run, s; default: that of the scenario.
    """
    from hil.api.jobs import loaded_rig, loaded_scenario, make_job
    from hil.cli.warm_up import compile_kernels_with_notice
    from hil.parts.fmi.plant_fmu import PlantCase, export_plant
    from hil.session import build

    job = make_job(loaded_scenario(scenario, settings), loaded_rig(rig, settings), seed, duration)
    build.check(job)
    console = notices()
    compile_kernels_with_notice(job, console)
    with console.status("compiling the plant"):
        case = PlantCase(job.scenario.value, job.rig.value, job.truth, job.seed, job.duration_s)
        export_plant(case, fmi, Path(out))
    print(f"{out}: plant of {job.scenario.value.name}, seed {seed}, FMI {fmi}.0", file=sys.stderr)  # noqa: T201
    return 0
