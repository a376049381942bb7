"""Rig files with fixed and absent axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hil.config.load import load_rig
from hil.config.motion_digest import motion_digest
from hil.config.rig import check_ids
from hil.config.tables import driver_registry
from hil.config.tables.driver_registry import DriverEntry, check_axes
from hil.core.messages import AxisFeedback, Homing
from hil.errors import BadInput
from tests.support.lab_benches import BENCHES, rig_file
from tests.support.run_settings import HARDWARE_WIRES

NO_RAILS = tuple(f"rig.rails.{name}.fixed_m=0.0" for name in "xyz")


def refusal(*settings: str, base: str = "emulated") -> str:
    with pytest.raises(BadInput) as refused:
        load_rig(base, settings)
    return str(refused.value)


def test_fixed_axis_needs_its_position_alone(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        'extends = "emulated"\nname = "lab"\n[rails]\nz = { fixed_m = 0.4 }\n[turntable.roll]\nfixed_deg = 90\n',
        encoding="utf-8",
    )
    rig = load_rig(str(path)).value
    assert rig.rails.driven == ("x", "y")
    assert rig.rails.z.si("travel") == (0.4, 0.4)
    assert rig.turntable.driven == ("pitch", "yaw")
    assert rig.undriven == ["rails.z", "turntable.roll"]
    assert rig.rails.z.brake is None
    assert [part.axis_names for part in rig.rails.parts("rails").values()] == [("x", "y")]


def test_absent_axis_is_fixed_at_zero() -> None:
    table = load_rig("mock").value.rails.model_dump(mode="json")
    rails = type(load_rig("mock").value.rails).model_validate(
        {name: value for name, value in table.items() if name != "z"}, strict=False
    )
    assert rails.driven == ("x", "y")
    assert rails.z.fixed_m == 0.0


def test_group_without_a_drive_has_no_wire() -> None:
    rig = load_rig("emulated", NO_RAILS).value
    assert rig.rails.parts("rails") == {}
    assert "rails" not in rig.device_tables()
    assert not [wire for wire in rig.wires() if wire.key.startswith("rails")]
    none = load_rig("emulated", ('rig.rails.driver="none"', *NO_RAILS)).value
    assert "rails" not in none.device_tables()


def test_driver_none_does_not_drive() -> None:
    text = refusal('rig.rails.driver="none"')
    assert 'rails.driver = "none": drives no axis, allowed: fixed x, y, z' in text


def test_controller_of_a_fixed_axis_is_refused() -> None:
    text = refusal("rig.rails.z.fixed_m=0.0", 'rig.rails.controllers=[{axes = ["z"], driver = "modbus_rtu", rtu = {}}]')
    assert 'axis "z", allowed: x, y' in text


def test_other_keys_of_a_fixed_axis_are_spelled_right() -> None:
    assert "fixed_mm" in refusal("rig.rails.z.fixed_m=0.0", "rig.rails.z.fixed_mm=1.0")


def test_fixed_middle_gimbal_is_off_the_pole() -> None:
    assert "fixed_deg 90: the middle gimbal" in refusal("rig.turntable.pitch.fixed_deg=90.0")


def test_axes_of_the_lab_are_right_handed() -> None:
    text = refusal("rig.bench.lab_axes=[[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]]")
    assert "lab_axes must be three right-handed unit axes" in text


@pytest.mark.parametrize("kind", ["mock", "emulated"])
@pytest.mark.parametrize("bench", BENCHES)
def test_rig_file_of_a_bench_is_short(bench: str, kind: str, tmp_path: Path) -> None:
    path = rig_file(tmp_path, bench, kind)
    assert len(Path(path).read_text(encoding="utf-8").splitlines()) <= 30
    assert load_rig(path).value.name == "lab"


def test_keys_of_fixed_axes_void_no_sign_off(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(f'extends = "emulated"\nname = "lab"\nkind = "hardware"\n{HARDWARE_WIRES}', encoding="utf-8")
    rig = load_rig(str(path)).value
    given = rig.model_dump(mode="json")
    assert given["rails"]["x"]["fixed_m"] is None
    fixed = load_rig(str(path), ["rig.rails.y.fixed_m=0.0"]).value
    turned = load_rig(str(path), ["rig.bench.lab_axes=[[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]"]).value
    assert len({motion_digest(each) for each in (rig, fixed, turned)}) == 3


def test_driver_of_one_axis_drives_any_axis(monkeypatch: pytest.MonkeyPatch) -> None:
    one = DriverEntry("turntable", "one", "module:factory", axes=range(1, 2))
    real = driver_registry.driver_entry
    monkeypatch.setattr(
        driver_registry, "driver_entry", lambda device, name: one if name == "one" else real(device, name)
    )
    names = ("roll", "pitch", "yaw")
    check_axes("driver", "turntable", "one", ("yaw",), names)
    with pytest.raises(ValueError, match="drives 1, any of them, here pitch, yaw"):
        check_axes("driver", "turntable", "one", ("pitch", "yaw"), names)


@pytest.mark.parametrize("n", [1, 2, 3, 6])
def test_feedback_of_any_number_of_axes_has_defaults(n: int) -> None:
    feedback = AxisFeedback(0.0, np.zeros(n), np.zeros(n))
    assert feedback.homing == (Homing.DONE,) * n
    assert feedback.limit == (0,) * n


def test_ids_of_drives_are_one_for_each_axis_that_is_driven_or_that_could_be() -> None:
    table = load_rig("emulated").value.turntable.model_copy(update={"roll": None, "pitch": None})
    assert table.axis_names == ("yaw",)
    for ids in ((5,), (4, 6, 5)):
        check_ids("node_ids", ids, table)
        assert table.ids_of(ids) == (5,)
    with pytest.raises(ValueError, match=r"has none for yaw, allowed: one for each of roll, pitch, yaw, or of yaw$"):
        check_ids("node_ids", (1, 2), table)
