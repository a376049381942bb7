"""A GNC as an FMU: the bits of the library, by name and by a mapping file; refused, stopped, contained."""

from __future__ import annotations

import gc
import json
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.core.messages import CYCLE
from hil.gnc_backends.library import open_library
from hil.loop.runner import COMPLETED
from hil.parts.campaigns.case_runner import CaseRunner
from hil.parts.fmi.archive import DESCRIPTION
from hil.parts.links.gnc_check.check import check_gnc
from hil.parts.links.gnc_check.gnc_under_test import LibraryUnderTest
from hil.session import build
from tests.support.external_gnc import MEASURED, USES_ALL, c_example
from tests.support.fmu import BINARY, described, example_fmu, repacked
from tests.support.run_settings import make_job
from tests.system.test_own_gnc import LATE

pytestmark = pytest.mark.xdist_group("campaign")

STEP = "    gnc_state *g = gnc;"
RUNNING = "if (input->mode == HIL_GNC_RUNNING && input->cycle == 50)"


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return c_example(tmp_path_factory.mktemp("library"))


@pytest.fixture(scope="module")
def fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return example_fmu(tmp_path_factory.mktemp("fmu"))


def history(scheme: str, duration_s: float, *settings: str) -> tuple[bytes, str]:
    """Return all rows of a run, and why it ended."""
    scenario, rig = load_scenario(scheme, settings).value, load_rig("mock", settings).value
    runner = CaseRunner(scenario, rig, duration_s or scenario.duration_s)
    rows = np.zeros(runner.cycles, CYCLE)
    runner.run(scenario, 4)  # an earlier case leaves no trace
    stats, stop = runner.run(scenario, 3, rows)
    return rows[: stats.cycles].tobytes(), stop


@pytest.mark.parametrize("measured", [(), MEASURED], ids=["poses", "all that is measured"])
@pytest.mark.parametrize("version", [2, 3])
def test_fmu_has_the_bits_of_the_library(tmp_path: Path, version: int, measured: tuple[str, ...]) -> None:
    change = (USES_ALL,) if measured else ()
    made, library = example_fmu(tmp_path, version, *change), c_example(tmp_path, "mygnc.so", *change)
    expected = history("scheme-1", 20.0, f"gnc.library={library}", *LATE, *measured)
    found = history("scheme-1", 20.0, f"gnc.fmu={made}", *LATE, *measured)
    assert found == expected
    assert found[1] == COMPLETED


@pytest.mark.slow
@pytest.mark.parametrize("version", [2, 3])
@pytest.mark.parametrize("scheme", ["scheme-1", "scheme-2"])
def test_fmu_has_the_bits_of_the_library_over_a_scheme(
    library: Path, tmp_path: Path, scheme: str, version: int
) -> None:
    made = example_fmu(tmp_path, version)
    found = history(scheme, 0.0, f"gnc.fmu={made}")
    assert found == history(scheme, 0.0, f"gnc.library={library}")
    numbers = {}
    for key, path in (("library", library), ("fmu", made)):
        out = tmp_path / f"{key}.json"
        assert execute(["run", scheme, "--set", f"gnc.{key}={path}", "--json", str(out)]) in (0, 1)
        numbers[key] = json.loads(out.read_text())
    for key in ("passed", "ready_phase", "navigation", "thrusters"):
        assert numbers["fmu"][key] == numbers["library"][key]


def test_cycle_in_python_steps_the_fmu_as_the_compiled_loop_does(fmu: Path) -> None:
    scenario = f"gnc.fmu={fmu}"
    job = make_job(5.0, (scenario,), seed=3)
    build.check(job)
    with build.runner(replace(job, compiled=False)) as runner:
        outcome = runner.run().history
    compiled = np.frombuffer(history("scheme-1", 5.0, scenario)[0], CYCLE)
    for name in ("truth", "navigation", "command"):
        assert outcome[name].tobytes() == compiled[name].tobytes()


MAPPING = """
[inputs]
reference_q_CH = {variables = ["q0", "q1", "q2", "q3"], order = "scalar_first"}
rate_radps = "gyro"
[outputs]
r_CT_H_m = ["px", "py", "pz"]
"""


