"""Faults as data: the table, the timetable of a scenario, and the texts of what is not allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

import hil
from docs.fault_responses import RESPONSES
from hil.config.load import load_rig, load_scenario
from hil.config.tables.faults import TERMS
from hil.errors import BadInput
from hil.params.faults import CODES
from hil.session.build import Job, check


def problem(text: str, rig: str = "mock", *settings: str) -> str:
    """Return the line about ``--set faults=[{text}]``."""

    def checked() -> None:
        job = Job(load_scenario("scheme-1", (f"faults=[{{{text}}}]", *settings)), load_rig(rig), 0, 100.0, 1.0)
        check(job)

    with pytest.raises(BadInput) as caught:
        checked()
    (found,) = caught.value.problems
    return str(found)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ('at_s=1.0, device="vmo", kind="no_pose"', 'device = "vmo": must be one of vmu, imu, thruster.1'),
        ('at_s=1.0, device="thruster", kind="leak", value=0.1', 'device = "thruster": must be one of'),
        ('at_s=1.0, device="thruster.0", kind="stuck_open"', 'device = "thruster.0": must be one of'),
        ('at_s=1.0, device="thruster.99", kind="stuck_open"', "the chaser has thruster.1 to thruster.16"),
        ('at_s=1.0, device="vmu", kind="stuck"', 'kind = "stuck": vmu has no_pose, frozen'),
        ('at_s=-1.0, device="vmu", kind="no_pose"', "faults[0].at_s: -1.0: must be greater than or equal to 0"),
        ('at_s=1e4, device="vmu", kind="no_pose"', "at_s = 10000: the run ends at 400 s"),
        ('at_s=5.0, until_s=5.0, device="vmu", kind="no_pose"', "until_s = 5: must be later than at_s = 5"),
        ('at_s=1.0, device="vmu", kind="offset", value=0.3', "value = 0.3: must be 3 numbers in m"),
        ('at_s=1.0, device="vmu", kind="offset"', 'kind = "offset" needs value in m'),
        *(
            (
                f'at_s=1.0, device="vmu", kind="offset", value={value}',
                f"faults[0].value: {value}: must be 3 numbers in m",
            )
            for value in ('"0.3 m"', "true", "[]", '["a"]', "[[1, 2]]", '[0.1, "0.2 m", 0]', "[1, 2, 3, 4]")
        ),
        ('at_s=1.0, device="vmu", kind="offset", value={x = 1}', 'faults[0].value: {"x": 1}: must be 3 numbers in m'),
        ('at_s=1.0, device="vmu", kind="offset", value=inf', "faults[0].value: Infinity: must be 3 numbers in m"),
        ('at_s=1.0, device="vmu", kind="latency", value="20 ms"', 'faults[0].value: "20 ms": must be one number in s'),
        ('at_s=1.0, device="vmu", kind="noise", value="2"', '"2": must be a number, or a list of 1 to 3 numbers'),
        ('at_s="1 s", device="vmu", kind="no_pose"', 'faults[0].at_s: "1 s": must be a valid number'),
        ('at_s=1.0, until_s=[2], device="vmu", kind="no_pose"', "faults[0].until_s: [2]: must be a valid number"),
        ('at_s=1.0, device=3, kind="no_pose"', "faults[0].device: 3: must be a valid string"),
        ('at_s=1.0, device="vmu", kind=["no_pose"]', 'faults[0].kind: ["no_pose"]: must be a valid string'),
        ('at_s=1.0, device="vmu", kind="outlier", value=0.5, size_m="1 m"', 'size_m: "1 m": must be a valid number'),
        ('at_s=1.0, device="imu", kind="stuck", sensor=1', "sensor: 1: must be 'gyro' or 'accelerometer'"),
        ('at_s=1.0, device="vmu", kind="latency", value=0.1, stamp=true', "stamp: true: must be 'exposure' or"),
        ('at_s=1.0, device="vmu", kind="no_pose", value=1.0', 'value does not go with kind = "no_pose"'),
        ('at_s=1.0, device="vmu", kind="latency", value=2.0', "value = 2: it must be 0 to 1 in s"),
        ('at_s=1.0, device="vmu", kind="outlier", value=0.1', 'kind = "outlier" needs size_m'),
        ('at_s=1.0, device="vmu", kind="latency", value=0.1, sensor="gyro"', "sensor does not go with kind"),
        ('at_s=1.0, device="imu", kind="dropout", sensor="magnetometer"', "must be 'gyro' or 'accelerometer'"),
        ('at_s=1.0, device="thruster.1", kind="delay", valve=0.1', "unknown key: did you mean value?"),
    ],
)
def test_a_fault_that_cannot_be_is_one_line(text: str, said: str) -> None:
    assert said in problem(text)


def test_axes_of_a_rig_on_wires_have_their_faults_at_the_emulators() -> None:
    assert "axes have faults on the mock rig only" in problem('at_s=1.0, device="rails.x", kind="stuck"', "emulated")


def test_a_delay_that_a_fast_loop_cannot_remember_is_refused() -> None:
    text = 'at_s=1.0, device="thruster.1", kind="delay", value=0.5'
    assert "at most 128 steps of the truth are kept, 0.128 s" in problem(text, "mock", "step_s=0.001")
    assert "at most 128 steps of the truth are kept, 0.128 s" in problem(text, "mock", "imu.rate_hz=1000.0")


def test_too_many_faults_of_one_device_are_refused() -> None:
    fault = {"at_s": 1.0, "device": "vmu", "kind": "no_pose"}
    with pytest.raises(BadInput, match="9 of vmu: at most 8 are allowed"):
        hil.run("scheme-1", duration_s=2.0, faults=[fault] * 9)


def test_faults_of_a_call_come_after_those_of_the_scenario() -> None:
    own = [{"at_s": 1.0, "device": "vmu", "kind": "no_pose"}]
    more = [{"at_s": 0.5, "device": "thruster.2", "kind": "leak", "value": 0.1, "until_s": 1.5}]
    found = hil.run("scheme-1", duration_s=1.0, overrides={"faults": own}, faults=more).summary["injected"]
    assert [(fault["device"], fault["kind"], fault["value"], fault["until_s"]) for fault in found] == [
        ("vmu", "no_pose", [], None),
        ("thruster.2", "leak", [0.1], 1.5),
    ]


def test_each_kind_has_its_number_in_the_kernels() -> None:
    for family, kinds in TERMS.items():
        numbers = [CODES[family][kind] for kind in kinds]
        assert sorted(numbers) == list(range(len(kinds)))


def test_each_kind_has_a_response_and_a_test_that_exists() -> None:
    assert set(RESPONSES) == {f"{family}.{kind}" for family, kinds in TERMS.items() for kind in kinds}
    root = Path(__file__).resolve().parents[3]
    for response in RESPONSES.values():
        file, _, name = response.test.partition("::")
        assert f"def {name}(" in (root / file).read_text()
