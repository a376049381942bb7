"""Thrusters are numbered from 1 in whatever a person reads: pages, figures, bags, names of faults, messages."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

import hil
from hil.config.load import load_scenario
from hil.core.gnc_records import OUTPUTS
from hil.core.messages import CYCLE
from hil.drivers.io import codec
from hil.gnc import backend_outputs
from hil.gnc_backends.output_texts import fault_text
from hil.parts.export.ros2 import _cycle
from hil.report.figures import firings
from hil.report.page import _numbers
from hil.report.results import RunResults

N = 16


@pytest.fixture(scope="module")
def run() -> hil.Run:
    """Return a run in which thruster 3 alone has failed."""
    fault = {"device": "thruster.3", "kind": "stuck_closed", "at_s": 0.0}
    return hil.run("scheme-1", duration_s=2.0, faults=[fault])


def test_report_has_a_row_for_each_thruster_from_one(run: hil.Run) -> None:
    results = RunResults.of(run.summary)
    results.thrusters.thruster_firings = list(range(100, 100 + N))
    page = "".join(_numbers(results))
    rows = re.findall(r"<tr><td[^>]*>(\d+)</td><td[^>]*>(1\d\d)</td>", page)
    assert rows == [(str(1 + i), str(100 + i)) for i in range(N)]


def test_raster_of_firings_has_thruster_one_at_one(run: hil.Run) -> None:
    rows = np.zeros(4, CYCLE)
    rows["t_s"], rows["command"]["on"][:, 2] = 0.02 * np.arange(4), 1
    raster = firings(rows, run.scenario).axes[0]
    assert raster.get_yticks().tolist() == list(range(1, N + 1))
    (drawn,) = [bars for bars in raster.collections if bars.get_paths()]
    assert np.mean(drawn.get_paths()[0].get_extents().intervaly) == pytest.approx(3.0)


def test_messages_of_ros_name_the_thrusters_of_the_vehicle(run: hil.Run) -> None:
    values = dict(_cycle(run.history[-1], 0, 0, N))
    assert values["/thrusters"][1] == [f"thruster_{number}" for number in range(1, N + 1)]


def test_faults_events_and_messages_have_the_same_numbers(run: hil.Run) -> None:
    assert [fault["device"] for fault in run.summary["injected"]] == ["thruster.3"]
    with pytest.raises(hil.errors.BadInput, match=rf"the chaser has thruster\.1 to thruster\.{N}"):
        hil.run("scheme-1", faults=[{"device": "thruster.17", "kind": "stuck_closed", "at_s": 0.0}])
    out = np.zeros(1, OUTPUTS["control"])[0]
    assert fault_text(out, backend_outputs.THRUSTER, 2, N, 0).startswith("thruster 3 is ")
    assert "thruster {n + 1}" in Path(codec.__file__).read_text(encoding="utf-8")


def test_page_of_the_console_numbers_its_rows_from_one() -> None:
    chart = (Path(hil.__file__).parent / "parts" / "console" / "page" / "chart.js").read_text(encoding="utf-8")
    assert "c.fillText(String(i + 1), box.left - 3" in chart


def test_records_have_the_thrusters_of_the_vehicle_and_no_more(run: hil.Run) -> None:
    assert run.command.on.shape == run.truth.thrust_fraction.shape == run.truth.open_s.shape == (len(run.t_s), N)
    assert len(run.summary["thrusters"]["thruster_firings"]) == N
    assert run.history["command"]["on"].shape[1] == 24
    assert len(load_scenario("scheme-1").value.chaser.thrusters.position_m) == N


def test_columns_have_one_name_in_frames_and_tables(run: hil.Run, tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    run.to_parquet(tmp_path / "run.parquet")
    names = pq.read_schema(tmp_path / "run.parquet").names
    assert names == ["t_s", *run.to_pandas().columns] == run.to_polars().columns
    assert {"truth.r_CT_H[0]", "truth.q_CH[3]", "command.on[15]"} <= set(names)
    assert "command.on[16]" not in names


def test_earlier_names_of_columns_are_read() -> None:
    from hil.recording.schema import present_column

    names = {"truth.r_CT_H.x": "truth.r_CT_H[0]", "truth.q_CH.q0": "truth.q_CH[3]", "command.on.5": "command.on[5]",
             "pose.covariance_position.0.2": "pose.covariance_position[0][2]", "t_s": "t_s",
             "truth.r_CT_H[1]": "truth.r_CT_H[1]"}  # fmt: skip
    assert {name: present_column(name) for name in names} == names
    hil.RunRequirement("R-1", "near", "|truth.r_CT_H.y|", at_most=1.0)
