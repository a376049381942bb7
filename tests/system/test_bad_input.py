"""Bad input ends with exit code 2 and one clear line, before anything moves."""

from __future__ import annotations

import errno
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hil.cli.main import execute
from hil.config.load import configs_folder
from tests.support import moon_reference as reference

HARDWARE = """
extends = "emulated"
name = "lab"
kind = "hardware"
sign_off.waived = true
[rails.modbus]
x = {{ host = "192.0.2.1", port = 502 }}
y = {{ host = "192.0.2.2", port = 502 }}
z = {{ host = "192.0.2.3", port = 502 }}
[turntable]
driver = "ascii"
[turntable.ascii]
port = "/dev/null"
[io]
host = "192.0.2.4"
port = 502
[vmu.rs422]
{vmu}
"""


def _refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Return the one line that the command printed."""
    assert execute(["run", *arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = printed.err.strip().splitlines()
    assert len(lines) == 1, printed.err
    return lines[0]


def test_unknown_scenario_names_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    line = _refused(capsys, "scheme-9")
    assert "scheme-9" in line
    assert all(name in line for name in ("scheme-1", "scheme-2", "scheme-3"))


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ("gnc.control.dead_band_m=0.1", ("gnc.control.dead_band_m", "unknown key", "deadband_m")),
        ("orbit.altitude_m=100", ("orbit.altitude_m", "100 m above the Moon", "8690")),
        ('name="../../../x"', ("name", "must have no /")),
        (f"{'a.' * 1000}b=1", ("1001 levels", "allowed up to 20")),
        ("chaser.mass_g=1000.0", ("chaser.mass_g", "mass_kg")),
        ("chaser.mass_kg=-1.0", ("chaser.mass_kg", "-1", "greater than 0")),
        ("chaser.mass_kg=nan", ("chaser.mass_kg", "finite")),
        ("initial.position_m=[nan, 0.0, 0.0]", ("initial.position_m[0]", "finite")),
        ("initial.position_m=[13.0, 0.0, 0.0]", ("initial.position_m", "rails.x", "12 m")),
        ("initial.position_m=[5.0, 2.0, 0.0]", ("initial.position_m", "rails.y", "1.5 m")),
        ("initial.attitude_deg=[80.0, 0.0, 0.0]", ("initial.attitude_deg", "turntable.roll", "60 deg")),
        ("rig.rails.x.travel_m=[5.0, 1.0]", ("rig.rails.x", "travel_m")),
        ("rig.vmu.driver=rs422", ("vmu.driver", "mock")),
        ("rig.io.thruster_lines=3", ("rig.io.thruster_lines", "allowed", "or 0 for none")),
        ("orbit.altitude_m=-1000.0", ("orbit.altitude_m", "-1000", "greater than 0")),
        ("orbit.eccentricity=0.8", ("orbit.eccentricity", "0.8", "less than or equal to 0.7")),
        ("truth.relative_motion=kepler", ("truth.relative_motion", "kepler", "'hill', 'nonlinear' or 'free'")),
        ("truth.gravity_degree=9", ("truth.gravity_degree", "9", "allowed 0 to 8")),
        ("truth.gravity_degree=-1", ("truth.gravity_degree", "-1", "0")),
        ("truth.gravity_file=nowhere.tab", ("truth.gravity_file", "nowhere.tab", "cannot be read")),
        ("truth.gravity_file=moon.grv", ("truth.gravity_file", "moon.grv", ".gfc", ".cof", ".tab")),
        ("orbit.body=pluto", ("orbit.body", "pluto", "unknown body", "earth")),
        ("orbit.body=earth", ("truth.gravity_degree", "8", "the Earth", "allowed 0 to 6")),
        ("truth.drag=true", ("truth.drag", "the Moon has no atmosphere")),
        ("truth.sun_direction=[1.0, 1.0, 0.0]", ("truth", "sun_direction", "unit vector")),
        ("truth.force_scatter_sigma=0.5", ("truth.force_scatter_sigma", "0.5", "0.2")),
        ("chaser.solar_array.mode_coupling=[40.0, 0.0, 0.0]", ("chaser.solar_array.mode_coupling", "40", "inertia")),
        ("chaser.inertia_kg_m2=[[9.0, 0.0, 0.0], [0.0, 9.0, 0.0], [0.0, 0.0, 0.0]]", ("inertia_kg_m2", "singular")),
        (
            "chaser.inertia_kg_m2=[[900.0, 0.0, 0.0], [0.0, 900.0, 0.0], [0.0, 0.0, 1900.0]]",
            ("chaser.inertia_kg_m2", "1900", "sum of the others, 900 + 900"),
        ),
        ("gnc.control.deadband_m", ("--set", "gnc.control.deadband_m=0.004")),
        (
            "gnc.guidance.approach_speed_mps=0.05",
            ("gnc.guidance.approach_speed_mps", "0.05", "closing_rate_max", "0.04"),
        ),
        ('gnc.guidance.sequence=["approach", "nowhere"]', ("gnc.guidance", '"nowhere"', "approach, ready")),
        ("gnc.guidance.phases.ready.until=3.0", ("gnc.guidance.phases.ready.until", "unknown key", "end_time_s")),
        ("gnc.guidance.phases.ready.duration_s=3.0", ("gnc.guidance.phases.ready", "duration_s", "wait", "end_time_s")),
        ("gnc.guidance.phases.approach.point_m=[13.0, 0.0, 0.0]", ("phases.approach.point_m", "rails.x", "12 m")),
        ("gnc.corridor.axis=[2.0, 0.0, 0.0]", ("gnc.corridor", "axis", "unit vector")),
        ("gnc.abort.at_s=-1.0", ("gnc.abort.at_s", "-1", "greater than or equal to 0")),
        ("rig.vmu.camera.focal_px=0.0", ("vmu.camera.focal_px", "greater than 0")),
    ],
)
def test_bad_setting_is_named_with_what_is_allowed(
    capsys: pytest.CaptureFixture[str], setting: str, words: tuple[str, ...]
) -> None:
    line = _refused(capsys, "scheme-1", "--set", setting)
    assert all(word in line for word in words), line


def test_orbit_that_dips_into_the_moon_is_refused_with_what_is_allowed(capsys: pytest.CaptureFixture[str]) -> None:
    line = _refused(capsys, "scheme-1", "--set", "orbit.altitude_m=100e3", "--set", "orbit.eccentricity=0.06")
    for word in ("orbit.eccentricity", "0.06", "10.3 km inside the Moon", "allowed below 0.0544"):
        assert word in line, line


def test_body_file_that_is_cut_is_refused_by_file_and_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = (configs_folder() / "bodies" / "earth.toml").read_text(encoding="utf-8")
    path = tmp_path / "cut.toml"
    path.write_text(text[: text.index("rotation_period_d")], encoding="utf-8")
    line = _refused(capsys, "leo-vbar", "--set", f"orbit.body={path}")
    assert line.startswith(f"{path}: rotation_period_d: is missing"), line
    path.write_text(text[: text.index("8.382")], encoding="utf-8")
    line = _refused(capsys, "leo-vbar", "--set", f"orbit.body={path}")
    assert all(word in line for word in ("orbit.body", str(path), "not TOML")), line


def test_orbit_below_the_surface_of_the_earth_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    line = _refused(capsys, "leo-vbar", "--set", "orbit.eccentricity=0.09")
    for word in ("orbit.eccentricity", "0.09", "inside the Earth", "allowed below 0.0618"):
        assert word in line, line


def test_linear_motion_on_an_ellipse_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    line = _refused(capsys, "scheme-1", "--set", "orbit.eccentricity=0.01", "--set", "truth.relative_motion=hill")
    assert "truth.relative_motion" in line
    assert "circular" in line


def test_gravity_file_that_is_cut_is_refused_by_file_and_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = reference.SHIPPED.read_text(encoding="ascii").splitlines(keepends=True)
    path = tmp_path / "cut.tab"
    path.write_text("".join(rows[:30]), encoding="ascii")
    line = _refused(capsys, "scheme-1", "--set", f"truth.gravity_file={path}")
    for word in ("truth.gravity_file", str(path), "is cut", "degree 7 order 4 is missing"):
        assert word in line, line


def test_all_faults_of_a_file_are_reported_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text('extends = "scheme-1"\n[chaser]\nmass_kg = -3\ncolour = "red"\n[orbit]\naltitude_km = 200\n')
    assert execute(["run", str(path)]) == 2
    lines = capsys.readouterr().err.strip().splitlines()
    assert len(lines) == 3
    assert all(line.startswith(f"{path}: ") for line in lines)


def test_file_that_is_not_toml_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("mass_kg = = 3\n")
    assert str(path) in _refused(capsys, str(path))


def test_rig_file_without_a_serial_port_is_refused_by_the_key(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(HARDWARE.format(vmu="baud = 460800"))
    line = _refused(capsys, "scheme-1", "--rig", str(path))
    assert str(path) in line or "emulated.toml" in line
    assert "vmu.rs422.port" in line


def test_rig_file_with_a_port_that_this_computer_has_not_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(HARDWARE.format(vmu='port = "/dev/ttyHIL7"'))
    line = _refused(capsys, "scheme-1", "--rig", str(path))
    assert "vmu.rs422.port" in line
    assert "/dev/ttyHIL7" in line


@pytest.mark.parametrize(
    "arguments",
    [
        ("--duration", "-5"),
        ("--duration", "nan"),
        ("--seed", "-1"),
        ("--speed", "0"),
        ("--speed", "4"),
        ("--json", "/no/such/folder/run.json"),
        ("--rig", "nowhere"),
        ("--no-such-option", "1"),
        ("--duration", "soon"),
    ],
)
def test_bad_option_is_refused_in_one_line(capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...]) -> None:
    assert arguments[0].lstrip("-").split("-")[0] in _refused(capsys, "scheme-1", *arguments).lower()


def test_keys_of_a_missing_base_are_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine.toml").write_text('name = "mine"\n')
    line = _refused(capsys, str(tmp_path / "mine.toml"))
    assert "duration_s, step_s, orbit, chaser, initial and 4 more: are missing: extends" in line


def test_more_runs_than_fit_into_memory_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for command in (["campaign", "scheme-1", "--out", str(tmp_path / "out")], ["fusion"]):
        assert execute([*command, "--runs", "10000000000"]) == 2
        assert capsys.readouterr().err == "--runs: 10000000000: must be at most 10000000\n"


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (OSError(errno.EMFILE, "Too many open files"), "raise the limit, ulimit -n"),
        (RuntimeError("can't start new thread"), "raise the limits, ulimit -u and -v"),
    ],
)
def test_limit_of_the_host_is_one_line_and_no_internal_error(
    error: Exception, words: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("hil.session.build.check", fail)
    assert words in _refused(capsys, "scheme-1", "--duration", "1")


def test_run_that_is_killed_leaves_its_json(tmp_path: Path) -> None:
    path = tmp_path / "run.json"
    options = ["--rig", "mock", "--speed", "1", "--json", str(path)]
    with subprocess.Popen(
        [sys.executable, "-m", "hil", "run", "scheme-1", *options], stderr=subprocess.PIPE
    ) as process:
        end_s = time.monotonic() + 60.0
        while not path.exists() and process.poll() is None and time.monotonic() < end_s:
            time.sleep(0.005)
        process.kill()
        process.communicate()
    left = json.loads(path.read_text())
    assert (left["scenario"], left["passed"]) == ("scheme-1", False)
    assert left["stop"] == "the process ended before the run was over"
