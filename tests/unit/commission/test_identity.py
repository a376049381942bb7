"""Identity lines of commissioning: only what the rig's driver has checked is reported as expected."""

from __future__ import annotations

import pytest

from hil.config.load import load_rig
from hil.parts.commissioning.identity import expected_identity


@pytest.mark.parametrize("rig", ["mock", "emulated"])
def test_each_axis_group_reports_the_identity_that_its_own_driver_checks(rig: str) -> None:
    tables = load_rig(rig).value
    lines = expected_identity(tables)
    assert [line.split(":")[0] for line in lines] == ["rails", "turntable"]
    for line, table in zip(lines, (tables.rails, tables.turntable), strict=True):
        required = table.entry.identity(table) if table.has_wires else {}
        assert line.endswith(": as expected" if required else "responds; the rig file requires no identity")
        assert all(f"{name} {value}" in line for name, value in required.items())


def test_rails_of_a_mock_rig_have_no_vendor() -> None:
    assert expected_identity(load_rig("mock").value)[0] == (
        "rails: three axes, responds; the rig file requires no identity"
    )
