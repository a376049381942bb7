"""Each cycle's records go to the sides that request them, and to the telemetry in any case."""

from __future__ import annotations

import time

import numpy as np

from hil.core.messages import CYCLE
from hil.frmn.mailboxes import GNC_FILTERS, MAILBOXES, Role
from hil.parts.links.link import Link
from hil.parts.links.mirror import MIRRORED, Mirror
from hil.parts.links.udp_receiver import ReceiveBuffers


class Rows:
    def __init__(self) -> None:
        self.rows = 0

    def put(self, row: np.ndarray) -> None:
        self.rows += 1


def test_cells_that_are_wanted_arrive_with_what_the_cycle_had() -> None:
    inner = Rows()
    wants = ("gnc.setup", "truth", "setpoint", "health")
    bench = Link(Role.DSS, "bench", ("gnc.setup", *MIRRORED), ("gnc.output",), ("127.0.0.1", 0))
    viewer = Link(Role.GNC, "viewer", ("gnc.output",), wants, None, bench.address)
    mirror = Mirror(bench)
    mirror.over(inner)
    mirror.begin(lambda: "running", lambda: 3)
    row = np.zeros(1, CYCLE)
    mirror.put(row)  # no reader is there yet
    viewer.service()
    viewer_is_there(bench)
    bench.send("gnc.setup", np.zeros(1, MAILBOXES["gnc.setup"].dtype))
    row["t_s"], row["lateness_s"], row["truth"]["mass_kg"], row["setpoint"]["rail_m"] = 0.02, 1e-5, 999.0, 3.0
    mirror.put(row)
    time.sleep(0.02)
    came = {arrival.name: arrival.record for arrival in viewer.poll()}
    assert set(came) == set(wants)
    assert came["truth"] == row["truth"]
    assert came["setpoint"] == row["setpoint"]
    assert came["health"][0].item() == (1, 0.02, b"running", 1e-5, 3)
    assert inner.rows == 2
    bench.close()
    viewer.close()


def test_other_computers_get_the_rows_of_the_telemetry_rate() -> None:
    bench = Link(Role.DSS, "bench", ("gnc.setup", *MIRRORED), ("gnc.output",), ("127.0.0.1", 0))
    viewer = Link(Role.GNC, "viewer", ("gnc.output",), ("gnc.setup", "health"), None, bench.address)
    inner = Rows()
    mirror = Mirror(bench, 5)
    mirror.over(inner)
    mirror.begin(lambda: "running", lambda: 0)
    viewer.service()
    viewer_is_there(bench)
    bench.send("gnc.setup", np.zeros(1, MAILBOXES["gnc.setup"].dtype))
    cycles = []
    for _ in range(11):
        mirror.put(np.zeros(1, CYCLE))
        time.sleep(0.005)
        cycles += [int(arrival.record["cycle"][0]) for arrival in viewer.poll() if arrival.name == "health"]
    assert cycles == [0, 5, 10]
    assert inner.rows == 11
    bench.close()
    viewer.close()


def viewer_is_there(bench: Link) -> None:
    give_up_s = time.monotonic() + 5.0
    while not bench.joined:
        assert time.monotonic() < give_up_s
        bench.poll()


def test_filters_that_are_sent_again_do_not_count_in_a_later_cycle() -> None:
    inbox, told = ReceiveBuffers(), np.zeros(1, GNC_FILTERS)
    told["cycle"] = 7
    inbox.take_filters(told)
    assert inbox.filters_of == 7
    inbox.filters_of = -1  # used
    inbox.take_filters(told)
    assert inbox.filters_of == -1
