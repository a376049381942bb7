"""Set-up of a drive that is served by another implementation: canopen's LocalNode, by the wall clock."""

from __future__ import annotations

import io
from collections.abc import Iterator

import canopen
import pytest
from canopen.objectdictionary import ODVariable
from canopen.objectdictionary.eds import import_eds

from hil.config.rig import Cia402
from hil.core.clock import WallClock
from hil.drivers.can_port import CanPort
from hil.drivers.turntable.cia402 import codec as codec
from hil.drivers.turntable.cia402.eds import SHIPPED, Eds
from hil.drivers.turntable.cia402.eds_file import read_data_sheet
from hil.drivers.turntable.cia402.sdo import PortNetwork
from hil.drivers.turntable.cia402.setup import DriveSetup

pytestmark = pytest.mark.wires

BUS = {"interface": "virtual", "channel": "canopen-node"}


@pytest.fixture
def node() -> Iterator[canopen.LocalNode]:
    network = canopen.Network()
    network.connect(**BUS)
    served = canopen.LocalNode(1, str(SHIPPED))
    network.add_node(served)
    for pair in ((0x608F, 1, 10_000_000), (0x608F, 2, 1), (0x6061, 0, 8)):
        served.set_data(pair[0], pair[1], pair[2].to_bytes(4 if pair[0] == 0x608F else 1, "little"))
    try:
        yield served
    finally:
        network.disconnect()


@pytest.mark.parametrize("modes", [0xE1, 0x60])
def test_drive_of_another_implementation_is_set_up(node: canopen.LocalNode, modes: int) -> None:
    node.set_data(0x6502, 0, modes.to_bytes(4, "little"))
    config, clock = Cia402(**BUS), WallClock()
    port = CanPort("turntable", config, clock)
    try:
        setup = DriveSetup(port, PortNetwork(port), 1, "turntable.roll", Eds(SHIPPED), lambda *_: None, clock)
        setup.identify(config)
        setup.configure(0.4, 0.5, 0.05, 0.02, config.master_id)
    finally:
        port.close()

    def value(index: int, subindex: int = 0) -> int:
        return int.from_bytes(node.get_data(index, subindex), "little")

    target = codec.TARGET_POSITION << 16 | 32 if modes == 0xE1 else codec.INTERPOLATION_DATA << 16 | 1 << 8 | 32
    assert value(0x1600, 1) == target
    assert value(0x6060) == (8 if modes == 0xE1 else 7)
    assert (value(0x60C2, 1), value(0x6007), value(0x605A), value(0x1400, 5)) == (20, 3, 6, 500)
    assert [value(0x1400, 1), value(0x1801, 1)] == [0x201, 0x281]


def test_data_sheet_is_read_as_canopen_reads_it() -> None:
    ours = read_data_sheet(SHIPPED).variables
    theirs = import_eds(io.StringIO(SHIPPED.read_text()), None)
    entries = [[each] if isinstance(each, ODVariable) else list(each.values()) for each in theirs.values()]
    variables = {(each.index, each.subindex): each for entry in entries for each in entry}
    assert ours.keys() == variables.keys()
    for key, each in variables.items():
        shown = (ours[key].data_type, ours[key].access, ours[key].is_mappable)
        assert shown == (each.data_type, each.access_type, each.pdo_mappable)
        if not isinstance(each.default, str):
            assert ours[key].number == each.default
