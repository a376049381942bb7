"""Wrong calls of the public API: each is answered by one line with the argument, its value and what is allowed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil

pytestmark = pytest.mark.xdist_group("api")

Call = Callable[[Any], Any]


@pytest.fixture(scope="module")
def run() -> hil.Run:
    return hil.run("scheme-1", duration_s=0.1)


FUNCTIONS: list[tuple[Callable[[], Any], str]] = [
    (lambda: hil.run(), "run: scenario: is missing"),
    (lambda: hil.run("scheme-1", sed=3), "run: sed: unknown argument: did you mean seed? known here: scenario, rig"),
    (lambda: hil.run("scheme-1", overides={}), "run: overides: unknown argument: did you mean overrides?"),
    (lambda: hil.run(*["scheme-1"] * 20), "run: too many positional arguments"),
    (lambda: hil.run(None), "scenario: None: must be a name, a path or a Scenario object"),
    (lambda: hil.run("scheme-1", rig=4), "rig: 4: must be a name, a path or a Rig object"),
    (lambda: hil.run("scheme-1", seed="7"), "seed: '7': must be an integer, not negative"),
    (lambda: hil.run("scheme-1", seed=True), "seed: True: must be an integer, not negative"),
    (lambda: hil.run("scheme-1", duration_s=float("nan")), "duration_s: nan: must be a number above 0"),
    (lambda: hil.run("scheme-1", overrides=3), "overrides: 3: must be a dict"),
    (lambda: hil.run("scheme-1", overrides={3: 4}), "overrides: 3: keys must be dotted names"),
    (lambda: hil.run("scheme-1", overrides={"gnc.control.dead": 1}), "overrides: gnc.control.dead: unknown key: did y"),
    (lambda: hil.run("scheme-1", overrides={"duration_s": "a"}), 'overrides: duration_s: "a": must be a'),
    (lambda: hil.run("scheme-1", faults={"device": "vmu"}), "faults: {'device': 'vmu'}: must be a list of tables"),
    (lambda: hil.run("scheme-1", faults=[3]), "faults: [3]: must be a list of tables"),
    (lambda: hil.run("scheme-1", gnc=dict), "gnc: dict: must be an object with a method step(input)"),
    (lambda: hil.run("scheme-1", control=3), "control: int: must be a class or an object with a method step(inp)"),
    (lambda: hil.run("scheme-1", navigation="none.py:law"), "gnc.navigation.backend"),
    (lambda: hil.run("scheme-1", record=3), "record: 3: must be a path"),
    (lambda: hil.run("scheme-1", case=-1), "case: -1: must be an integer, not negative"),
    (lambda: hil.run("scheme-1", campaign="results"), "campaign: needs case"),
    (lambda: hil.run("scheme-1", case=0, dispersions=[1]), "dispersions: [1]: must be a path"),
    (lambda: hil.run("scheme-1", record="/proc/x"), "record: /proc/x: cannot record there"),
    (lambda: hil.run("scheme-1", control="none.py:Law"), 'control: gnc.control.backend: "none.py:Law": no such file'),
    (lambda: hil.kernel_backend(lambda *_: None), "kernel_backend: is a decorator with parentheses"),
    (lambda: hil.load_scenario(7), "name: 7: must be a name, a path or a Scenario object"),
    (lambda: hil.load_scenario("scheme-1", 7), "overrides: 7: must be a dict"),
    (lambda: hil.load_rig(b"mock"), "name: b'mock': must be a name, a path or a Rig object"),
    (lambda: hil.load_rig("lab"), "lab: unknown rig"),
    (lambda: hil.open(5), "path: 5: must be a path"),
    (lambda: hil.open(None), "path: None: must be a path"),
    (lambda: hil.open("."), ".: "),
    (lambda: hil.open("x.mcap", trust_code=1), "trust_code: 1: must be True or False"),
    (lambda: hil.campaign("scheme-1"), "runs: must be given, unless rare or sobol is"),
    (lambda: hil.campaign("scheme-1", "100"), "runs: '100': must be an integer, at least 1"),
    (lambda: hil.campaign("scheme-1", 1.0), "runs: 1.0: must be an integer, at least 1"),
    (lambda: hil.campaign("scheme-1", 1, workers=-1), "workers: -1: must be an integer, at least 0"),
    (lambda: hil.campaign("scheme-1", 1, out=5), "out: 5: must be a path"),
    (lambda: hil.campaign("scheme-1", 1, on_progress=5), "on_progress: 5: must be a function"),
    (lambda: hil.campaign("scheme-1", 1, scheduler=5), "scheduler: 5: must be a name"),
    (lambda: hil.campaign("scheme-1", 1, sweep="a"), "sweep: a: must look like gnc.control.deadband_m=0.002:0.02:10"),
    (lambda: hil.campaign("scheme-1", 1, against=5), "against: 5: must be a name, a path or a Scenario object"),
    (lambda: hil.campaign("scheme-1", rare="x"), "rare: x: must be an outcome, < or >, and a number"),
    (lambda: hil.campaign("scheme-1", 1, sobol=4), "sobol: not together with runs"),
    (lambda: hil.sweep("scheme-1", "gnc.control.deadband_m", ["a"], 1), "values: ['a']: must be a list of numbers"),
    (lambda: hil.sweep("scheme-1", "gnc.control.deadband_m", [], 1), "values: must be one number or more"),
    (lambda: hil.sweep("scheme-1", "gnc.control.deadband_m", 0.1, 1), "values: 0.1: must be a list of numbers"),
    (lambda: hil.sweep("scheme-1", "gnc.control.dead", [0.1], 1), "sweep: gnc.control.dead: unknown key"),
    (lambda: hil.sweep("scheme-1", 4, [0.1], 1), "key: 4: must be a name"),
    (lambda: hil.sweep("scheme-1", "gnc.control.deadband_m"), "sweep: values, runs: is missing"),
    (lambda: hil.rare_event("scheme-1", "mass > 3"), "rare: mass: no such outcome: give one of"),
    (lambda: hil.rare_event("scheme-1", 3), "event: 3: must be a name"),
    (lambda: hil.rare_event("scheme-1", "propellant_kg > 1", method="x"), "method: x: must be subset or importance"),
    (lambda: hil.sobol_indices("scheme-1", 0), "rows: 0: must be an integer, at least 1"),
    (lambda: hil.margins("scheme-1", runs=0), "runs: 0: must be an integer, at least 1"),
    (lambda: hil.margins("scheme-1", watch=3), "watch: 3: must be a function"),
    (lambda: hil.compare(3), "compare: second: is missing"),
    (lambda: hil.Bench("mock"), "Bench: scenario: is missing"),
    (lambda: hil.Bench("mock", "scheme-1", speed="x"), "speed: 'x': must be a number above 0"),
    (lambda: hil.VisionUnit(5), "geometry: 5: must be a VmuGeometry object, a name or a path"),
    (lambda: hil.DockingMonitor(5), "scene: 5: must be a Scene object, a name or a path"),
    (lambda: hil.Setting("gain"), "Setting: default: is missing"),
    (lambda: hil.Setting("gain", "1"), "default: '1': must be a number"),
    (lambda: hil.Component("range_m"), "Component: unit: is missing"),
    (lambda: hil.SensorError("bias", "range_m", "sigma_m"), "component: 'range_m': must be an integer"),
    (
        lambda: hil.RunRequirement("R-1", "near", "truth.r_CT_H[3]", at_most=1.0),
        "R-1: quantity: truth.r_CT_H[3]: must ",
    ),
    (lambda: hil.RunRequirement("R-1", "near", "truth.q", at_most=1.0), "R-1: quantity: truth.q: no such column"),
    (lambda: hil.RunRequirement("R-1", "near", 4, at_most=1.0), "R-1: quantity: 4: must be a column or a function"),
]

METHODS: list[tuple[Call, str]] = [
    (
        lambda run: run.plot("orbit"),
        'plot: name: \'orbit\': must be "ready", "trajectory", "errors", "attitude", "nees" or',
    ),
    (lambda run: run.plot(3), "plot: name: 3: must be "),
    (lambda run: run.nees(2.0), "probability: 2: must be above 0 and below 1"),
    (lambda run: run.report(5), "report: path: 5: must be a path"),
    (lambda run: run.report("none/run.html"), "none/run.html: cannot be written: no such folder"),
    (lambda run: run.to_parquet("none/x.parquet"), "none/x.parquet: cannot be written: No such file or directory"),
    (lambda run: run.nees().inside("r"), "inside: 'r': must be position or attitude"),
    (lambda run: run.report("run.pdf"), "run.pdf: must end in .html"),
    (lambda run: run.to_parquet(5), "to_parquet: path: 5: must be a path"),
    (lambda run: run.rows_of("images"), "rows_of: images: no such rows of a part, known are portions"),
    (lambda run: run.rows_of(5), "rows_of: name: 5: must be a name"),
    (lambda run: hil.compare(run, 4), "second: 4: must be a Run object or a Campaign object"),
    (lambda run: hil.DockingMonitor("atv").feed(3), "feed: frame: 3: must be a VideoFrame object or a numpy array"),
]


@pytest.mark.parametrize(("call", "text"), FUNCTIONS, ids=range(len(FUNCTIONS)))
def test_wrong_call_of_a_function_is_answered_by_one_line(
    call: Callable[[], Any], text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(hil.errors.BadInput) as raised:
        call()
    assert text in str(raised.value)
    assert "\n" not in str(raised.value)
    assert raised.value.__suppress_context__ or raised.value.__context__ is None or raised.value.__cause__ is not None
    assert not any(tmp_path.iterdir())


@pytest.mark.parametrize(("call", "text"), METHODS, ids=range(len(METHODS)))
def test_wrong_call_of_a_method_is_answered_by_one_line(call: Call, text: str, run: hil.Run) -> None:
    with pytest.raises(hil.errors.BadInput) as raised:
        call(run)
    assert text in str(raised.value)
    assert "\n" not in str(raised.value)


def test_numpy_numbers_and_paths_are_accepted(tmp_path: Path) -> None:
    run = hil.run("scheme-1", seed=np.int64(3), duration_s=np.float64(0.1), record=tmp_path / "runs")
    assert run.summary["seed"] == 3
    assert (tmp_path / "runs").is_dir()
