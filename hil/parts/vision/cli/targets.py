"""``hil targets``: sheets of targets for the vision unit."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import App, Parameter

from hil.cli.options import Check, Settings, TomlFile
from hil.cli.output import file_path_problem, say
from hil.core.files import write_text

app = App(name="targets")


def _sheet_problem(path: str) -> str:
    return file_path_problem(path) if path.endswith(".svg") else f"{path}: must end in .svg"


@app.command(name="print", help="Write the sheet of a rig's target, to be printed at full scale.")
def print_target(
    rig: str = "mock",
    /,
    *,
    out: Annotated[str, Parameter(name=("--out", "-o")), Check(_sheet_problem)],
    geometry_out: TomlFile = None,
    settings: Settings = (),
) -> int:
    """Write the sheet of a rig's target at full scale: AprilTags, a ChArUco board, or where to drill for the LEDs.

    Parameters
    ----------
    rig
        mock, emulated, or the path of a rig file: vmu.estimator, vmu.estimator_settings and vmu.leds_m.
    out
        Sheet to write, *.svg, in millimetres, with a mark of its orientation and a scale.
    geometry_out
        Geometry file (*.toml) to write: that of the rig, with the key print.
    """
    from hil.config.camera_identity import file_doubt
    from hil.config.load import load_rig
    from hil.parts.cameras.pose_sensor import geometry_of_unit
    from hil.vmu.calibration.files import as_toml
    from hil.vmu.sheets import sheet

    vmu = load_rig(rig, settings).value.vmu
    text, way = sheet(vmu)
    write_text(text, out)
    say(out if way is None else f'{out}: its geometry file needs the key print = "{way}"')
    if geometry_out is not None:
        geometry = geometry_of_unit(vmu).model_copy(update={"print": way})
        table = geometry.model_dump(exclude_none=True)
        write_text(as_toml(table, f"Vision unit, with the target printed from {Path(out).name}."), geometry_out)
        say(file_doubt(geometry.identities, geometry_out) or geometry_out)
    return 0
