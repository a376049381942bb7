"""Check of an external GNC: the example passes, each fault that is put into it is found and named."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_scenario
from hil.errors import BadInput
from hil.gnc_backends.shared_library import LibraryBackend
from hil.parts.links.gnc_check.check import Report, check_gnc
from hil.parts.links.gnc_check.gnc_under_test import LibraryUnderTest, ProgramUnderTest, check_link
from tests.support.external_gnc import C_EXAMPLE, PYTHON_EXAMPLE, c_example, compile_c

SCALAR_FIRST = (
    "    gnc_state *g = gnc; => "
    "    gnc_state *g = gnc; hil_gnc_input other = *input; for (int k = 0; k < 4; k++) { "
    "other.reference_q_CH[k] = input->reference_q_CH[(k + 1) % 4]; "
    "for (int p = 0; p < 4; p++) other.poses[p].q_CH[k] = input->poses[p].q_CH[(k + 1) % 4]; } input = &other;"
)
MILLIMETRES = "for (int i = 0; i < 3; i++) output->r_CT_H_m[i] = 1e3 * g->r[i];"
FAULTS = {
    "sign": ("control(g, input, output); => control(g, input, output); output->force[1] = -output->force[1];",),
    "degrees": ("1, phi[i], g->w[i], 0.0 => 1, 57.29578 * phi[i], 57.29578 * g->w[i], 0.0",),
    "radians": ("1, phi[i], g->w[i], 0.0 => 1, phi[i] / 57.29578, g->w[i] / 57.29578, 0.0",),
    "scalar first": (SCALAR_FIRST,),
    "hold": ("memset(g->firing, 0, sizeof g->firing); => output->torque[2] = 1;",),
    "millimetres": (f"memcpy(output->r_CT_H_m, g->r, sizeof g->r); => {MILLIMETRES}",),
    "gyro": ("in->rate_radps[i] - => 0.0174533 * in->rate_radps[i] -",),
}
WORDS = {
    "sign": ("sign", "the force drives an offset along y on instead of opposing it"),
    "degrees": ("size", "57 times too much"),
    "radians": ("size", "57 times too little"),
    "scalar first": ("misread", "reads quaternions with the scalar first"),
    "hold": ("quiet", "fires in HOLD"),
    "millimetres": ("estimate", "position in millimetres"),
    "gyro": ("estimate", "the gyro read as degrees per second"),
}


def check(library: Path, slower_s: float = 0.0) -> Report:
    partner = _Slower(library, slower_s)
    try:
        return check_gnc(partner, load_scenario("scheme-1").value)
    finally:
        partner.close()


class _Slower(LibraryUnderTest):
    """A library whose replies take longer."""

    def __init__(self, library: Path, slower_s: float) -> None:
        super().__init__(LibraryBackend(str(library), "gnc", lambda what: BadInput.single("test", "", what)))
        self._slower_s = slower_s

    def ask(self, told: np.record) -> tuple[np.record, float]:
        output, took_s = super().ask(told)
        return output, took_s + self._slower_s


def faults(report: Report) -> list[tuple[str, str]]:
    return [(found.check, found.text) for found in report.findings if not found.passed and found.check != "time"]


def test_example_passes_and_its_estimate_is_that_of_the_sequence(tmp_path: Path) -> None:
    report = check(c_example(tmp_path))
    assert faults(report) == []
    assert report.estimate["position_m"] < 0.01
    assert {"answers", "time", "quiet", "delay", "sign", "size", "motion", "poses", "abort", "estimate"} == {
        found.check for found in report.findings
    }


_EVERY_TIME = ("scalar first",)


@pytest.mark.parametrize(
    "fault", [pytest.param(name, marks=() if name in _EVERY_TIME else pytest.mark.slow) for name in FAULTS]
)
def test_fault_is_found_and_named(tmp_path: Path, fault: str) -> None:
    report = check(c_example(tmp_path, "broken.so", *FAULTS[fault]))
    name, words = WORDS[fault]
    assert any(name == found and words in text for found, text in faults(report)), faults(report)


def test_late_answers_are_named_and_end_the_check(tmp_path: Path) -> None:
    report = check(c_example(tmp_path), slower_s=0.025)
    (late,) = [found.text for found in report.findings if found.check == "time"]
    assert late.startswith("answers come late: p50 25")
    assert not report.passed


def test_command_writes_its_findings_and_reports_them_by_its_exit_code(tmp_path: Path) -> None:
    fires_in_hold, numbers = c_example(tmp_path, "broken.so", *FAULTS["hold"]), tmp_path / "check.json"
    assert execute(["gnc", "check", str(fires_in_hold), "--json", str(numbers)]) == 1
    found = json.loads(numbers.read_text())
    assert found["answers"]["count"] > 10_000
    assert [each["text"] for each in found["findings"] if not each["passed"] and each["check"] != "time"] == [
        "fires in HOLD: thrusters open in RUNNING alone"
    ]


@pytest.mark.slow
@pytest.mark.parametrize("language", ["c", "python"])
def test_programs_pass_over_udp(tmp_path: Path, language: str) -> None:
    link = check_link(("127.0.0.1", 0), None)
    if language == "c":
        sources = [C_EXAMPLE / "gnc_udp.c", C_EXAMPLE / "gnc.c"]
        command = [str(compile_c(sources, tmp_path / "gnc_udp"))]
    else:
        command = [sys.executable, str(PYTHON_EXAMPLE)]
    with subprocess.Popen([*command, "127.0.0.1", str(link.address[1])]) as program:
        partner = ProgramUnderTest(link, 20.0)
        try:
            report = check_gnc(partner, load_scenario("scheme-1").value)
        finally:
            partner.close()
        assert program.wait(5.0) == 0
    assert faults(report) == []


def test_missing_server_and_nothing_to_check_are_reported_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["gnc", "check", "127.0.0.1:0", "--wait", "0.2"]) == 3
    assert "none has answered" in capsys.readouterr().err.splitlines()[-1]
    assert execute(["gnc", "check", "mygnc"]) == 2
    assert "give a shared library (*.so), an FMU (*.fmu) or HOST:PORT" in capsys.readouterr().err
