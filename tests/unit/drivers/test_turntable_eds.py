"""The shipped EDS is the emulated drive's; an EDS that lacks what the driver needs is refused line by line."""

from __future__ import annotations

import pytest

from hil.config.load import load_rig
from hil.core.clock import WallClock
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.driver import Cia402Turntable
from hil.drivers.turntable.cia402.eds import SHIPPED, Eds
from hil.drivers.turntable.cia402.objects import ObjectDictionary
from hil.errors import BadInput


def altered(tmp_path, *changes):
    text = SHIPPED.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    path = tmp_path / "drive.eds"
    path.write_text(text)
    return path


def section(index):
    """Return one section of the shipped EDS."""
    text = SHIPPED.read_text()
    start = text.index(f"[{index}]")
    return text[start:].split("\n\n")[0]


def test_shipped_eds_has_what_the_driver_needs_for_homing_and_profiles():
    assert Eds(SHIPPED, homing=True).has_profiles


def test_emulated_drive_starts_with_the_defaults_of_its_eds():
    objects = ObjectDictionary(500)
    assert objects.value(codec.SETPOINT_PDO.parameter, codec.PDO_EVENT_TIMER) == 500
    assert objects.value(codec.FOLLOWING_ERROR_WINDOW) == codec.UNLIMITED_WINDOW
    assert not objects.map_pdos()  # none exists before it is configured


@pytest.mark.parametrize(
    ("index", "old", "new", "problem"),
    [
        ("6064", "DataType=0x0004", "DataType=0x0003", r"0x6064: DataType is INTEGER16, allowed: INTEGER32"),
        ("6040", "AccessType=rw", "AccessType=ro", r"0x6040: AccessType=ro: the driver writes it, allowed: rw"),
        ("606C", "PDOMapping=1", "PDOMapping=0", r"0x606C: PDOMapping=0: .* allowed: 1"),
        ("1800sub5", "AccessType=rw", "AccessType=ro", None),
        ("1801sub5", "AccessType=rw", "AccessType=ro", r"0x1801 sub 5: AccessType=ro"),
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
