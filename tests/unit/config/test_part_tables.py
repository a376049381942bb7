"""Tables that parts add to scenario and rig files: validation, and digests that do not depend on what is installed."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from hil.api.jobs import loaded_rig, loaded_scenario
from hil.config.load import load_rig, load_scenario
from hil.config.motion_digest import motion_digest
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.config.tables.model import ConfigModel, Positive
from hil.core import part
from hil.core.part import InstalledPart, Part, Parts
from hil.errors import BadInput
from hil.parts.campaigns.campaign import campaign_digest
from hil.recording import read, schema


class Station(ConfigModel):
    """Table of the part."""

    rate_hz: Positive = 10.0
    """Rate."""


NO_MODEL = 3
RIG = ("rig.laser.rate_hz=5",)


def use(monkeypatch: pytest.MonkeyPatch, tables: dict[str, str]) -> None:
    """Install a part with ``tables``, by the names of their models in this module."""
    declared = Part(name="laser", summary="", tables={key: f"{__name__}:{name}" for key, name in tables.items()})
    monkeypatch.setattr(part, "parts", lambda: Parts({"laser": InstalledPart(declared, "1.0", "acme")}, []))


def test_table_has_the_defaults_of_its_model_where_the_file_has_it(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, {"laser": "Station", "rig.laser": "Station"})
    assert load_rig("mock").value.table_of_part("laser") is None
    rig = load_rig("mock", RIG).value
    assert rig.table_of_part("laser") == Station(rate_hz=5.0)
    assert loaded_rig(rig, ()).value == rig
    scenario = load_scenario("scheme-1", ["laser={}"]).value
    assert loaded_scenario(scenario, ["laser.rate_hz=2"]).value.table_of_part("laser") == Station(rate_hz=2.0)
    assert part.used_parts(scenario, rig)
    assert not part.used_parts(load_scenario("scheme-1").value, load_rig("mock").value)


def test_other_faults_do_not_hide_an_unknown_table(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, {"laser": "Station"})
    with pytest.raises(BadInput) as caught:
        load_scenario("scheme-1", ["lasr.rate_hz=2", "step_s=-1.0", "laser.rate_hz=1e999"])
    lines = str(caught.value).splitlines()
    assert any("lasr: unknown key: did you mean laser?" in line for line in lines)
    assert any("step_s" in line for line in lines)


def test_installed_part_changes_no_digest_of_files_without_its_table(monkeypatch: pytest.MonkeyPatch) -> None:
    def digests() -> tuple[str, str]:
        scenario, rig = load_scenario("scheme-1").value, load_rig("mock").value
        return motion_digest(rig), campaign_digest(scenario, rig)

    without = digests()
    use(monkeypatch, {"laser": "Station", "rig.laser": "Station"})
    assert digests() == without
    assert motion_digest(load_rig("mock", RIG).value) != without[0]


def test_recorded_tables_are_read_without_the_part(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, {"rig.laser": "Station", "laser": "Station"})
    rig, scenario = load_rig("mock", RIG).value, load_scenario("scheme-1", ["laser={}"]).value
    about = {"laser": {"version": "1.0", "origin": "acme", "topics": [], "tables": ["rig.laser", "laser"]}}
    files = {
        schema.PARTS_FILE: json.dumps(about),
        "rig.json": rig.model_dump_json(),
        "scenario.json": scenario.model_dump_json(),
    }
    found = read.Contents(Path("run.mcap"), files=files)
    assert read._model(found, "rig.json", Rig) == rig
    use(monkeypatch, {"laser": "Station"})
    assert read._model(found, "rig.json", Rig) == load_rig("mock").value
    assert read._model(found, "scenario.json", Scenario) == scenario
    files[schema.PARTS_FILE] = "{}"
    with pytest.raises(BadInput, match=r"rig.json: laser: "):
        read._model(found, "rig.json", Rig)


@pytest.mark.parametrize(
    ("tables", "line"),
    [
        ({"laser": "MISSING"}, r"cannot be imported: AttributeError"),
        ({"laser": "NO_MODEL"}, r"is 3, expected a ConfigModel"),
        ({"gnc": "Station"}, r"\[gnc\]: declared by a part, but a key of the program itself"),
    ],
)
def test_table_without_a_usable_model_is_one_line(
    tables: dict[str, str], line: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    use(monkeypatch, tables)
    with pytest.raises(BadInput, match=line) as caught:
        load_scenario("scheme-1", ["laser.rate_hz=2"])
    assert "\n" not in str(caught.value)