def test_mapping_converts_names_orders_and_units(library: Path, fmu: Path, tmp_path: Path) -> None:
    """The same binary under a description with other names and units: the bench converts, the FMU sees the same."""
    places = {"q1": 1, "q2": 2, "q3": 3, "q0": 4}
    changes = [f'name="reference_q_CH[{i}]" => name="{name}"' for name, i in places.items()]
    changes += [f'name="r_CT_H_m[{i}]" => name="{name}"' for i, name in ((1, "px"), (2, "py"), (3, "pz"))]
    made = described(fmu, tmp_path / "other.fmu", *changes)
    made = described(
        made, tmp_path / "named.fmu", *[f'name="rate_radps[{i}]" => name="gyro[{i - 1}]"' for i in (1, 2, 3)]
    )
    mapping = tmp_path / "mapping.toml"
    mapping.write_text(MAPPING)
    settings = (f"gnc.fmu={made}", f"gnc.fmu_mapping={mapping}")
    assert history("scheme-1", 10.0, *settings) == history("scheme-1", 10.0, f"gnc.library={library}")


def test_unit_of_the_fmu_is_converted(fmu: Path, tmp_path: Path) -> None:
    """An FMU that gives its estimate in what it calls millimetres, but are metres, is a factor of 1000 off."""
    made = described(
        fmu,
        tmp_path / "mm.fmu",
        '<Unit name="m">\n      <BaseUnit m="1" /> => <Unit name="m">\n      <BaseUnit m="1" factor="0.001" />',
    )
    scenario = load_scenario("scheme-1", [f"gnc.fmu={made}"]).value
    found = open_library(scenario.gnc)
    elements = {(e.field.name, e.index, e.variable.name): e for e in found.outputs}  # type: ignore[union-attr]
    assert next(e for key, e in elements.items() if key[0] == "r_CT_H_m").factor == 1e-3


REFUSED = {
    "not there": (None, "no such file"),
    "model exchange": (("CoSimulation => ModelExchange",), "export it for co-simulation"),
    "once": (
        ('canHandleVariable => canBeInstantiatedOnlyOncePerProcess="true" canHandleVariable',),
        "gnc.fmu_process = true",
    ),
    "step": (
        (
            'canHandleVariableCommunicationStepSize="true" => canHandleVariableCommunicationStepSize="false"',
            '<DefaultExperiment startTime="0.0" => <DefaultExperiment stepSize="0.03" startTime="0.0"',
        ),
        "allows steps of 0.03 s and multiples: step_s is 0.02 s",
    ),
    "no force": (
        ('name="force[1]" => name="other[1]"', 'name="force[3]" => name="other[3]"'),
        "no variable 'force[1]'",
    ),
    "partial estimate": (('name="q_CH[2]" => name="q2"',), "has no variable 'q_CH[2]'"),
    "unfed input": (('name="boost" => name="extra"',), "input extra: no field of that name"),
    "unit": (
        ('name="t_s" valueReference => name="t_s" x="" valueReference', '<BaseUnit s="1" /> => <BaseUnit m="1" />'),
        "has the unit 's', the bench has 's'",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_fmu_that_cannot_be_used_is_refused_in_one_line(
    fmu: Path, tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]
) -> None:
    changes, says = REFUSED[case]
    made = tmp_path / "bad.fmu"
    if changes is not None:
        described(fmu, made, *changes)
    assert execute(["run", "scheme-1", "--set", f"gnc.fmu={made}"]) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert error.count("\n") == 0
    assert "gnc.fmu" in error


def _without_binary(files: dict[str, bytes]) -> None:
    del files[BINARY]


def _for_windows(files: dict[str, bytes]) -> None:
    files["binaries/win64/gnc.dll"] = files.pop(BINARY)


def _traversal(files: dict[str, bytes]) -> None:
    files["../../evil"] = b""


def _bomb(files: dict[str, bytes]) -> None:
    files[DESCRIPTION] = b'<!DOCTYPE a [<!ENTITY a "aa">]>' + files[DESCRIPTION].partition(b"?>\n")[2]


def _garbage_binary(files: dict[str, bytes]) -> None:
    files[BINARY] = b"\x7fELF" + bytes(100)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_without_binary, "has sources and no binary"),
        (_for_windows, "has binaries for win64 only: this computer needs linux64"),
        (_traversal, "relative paths inside the archive"),
        (_bomb, "entities are not allowed"),
        (_garbage_binary, "cannot be loaded"),
    ],
)
def test_archive_that_cannot_be_used_is_refused(fmu: Path, tmp_path: Path, change, says: str, capsys) -> None:  # type: ignore[no-untyped-def]
    made = repacked(fmu, tmp_path / "bad.fmu", change)
    assert execute(["gnc", "check", str(made)]) == 2
    error = capsys.readouterr().err.strip()
    assert says in error
    assert "\n" not in error


