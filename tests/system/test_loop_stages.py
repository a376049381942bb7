"""``benchmarks/loop_stages.py``: the loop with time stamps is that of the program, and no call of it is left out."""

from __future__ import annotations

import numpy as np

from benchmarks.loop_stages import fly, stamped_loop


def test_stamped_calls_are_those_of_the_loop_and_add_up_to_its_cycle() -> None:
    loop, rows = stamped_loop()
    flight = fly("scheme-1", ("duration_s=20.0",), 3, loop, len(rows))
    spent = dict(zip(rows, flight.rows_ns, strict=True))
    assert set(spent) >= {"core.check_axes", "core.advance", "count_cycle", "_run_gnc, with a pose", "_send_setpoint"}
    assert np.sum(flight.rows_ns) > 0.7 * flight.plain_ns
    assert flight.poses > 0
