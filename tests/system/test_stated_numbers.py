"""Pages state the numbers of docs/numbers.toml, its commands can be run, and so can sims and benchmarks."""

from __future__ import annotations

import argparse
import importlib
import os
import shlex
import subprocess
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from hil.cli.main import app
from hil.config.load import load_rig, load_scenario
from sims.stated_numbers import ROOT, estimate, interval, phrases, place, rows

ROWS = rows()
of_each_row = pytest.mark.parametrize("row", ROWS, ids=[row["command"] for row in ROWS])
QUICK = ("sims/monitor_study.py independent --portions 2",)
SMALLEST = (
    "benchmarks/cameras_in_the_loop.py --duration 12", "benchmarks/campaign.py --seconds 1 --rounds 1 --scaling",
    "benchmarks/console.py --clients 1 --rounds 1 --seconds 2", "benchmarks/filters.py", "benchmarks/fmu.py",
    "benchmarks/foxglove.py mock 2", "benchmarks/frmn.py --seconds 1 --rounds 1", "benchmarks/images.py --seconds 2",
    "benchmarks/lateness.py --rounds 1 --seconds 1", "benchmarks/loop_stages.py", "benchmarks/monitor.py --frames 2",
    "benchmarks/plain_loop.py", "benchmarks/recording.py --seconds 2", "benchmarks/truth_step.py --span-s 4",
    "benchmarks/soak.py --bench-hours 0.02 --rig mock --out OUT", "benchmarks/vmu.py 1",
    "benchmarks/vmu_detect.py --range-m 3", "benchmarks/vmu_layouts.py 1", "benchmarks/drive_mechanics.py --duration 3",
    "sims/benchmark_table.py --runs 1 --out OUT --page OUT.json", "sims/calibration_study.py 1",
    "sims/disturbances.py vmu --count 1 --seeds 1 --row clean", "sims/error_models.py 1 scheme-1-paper bias",
    "sims/fault_matrix.py running --lock-step", "sims/foxglove_layout.py", "sims/guard_volume.py 2 1",
    "sims/integrity_campaign.py 20 scheme-1 --workers 1", "sims/integrity_cases.py", "sims/monitor_paper.py 2",
    "sims/monitor_pixels.py --pictures 2", "sims/rendered_consistency.py 1 8 --workers 1",
    "sims/scheme_pictures.py scheme-1 OUT.png", "sims/sigma_coverage.py --portions 4 --poses 14",
    "sims/stated_numbers.py 'hil run scheme-2'", "sims/viewer_picture.py OUT.png", "sims/vmu_spots.py --images 1",
    "sims/vmu_study.py coverage --poses 10",
)  # fmt: skip
"""Commands of all scripts but those in ELSEWHERE at their smallest size; of QUICK numbers rest on them."""
ELSEWHERE = ("sims/rt_guest.py", "sims/vision_differences.py")  # in a virtual machine; by test_vision_alone.py


@of_each_row
def test_pages_state_the_numbers_of_the_table(row: dict[str, Any]) -> None:
    for page, text in phrases(row):
        assert place(text, page.read_text(encoding="utf-8")), f"{page}: {text}"


def test_each_command_is_that_of_one_row_and_was_measured() -> None:
    assert [command for command, n in Counter(row["command"] for row in ROWS).items() if n > 1] == []
    assert [row["command"] for row in ROWS if not row["commit"]] == []


@of_each_row
def test_command_parses_and_its_scenario_exists(row: dict[str, Any], monkeypatch: pytest.MonkeyPatch) -> None:
    program, *words = shlex.split(row["command"].replace("{cases}", "20"))
    if program == "hil":
        out = ["--out", "results"] * (words[0] == "campaign")
        app.parse_args([*words, *out], exit_on_error=False, print_error=False)
        given = [(option, value) for option, value in pairwise(words) if option.startswith("--")]
        settings = [value for option, value in given if option == "--set"]
        sets = [f"dispersions={value}" for option, value in given if option == "--dispersions"]
        if words[0] != "fusion":
            load_scenario(words[1], (*sets, *settings))
            if any(setting.startswith(("rig.", "--rig")) for setting in (*words, *settings)):
                load_rig(dict(given).get("--rig", "mock"), tuple(settings))
        return

    class Parsed(Exception):
        pass

    def parse(parser: argparse.ArgumentParser) -> None:
        argparse.ArgumentParser.parse_known_args(parser, words[1:])
        raise Parsed

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse)
    with pytest.raises(Parsed):
        importlib.import_module(words[0].removesuffix(".py").replace("/", ".")).main()


def test_an_interval_is_that_of_the_sample() -> None:
    assert interval(["rate", "990", ""], 100, 1000) == (92.0, 100.0)
    assert interval(["mean", "9.00", "", 4.0], 100, 1000)[1] - 9.0 == pytest.approx(
        0.005 + 3.8906 * 4.0 * (0.01 + 0.001) ** 0.5, rel=1e-4
    )
    assert interval(["exact", "0.65", ""], 1, 1) == pytest.approx((0.645, 0.655), abs=1e-6)
    assert interval(["probability", "1.00e-3", "", 0.2], 1, 1)[1] == pytest.approx(3.02e-3, rel=0.01)
    assert estimate("rate", [True, False, True]) == (2.0, 0.0)
    assert estimate("median", range(101))[0] == 50.0


@pytest.mark.parametrize("command", [*QUICK, *(pytest.param(command, marks=pytest.mark.slow) for command in SMALLEST)])
def test_script_runs_at_its_smallest_size(command: str, tmp_path: Path) -> None:
    script, *words = shlex.split(command.replace("OUT", str(tmp_path / "out")))
    environment = os.environ | {"PYTHONPATH": str(ROOT)}
    done = subprocess.run([sys.executable, ROOT / script, *words], cwd=tmp_path, env=environment, capture_output=True)
    assert done.returncode in (0, 1), done.stderr  # 1: something is not as expected, of so few cases
    assert b"Traceback" not in done.stderr, done.stderr


def test_every_script_has_its_smallest_size() -> None:
    scripts = {str(path.relative_to(ROOT)) for folder in ("sims", "benchmarks") for path in ROOT.glob(f"{folder}/*.py")}
    assert scripts == {*(command.split()[0] for command in (*QUICK, *SMALLEST)), *ELSEWHERE}
