"""``import hil``: the public names, imported when first used, and typed for mypy in strict mode."""

from __future__ import annotations

import json
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import hil
from hil.config.load import load_scenario

SCRIPT = """
import numpy as np

import hil


class Coasts:
    def step(self, gnc_input: object) -> None:
        return None


def ready(deadband_m: float) -> float | None:
    run = hil.run("scheme-1", overrides={"gnc.control.deadband_m": deadband_m}, gnc=Coasts())
    r_CT_H: np.ndarray = run.truth.r_CT_H
    rate: float = hil.campaign("scheme-1", runs=10).pass_rate["rate"]
    same: bool = hil.open("run.mcap").replay().identical
    with hil.Bench("mock", hil.load_scenario("scheme-1")) as bench:
        bench.arm()
        passed: bool = bench.start(until="ready").passed
    print(r_CT_H, rate, same, passed, hil.__version__, hil.errors.BadInput)
    hil.run(3)
    return run.ready_time_s
"""
"""A script of a user with one error: the last call."""


def test_names_are_imported_when_first_used() -> None:
    code = "import sys, hil; assert not [m for m in sys.modules if m.startswith(('hil.', 'numpy', 'dataclasses'))]"
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("name", [name for name in hil.__all__ if name != "__version__"])
def test_each_public_name_is_there_and_documented(name: str) -> None:
    assert getattr(hil, name).__doc__
    assert name in dir(hil)


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        hil.no_such_name  # noqa: B018


def test_importing_a_subpackage_hides_no_public_name() -> None:
    code = "import hil.parts.campaigns.store, hil, hil.cli.run; assert callable(hil.campaign) and callable(hil.run)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_scripts_of_users_pass_mypy_in_strict_mode(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    root = Path(hil.__file__).parents[1]
    assert tomllib.loads((root / "pyproject.toml").read_text())["tool"]["mypy"]["strict"]  # its options: one cache
    command = [sys.executable, "-m", "mypy", "--config-file", str(root / "pyproject.toml"), str(script)]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, check=False)
    errors = [line for line in done.stdout.splitlines() if "error:" in line]
    assert len(errors) == 1, done.stdout
    assert 'Argument 1 to "run" has incompatible type "int"' in errors[0]


@pytest.mark.parametrize(
    "overrides",
    [
        {"gnc.control.deadband_m": 0.004, "truth.mass_loss": False, "name": 'a b = "c" #', "duration_s": 30},
        {"gnc": {"control": {"deadband_m": 0.004}}, "truth": {"mass_loss": False}, "name": "ü"},
        {"initial.position_m": (0.7, -0.03, 0.03), "initial": {"attitude_deg": [0.0, 1, 2.5]}},
    ],
)
def test_overrides_are_the_settings_of_the_command_line(overrides: dict[str, object]) -> None:
    from hil.api.jobs import settings_of

    expected = load_scenario("scheme-1", settings_of(overrides)).value
    assert hil.load_scenario("scheme-1", overrides) == expected
    assert hil.load_scenario(hil.load_scenario("scheme-1"), overrides) == expected
    for key, value in overrides.items():
        if "." in key:
            found: object = expected
            for part in key.split("."):
                found = getattr(found, part)
            assert json.dumps(found) == json.dumps(value)


def test_rig_objects_take_overrides_of_the_rig_only() -> None:
    rig = hil.load_rig(hil.load_rig("mock"), {"rig.vmu.timeout_s": 0.7, "duration_s": 3.0})
    assert rig.vmu.timeout_s == 0.7


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (lambda: hil.run("scheme-9"), "scheme-9: unknown scenario"),
        (lambda: hil.run(3), "scenario: 3: must be a name, a path or a Scenario object"),
        (lambda: hil.run("scheme-1", rig=None), "rig: None: must be a name"),
        (lambda: hil.run("scheme-1", seed=-1), "seed: -1: must be an integer, not negative"),
        (lambda: hil.run("scheme-1", seed=1.5), "seed: 1.5: must be an integer"),
        (lambda: hil.run("scheme-1", duration_s=0), "duration_s: 0: must be a number above 0"),
        (lambda: hil.run("scheme-1", duration_s="3"), "duration_s: '3': must be a number above 0"),
        (
            lambda: hil.run("scheme-1", overrides={"gnc.control.deadband": 1}),
            "overrides: gnc.control.deadband: unknown key: the unit is part of the name, here it is deadband_deg or "
            "deadband_m",
        ),
        (lambda: hil.run("scheme-1", overrides={"duration_s": object()}), "overrides: duration_s: <object"),
        (lambda: hil.run("scheme-1", overrides={"duration_s": [object()]}), "overrides: duration_s: <object"),
        (lambda: hil.run("scheme-1", overrides=["duration_s=3"]), "overrides: ['duration_s=3']: must be a dict"),
        (lambda: hil.run("scheme-1", overrides={"a=b": 1}), "overrides: a=b: keys must be dotted names"),
        (lambda: hil.run("scheme-1", faults=[{"at_s": 3.0, "device": "vmu"}]), "faults: faults[0].kind: is missing"),
        (lambda: hil.run("scheme-1", faults="vmu"), "faults: 'vmu': must be a list of tables"),
        (lambda: hil.run("scheme-1", gnc=3), "gnc: int: must be an object with a method step(input)"),
        (lambda: hil.open("nothing.mcap"), "nothing.mcap: cannot be read: No such file"),
        (lambda: hil.campaign("scheme-1", runs=0), "runs: 0: must be an integer, at least 1"),
        (lambda: hil.VisionUnit("nothing.toml"), "nothing.toml"),
        (lambda: hil.DockingMonitor("nothing"), "nothing: unknown scene"),
        (lambda: hil.Bench("mock", "scheme-1", speed=0.0), "speed: 0.0: must be a number above 0"),
    ],
)
def test_bad_arguments_get_one_clear_line(call, text: str) -> None:
    with pytest.raises(hil.errors.BadInput) as caught:
        call()
    assert str(caught.value).startswith(text)
    assert "\n" not in str(caught.value)


def test_an_invalid_copy_of_a_scenario_is_refused() -> None:
    scenario = hil.load_scenario("scheme-1")
    with pytest.raises(hil.errors.BadInput, match="Scenario object: step_s: "):
        hil.run(scenario.model_copy(update={"step_s": -1.0}))


@pytest.mark.parametrize(
    ("package", "extra", "call"),
    [
        ("pyarrow", "campaign", lambda: hil.campaign("scheme-1", runs=1)),
        ("distributed", "campaign", lambda: hil.campaign("scheme-1", runs=1, scheduler="tcp://127.0.0.1:1")),
    ],
)
def test_a_package_of_an_extra_that_is_missing_is_named_with_the_extra(monkeypatch, package, extra, call) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(hil.errors.BadInput) as caught:
        call()
    assert str(caught.value) == f"campaign: needs {package}, which is not installed: pip install 'hil-bench[{extra}]'"


def test_name_that_the_package_does_not_have_is_answered_by_the_nearest_or_by_all_functions() -> None:
    with pytest.raises(AttributeError, match=r"'Campain': did you mean Campaign\?"):
        _ = hil.Campain
    with pytest.raises(AttributeError, match=r"'simulate': it has campaign, compare, .* run, "):
        _ = hil.simulate
