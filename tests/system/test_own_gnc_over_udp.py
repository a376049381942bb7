"""The examples as programs of their own: at the other end of ``hil dss`` they fly as the library does."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import pytest

from hil.cli.main import execute
from hil.config.load import load_scenario
from hil.gnc_backends.library import open_library
from hil.parts.links.authentication import link_key
from hil.parts.links.binary_gnc_server import BINARY_WANTS, OFFERS, BinaryGncServer
from hil.parts.links.gnc_server import GncServer, gnc_side, wants_of
from tests.support.external_gnc import C_EXAMPLE, MEASURED, PYTHON_EXAMPLE, USES_ALL, c_example, compile_c
from tests.support.fmu import example_fmu
from tests.support.run_settings import typed

pytestmark = pytest.mark.xdist_group("campaign")


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def flown_over_udp(folder: Path, language: str, *options: str) -> tuple[int, dict[str, Any]]:
    """Return exit code and numbers of ``hil dss`` in lock-step with an example at the other end."""
    if language == "c":
        sources = [C_EXAMPLE / "gnc_udp.c", C_EXAMPLE / "gnc.c"]
        command = [str(compile_c(sources, folder / "gnc_udp"))]
    else:
        command = [sys.executable, str(PYTHON_EXAMPLE)]
    port, numbers = str(free_port()), folder / f"{language}.json"
    with subprocess.Popen([*command, "127.0.0.1", port]) as program:
        listen = ["--lock-step", "--listen", f"127.0.0.1:{port}", "--json", str(numbers)]
        code = execute(["dss", "scheme-1", *listen, *options])
        assert program.wait(10.0) == 0  # it has received the disconnect
    return code, json.loads(numbers.read_text())


def test_c_program_in_lock_step_flies_as_the_same_code_in_a_library(tmp_path: Path) -> None:
    _, apart = flown_over_udp(tmp_path, "c", "--duration", "8")
    numbers = tmp_path / "run.json"
    library = ["--set", f"gnc.library={c_example(tmp_path)}"]
    execute(["run", "scheme-1", "--duration", "8", *library, "--json", str(numbers)])
    here = json.loads(numbers.read_text())
    for name in ("navigation", "thrusters", "verdict", "events"):
        assert apart[name] == here[name], name


def over_hil_gnc(folder: Path, setting: str, *options: str) -> dict[str, Any]:
    """Return the numbers of ``hil dss`` in lock-step with ``hil gnc --set`` at the other end."""
    port, numbers = str(free_port()), folder / "dss.json"
    bench = f"127.0.0.1:{port}"
    command = [sys.executable, "-m", "hil", "gnc", "scheme-1", "--dss", bench, "--set", setting, *options]
    with subprocess.Popen(command, stderr=subprocess.DEVNULL) as program:
        listen = ["--lock-step", "--listen", bench, "--json", str(numbers), "--duration", "8"]
        execute(["dss", "scheme-1", *listen])
        program.wait(10.0)
    found: dict[str, Any] = json.loads(numbers.read_text())
    return found


def in_threads(folder: Path, *settings: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the numbers of ``hil run``, and of ``hil dss`` with a server in another thread of this process."""
    here, apart, port = folder / "run.json", folder / "dss.json", free_port()
    execute(["run", "scheme-1", "--duration", "2", *typed(*settings), "--json", str(here)])
    scenario = load_scenario("scheme-1", settings)
    binary = open_library(scenario.value.gnc)
    offers = {"wants": wants_of(scenario)} if binary is None else {"offers": OFFERS, "wants": BINARY_WANTS}
    link = gnc_side("test gnc", None, ("127.0.0.1", port), link_key(None), **offers)
    given = (scenario.value, link)
    server = GncServer(*given) if binary is None else BinaryGncServer(binary, *given)
    thread = threading.Thread(target=server.serve, args=(30.0,))
    thread.start()
    bench = [text for text in settings if not text.startswith("gnc.")]
    listen = ["--lock-step", "--listen", f"127.0.0.1:{port}", "--json", str(apart), "--duration", "2"]
    execute(["dss", "scheme-1", *listen, *typed(*bench)])
    thread.join(30.0)
    link.close()
    if isinstance(server, BinaryGncServer):
        server.close()
    return json.loads(here.read_text()), json.loads(apart.read_text())


def test_server_of_a_library_flies_as_the_library_does_with_all_that_is_measured(tmp_path: Path) -> None:
    here, found = in_threads(tmp_path, f"gnc.library={c_example(tmp_path, 'mygnc.so', USES_ALL)}", *MEASURED)
    assert found["stop"] == "completed"
    assert (found["navigation"], found["thrusters"]) == (here["navigation"], here["thrusters"])


def test_server_of_the_built_in_gnc_fuses_further_sensors_as_hil_run_does(tmp_path: Path) -> None:
    here, found = in_threads(tmp_path, *MEASURED)
    assert found["stop"] == "completed"
    for name in ("position_rmse_m", "position_sigma_m", "nees_pkf"):
        assert found["navigation"][name] == here["navigation"][name]


def test_program_that_does_not_receive_a_sensor_is_refused_before_the_run(tmp_path: Path) -> None:
    port, numbers = str(free_port()), tmp_path / "c.json"
    program_file = compile_c([C_EXAMPLE / "gnc_udp.c", C_EXAMPLE / "gnc.c"], tmp_path / "gnc_udp")
    with subprocess.Popen([str(program_file), "127.0.0.1", port]) as program:
        listen = ["--lock-step", "--listen", f"127.0.0.1:{port}", "--json", str(numbers)]
        assert execute(["dss", "scheme-1", *listen, "--set", "sensors.ranger.kind=range_finder"]) == 3
        program.wait(10.0)


@pytest.mark.slow
def test_hil_gnc_flies_a_library_and_an_fmu_as_hil_run_does(tmp_path: Path) -> None:
    numbers = tmp_path / "run.json"
    library = f"gnc.library={c_example(tmp_path)}"
    execute(["run", "scheme-1", "--duration", "8", "--set", library, "--json", str(numbers)])
    here = json.loads(numbers.read_text())
    for setting in (library, f"gnc.fmu={example_fmu(tmp_path)}"):
        apart = over_hil_gnc(tmp_path, setting)
        assert apart["stop"] == "completed"
        for name in ("navigation", "thrusters", "verdict"):
            assert apart[name] == here[name], name


@pytest.mark.slow
@pytest.mark.parametrize(
    ("failure", "words"),
    [
        ("for (;;) {}", "no answer within 0.3 s"),
        ("*(volatile int *)0 = 1;", "its process has ended"),
        ("return 3;", "its step returned 3"),
    ],
    ids=["hangs", "crashes", "error"],
)
def test_fmu_that_fails_in_hil_gnc_stops_the_bench_and_is_contained(tmp_path: Path, failure: str, words: str) -> None:
    fmu = example_fmu(tmp_path, 2, f"gnc_state *g = gnc; => gnc_state *g = gnc; if (input->t_s > 0.5) {{ {failure} }}")
    settings = ["--set", "gnc.fmu_process=true", "--set", "gnc.fmu_timeout_s=0.3"]
    apart = over_hil_gnc(tmp_path, f"gnc.fmu={fmu}", *settings)
    assert words in apart["stop"]


@pytest.mark.slow
@pytest.mark.parametrize("language", ["c", "python"])
def test_example_flies_scheme_1_through_table_iii_over_udp(tmp_path: Path, language: str) -> None:
    code, summary = flown_over_udp(tmp_path, language)
    assert code == 0
    assert summary["passed"]
