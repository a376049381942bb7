"""Pages of alarms and of the results of a run, made from their tables."""

from __future__ import annotations

import inspect
from collections.abc import Iterator

from docs.vmu_statuses import STATUSES
from hil.core.alarm_table import ALARMS
from hil.core.alarms import AlarmKind
from hil.report.results import Results, RunResults


def alarms_of(hazard: str) -> list[str]:
    """Return the quantities of the alarms of ``hazard``."""
    return [_quantity(kind) for kind in ALARMS.values() if kind.hazard == hazard]


def _quantity(kind: AlarmKind) -> str:
    return kind.quantity.replace("{}", "*")


def alarms() -> str:
    """Return the page of all alarms: device, unit, priority and hazard of each."""
    intro = """# Alarms

Each alarm has device, quantity, value and limit, as texts and, if they are numbers, in SI units (`measured`, `allowed`,
`unit` in the [JSON](../json.md)); angles are radians there, and of an axis that rotates m is rad. A * stands for a part
that varies. [Limits, and how alarms behave](../modes-and-alarms.md#alarms).
"""
    head = "| code | quantity | device | unit | priority | hazard |"
    rows = [
        f"| `{kind.code}` | {_quantity(kind)} | {kind.device} | {kind.unit} | {kind.priority} "
        f"| [{kind.hazard}](hazards.md) |"
        for kind in ALARMS.values()
    ]
    return f"{intro}\n{head}\n|{'---|' * 6}\n" + "\n".join(rows) + "\n"


def vmu_statuses() -> str:
    """Return the page of the statuses of a frame of the vision unit."""
    intro = "# Statuses of the vision unit\n\nColumn `status` of `hil vmu --out`.\n"
    rows = [f"| `{name}` | {each.meaning} | {'yes' if each.has_pose else 'no'} |" for name, each in STATUSES.items()]
    return f"{intro}\n| status | meaning | pose |\n|---|---|---|\n" + "\n".join(rows) + "\n"


def run_results() -> str:
    """Return the page of the results of a run: keys of the JSON, and which are key numbers of reports."""
    intro = """# Results of a run

Keys of `hil run --json`. A bold one is among the key numbers of reports and comparisons. `[3]` is x, y, z or theta1,
theta2, theta3; the unit is the end of a name; [contents of some](../json.md#hil-run).
"""
    return f"{intro}\n| key | meaning |\n|---|---|\n" + "\n".join(_result_rows(RunResults, "")) + "\n"


def _result_rows(table: type[Results], prefix: str) -> Iterator[str]:
    for each, inner in table.rows():
        key = f"`{prefix}{each.name}`"
        about = (inspect.getdoc(inner) or "").replace("\n", " ") if inner is not None else ""
        meaning = "; ".join(filter(None, (each.metadata["meaning"], about)))
        yield f"| {f'**{key}**' if each.metadata['label'] else key} | {meaning} |"
        if inner is not None:
            yield from _result_rows(inner, f"{prefix}{each.name}.")
