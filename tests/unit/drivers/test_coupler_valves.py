"""Valves of a floating vehicle at the coupler: they have power while the relay is closed, as long as it is pulsed."""

from __future__ import annotations

from hil.config.load import load_rig
from hil.parts.emulation.digital_io import EmulatedCoupler

PERIOD_S = 0.01


def coupler() -> EmulatedCoupler:
    io = load_rig("emulated-floating").value.io
    assert io is not None
    return EmulatedCoupler(io, io.pump_timeout_s)


def pulse(of: EmulatedCoupler, begin_s: float, end_s: float) -> None:
    """Pulse the charge pump, with enable on from the second pulse on."""
    pump, enable = of.map.coils[:2]
    for k in range(round((end_s - begin_s) / PERIOD_S)):
        of.image.coils[pump] = not of.image.coils[pump]
        of.image.coils[enable] = k > 0
        of.advance(begin_s + k * PERIOD_S)


def test_valves_close_when_the_pulses_cease() -> None:
    it = coupler()
    it.image.coils[it.map.thrusters[2]] = True
    assert not it.advance(0.0).thrusters
    pulse(it, 0.1, 0.3)
    assert it.advance(0.3).thrusters[:4] == b"\0\0\1\0"
    assert it.advance(0.33).thrusters[2]
    assert not it.advance(0.36).thrusters  # 0.05 s after the last pulse, at 0.29 s


def test_emergency_stop_closes_the_valves() -> None:
    it = coupler()
    it.image.coils[it.map.thrusters[0]] = True
    pulse(it, 0.1, 0.3)
    assert it.advance(0.3).thrusters[0]
    it.faults.on("estop")
    it.advance(0.31)
    assert not it.advance(0.33).thrusters  # within the time in which the relay opens
