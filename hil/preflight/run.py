"""Preflight: all checks in order."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hil.checks.before_run import unseen_warnings
from hil.checks.compatibility import check_approach, check_plan, requires_sign_off
from hil.checks.ephemeris import ephemeris_warnings
from hil.checks.signed_record import MEASURED_S, proof_gap
from hil.checks.truth import check_truth
from hil.config.load import Loaded
from hil.config.rig import Rig
from hil.config.scenario import Scenario
from hil.core.part import hooks, provided
from hil.preflight import lateness
from hil.preflight.check import PreflightCheck, all_passed
from hil.preflight.host import HostFacts, host_checks, probe_host
from hil.preflight.lateness import Lateness, lateness_check, measure, pause_check

Probe = Callable[[Path], HostFacts]
Meter = Callable[[float, float], Lateness]
"""Returns the lateness of an empty loop: of its period, s, and the duration of the measurement, s."""


@dataclass(frozen=True, slots=True)
class Preflight:
    """Results of a preflight; ``lateness`` is None if it could not be measured."""

    checks: list[PreflightCheck]
    lateness: Lateness | None
    rate_hz: float

    @property
    def passed(self) -> bool:
        return all_passed(self.checks)

    def numbers(self) -> dict[str, Any]:
        """Return all results for JSON."""
        late = self.lateness
        return {
            "passed": self.passed,
            "rate_hz": self.rate_hz,
            "lateness_us": late.percentiles_us if late else None,
            "lateness_histogram": [{**b, "up_to_us": b["below_us"]} for b in late.histogram] if late else None,
            "checks": [{"name": c.name, "passed": c.passed, "value": c.value, "advice": c.advice} for c in self.checks],
        }


def preflight(
    scenario: Loaded[Scenario],
    rig: Loaded[Rig],
    folder: Path,
    enable_drives: bool,
    announce: Callable[[str], None] = lambda _: None,
    probe: Probe = probe_host,
    meter: Meter = measure,
    now_unix_s: Callable[[], float] = time.time,
) -> Preflight:
    """Return the results of all checks.

    folder: where runs are written. announce: called with each step. probe, meter: read the facts of the host and
    measure its lateness. now_unix_s: returns the time, for the due date of the proof test.
    """
    run = scenario.value
    announce("reading the operating system")
    cycles = round(run.duration_s / run.step_s) + 1
    on_hardware = rig.value.kind == "hardware"
    checks = host_checks(probe(folder), cycles, on_hardware)
    announce("checking the planned trajectory")
    checks.append(reachability_check(scenario, rig))
    checks += [PreflightCheck("axes", None, line) for line in unseen_warnings(run, rig.value)]
    checks += [PreflightCheck("orbit", None, line) for line in ephemeris_warnings(run, rig.value, run.duration_s)]
    if rig.value.kind != "mock":
        checks.append(overtravel_check(rig.value))
    if on_hardware:
        checks.append(proof_test_check(rig, now_unix_s()))
    announce("opening the devices")
    checks += device_checks(run, rig.value, enable_drives)
    announce("measuring the lateness")
    try:
        duration_s = {"hardware": MEASURED_S + run.step_s, "emulated": lateness.WIRED_S}
        late = meter(run.step_s, duration_s.get(rig.value.kind, lateness.DURATION_S))
    except RuntimeError as error:
        return Preflight([*checks, PreflightCheck("lateness", False, str(error))], None, 1.0 / run.step_s)
    checks.append(lateness_check(late))
    if rig.value.kind != "mock":
        io = rig.value.io
        checks.append(pause_check(late, io.pump_timeout_s if io is not None else None, on_hardware))
    return Preflight(checks, late, 1.0 / run.step_s)


def device_checks(scenario: Scenario, rig: Rig, enable_drives: bool) -> list[PreflightCheck]:
    """Return the checks of the clock, of the rig's links and of its devices.

    Rails and turntable of a hardware rig are opened only with ``enable_drives``: opening enables their drives, which
    then hold their positions.
    """
    if rig.kind == "mock":
        in_memory = PreflightCheck("devices", None, "in memory: no links, no devices")
        return [in_memory, *(each for check in hooks("preflight", scenario, rig) for each in check(rig))]
    checks: list[PreflightCheck] = provided(f"rig.kind={rig.kind}: preflight", rig.name)(scenario, rig, enable_drives)
    return checks


def reachability_check(scenario: Loaded[Scenario], rig: Loaded[Rig]) -> PreflightCheck:
    """Return the check that the rig can realise the planned trajectory of the scenario."""
    problems = check_truth(scenario) or [*check_plan(scenario, rig), *check_approach(scenario)]
    name = f"reachability of {scenario.value.name}"
    if not problems:
        return PreflightCheck(
            name, True, "travel, speed, acceleration, gimbals and view are sufficient for the plan with its dispersion"
        )
    text = "; ".join(str(problem) for problem in problems)
    return PreflightCheck(name, False, text, "change the named key of the scenario or limit of the rig")


def proof_test_check(rig: Loaded[Rig], now_unix_s: float) -> PreflightCheck:
    """Return the check that emergency stop, safety chain and brakes were tested, and are not due to be tested again."""
    gap, text = proof_gap(rig, now_unix_s)
    if not gap:
        return PreflightCheck("proof test", True, text)
    advice = f"hil commission {rig.source} --proof-test tests emergency stop, safety chain and brakes"
    return PreflightCheck("proof test", False if requires_sign_off(rig.value) else None, f"{gap}: {text}", advice)


def overtravel_check(rig: Rig) -> PreflightCheck:
    """Return how far the hard-wired overtravel switches must lie beyond the soft limits: v^2 / 2a of each axis."""
    texts = []
    for device, table, unit in (("rails", rig.rails, "m"), ("turntable", rig.turntable, "deg")):
        for name in table.driven:
            axis = getattr(table, name)
            path = axis.in_file("rate_max") ** 2 / (2.0 * axis.in_file("acceleration_max"))
            texts.append(f"{device}.{name} {path:.2f} {unit}")
    value = f"hard-wired switches at least this far beyond the travel: {', '.join(texts)}"
    return PreflightCheck("overtravel", None, value, "measure it: their places are not in the rig file")
