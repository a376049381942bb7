"""A library that never returns: the loop hangs in it, the bench comes to a stand all the same."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from tests.support.external_gnc import c_example
from tests.system.test_killed_processes import GENEROUS_S, running

pytestmark = pytest.mark.wires


@pytest.mark.slow
def test_the_axes_stand_after_a_library_has_hung(tmp_path: Path) -> None:
    flag = tmp_path / "hang"
    library = c_example(
        tmp_path,
        "hanging.so",
        "#include <math.h> => #define _DEFAULT_SOURCE\n#include <unistd.h>\n#include <math.h>",
        f'    gnc_state *g = gnc; =>     gnc_state *g = gnc; while (access("{flag}", F_OK) == 0) usleep(100000);',
    )
    with running(tmp_path, f"gnc.library={library}") as bench:
        bench.wait_for_speed(0.02)
        flag.touch()
        hung_s = time.monotonic()
        braking_s, stood_s = bench.times_to_stop(GENEROUS_S)
        assert braking_s is not None
        assert stood_s is not None
        print(f"brakes after {1e3 * braking_s:.0f} ms, stands after {1e3 * stood_s:.0f} ms")  # noqa: T201
        assert bench.controller.poll() is None, f"the loop returned after {time.monotonic() - hung_s:.1f} s"
