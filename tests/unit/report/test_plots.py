"""Plots of a run by name, its NEES, and the comparison of two runs."""

from __future__ import annotations

import inspect
from typing import Literal, get_args

import numpy as np
import pytest

import hil
from hil.report.consistency import nees_of
from hil.report.plots import PLOTS


@pytest.fixture(scope="module")
def run() -> hil.Run:
    return hil.run("scheme-1", duration_s=12.0)


def test_names_of_plots_are_those_of_the_method_and_of_its_documentation() -> None:
    annotation = inspect.signature(hil.Run.plot).parameters["name"].annotation
    assert set(get_args(eval(annotation, {"Literal": Literal}))) == set(PLOTS)
    text = hil.Run.plot.__doc__ or ""
    assert [name for name in PLOTS if f"``{name}``" not in text] == []


@pytest.mark.parametrize("name", PLOTS)
def test_each_plot_has_labels_and_data(name: str, run: hil.Run) -> None:
    figure = run.plot(name)  # type: ignore[arg-type]
    figure.canvas.draw()
    assert all(axes.has_data() for axes in figure.axes)
    assert {axes.get_xlabel() for axes in figure.axes} & {"time, s", "x in H, m"}
    assert any(axes.get_ylabel() for axes in figure.axes)


def test_trajectory_shows_the_corridor_about_the_reference(run: hil.Run) -> None:
    lines = {each.get_label(): each for each in run.plot("trajectory").axes[0].lines}
    off_m = lines["corridor"].get_ydata() - lines["reference"].get_ydata()
    margin_m = run.history["supervision"]["corridor_margin_m"]  # of an estimate that is nearly on the line
    assert np.nanmax(margin_m) == pytest.approx(off_m.max(), abs=0.02)


def test_run_without_a_nees_is_answered_by_one_line() -> None:
    blind = hil.run("scheme-1", duration_s=0.4, faults=[{"device": "vmu", "kind": "no_pose", "at_s": 0.0}])
    for call in (blind.nees, lambda: blind.plot("nees")):
        with pytest.raises(hil.errors.BadInput, match="has no NEES: no pose"):
            call()


def test_nees_has_its_bounds_at_each_pose(run: hil.Run) -> None:
    found = run.nees()
    assert len(found.t_s) == len(found.position) == np.isfinite(run.cycles.nees_position).sum() > 20
    assert found.position_bounds == pytest.approx((2.700, 19.023), abs=1e-3)
    assert found.attitude_bounds == pytest.approx((1.237, 14.449), abs=1e-3)
    assert 0.5 < found.inside("position") <= 1.0
    assert run.nees(0.999).position_bounds[1] > found.position_bounds[1]
    assert nees_of(run.history[:0], False).t_s.shape == (0,)


def test_verdict_is_shown_as_on_the_command_line(run: hil.Run, capsys: pytest.CaptureFixture[str]) -> None:
    run.show(explain=True)
    shown = capsys.readouterr().out
    assert "ok   security           corridor margin" in shown
    assert "Root mean square of the error" in shown
    assert "FAIL scheme-1 on mock, seed 0" in shown


def test_runs_and_recordings_are_compared_alike(run: hil.Run, tmp_path) -> None:  # type: ignore[no-untyped-def]
    same = hil.compare(run, hil.run("scheme-1", duration_s=12.0))
    assert {each.largest for each in same.divergences} == {0.0}
    assert "the truths are identical" in repr(same)
    lighter = hil.compare(run, hil.run("scheme-1", duration_s=0.1, overrides={"chaser.mass_kg": 900.0}))
    assert lighter.settings == {"chaser.mass_kg": (1000.0, 900.0)}
    assert "chaser.mass_kg 900.0 for 1000.0" in repr(lighter)
    other = hil.run("scheme-1", seed=1, duration_s=12.0, record=tmp_path)
    found = hil.compare(run, hil.open(next(tmp_path.glob("*.mcap"))))
    assert len(found.divergences) == 9
    assert max(each.largest for each in found.divergences) > 0.0
    assert found.to_pandas().index[0] == "position x"
    assert found.numbers["verdict"] == ("fail", "fail")
    assert found.plot().axes[0].has_data()
    assert "seed 1" in repr(found)
    assert other.summary["seed"] == 1
    assert hil.compare(run, hil.run("scheme-2", duration_s=0.1)).divergences == []
