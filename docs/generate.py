"""Reference pages that are made from the code: ``python -m docs.generate`` writes those that differ.

``pages()`` has the text of each page by its path below ``docs/``: the command line from its declarations, the keys of
configuration files from ``hil.config.key_reference``, the records from their field tables.
"""

from __future__ import annotations

import inspect
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Final

from pydantic import BaseModel

from docs import benchmark_pages, package_pages, record_pages, result_pages, wire_pages
from docs.fault_responses import RESPONSES
from hil.cli.main import app
from hil.config.key_reference import KeyTable, own_keys, tables
from hil.config.protocol import Protocol
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.scene import Scene
from hil.config.tables.body import CentralBody
from hil.config.tables.dispersions import Spread
from hil.config.tables.driver_registry import DeviceTable
from hil.config.tables.faults import EMULATED, TERMS, ErrorTerm
from hil.config.tables.limits import RIG_LIMITS, SCENARIO_LIMITS
from hil.config.vmu_frame import VmuFrame
from hil.config.vmu_geometry import VmuGeometry
from hil.core.sensor_records import (
    SENSOR_ESTIMATE_FIELDS,
    SENSOR_INNOVATION_FIELDS,
    SENSOR_OUTPUT_FIELDS,
    SENSOR_SAMPLE_FIELDS,
    SENSOR_TRUTH_FIELDS,
)
from hil.sensors.registry import SHIPPED, sensor

FOLDER: Final = "reference/generated"


def pages() -> dict[str, str]:
    """Return the text of each generated page by its path below ``docs/``."""
    return {f"{FOLDER}/{name}.md": make() for name, make in PAGES.items()}


def write(docs: Path) -> None:
    """Write the pages that are missing or differ."""
    for name, text in pages().items():
        path = docs / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")


def command_line() -> str:
    """Return the page of all commands, as ``--help`` shows them."""
    text = app.generate_docs(heading_level=1, max_heading_level=3)
    start = text.index("## hil run")
    body = re.sub(r" \*\[default: \(\)\]\*|(?<=[a-z]) -m [\w.]+(?=\s)", "", text[start:])
    intro = """# Command line

`hil COMMAND --help` shows the same. Every command ends with one of these exit codes:

| exit code | meaning |
|---|---|
| 0 | completed; verdict pass |
| 1 | completed; verdict fail |
| 2 | invalid input: one line per error, with file, key, value and allowed values |
| 3 | safe stop: device fault, limit, or Ctrl-C; a campaign that cannot continue |
| 4 | internal error |

`--set a.b=v` overrides a key of the [scenario](scenario.md), `--set rig.a.b=v` a key of the [rig](rig.md). Texts may be
given without quotes. Commands under earlier names are accepted.
"""
    return f"{intro}\n{body}\n"


def scenario_keys() -> str:
    """Return the page of the keys of a scenario file."""
    intro = """# Scenario keys

A scenario is a TOML file; keys that it omits are taken from the scenario named by `extends` (a shipped name, or a path
relative to the file). `hil keys [PATTERN]` lists them. Frames: [Frames and
signs](../../explanation/frames.md).

`[dispersions]` repeats the tables of the scenario; each of their decimal numbers may have a distribution:
"""
    spread = _rows(KeyTable([], Spread, "", own_keys(Spread)))
    return f"{intro}\n{spread}\n{_sections(Scenario)}"


def rig_keys() -> str:
    """Return the page of the keys of a rig file."""
    intro = """# Rig keys

A rig is a TOML file; keys that it omits are taken from the rig named by `extends` (`mock`, `emulated`, `emulated-rtu`,
`emulated-machine`, or a path relative to the file). Paths in it are relative to it. A driver of another package has the
keys that its own documentation gives, in a table of its name.
"""
    return f"{intro}\n{_sections(Rig)}"