def test_hil_gnc_refuses_an_fmu_that_is_none(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["gnc", "scheme-1", "--set", f"gnc.fmu={tmp_path / 'no.fmu'}"]) == 2
    assert "no such file" in capsys.readouterr().err


def test_parameter_of_the_scenario_is_set(tmp_path: Path) -> None:
    change = "BANDWIDTH_RADPS = 0.15 => BANDWIDTH_RADPS = 0.15"
    made = example_fmu(tmp_path, 2, change)
    light = history("scheme-1", 5.0, f"gnc.fmu={made}", 'gnc.fmu_parameters={"step_s" = 0.04}')
    assert light[0] != history("scheme-1", 5.0, f"gnc.fmu={made}")[0]


FAILING = {
    "error status": (f'{STEP} {RUNNING} {{ strcpy(output->text, "no fuel"); return 1; }}', "no fuel"),
    "not a number": (f"{STEP} if (input->cycle == 900) g->r[1] = NAN;", "r_CT_H_m[1] is nan"),
}


@pytest.mark.parametrize("case", FAILING)
def test_fault_of_the_fmu_stops_the_bench(tmp_path: Path, case: str, capsys: pytest.CaptureFixture[str]) -> None:
    put_in, says = FAILING[case]
    made = example_fmu(tmp_path, 2, f"{STEP} => {put_in}")
    assert execute(["run", "scheme-1", "--duration", "20", "--set", f"gnc.fmu={made}"]) == 3
    error = capsys.readouterr().err
    assert says in error
    assert f"gnc {made.name}" in error


CONTAINED = {
    "crash": (f"{STEP} {RUNNING} abort();", "its process has ended"),
    "hang": (f"{STEP} {RUNNING} for (;;) {{}}", "no answer within 0.3 s"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CONTAINED)
def test_fmu_in_its_own_process_is_contained(tmp_path: Path, case: str) -> None:
    put_in, says = CONTAINED[case]
    made = example_fmu(tmp_path, 2, f"{STEP} => {put_in}")
    before = set(Path(tempfile.gettempdir()).glob("hil-fmu-*"))
    begun_s = time.monotonic()
    rows, stop = history("scheme-1", 3.0, f"gnc.fmu={made}", "gnc.fmu_process=true", "gnc.fmu_timeout_s=0.3")
    assert says in stop
    assert len(rows) // CYCLE.itemsize == 50
    assert time.monotonic() - begun_s < 60.0
    gc.collect()
    assert not _children("isolated_fmu")
    assert set(Path(tempfile.gettempdir()).glob("hil-fmu-*")) <= before


def _children(name: str) -> list[str]:
    """Return the command lines of this process' children that contain ``name``."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                stat, line = (entry / "stat").read_text(), (entry / "cmdline").read_text()
            except OSError:
                continue
            if (
                name in line
                and int(stat.rsplit(")", 1)[1].split()[1]) == os.getpid()
                and stat.rsplit(")", 1)[1].split()[0] != "Z"
            ):
                found.append(line)
    return found


@pytest.mark.slow
def test_fmu_in_its_own_process_has_the_same_bits(library: Path, fmu: Path) -> None:
    contained = history("scheme-1", 3.0, f"gnc.fmu={fmu}", "gnc.fmu_process=true")
    assert contained == history("scheme-1", 3.0, f"gnc.library={library}")


RATE = "    memcpy(output->w_CH_C_radps, g->w, sizeof g->w);"
ONE_LATE = "hil_gnc_output late; late = *output; *output = g->late; output->cycle = input->cycle; g->late = late;"


@pytest.mark.slow
def test_check_reports_outputs_that_come_a_step_late(fmu: Path, tmp_path: Path) -> None:
    texts = {}
    late = example_fmu(
        tmp_path,
        2,
        "    hil_gnc_setup setup; =>     hil_gnc_setup setup; hil_gnc_output late;",
        f"{RATE} => {RATE} {ONE_LATE}",
        "        g->setup = *setup; => { g->setup = *setup; g->late.state = HIL_GNC_WORKING; }",
    )
    for made in (fmu, late):
        scenario = load_scenario("scheme-1", [f"gnc.fmu={made}"]).value
        found = open_library(scenario.gnc)
        assert found is not None
        report = check_gnc(LibraryUnderTest(found), scenario)
        texts[made] = [finding.text for finding in report.findings if finding.check == "delay"]
        assert report.passed or made == late
    assert texts[fmu] == ["outputs answer the input of their own cycle"]
    assert texts[late] == ["outputs come 1 cycle (20 ms) after the input that they answer"]
