"""The sign-off of a rig: its file, what its digest covers, and which rigs may run."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from hil.checks.compatibility import check_sign_off, sign_off_gap
from hil.checks.waivers import waivers
from hil.cli.main import execute
from hil.config.load import load_rig, load_scenario
from hil.config.motion_digest import motion_digest
from hil.config.rig import Rig
from hil.core.operator_commands import FreshDigits
from hil.core.operator_keys import OperatorKey, write_operators
from hil.parts.commissioning.cli.commission import Terminal
from hil.parts.commissioning.sign_off import as_toml, signed_before
from hil.parts.commissioning.steps import AxisFindings, Findings
from hil.report.summary import sign_off_summary
from hil.report.table import print_sign_off, print_waived
from tests.support.run_settings import HARDWARE_WIRES

NAMES = ("rails.x", "rails.y", "rails.z", "turntable.roll", "turntable.pitch", "turntable.yaw")


def found(axes: range | list[int], whole: bool) -> Findings:
    results = [AxisFindings(k, NAMES[k], 0.001, 0.0004 if k < 3 else math.radians(0.05)) for k in axes]
    return Findings(results, np.full(6, 0.001) if whole else None)


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    path = tmp_path / "lab.toml"
    path.write_text(f'extends = "emulated"\nname = "lab"\nkind = "hardware"\n{HARDWARE_WIRES}')
    return path


def signed(
    lab: Path,
    axes: range | list[int] = range(6),
    whole: bool = True,
    base: str = "lab.toml",
    by: OperatorKey | str = 'A. "Tech" Nician',
) -> Path:
    """Write the sign-off of ``lab`` next to it; return its path."""
    text = as_toml(found(axes, whole), load_rig(str(lab)).value, base, by, "2026-03-01")
    path = lab.with_name(f"signed-{len(list(lab.parent.iterdir()))}.toml")
    path.write_text(text)
    return path


def test_file_names_signer_date_and_findings(lab: Path) -> None:
    sign_off = load_rig(str(signed(lab))).value.sign_off
    assert sign_off is not None
    assert (sign_off.by, sign_off.date) == ('A. "Tech" Nician', "2026-03-01")
    assert set(sign_off.axes) == set(NAMES)
    assert sign_off.axes["rails.x"].following_error_max_m == pytest.approx(0.0004)
    assert sign_off.axes["rails.x"].following_error_max_deg is None
    assert sign_off.axes["turntable.yaw"].following_error_max_deg == pytest.approx(0.05)
    assert sign_off.axes["turntable.yaw"].scale_error == pytest.approx(0.001)


def test_rig_that_is_signed_off_may_run(lab: Path) -> None:
    assert check_sign_off(load_rig(str(signed(lab)))) == []


def test_hardware_without_a_sign_off_is_refused_in_a_line(lab: Path) -> None:
    (problem,) = check_sign_off(load_rig(str(lab)))
    assert str(problem).startswith(f"{lab}: rig.sign_off: is missing: commission it with hil commission {lab}")
    assert "rig.sign_off.waived=true" in str(problem)


def test_waiver_is_an_override(lab: Path) -> None:
    assert check_sign_off(load_rig(str(lab), ["rig.sign_off.waived=true"])) == []


def test_run_refuses_hardware_before_anything_is_opened(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["run", "scheme-1", "--rig", str(lab)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert line.startswith(f"{lab}: rig.sign_off: is missing: commission it with hil commission")
    changed = ["--set", "rig.rails.x.rate_max_mps=0.45"]
    assert execute(["run", "scheme-1", "--rig", str(signed(lab)), *changed]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "the rig was changed after its sign-off" in line


def test_report_of_hardware_names_the_signer_or_the_waiver(lab: Path, mock_rig: Rig) -> None:
    told = io.StringIO()
    console = Console(file=told, width=200)
    for rig in (load_rig(str(signed(lab))).value, load_rig(str(lab), ["rig.sign_off.waived=true"]).value, mock_rig):
        print_sign_off(sign_off_summary(rig), console)
        print_waived([waiver.as_json() for waiver in waivers(rig, load_scenario("scheme-1").value)], console)
    signed_line, waived_line = told.getvalue().strip().splitlines()
    assert signed_line == 'Sign-off    2026-03-01 by A. "Tech" Nician'
    assert waived_line.startswith("WAIVED rig.sign_off.waived = true: ")
    assert waived_line.endswith(f"the sign-off is not complete, missing: {', '.join(NAMES)}")
    assert sign_off_summary(mock_rig) is None


@pytest.mark.parametrize("rig", ["mock", "emulated", "emulated-rtu"])
def test_no_other_rig_needs_one(rig: str) -> None:
    assert check_sign_off(load_rig(rig)) == []


@pytest.mark.parametrize(
    "change",
    [
        "rig.rails.x.rate_max_mps=0.4",
        "rig.rails.x.travel_m=[-0.2, 11.0]",
        "rig.turntable.yaw.acceleration_max_degps2=81.0",
        "rig.turntable.following_error_max_deg=2.5",
        "rig.turntable.cia402.counts_per_turn=10000001",
        "rig.bench.lever_arm_m=[0.0, 0.0, 0.36]",
        "rig.bench.gimbal_order=zxy",
        "rig.bench.rails_order=zyx",
        "rig.bench.geometry_file=measured.toml",
        "rig.rails.map.word_order=little",
        "rig.rails.modbus.x.port=1502",
        "rig.io.pump_timeout_s=0.06",
        "rig.safety.command_age_max_s=0.4",
        "rig.host.overruns_max=6",
        "rig.vmu.lost_packets_max=11.0",
        "rig.console.lease_s=2.5",
        "rig.console.on_loss=continue",
        "rig.guard.startup_s=2.5",
        "rig.vmu.rate_hz=5.0",
    ],
)
def test_change_of_what_decides_the_motion_ends_the_sign_off(lab: Path, change: str) -> None:
    (problem,) = check_sign_off(load_rig(str(signed(lab)), [change]))
    assert "the rig was changed after its sign-off on 2026-03-01" in str(problem)
    assert "hil commission" in str(problem)


@pytest.mark.parametrize(
    "change",
    [
        "rig.rails.x.lead_s=-0.01",
        "rig.name=other",
        "rig.host.cpu=1",
        "rig.console.on_loss=stop",
        "rig.bench.errors.seed=1",
        "rig.bench.thermal_sigma_m=1e-4",
    ],
)
def test_change_of_anything_else_does_not(lab: Path, change: str) -> None:
    assert check_sign_off(load_rig(str(signed(lab)), [change])) == []


def test_sign_off_of_a_rehearsal_does_not_hold_for_hardware(lab: Path, tmp_path: Path) -> None:
    rehearsed = tmp_path / "rehearsed.toml"
    rehearsed.write_text(f'extends = "emulated"\n{HARDWARE_WIRES}')
    now_hardware = tmp_path / "now-hardware.toml"
    now_hardware.write_text(f'extends = "{signed(rehearsed, base="rehearsed.toml").name}"\nkind = "hardware"\n')
    (problem,) = check_sign_off(load_rig(str(now_hardware)))
    assert "changed" in str(problem)


def test_axes_may_be_signed_one_after_the_other(lab: Path) -> None:
    first = signed(lab, [0, 5], whole=False)
    rig = load_rig(str(first)).value
    assert signed_before(rig) == {"rails.x", "turntable.yaw"}
    assert sign_off_gap(rig) == "is not complete, missing: rails.y, rails.z, turntable.roll, turntable.pitch"
    second = signed(first, [1, 2, 3, 4], whole=True, base=first.name)
    both = load_rig(str(second))
    assert both.value.sign_off is not None
    assert set(both.value.sign_off.axes) == set(NAMES)
    assert check_sign_off(both) == []


def test_axes_signed_before_a_change_do_not_count(lab: Path) -> None:
    first = load_rig(str(signed(lab, [0], whole=False)), ["rig.rails.z.rate_max_mps=0.1"]).value
    assert signed_before(first) == frozenset()
    assert "missing: rails.x, rails.y" in sign_off_gap(first)


def test_digest_covers_the_content_of_a_file_of_the_rig_and_not_its_path(tmp_path: Path) -> None:
    rig = load_rig("emulated").value

    def digest(name: str, text: str) -> str:
        (tmp_path / name).write_text(text)
        bench = rig.bench.model_copy(update={"geometry_file": str(tmp_path / name)})
        return motion_digest(rig.model_copy(update={"bench": bench}))

    first = digest("a.toml", "squareness")
    assert digest("b.toml", "squareness") == first
    assert digest("a.toml", "squareness, edited") != first


def test_digest_covers_the_content_of_the_protocol_file_and_not_its_path(tmp_path: Path) -> None:
    digests = []
    for folder, delay in (("a", ""), ("b", ""), ("c", "# another word\n")):
        (tmp_path / folder).mkdir()
        source = Path("configs/protocols/acu.toml").read_text()
        (tmp_path / folder / "mine.toml").write_text(delay + source)
        rig = tmp_path / folder / "rig.toml"
        rig.write_text(
            'extends = "emulated"\n[turntable]\ndriver = "ascii"\n[turntable.ascii]\nprotocol = "mine.toml"\n'
        )
        digests.append(motion_digest(load_rig(str(rig)).value))
    assert digests[0] == digests[1] == digests[2]
    other = tmp_path / "d.toml"
    other.write_text('extends = "emulated"\n[turntable]\ndriver = "ascii"\n[turntable.ascii]\nprotocol = "hil-ascii"\n')
    assert motion_digest(load_rig(str(other)).value) != digests[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("mock",), ("mock", "no devices to commission")),
        (("emulated", "--axis", "rails.w"), ("--axis", "rails.w", "turntable.yaw")),
        (("emulated", "--out", "lab.ini"), ("--out", "lab.ini", ".toml")),
        (("emulated", "--date", "1.3.2026"), ("--date", "1.3.2026", "2026-03-01")),
        (("emulated", "--date", "2026-13-01"), ("--date", "2026-13-01")),
        (("emulated", "--operator", " "), ("--operator", "give a name")),
        (("emulated", "--speed", "0"), ("--speed", "above 0")),
        (
            ("emulated", "--out", "new.toml", "--set", "rig.rails.timeout_s=1.0"),
            ("--set", "rig.rails.timeout_s", "--out"),
        ),
    ],
)
def test_bad_option_is_refused_in_a_line(
    capsys: pytest.CaptureFixture[str], arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    assert execute(["commission", *arguments]) == 2
    line = capsys.readouterr().err.strip()
    assert "\n" not in line
    assert all(word in line for word in words), line


def test_hardware_needs_the_answers_of_a_technician(lab: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert execute(["commission", str(lab), "--yes"]) == 2
    assert "--yes: lab is hardware: an operator must watch the bench and answer" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("typed", "answer", "times"),
    [
        ("y 10\n", True, 1),
        ("No\n", False, 1),
        ("what\n\nyes 12\n", True, 3),
        ("", False, 1),
        ("y\ny 10\nn\n", False, 3),
        ("y\n" * 50, False, 20),
    ],
)
def test_question_is_repeated_until_answered_by_its_digits_and_no_terminal_counts_as_no(
    monkeypatch: pytest.MonkeyPatch, typed: str, answer: bool, times: int
) -> None:
    shown = io.StringIO()
    monkeypatch.setattr("sys.stdin", io.StringIO(typed))
    digits = FreshDigits(lambda: 0.0, lambda _: 0)
    assert Terminal(Console(file=shown), digits).ask("Is it [so]?") is answer
    assert shown.getvalue().count("Is it [so]? [y ") == times


def test_sign_off_names_its_key_and_a_changed_or_forged_one_is_found(
    lab: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    ann, operators = OperatorKey("ann", "a1" * 32), tmp_path / "operators.toml"
    write_operators(operators, {ann.id: ann})
    file = signed(lab, by=ann)
    sign_off = load_rig(str(file)).value.sign_off
    assert sign_off is not None
    assert {each.key for each in (sign_off, *sign_off.axes.values())} == {ann.id}
    command = ["operators", "verify", str(file), "--operators", str(operators)]
    assert execute(command) == 0
    assert capsys.readouterr().out.count(f"PASS {file}: ") == 7
    text = file.read_text()
    for old, new, words in (
        ("2026-03-01", "2026-09-01", "not sealed by the key of ann: the record or its signature was changed"),
        ('by = "ann"', 'by = "bob"', "not sealed by the key of ann"),
        ("scale_error = 0.001", "scale_error = 0.000", "not sealed by the key of ann"),
        (f'key = "{ann.id}"', 'key = "0123456789abcdef"', "which is not in the file"),
        (f'key = "{ann.id}"', "", "signed by the name ann, without a key"),
    ):
        file.write_text(text.replace(old, new))
        assert execute(command) == 1
        assert words in capsys.readouterr().out