def fault_table() -> str:
    """Return the page of all kinds of faults: what they do, and how each is detected."""
    intro = """# Faults

A fault is a term of the error model of a device that acts for a time. A scenario gives a timetable with the keys of
[`[[faults]]`](scenario.md), as do `--set 'faults=[...]'` and `hil.run(..., faults=[...])`: see [how to inject
faults](../../how-to/inject-faults.md). A fault acts from `at_s` to `until_s` of the run's time, in the compiled loop,
the cycle in Python, campaigns and replays alike. Faults of axes need the mock rig; those of an emulated rig are
switched on
at the control ports of its [emulators](../../how-to/set-up-a-rig.md).

The effect is that without a reaction. Detection and reaction are those of a single fault at the sizes of the test. A
fault that is not detected for sure need not be: at the sizes of the test the approach ends without misleading
information and outside of the [keep-out](../../explanation/safety.md#what-is-monitored).
"""
    devices = {
        "vmu": "`vmu`: vision unit. Its frames are disturbed on their way to the loop, whatever their source",
        "imu": "`imu`: virtual IMU",
        "monitor": "`monitor`: docking monitor of the scenario. Its measurements are disturbed on their way to "
        "the interlock",
        "thruster": "`thruster.1` and so on, in the order of the scenario",
        "axis": "`rails.x`, `rails.y`, `rails.z`, `turntable.roll`, `turntable.pitch`, `turntable.yaw`",
        "sensor": "`sensor.NAME`: a further sensor of the scenario, with the kinds of faults that its module declares",
        "target": "`target`: leaves the place where the approach expects it",
    }
    parts = [intro]
    for family, kinds in TERMS.items():
        rows = [
            f"| `{name}` | {_fault_value(term)} | {term.unit} | {term.frame} | {_fault_range(term)} | {term.effect} "
            f"| {_fault_response(family, name)} |"
            for name, term in kinds.items()
        ]
        head = "| `kind` | `value` | unit | frame | allowed | effect | detection | reaction | test |"
        parts.append(f"## {family}\n\n{devices[family]}.\n\n{head}\n|{'---|' * 9}\n" + "\n".join(rows) + "\n")
    parts.append("## Emulated devices\n\nSwitched at the control port of the device: `on drop 0.2`, `on stuck y`.\n")
    parts.append("| part | fault | number | allowed | unless given | effect |\n|---|---|---|---|---|---|")
    for part, kinds in EMULATED.items():
        for name, term in kinds.items():
            default = f"{term.default:g}" if term.default is not None else ""
            shown = f"{name} AXIS" if term.of_axis else name
            parts.append(f"| {part} | `{shown}` | {term.unit} | {_fault_range(term)} | {default} | {term.effect} |")
    return "\n".join([*parts, ""])


def _fault_value(term: ErrorTerm) -> str:
    count = ("", "number", "2 numbers", "3 numbers")[term.values]
    more = ", ".join(f"`{option}`" for option in term.options)
    return "; ".join(part for part in (count, more) if part)


def _fault_response(family: str, kind: str) -> str:
    response = RESPONSES[f"{family}.{kind}"]
    if response.detected_by is None:
        return f"not for sure: {response.detection} | {response.reaction} | `{response.test}`"
    by = {"navigation": "GNC", "monitor": "docking monitor", "guard": "bench guard", "device": "device"}
    return f"{by[response.detected_by]}: {response.detection} | {response.reaction} | `{response.test}`"


def _fault_range(term: ErrorTerm) -> str:
    if not term.values:
        return ""
    return f"{'magnitude ' if term.values == 3 else ''}{term.low:g} to {term.high:g}"


