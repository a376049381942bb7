"""``hil sensors``: the sensor modules that a scenario can add, and the check of one of them."""

from __future__ import annotations

from cyclopts import App

from hil.cli.options import File, Seed
from hil.cli.output import print_columns, write_json
from hil.errors import BadInput

app = App(name="sensors")


@app.command(name="list", help="List the sensor modules that a scenario can add.")
def list_sensors(*, json: File = None) -> int:
    """List the sensor modules of this program and of installed packages, which a scenario can add.

    Parameters
    ----------
    json
        File for the entries, - for standard output.
    """
    from hil.sensors.registry import kinds

    sensors = kinds()
    if json is not None:
        entries = {kind: {"error": s} if isinstance(s, str) else s.as_json() for kind, s in sensors.items()}
        write_json({"sensors": entries}, json)
    if json != "-":
        rows = [(kind, s if isinstance(s, str) else s.summary) for kind, s in sensors.items()]
        print_columns(("kind", ""), rows, left=range(2))
    return 0


@app.command(help="Check a sensor module: its declaration, its Jacobian by differences, its noise.")
def check(name: str, /, *, seed: Seed = 0, json: File = None) -> int:
    """Check a sensor module: its declaration, its Jacobian by differences, its noise by many measurements.

    Parameters
    ----------
    name
        Kind of the sensor, or a class in a file: FILE.py:NAME.
    seed
        Of the places and the noise of the check.
    json
        File for the result, - for standard output.
    """
    from hil.sensors.check import problems
    from hil.sensors.registry import sensor

    kind = sensor(name)
    lines = problems(kind, seed=seed)
    write_json({"sensor": name, "passed": not lines, "problems": lines} | kind.as_json(), json)
    if lines:
        raise BadInput.single("hil sensors check", name, lines[0])
    if json != "-":
        components = ", ".join(component.name for component in kind.components)
        rows = [(kind.kind, kind.summary), ("components", components), ("check", "passed")]
        print_columns(("", ""), rows, left=range(2))
    return 0
