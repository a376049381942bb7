"""The reference is complete: every key of configuration files, every command, and every column has a description."""

import re
from collections import Counter
from pathlib import Path

import pytest
from pydantic import BaseModel

from docs import generate
from hil.cli.main import COMMANDS
from hil.config import key_reference
from hil.config.protocol import Protocol
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.scene import Scene
from hil.config.tables.model import ConfigModel
from hil.config.tables.units import split
from hil.config.vmu_frame import VmuFrame
from hil.config.vmu_geometry import VmuGeometry
from hil.core import alarm_table
from hil.core.alarms import AlarmKind
from hil.core.modes import Mode
from hil.core.operator_commands import OperatorCommand
from hil.drivers.vmu import CAMERA_COUNTERS, COUNTERS
from hil.frmn.mailboxes import BY_NUMBER
from hil.parts.campaigns.outcome import COUNTS, FLAGS, NUMBERS, TEXTS
from hil.report.limits import LIMITS

ROOT = Path(__file__).resolve().parents[2]
MODELS = (Scenario, Rig, VmuGeometry, Scene, Protocol, VmuFrame)


@pytest.mark.parametrize("model", MODELS, ids=lambda model: model.__name__)
def test_every_key_has_a_meaning_and_every_table_a_description(model: type[BaseModel]) -> None:
    tables = [each for each in key_reference.tables(model) if each.model.__module__.startswith("hil.")]
    assert [f"{table.model.__name__}.{key.name}" for table in tables for key in table.keys if not key.meaning] == []
    assert [table.model.__name__ for table in tables if not table.model.__doc__] == []
    unknown = [f"{table.model.__name__}.{key.name}" for table in tables for key in table.keys if key.unit == "?"]
    assert unknown == []


def test_every_key_is_read_and_every_alarm_raised() -> None:
    texts = [path.read_text() for path in (ROOT / "hil").rglob("*.py")]
    words = Counter(word for text in texts for word in re.findall(r"\w+", text))
    by_name = {name for text in texts for name in re.findall(r'"(\w+)"', text)}  # si("speed_mismatch_max")
    ours = [table for model in (Scenario, Rig) for table in key_reference.tables(model)]
    ours = [table for table in ours if table.model.__module__.startswith("hil.")]
    rows = {(table.model.__name__, key.name) for table in ours for key in table.keys}
    unread = {(model, key) for model, key in rows if words[key] < 2 and split(key)[0] not in by_name}
    by_pattern = {
        "MachineErrors": r"[xyz]_(position|straightness)_m|[xyz]_rotation_deg", "ControlBits": "fault_reset",
    }  # fmt: skip
    assert [each for each in unread if not re.fullmatch(by_pattern.get(each[0], ""), each[1])] == []
    kinds = [name for name, value in vars(alarm_table).items() if isinstance(value, AlarmKind)]
    assert [name for name in kinds if words[name] < 2] == []


def test_number_of_another_package_without_a_unit_in_its_name_is_listed_as_such() -> None:
    class Table(ConfigModel):
        """A table."""

        speed: float

    (table,) = key_reference.tables(Table)
    assert [(key.name, key.unit) for key in table.keys] == [("speed", key_reference.UNKNOWN_UNIT)]


def test_a_key_shows_type_unit_range_and_default() -> None:
    rows = {key.name: key for table in key_reference.tables(Rig) for key in table.keys}
    assert rows["lead_s"][1:5] == ("number", "s", "from -0.2 to 0.2", "`0.0`")
    control = next(table for table in key_reference.tables(Scenario) if "gnc.control" in table.places)
    lead = next(key for key in control.keys if key.name == "lead_s")
    assert lead.allowed == "from 0; 0 to 100 during a run"
    assert rows["gimbal_order"].allowed.startswith('`"zyx"`, `"zxy"`')
    assert rows["travel_m"][1:3] == ("number[2]", "m")


def test_generated_pages_are_those_of_the_code() -> None:
    differ = [name for name, text in generate.pages().items() if (ROOT / "docs" / name).read_text() != text]
    assert differ == [], "python -m docs.generate writes them"


def test_page_of_the_command_line_has_every_command_and_the_others_have_rows() -> None:
    page, *others = generate.pages().values()
    assert all(re.search(r"\n\| (`|0 \||H-)|\n```toml\n", other) for other in others)
    headings = re.findall(r"^#+ hil (.*)$", page, re.MULTILINE)
    assert set(COMMANDS) <= set(headings)
    assert {"gnc check", "gnc header", "recordings list"} <= set(headings)


def test_columns_of_a_campaign_are_described() -> None:
    page = (ROOT / "docs" / "reference" / "columns.md").read_text().split("## Campaigns")[1]
    described = set(re.findall(r"`(\w+)`", page))
    plain = [name for name in (*FLAGS, *COUNTS, *TEXTS, *NUMBERS) if not name.startswith("margin_")]
    names = {re.sub(r"_[xyz]$", "", name) for name in plain}
    assert names <= {re.sub(r"_[xyz]$", "", name) for name in described}


def test_modes_commands_and_codecs_have_their_places_on_generated_pages() -> None:
    modes, wires = generate.PAGES["modes"](), generate.PAGES["wires"]()
    assert all(f"- **{mode.name}**: " in modes for mode in (*Mode, *OperatorCommand))
    assert all(f"| `{name}` |" in modes for name in LIMITS)
    assert all(f"| `{box.name}` |" in wires for box in BY_NUMBER.values())
    unit, cameras = (
        {name for row in re.findall(r"^- \*\*(.*)\*\*: ", part, re.MULTILINE) for name in row.split(", ")}
        for part in wires.split("## Counters of cameras")
    )
    assert unit == set(COUNTERS)
    assert cameras == {re.sub(r"_p\d+_us$", "", name) for name in CAMERA_COUNTERS}
    assert "| 159 | checksum | | crc16-ccitt-false |" in wires  # 161 bytes, as the wire has them