def sensor_table() -> str:
    """Return the page of the shipped sensor modules: components, settings, errors and faults."""
    intro = """# Sensors

Sensors that a scenario can add, `[[sensors]]`, with the keys that each declares in addition to those of
[every sensor](scenario.md). [How to add one](../../how-to/add-a-sensor.md); [how they are
fused](../../explanation/sensors.md).
"""
    parts = [intro]
    for kind in SHIPPED:
        found = sensor(kind)
        parts.append(f"## {kind}\n\n{inspect.cleandoc(found.module.__doc__ or '')}\n")
        sees = "where the bench is" if found.module.sees == "bench" else "the truth"
        parts.append(f"A modelled one sees {sees}, {found.module.rate_hz:g} times per second.\n")
        rows = [f"| `{c.name}` | {c.unit} | {c.doc} |" for c in found.components]
        parts.append("| component | unit | meaning |\n|---|---|---|\n" + "\n".join(rows) + "\n")
        rows = [f"| `{s.name}` | {s.default:g} | {s.unit} | {s.allowed} | {s.doc} |" for s in found.settings]
        parts.append("| key | default | unit | allowed | meaning |\n|---|---|---|---|---|\n" + "\n".join(rows) + "\n")
        parts.append(f"Errors that are states of the filters: {', '.join(f'`{c}`' for c in found.error_columns())}.\n")
        rows = [f"| `{fault}` | {text} |" for fault, text in found.module.faults.items()]
        parts.append("| fault | how it is seen |\n|---|---|\n" + "\n".join(rows) + "\n")
    parts += [
        f"## {name}\n\n{text}:\n\n{record_pages.markdown_table(fields)}\n"
        for name, (text, fields) in SENSOR_RECORDS.items()
    ]
    return "\n".join(parts)


SENSOR_RECORDS = {
    "Truth": ("`truth`, what `measure` reads", SENSOR_TRUTH_FIELDS),
    "Output": ("`out` of `measure`", SENSOR_OUTPUT_FIELDS),
    "Sample": ("`out.sample`", SENSOR_SAMPLE_FIELDS),
    "Estimate": ("`estimate`, what `innovate` reads", SENSOR_ESTIMATE_FIELDS),
    "Innovation": ("`out` of `innovate`", SENSOR_INNOVATION_FIELDS),
}
"""Records of a sensor module -> what they are, and their fields."""


def limit_table() -> str:
    """Return the page of all protective limits: what each protects from, its ranges, and where a weak one shows."""
    intro = """# Protective limits

A value outside of the range of its kind of rig is an error (exit code 2). A value weaker than recommended is accepted
and shown in red, on every kind of rig: by `hil preflight`, before `hil console` opens the bench and on its page, in the
report and at the terminal, there with the verdict as well; the JSON of runs and preflights, and with it the recording,
has it in `waived`. On hardware a change of any of these keys ends the [sign-off](../../how-to/commission.md).
"""
    head = "| key | protects from | recommended | on hardware | on mock and emulated rigs | where a weak one shows |"
    shows = {"rig.": "in red, and the sign-off ends", "": "in red"}
    rows = [
        f"| `{prefix}{limit.key}` | {limit.protects} | "
        + " | ".join(map(limit.range_text, (limit.recommended, limit.hardware, limit.simulated)))
        + f" | {shows[prefix]} |"
        for prefix, limits in (("rig.", RIG_LIMITS), ("", SCENARIO_LIMITS))
        for limit in limits
    ]
    return f"{intro}\n{head}\n|{'---|' * 6}\n" + "\n".join(rows) + "\n"


def other_files() -> str:
    """Return the page of the keys of the other configuration files."""
    parts = {
        "Geometry file of the vision unit": VmuGeometry,
        "Scene file of the docking monitor": Scene,
        "Body file of a central body": CentralBody,
        "Protocol file of a serial turntable": Protocol,
        "Frame file of a vision unit": VmuFrame,
    }
    text = "# Keys of geometry, scene, body, protocol and frame files\n\nJSON or TOML; the last three are TOML.\n"
    return text + "".join(f"\n## {title}\n\n{_sections(model, level=3)}" for title, model in parts.items())


def dispersion_sets() -> str:
    """Return the page of the shipped dispersion sets: their files, which have the source of each size."""
    intro = """# Dispersion sets

What `hil campaign --dispersions NAME` draws, with the source of each size. Pass rates:
[campaigns](../../explanation/campaigns.md#pass-rates).
"""
    files = sorted((Path(__file__).parents[1] / "configs" / "dispersions").glob("*.toml"))
    sections = [f"## {path.stem}\n\n```toml\n{path.read_text(encoding='utf-8').strip()}\n```\n" for path in files]
    return "\n".join([intro, *sections])


HAZARD_KEYS: Final = (
    "id", "losses", "hazard", "cause", "software", "hardware", "category", "tests", "remains",
)  # fmt: skip
"""Keys of a row of ``docs/hazards.toml``."""


