"""Cases on a GPU: in numba's simulator bit for bit those of the CPU; what is missing is one line."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

import hil
from hil.cli.main import execute
from hil.config.load import Loaded
from hil.config.scenario import Scenario
from hil.errors import BadInput, CampaignStopped
from hil.monte_carlo import cuda_engine
from hil.monte_carlo.cuda_engine import BOUND, compare_rows
from hil.monte_carlo.engines import LocalEngine
from hil.monte_carlo.outcome import NUMERIC, failed_row
from tests.support.cuda_simulator import run_simulated

SETTINGS = (
    'faults=[{at_s = 2.0, device = "rails.x", kind = "stuck"}]',
    "vmu.latency_jitter_s=0.2",
    "rig.bench.axes_rate_hz=250",
)


def test_cases_on_a_gpu_have_the_bits_of_the_cpu() -> None:
    found = run_simulated("scheme-1", SETTINGS, 2.5)
    gpu, cpu = found["gpu"], found["cpu"]
    assert [row["case"] for row in gpu] == [0, 1, 2, 3]
    assert [gpu[0], *gpu[2:]] == [cpu[0], *cpu[2:]]
    assert gpu[1]["stop"] == "not flown: ValueError: as if it could not be drawn"
    assert all(gpu[i]["stop"].startswith("rails.x: distance from the demand") for i in (0, 2, 3))
    assert found["summary"]["engine"]["agreement"]["largest_difference"] == 0.0


@pytest.mark.parametrize("name", ["ready_time_s", "firings", "passed"])
def test_campaign_stops_if_the_gpu_differs_from_the_cpu(name: str) -> None:
    cpu = {"case": 0, **failed_row("x"), "ready_time_s": 200.0, "propellant_kg": 0.1}
    close = cpu | {"ready_time_s": 200.0 * (1.0 + 0.5 * BOUND)}
    assert compare_rows([close], [cpu]) == {
        "cases": 1, "largest_difference": pytest.approx(0.5 * BOUND), "outcome": "ready_time_s", "bound": BOUND,
    }  # fmt: skip
    assert name in NUMERIC
    with pytest.raises(CampaignStopped, match=f"case 0: {name} is"):
        compare_rows([cpu | {name: cpu[name] + 1}], [cpu])
    with pytest.raises(CampaignStopped, match=name):
        compare_rows([cpu | {name: None}], [cpu])


def test_missing_package_or_gpu_is_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def line(*options: str) -> str:
        assert execute(["campaign", "scheme-1", "--runs", "3", "--out", str(tmp_path / "out"), *options]) == 2
        assert not (tmp_path / "out").exists()
        text = capsys.readouterr().err.strip()
        assert "\n" not in text
        return text

    monkeypatch.setattr(cuda_engine, "_is_installed", lambda: False)
    assert "--engine: cuda: needs numba-cuda" in line("--engine", "cuda")
    monkeypatch.setattr(cuda_engine, "_is_installed", lambda: True)
    monkeypatch.setattr("numba.cuda.is_available", lambda: False)
    assert "--engine: cuda: no GPU" in line("--engine", "cuda")
    assert "monitor: modules of sensors do not run" in line("--engine", "cuda", "--set", "monitor.source=model")
    assert "must be one of cpu, cuda" in line("--engine", "opencl")
    assert "not together with --scheduler" in line("--engine", "cuda", "--scheduler", "tcp://host:1")
    rare = ("--rare", "position_m_x > 0.01", "--method", "importance", "--runs", "400")
    assert execute(["campaign", "scheme-1", *rare, "--out", str(tmp_path / "out"), "--engine", "cuda"]) == 2
    assert "--method importance" in capsys.readouterr().err
    with pytest.raises(BadInput, match=r"^engine: cuda: no GPU that can be used"):
        hil.campaign("scheme-1", runs=3, out=tmp_path / "out", engine="cuda")
    assert not (tmp_path / "out").exists()


def test_campaign_in_python_takes_the_engine_and_does_not_mix_its_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class OnCpu(LocalEngine):
        """In place of a GPU."""

        def __init__(self, threads: int, scenarios: Sequence[Loaded[Scenario]]) -> None:
            assert [each.value.name for each in scenarios] == ["scheme-1"]
            super().__init__(threads)

        def summary(self) -> dict[str, Any]:
            return {"engine": {"name": "cuda"}}

    monkeypatch.setattr(cuda_engine, "CudaEngine", OnCpu)
    out = tmp_path / "out"
    found = hil.campaign("scheme-1", runs=1, out=out, duration_s=2.0, workers=1, engine="cuda")
    assert found.summary["engine"] == {"name": "cuda"}
    assert len(hil.campaign("scheme-1", runs=2, out=out, duration_s=2.0, workers=1, engine="cuda").cases) == 2
    with pytest.raises(BadInput, match=r'another campaign \(engine "cuda"; asked for: no engine\)'):
        hil.campaign("scheme-1", runs=2, out=out, duration_s=2.0, workers=1)
