"""The shipped EDS is the emulated drive's; an EDS that lacks what the driver needs is refused line by line."""

from __future__ import annotations

import numpy as np
import pytest

from hil.cli.main import execute
from hil.config.load import load_rig
from hil.config.rig import Cia402
from hil.core.clock import WallClock
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.driver import Cia402Turntable
from hil.drivers.turntable.cia402.eds import SHIPPED, Eds
from hil.errors import BadInput
from hil.parts.emulation.cia402_objects import ObjectDictionary
from tests.support.data_sheets import altered, section
from tests.support.turntable_bench import served


def test_shipped_eds_has_what_the_driver_needs_for_homing_and_profiles():
    assert Eds(SHIPPED, homing=True).has_profiles


def test_emulated_drive_starts_with_the_defaults_of_its_eds():
    objects = ObjectDictionary(Cia402(), 1, 500)
    assert objects.value(codec.SETPOINT_PDO.parameter, codec.PDO_EVENT_TIMER) == 500
    assert objects.value(codec.FOLLOWING_ERROR_WINDOW) == codec.UNLIMITED_WINDOW
    assert not objects.map_pdos()  # none exists before it is configured


@pytest.mark.parametrize(
    ("index", "old", "new", "problem"),
    [
        ("6064", "DataType=0x0004", "DataType=0x0003", r"\[6064\] DataType: is INTEGER16, allowed: .* 32 bits"),
        ("6040", "AccessType=rw", "AccessType=ro", r"\[6040\] AccessType: ro: the driver writes it, allowed: rw"),
        ("6064", "PDOMapping=1", "PDOMapping=0", r"\[6064\] PDOMapping: 0: .* allowed: 1"),
        ("606C", "PDOMapping=1", "PDOMapping=0", None),
        ("1800sub5", "AccessType=rw", "AccessType=ro", None),
        ("1801sub5", "AccessType=rw", "AccessType=ro", None),
    ],
)
def test_object_that_does_not_fit_is_refused_by_file_index_and_allowed_value(tmp_path, index, old, new, problem):
    whole = section(index)
    path = altered(tmp_path, (whole, whole.replace(old, new)))
    if problem is None:
        Eds(path)
        return
    with pytest.raises(BadInput, match=problem) as caught:
        Eds(path)
    assert str(caught.value).startswith(str(path))


def test_object_that_is_missing_is_refused(tmp_path):
    path = altered(tmp_path, (section("6041"), ""))
    with pytest.raises(BadInput, match=r"drive\.eds: 0x6041: is missing"):
        Eds(path)


def test_homing_objects_are_needed_only_where_an_axis_homes(tmp_path):
    path = altered(tmp_path, (section("6098"), ""))
    Eds(path)
    with pytest.raises(BadInput, match="0x6098: is missing"):
        Eds(path, homing=True)


def test_optional_objects_may_be_missing(tmp_path):
    eds = Eds(altered(tmp_path, (section("60B1"), ""), (section("60FD"), ""), (section("6081"), "")))
    assert not eds.maps(codec.SETPOINT_PDO)
    assert not eds.maps(codec.STATUS_PDO)
    assert eds.maps(codec.STATUS_PDO_PLAIN)
    assert not eds.has_profiles


def test_modes_without_setpoints_are_the_only_line(tmp_path):
    path = altered(tmp_path, (section("6502"), "[6502]\nParameterName=x\nDataType=7\nDefaultValue=0x25\n"))
    with pytest.raises(BadInput, match=r"\[6502\] DefaultValue: 0x25 has neither bit 7") as caught:
        Eds(path)
    assert len(caught.value.problems) == 1


