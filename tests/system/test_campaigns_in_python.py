"""Comparisons, sweeps and tables of other libraries, in scripts as a user writes them."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hil
from hil.errors import BadInput
from hil.parts.campaigns.batch import Case, Spec
from tests.support.backends import kernel_file

pytestmark = pytest.mark.xdist_group("campaign")
SHORT: dict[str, Any] = {"duration_s": 2.0, "workers": 1}


def test_two_campaigns_are_compared_case_by_case(tmp_path: Path) -> None:
    found = hil.campaign("scheme-1", 6, tmp_path / "c", against="scheme-2", **SHORT)
    again = hil.compare(found.first, found.second)
    assert again.summary == found.summary
    difference = found.second.column("propellant_kg") - found.first.column("propellant_kg")
    assert found.difference["propellant_kg"]["mean"] == pytest.approx(np.mean(difference))
    assert "Paired differences" in (tmp_path / "c" / "report.html").read_text()


def test_repr_of_a_comparison_names_the_settings_that_differ() -> None:
    first, second = (hil.campaign("scheme-1", 2, overrides={"chaser.mass_kg": kg}, **SHORT) for kg in (1e3, 900.0))
    assert "scheme-1 against scheme-1 (chaser.mass_kg 900.0 for 1000.0)" in repr(hil.compare(first, second))
    assert "(" not in repr(hil.compare(first, first))


def test_campaigns_of_other_cases_are_not_compared() -> None:
    shown: list[float] = []
    few, many = (
        hil.campaign("scheme-1", runs, **SHORT, on_progress=lambda _, part: shown.append(part)) for runs in (2, 3)
    )
    assert shown[0] == 0.0
    assert shown[-1] == 1.0
    with pytest.raises(BadInput, match="same seed and number of cases"):
        hil.compare(few, many)


def test_finished_campaign_is_opened_again_and_names_the_command_of_a_case_with_all_settings(tmp_path: Path) -> None:
    settings = {"dispersions": "stress", "gnc.control.deadband_m": 0.02}
    flown = hil.campaign("scheme-1", 3, tmp_path / "c", overrides=settings, **SHORT)
    opened = hil.open_campaign(tmp_path / "c")
    assert opened.cases.equals(flown.cases)
    assert opened.summary["why"] == flown.summary["why"]
    command = opened.why(2)["command"].replace(str(tmp_path / "c"), "DIR")
    options = "--rig mock --set 'dispersions=\"stress\"' --set gnc.control.deadband_m=0.02 --campaign DIR --case 2"
    assert command == f"hil run scheme-1 {options}"
    assert "gnc.control.deadband_m=0.02" in (tmp_path / "c" / "report.html").read_text()
    with pytest.raises(BadInput, match=r"given .*deadband_m=0.02.*asked for: given .*\[\]\}\), give a new folder"):
        hil.campaign("scheme-1", 3, tmp_path / "c", **SHORT)
    manifest = tmp_path / "c" / "campaign.json"
    for damaged in (3, {}, {"scenario": "scheme-1", "rig": "mock", "settings": [3]}):
        manifest.write_text(json.dumps(json.loads(manifest.read_text()) | {"given": damaged}))
        with pytest.raises(BadInput, match=r"hil.campaign with the same arguments returns its results"):
            hil.open_campaign(tmp_path / "c")
    with pytest.raises(BadInput, match=r"is the folder of a campaign: hil.open_campaign opens it"):
        hil.open(tmp_path / "c")


def test_folder_of_a_campaign_names_no_code_that_is_loaded(tmp_path: Path) -> None:
    law = kernel_file(tmp_path, "out.force[0] = 0.0")
    settings = {"gnc.control.backend": law}
    hil.campaign("scheme-1", 1, tmp_path / "c", overrides=settings, **SHORT)
    with pytest.raises(BadInput, match="which may be code: trust_code=True if you trust it"):
        hil.open_campaign(tmp_path / "c")
    assert len(hil.open_campaign(tmp_path / "c", trust_code=True).cases) == 1


def test_sweep_has_a_campaign_for_each_value(tmp_path: Path) -> None:
    found = hil.sweep("scheme-1", "gnc.control.deadband_m", [0.004, 0.008], 3, tmp_path / "s", **SHORT)
    assert found.values == (0.004, 0.008)
    assert [len(each.cases) for each in found.campaigns] == [3, 3]
    assert [point["value"] for point in found.summary["points"]] == [0.004, 0.008]
    assert "Sweep of gnc.control.deadband_m" in (tmp_path / "s" / "report.html").read_text()
    same = hil.campaign("scheme-1", 3, sweep="gnc.control.deadband_m=0.004:0.008:2", **SHORT)
    assert same.summary == found.summary


def test_law_that_is_edited_flies_in_the_next_campaign_of_the_same_process(tmp_path: Path) -> None:
    def firings(force: str) -> float:
        law = kernel_file(tmp_path, f"out.force[0] = {force}")
        overrides = {"gnc.control.backend": law}
        return float(hil.campaign("scheme-1", 2, overrides=overrides, **SHORT).column("firings").sum())

    assert firings("0.0") == 0.0
    assert firings("1.0") > 0.0


def test_worker_with_other_files_flies_no_case(tmp_path: Path) -> None:
    law = kernel_file(tmp_path, "out.force[0] = 0.0")
    scenario = hil.load_scenario("scheme-1", {"gnc.control.backend": law})
    spec = Spec.of(scenario, hil.load_rig("mock"), 0, 1.0)
    kernel_file(tmp_path, "out.force[0] = 1.0")
    with pytest.raises(BadInput, match="files of GNC or sensors have changed since the campaign was begun"):
        Case(spec)


def test_case_of_a_campaign_is_flown_again_and_explained(tmp_path: Path) -> None:
    campaign = hil.campaign("scheme-1", 3, tmp_path / "c", dispersions="stress", **SHORT)
    run = hil.run("scheme-1", case=2, dispersions="stress", duration_s=2.0)
    assert run.summary["first_violated"] == campaign.column("first_violated")[2] != ""
    assert run.why()["text"].startswith("the ")
    assert campaign.why(2)["first_violated"]["_s"] == pytest.approx(run.summary["first_violated_s"])


def test_studies_take_the_dispersions_and_the_duration_of_a_campaign(tmp_path: Path) -> None:
    noise = tmp_path / "noise.toml"
    noise.write_text(
        'name = "noise"\nvmu.sigma_position_m = { kind = "uniform", low = 0.5, high = 3.0, relative = true }'
    )
    found = hil.sobol_indices("scheme-1", 10, dispersions=noise, **SHORT)
    assert {row["dispersion"] for row in found.summary["sobol"]["propellant_kg"]} == {"vmu.sigma_position_m", "noise"}
    with pytest.raises(BadInput, match="unknown dispersion set"):
        hil.rare_event("scheme-1", "firings > 1000", dispersions="none-such", **SHORT)


def test_one_study_at_a_time() -> None:
    with pytest.raises(BadInput, match="not together"):
        hil.campaign("scheme-1", 2, sobol=20, sweep="gnc.control.deadband_m=0.004:0.008:2")


@pytest.mark.parametrize("library", ["pandas", "polars", "xarray"])
def test_library_that_is_not_installed_is_bad_input(library: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, library, None)
    run = hil.run("scheme-1", duration_s=0.1)
    with pytest.raises(BadInput, match=f"pip install {library}"):
        getattr(run, f"to_{library}")()


def test_run_is_a_table_of_pandas() -> None:
    pytest.importorskip("pandas")
    run = hil.run("scheme-1", duration_s=1.0)
    table = run.to_pandas()
    np.testing.assert_array_equal(table["truth.r_CT_H[0]"], run.truth.r_CT_H[:, 0])
    np.testing.assert_array_equal(table["navigation.q_CH.q0"], run.navigation.q_CH[:, 3])  # an earlier name
    assert list(table[["truth.r_CT_H.x", "command.on.2"]].columns) == ["truth.r_CT_H[0]", "command.on[2]"]
    assert pickle.loads(pickle.dumps(table[table.index > 0.5]))["truth.r_CT_H.z"].shape == (25,)
    with pytest.raises(KeyError, match=r"truth\.r_CT_H\.w"):
        table["truth.r_CT_H.w"]
    np.testing.assert_array_equal(table.index, run.t_s)
    assert table.attrs["units"]["truth.r_CT_H[0]"] == table.attrs["units"]["truth.r_CT_H.x"] == "m"
    assert hil.campaign("scheme-1", 2, **SHORT).to_pandas().index.tolist() == [0, 1]


def test_run_is_a_table_of_polars() -> None:
    pytest.importorskip("polars")
    run = hil.run("scheme-1", duration_s=1.0)
    np.testing.assert_array_equal(run.to_polars()["navigation.q_CH[3]"].to_numpy(), run.navigation.q_CH[:, 3])
    assert hil.campaign("scheme-1", 2, **SHORT).to_polars().height == 2


def test_run_is_a_dataset_of_xarray() -> None:
    pytest.importorskip("xarray")
    run = hil.run("scheme-1", duration_s=1.0)
    data = run.to_xarray()
    np.testing.assert_array_equal(data.truth_r_CT_H.sel(axis="y"), run.truth.r_CT_H[:, 1])
    assert data.truth_r_CT_H.attrs["units"] == "m"
    assert data.truth_r_CT_H.attrs["frame"] == "H"