def hazards() -> str:
    """Return the page of all hazards: cause, barriers, category asked, tests, and what remains."""
    intro = """# Hazards of the bench

Losses: **P** a person is hurt, **B** bench or specimen is damaged, **V** a verdict is wrong, **A** an act cannot be
attributed. The category is asked of the hardware barrier, by ISO 13849-1; software of this program has none ([what it
cannot do](../../explanation/safety-file.md#what-software-cannot-do)). The table is `docs/hazards.toml`; the suite
checks that each test exists, and [each alarm](alarms.md) names its hazard.
"""
    rows = tomllib.loads((Path(__file__).parent / "hazards.toml").read_text(encoding="utf-8"))["hazards"]
    head = "| | hazard | losses | category asked | tests | alarms |\n|---|---|---|---|---|---|\n"
    lines = [
        f"| {row['id']} | {row['hazard']} | {row['losses']} | {row['category']} | {len(row['tests'])} "
        f"| {len(result_pages.alarms_of(row['id']))} |"
        for row in rows
    ]
    sections = [
        f"## {row['id']} {row['hazard']}\n\n| | |\n|---|---|\n| cause | {row['cause']} |\n| barrier in software | "
        f"{row['software']} |\n| barrier in hardware | {row['hardware']} |\n| category asked of it | {row['category']} "
        f"|\n| alarms | {', '.join(result_pages.alarms_of(row['id'])) or 'none'} |\n"
        f"| tests | {', '.join(map(_test_link, row['tests']))} |\n"
        f"| what remains | {row['remains']} |\n"
        for row in rows
    ]
    return f"{intro}\n{head}" + "\n".join(lines) + "\n\n" + "\n".join(sections)


def _test_link(name: str) -> str:
    path, _, function = name.partition("::")
    return f"`{function}` (`{path}`)"


PAGES: Final[dict[str, Callable[[], str]]] = {
    "command-line": command_line,
    "scenario": scenario_keys,
    "faults": fault_table,
    "limits": limit_table,
    "sensors": sensor_table,
    "hazards": hazards,
    "alarms": result_pages.alarms,
    "run-results": result_pages.run_results,
    "vmu-statuses": result_pages.vmu_statuses,
    "rig": rig_keys,
    "files": other_files,
    "dispersions": dispersion_sets,
    "packages": package_pages.packages,
    "benchmark": benchmark_pages.benchmark,
    "wires": wire_pages.wires,
    "modes": wire_pages.modes,
    "records": record_pages.records,
    "gnc-records": record_pages.gnc_records,
    "backend-records": record_pages.backend_records,
    "model-records": record_pages.model_records,
}


def _sections(root: type[BaseModel], level: int = 2) -> str:
    sections = []
    for table in (each for each in tables(root) if each.model.__module__.startswith("hil.")):
        first, *others = [f"`[{place}]`" for place in table.places if place] or ["Top level"]
        text = [f"{'#' * level} {first}", f"Also {', '.join(others)}." if others else "", _prose(table.model)]
        if table.inherits:
            text.append(f"The keys of {table.inherits}, and:" if table.keys else f"The keys of {table.inherits}.")
        if table.keys:
            text.append(_rows(table))
        sections.append("\n\n".join(filter(None, text)))
    return "\n\n".join(sections) + "\n"


def _prose(model: type[BaseModel]) -> str:
    """Return the docstring of a model as Markdown, pages that it names as links."""
    own = model.__dict__.get("__doc__") or ""
    text = "" if model is DeviceTable else inspect.cleandoc(own).replace("``", "`")
    return re.sub(r"docs/([\w/-]+)/([\w-]+)\.md", r"[\2](../../\1/\2.md)", text)


def _rows(table: KeyTable) -> str:
    rows = ["| key | type | unit | allowed | default | meaning |", "|---|---|---|---|---|---|"]
    for key in table.keys:
        meaning = key.meaning.replace("``", "`").replace("|", "\\|")
        rows.append(f"| `{key.name}` | {key.type} | {key.unit} | {key.allowed} | {key.default} | {meaning} |")
    return "\n".join(rows)


if __name__ == "__main__":
    write(Path(__file__).parent)