SLIPS = {
    "byte order mark": lambda text: "\ufeff" + text,
    "section in capitals": lambda text: text.replace("[1400sub1]", "[1400SUB1]"),
    "file information in lower case": lambda text: text.replace("[DeviceInfo]", "[deviceinfo]"),
    "no device information": lambda text: text.replace("[DeviceInfo]", "[Devices]"),
    "keys in capitals": lambda text: text.replace("DataType=", "DATATYPE="),
    "types in capitals": lambda text: text.replace("AccessType=rw", "AccessType=RW"),
    "spaces around": lambda text: text.replace("DataType=0x0007", "DataType = 0x0007 "),
    "doubled option": lambda text: text.replace("LSS_Supported=0", "LSS_Supported=0\nLSS_Supported=1"),
    "doubled option of an object": lambda text: text.replace("[6081]\n", "[6081]\nDataType=0x0006\n"),
    "doubled section": lambda text: text + "\n[6081]\nParameterName=Profile velocity\n",
    "wrong count of objects": lambda text: text.replace("SupportedObjects=39", "SupportedObjects=7"),
    "count that is no number": lambda text: text.replace("SupportedObjects=39", "SupportedObjects=many"),
    "wrong count of sub-indices": lambda text: text.replace("SubNumber=5", "SubNumber=2"),
    "listed without a section": lambda text: text.replace("39=0x6502", "39=0x6502\n40=0x2FFF"),
    "type of a maker": lambda text: text + "\n[2000]\nParameterName=Own\nDataType=0x0040\nAccessType=ro\n",
    "type that is no number": lambda text: text + "\n[2000]\nParameterName=Own\nDataType=real\nAccessType=ro\n",
    "default that is no number": lambda text: text + "\n[2000]\nDataType=0x0007\nDefaultValue=1.5\n",
    "limits exchanged": lambda text: text + "\n[2000]\nDataType=0x0004\nLowLimit=5\nHighLimit=-5\n",
    "line without a value": lambda text: text.replace("[FileInfo]", "[FileInfo]\nCreated by hand"),
    "text before the first section": lambda text: "exported\n" + text,
    "section that is not closed": lambda text: text + "\n[Comments\nLines=0\n",
    "ends of line of an old Mac": lambda text: text.replace("\n", "\r"),
    "percent and colons": lambda text: text.replace("ParameterName=Error code", "ParameterName=Error: 5 %(x)s"),
    "node id as makers write it": lambda text: text.replace("[6081]", "[1402sub1]\nDefaultValue=0x400+$NodeID\n[6081]"),
}


@pytest.mark.parametrize("slip", SLIPS)
def test_slip_in_a_data_sheet_refuses_no_file(tmp_path, slip):
    path = tmp_path / "drive.eds"
    changed = SLIPS[slip](SHIPPED.read_text())
    assert changed != SHIPPED.read_text()
    path.write_bytes(changed.encode())
    eds = Eds(path, homing=True)
    assert eds.streams == [codec.CYCLIC_SYNCHRONOUS_POSITION, codec.INTERPOLATED_POSITION]
    assert all(note.startswith("[") or slip == "text before the first section" for note in eds.notes)


def test_slip_in_an_object_that_is_needed_names_section_and_key(tmp_path):
    path = altered(tmp_path, (section("6041"), section("6041").replace("DataType=0x0006", "DataType=word")))
    assert Eds(path).notes == ["[6041] datatype: 'word' is no number: unknown"]  # the profile gives its type


def test_array_in_the_compact_form_is_read(tmp_path):
    compact = "[1016]\nParameterName=x\nObjectType=0x8\nDataType=0x0007\nAccessType=rw\nCompactSubObj=2\n"
    text = SHIPPED.read_text()
    first, last = text.index("[1016]"), text.index("[1017]")
    path = tmp_path / "drive.eds"
    path.write_text(text[:first] + compact + "\n[1016Value]\nNrOfEntries=1\n2=0x7F0064\n\n" + text[last:])
    eds = Eds(path)
    assert eds.can_write(codec.HEARTBEAT_CONSUMER, 1)
    assert eds.default(codec.HEARTBEAT_CONSUMER, 2) == 0x7F0064


def test_watchdog_that_a_drive_lacks_has_a_substitute_or_a_line(tmp_path):
    without_timer = (section("1400sub5"), "")
    eds = Eds(altered(tmp_path, without_timer))
    assert eds.watchdogs() == [codec.HEARTBEAT_GUARD]
    assert not eds.losses()
    eds = Eds(altered(tmp_path, without_timer, (section("6007"), "")))
    assert [line.split(":")[0] for line in eds.losses()] == ["0x6007 is missing or takes none of 3, 1, 2"]
    eds = Eds(altered(tmp_path, without_timer, (section("1016sub1"), "")))
    assert "no watchdog of the drive" in eds.losses()[0]


