"""The part as ``hil`` finds it: table, rows, numbers, section and command of a run."""

from pathlib import Path

import pytest

import hil
from hil.cli.main import execute
from hil.errors import BadInput
from hil.report.section import sections_of


def test_run_has_rows_numbers_section_and_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = hil.run("scheme-1", duration_s=4.0, overrides={"ranging.rate_hz": 5.0}, record=tmp_path)
    assert run.summary["ranging"]["samples"] == 21
    assert "Ranging" in [section.title for section in sections_of(run.summary)]
    recording = run.summary["recording"]["file"]
    assert len(hil.open(recording).rows_of("ranging_samples")) == 21
    assert execute(["ranging", recording]) == 0
    assert len(capsys.readouterr().out.splitlines()) == 21


def test_alarm_stands_while_the_distance_is_short() -> None:
    near = {"ranging.alarm_below_m": 50.0}
    (alarm,) = hil.run("scheme-1", duration_s=1.0, overrides=near).summary["alarms"]
    assert (alarm["code"], alarm["device"], alarm["allowed"], alarm["active"]) == ("distance", "ranging", 50.0, True)
    assert hil.run("scheme-1", duration_s=1.0, overrides={"ranging.rate_hz": 5.0}).summary["alarms"] == []


def test_run_without_the_table_does_not_use_the_part() -> None:
    assert "ranging" not in hil.run("scheme-1", duration_s=1.0).summary


def test_wrong_value_is_refused_in_one_line() -> None:
    with pytest.raises(BadInput, match=r"^overrides: ranging.rate_hz: -1.0: must be greater than 0$"):
        hil.load_scenario("scheme-1", {"ranging.rate_hz": -1.0})
