"""A stop asked for in each mode and phase of an attended bench: time to rest, and the chain; devices that lose power.

``pytest -s tests/system/test_stop_in_each_phase.py`` prints the times.
"""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

import pytest

from hil.core.modes import Mode
from tests.system.test_killed_in_each_mode import DROP_M, STANDING_MPS, Bench, bench, stop_times

pytestmark = [pytest.mark.wires, pytest.mark.slow]

STANDS_S = 1.3  # a ramp from 0.25 m/s, standstill, and a busy computer
TORQUE_OFF_S = 2.0  # after the brakes have closed
PHASES = ("standby", "homing", "jogging", "placing", "armed", "running", "hold", "abort", "retreat", "parking")
_BRAKING_S, _RETREATING_S = 0.5, 6.0


def bring_to(made: Bench, phase: str) -> None:
    """Lead the bench into ``phase``; abort and retreat are those of the chaser, while running."""
    made.bring_to("running" if phase in ("abort", "retreat") else phase)
    if phase in ("abort", "retreat"):
        made.order("abort")
        time.sleep(_BRAKING_S if phase == "abort" else _RETREATING_S)
    assert made.has_torque(), "the relay opened before: the computer paused for more than its 50 ms"


@pytest.mark.parametrize("phase", PHASES)
def test_stop_brings_the_axes_to_rest_before_the_chain_opens(tmp_path: Path, phase: str) -> None:
    with bench(tmp_path) as made:
        bring_to(made, phase)
        (z_m, z_mps), speed = made.z(), made.speed()
        made.order("stop")
        stands, opened = stop_times(made)
        time.sleep(0.3)
        drop_m = z_m - made.z()[0]
        assert stands is not None
        assert opened is not None
        print(  # noqa: T201
            f"{phase:9}: {1e3 * speed:4.0f} mm/s, stands {1e3 * stands:4.0f} ms, torque off {1e3 * opened:4.0f} ms, "
            f"z drop {1e3 * drop_m:+.2f} mm"
        )
        assert stands < STANDS_S
        assert stands <= opened < TORQUE_OFF_S
        assert made.speed() < STANDING_MPS
        if abs(z_mps) < 1e-3:
            assert abs(drop_m) < DROP_M


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "hanging"])
@pytest.mark.parametrize("device", ["turntable", "vmu", "io"])
@pytest.mark.parametrize("phase", ["jogging", "placing", "armed", "running", "hold", "parking"])
def test_device_that_loses_its_power_stops_the_bench(
    tmp_path: Path, phase: str, device: str, how: signal.Signals
) -> None:
    """A vision unit is not needed to move axes outside a run; the rails stand in all other cases."""
    with bench(tmp_path) as made:
        bring_to(made, phase)
        os.kill(made.emulated.pids[device], how)
        begun = time.monotonic()
        while made.modes[-1] not in (Mode.SAFE_STOP.value, "off") and time.monotonic() - begun < 3.0:
            time.sleep(0.002)
        noticed = time.monotonic() - begun
        stopped = made.modes[-1] in (Mode.SAFE_STOP.value, "off")
        time.sleep(1.5)
        speed = made.speed() if device != "turntable" else float(abs(made.rail_rates()).max())
        print(  # noqa: T201
            f"{phase:9} {device:9} {how.name}: {made.modes[-1]} after {1e3 * noticed:4.0f} ms, "
            f"{1e3 * speed:.1f} mm/s 1.5 s later, torque {'on' if made.has_torque() else 'off'}"
        )
        assert stopped == (device != "vmu" or phase == "running")
        if stopped:
            assert speed < STANDING_MPS
            assert device == "io" or not made.has_torque()
        os.kill(made.emulated.pids[device], signal.SIGCONT) if how is signal.SIGSTOP else None