@pytest.mark.parametrize(("high", "code", "lost"), [(8, 6, 0), (5, 5, 0), (2, None, 1)])
def test_quick_stop_is_the_best_that_the_drive_takes(tmp_path, high: int, code: int | None, lost: int) -> None:
    limits = section("605A") + f"\nLowLimit=0\nHighLimit={high}"
    eds = Eds(altered(tmp_path, (section("605A"), limits)))
    assert eds.reaction(codec.QUICK_STOP_OPTION, codec.QUICK_STOP_REACTIONS) == code
    assert len(eds.losses()) == lost


def test_transmission_of_setpoints_that_is_fixed_is_used_as_it_is(tmp_path) -> None:
    fixed = section("1400sub2").replace("AccessType=rw", "AccessType=const\nDefaultValue=255")
    path = altered(tmp_path, (section("1400sub2"), fixed))
    with served("cia402", cia402={"eds_file": str(path)}) as (_, device, clock):
        goal = np.radians((8.0, -6.0, 3.0))
        for _ in range(80):
            device.send(goal, np.zeros(3), clock.now_s())
            clock.sleep(0.02)
        assert device.read(clock.now_s()).position == pytest.approx(goal, abs=1e-4)


def test_fixed_mapping_of_another_object_is_refused(tmp_path) -> None:
    changes = []
    for number in ("1600", "1601"):
        fixed = section(f"{number}sub1").replace("AccessType=rw", "AccessType=ro\nDefaultValue=0x60FF0020")
        changes.append((section(f"{number}sub1"), fixed))
    with pytest.raises(BadInput, match=r"\[1600sub1\] AccessType: ro: the driver maps 0x607A there, allowed: rw"):
        Eds(altered(tmp_path, *changes))


def test_fixed_identifier_of_another_use_is_refused(tmp_path) -> None:
    fixed = section("1800sub1").replace("AccessType=rw", "AccessType=ro").replace("0x80000000", "$NODEID+0x380")
    with pytest.raises(BadInput, match=r"\[1800sub1\] AccessType: ro, DefaultValue: 0x380: the driver needs 0x180"):
        Eds(altered(tmp_path, (section("1800sub1"), fixed), (section("1801sub1"), "")))


@pytest.mark.parametrize("text", ["", "[6040]\nParameterName=x\n", "no sections at all", "[DeviceInfo]\n[6040\n"])
def test_file_that_is_no_eds_is_refused(tmp_path, text):
    path = tmp_path / "drive.eds"
    path.write_text(text)
    with pytest.raises(BadInput, match=r"drive\.eds: "):
        Eds(path)


def test_driver_reads_the_eds_that_the_rig_file_names(tmp_path):
    missing = tmp_path / "none.eds"
    rig = load_rig("emulated", ["rig.turntable.cia402.channel=/nowhere", f"rig.turntable.cia402.eds_file={missing}"])
    with pytest.raises(BadInput, match=r"none\.eds: cannot be read"):
        Cia402Turntable(rig.value.turntable, WallClock())


def test_data_sheet_alone_shows_what_the_driver_will_use(capsys) -> None:
    assert execute(["preflight", "--eds", str(SHIPPED)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    for words in ("cyclic synchronous position", "0x60A9 = 0x00B50300", "0x60C2", "setpoint time-out", "by the drive"):
        assert words in printed


def test_data_sheet_of_a_drive_that_cannot_be_used_is_one_line(tmp_path, capsys) -> None:
    path = altered(tmp_path, (section("6502"), "[6502]\nParameterName=x\nDataType=7\nDefaultValue=0x25\n"))
    assert execute(["preflight", "--eds", str(path)]) == 2
    assert "[6502] DefaultValue: 0x25 has neither" in capsys.readouterr().err
